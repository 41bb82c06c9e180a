"""ReAct: look, think, look again, answer; the whole history travels with every turn.

The loop is the benchmark's: the first turn must look; a look within 1 degree of an earlier one of the same frame is
refused with the reason; a malformed turn costs a turn, and the next one is told the error; the evidence is a box in the
newest crop. An answer that is not taken ends the question only where it is sent again as it was. At the end the newest
readable answer and box count. Every crop made so far, or the last few, is sent again with its metadata, so a turn needs
nothing but its own request: servers may be stateless, and a finished call can be replayed from its request alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

from jrdb_avr.agent.methods.attempt import (
    DUPLICATE_DEG,
    Attempt,
    ImageFrame,
    ParsedReply,
    final_parts,
    heading,
    history_settings,
    on_crop,
    shared_settings,
)
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.messages import Message, Part, Picture, metadata_line, picture_of, with_last_pictures
from jrdb_avr.agent.model.prompts import frame_ranges, mode_text, render
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Prediction, Question, Task
from jrdb_avr.schema.panorama import CROP

BUDGET: Final = 24

_NO_PICTURE: Final = ImageFrame((), CROP, CROP, 0)
"""Stands for the newest picture before the first look: every box in an answer is refused."""


@dataclass(frozen=True)
class ReAct:
    """The method `react` with a budget of observations; at most twice as many model calls and two.

    history: how many of the newest crops are sent in each turn, of others their metadata alone; None: all.
    """

    name: ClassVar = "react"

    chat: Chat
    convention: Convention = CONTRACT
    budget: int = BUDGET
    history: int | None = None

    @property
    def most_calls(self) -> int:
        return 2 * self.budget + 2

    def settings(self) -> dict[str, Any]:
        """The method's settings in a run's manifest."""
        return {
            "budget": self.budget,
            "most_calls": self.most_calls,
            "duplicate_deg": DUPLICATE_DEG,
            **history_settings(self.history),
            **shared_settings(self.convention),
        }

    def answer(self, task: Task) -> Prediction:
        """Play one question to its answer, or to the last allowed call."""
        episode = _Episode(task, self)
        while episode.attempt.calls < self.most_calls and not episode.ended:
            episode.turn()
        left = "" if episode.ended else f"no answer was taken within {self.most_calls} turns"
        return episode.attempt.prediction(replace(episode.kept, refusal=left))


@dataclass
class _Episode:
    """One question being played.

    kept: the newest readable answer and box, and why the last malformed turn was; refused: the last answer that was not
    taken, where no look was made since.
    """

    task: Task
    method: ReAct
    looks: list[tuple[Observation, Picture]] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)
    error: str = ""
    kept: ParsedReply = field(default_factory=ParsedReply)
    refused: Mapping[str, Any] | None = None
    ended: bool = False

    def __post_init__(self) -> None:
        question, sequence = self.task.question, self.task.sequence
        self.attempt = Attempt(self.task, self.method.chat, self.method.convention)
        text = mode_text(question.answer_mode, sequence.frame_count)
        self.system = render(
            "react_system",
            fps=f"{sequence.fps:g}",
            answer_form=text.form,
            answer_rule=text.rule,
            budget=self.method.budget,
            calls=self.method.most_calls,
        )
        self.heading = render(
            "react_task", heading=heading(question), frames=frame_ranges(sequence.frames), advice=text.advice
        )
        self.schema = react_turn_schema(question)

    # -- one turn -----------------------------------------------------------------------------------------------------

    def turn(self) -> None:
        """One model call and what follows from it."""
        reply = self.attempt.ask(self.messages(), self.schema)
        self.error = ""
        try:
            move = decode.reply_object(reply, self.method.convention)
            match move.get("action"):
                case "observe":
                    self._observe(move)
                case "answer":
                    self._answer(move)
                case _:
                    raise DecodeError('"action" must be "observe" or "answer"')
        except DecodeError as error:
            self.error = str(error)
            self.steps.append(f"malformed: {self.error}")
            self.kept = replace(self.kept, faults=(self.error,))

    def _observe(self, move: Mapping[str, Any]) -> None:
        decode.only_keys(move, ("action", "frame_id", "angle_deg"), "an observe turn")
        frame, angle = self.attempt.read_look(move)
        if len(self.looks) >= self.method.budget:
            raise DecodeError("no looks are left: answer now")
        if reason := self.attempt.duplicate(frame, angle):
            self.steps.append(f"look at frame {frame:06d}, angle {angle:g}: refused, {reason}")
            return
        observation = self.attempt.look(frame, angle)
        self.looks.append((observation, picture_of(observation)))
        self.refused = None
        self.steps.append(f"look at frame {frame:06d}, angle {angle:g}: picture {len(self.looks)}")

    def _answer(self, move: dict[str, Any]) -> None:
        """Take the answer, or keep what can be read of it. Raises DecodeError."""
        del move["action"]
        again, self.refused = move == self.refused, move
        image = on_crop(self.looks[-1][0]) if self.looks else _NO_PICTURE
        parsed = self.attempt.parse_final(move, image)
        self.kept = parsed.over(self.kept)
        self.ended = again or not parsed.faults
        if parsed.faults:
            raise DecodeError("; ".join(parsed.faults) if self.looks else "the first turn must look")

    # -- what the model gets ------------------------------------------------------------------------------------------

    def messages(self) -> list[Message]:
        """The system prompt, then question and legal frames, every crop with its metadata, and the state at the end.

        A turn's messages begin as those of the turn before up to its newest picture, so that a server can keep its work
        on the common beginning.
        """
        parts: list[Part] = [self.heading]
        for number, (observation, picture) in enumerate(self.looks, 1):
            parts += [f"Picture {number}: {metadata_line(observation)}", picture]
        frames = sorted({observation.frame_id for observation, _ in self.looks})
        left = self.method.budget - len(self.looks)
        parts.append(
            render(
                "react_state",
                steps="\n".join(f"{n}. {step}" for n, step in enumerate(self.steps, 1)) or "none",
                seen=", ".join(frames) or "none",
                newest=len(self.looks) or "none",
                used=len(self.looks),
                left=left,
                then="answer when you can" if left else "no looks are left, so this turn must answer",
                turns=self.method.most_calls - self.attempt.calls,
                error=f"Your last turn was malformed, and cost a turn: {self.error}" if self.error else "",
            )
        )
        messages = [Message("system", (self.system,)), Message("user", tuple(parts))]
        return with_last_pictures(messages, self.method.history)


def react_turn_schema(question: Question) -> dict[str, Any]:
    """The JSON Schema of a turn: a look, or the answer."""
    look = {"frame_id": decode.FRAME_ID_SCHEMA, "angle_deg": {"type": "number"}}
    actions = {"observe": look, "answer": final_parts(question)}
    return {
        "anyOf": [
            decode.closed_object({"action": {"type": "string", "enum": [action]}, **parts})
            for action, parts in actions.items()
        ]
    }
