"""ReAct: look, think, look again, answer; the whole history travels with every turn.

The loop is the benchmark's: the first turn must look; a look within 1 degree of an earlier one of the same frame is
refused and told why; a malformed turn is shown its error once and the second one ends the question as invalid; the
evidence is a box in the newest crop. Every crop made so far is sent again with its metadata, so a turn needs nothing
but its own request: servers may be stateless, and a finished call can be replayed from its request alone.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec

from jrdb_avr.schema.answers import TIE, Answer, Evidence, encode_answer
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Prediction, Step, Task
from jrdb_avr.schema.panorama import CROP, angle_error, from_crop

from . import decode
from .client import Chat
from .decode import Convention
from .messages import Message, Part, Picture, crop_picture, transcript
from .prompt import choice_lines, frame_ranges, mode_text, render

BUDGET: Final = 24
DUPLICATE_DEG: Final = 1.0


@dataclass(frozen=True)
class ReAct:
    """The method `react` with a budget of observations; at most twice as many model calls and two."""

    chat: Chat
    convention: Convention = decode.CONTRACT
    budget: int = BUDGET

    @property
    def name(self) -> str:
        return "react"

    @property
    def most_calls(self) -> int:
        return 2 * self.budget + 2

    def settings(self) -> dict[str, Any]:
        """What the manifest of a run says of the method."""
        return {
            "budget": self.budget,
            "most_calls": self.most_calls,
            "duplicate_deg": DUPLICATE_DEG,
            "convention": {"name": self.convention.name, "boxes": self.convention.boxes},
        }

    def answer(self, task: Task) -> Prediction:
        """Play one question to its answer, to the second malformed turn, or to the last allowed call."""
        episode = _Episode(task, self)
        while episode.calls < self.most_calls:
            prediction = episode.turn()
            if prediction is not None:
                return prediction
        return episode.ended(f"no answer within {self.most_calls} turns")


@dataclass(frozen=True)
class _Look:
    """An observation with its picture as sent."""

    observation: Observation
    picture: Picture


@dataclass
class _Episode:
    """One question being played."""

    task: Task
    method: ReAct
    looks: list[_Look] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)
    calls: int = 0
    error: str = ""
    strikes: int = 0
    raw: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0

    def __post_init__(self) -> None:
        question, sequence = self.task.question, self.task.sequence
        self.legal = frozenset(sequence.frames)
        text = mode_text(question.answer_mode, sequence.frame_count)
        choices = choice_lines(question.choices)
        self.system = render(
            "react_system",
            fps=f"{sequence.fps:g}",
            answer_form=text.form,
            answer_rule=text.rule,
            budget=self.method.budget,
            calls=self.method.most_calls,
        )
        self.heading = render(
            "react_task",
            question=question.question,
            mode=question.answer_mode,
            choices=f"Choices:\n{choices}" if choices else "No choices.",
            frames=frame_ranges(sequence.frames),
            advice=text.advice,
        )
        self.schema = self._schema()

    # -- one turn -----------------------------------------------------------------------------------------------------

    def turn(self) -> Prediction | None:
        """One model call and what follows from it; a prediction when the question has ended."""
        messages = self.messages()
        started = time.perf_counter()
        reply = self.method.chat.complete(messages, self.schema)
        self.calls += 1
        self.prompt_tokens += reply.prompt_tokens
        self.completion_tokens += reply.completion_tokens
        self.raw = reply.content or reply.reasoning
        self._record("model", transcript(messages), reply, started)
        self.error = ""
        try:
            move = decode.reply_object(reply, self.method.convention)
            match move.get("action"):
                case "observe":
                    self._observe(move)
                    return None
                case "answer":
                    return self._answer(move)
                case _:
                    raise DecodeError('"action" must be "observe" or "answer"')
        except DecodeError as error:
            return self._strike(str(error))

    def _strike(self, reason: str, answer: Answer | None = None, evidence: Evidence | None = None) -> Prediction | None:
        """Show a malformed turn its error, or end the question at the second one."""
        self.strikes += 1
        if self.strikes > 1:
            return self.ended(reason, answer, evidence)
        self.error = reason
        self.steps.append(f"malformed: {reason}")
        return None

    def _observe(self, move: Mapping[str, Any]) -> None:
        decode.only_keys(move, ("action", "frame_id", "angle_deg"), "an observe turn")
        frame, angle = decode.frame_id(move["frame_id"]), decode.angle(move["angle_deg"])
        if frame not in self.legal:
            raise DecodeError(f"frame_id {frame:06d} is none of the legal frames")
        if len(self.looks) >= self.method.budget:
            raise DecodeError("no looks are left: answer now")
        asked: dict[str, Any] = {"sequence": self.task.question.sequence, "frame_index": frame, "angle_deg": angle}
        started = time.perf_counter()
        for look in self.looks:
            seen = look.observation
            if seen.frame_index == frame and float(angle_error(seen.angle_deg, angle)) <= DUPLICATE_DEG + TIE:
                reason = f"within {DUPLICATE_DEG:g} degree of the earlier look at angle {seen.angle_deg:g}"
                self.steps.append(f"look at frame {frame:06d}, angle {angle:g}: refused, {reason}")
                self._record("observe", asked, {"refused": reason}, started)
                return
        observation = self.task.observe(**asked)
        look = _Look(observation, crop_picture(observation))
        self.looks.append(look)
        self.steps.append(f"look at frame {frame:06d}, angle {angle:g}: picture {len(self.looks)}")
        self._record("observe", asked, _metadata(observation), started)

    def _answer(self, move: Mapping[str, Any]) -> Prediction | None:
        if not self.looks:
            raise DecodeError("the first turn must look")
        decode.only_keys(move, ("action", "answer", "evidence_bboxes"), "an answer turn")
        question, newest = self.task.question, self.looks[-1].observation
        started = time.perf_counter()
        answer: Answer | None = None
        evidence: Evidence | None = None
        reasons = []
        try:
            answer = decode.read_answer(
                move["answer"], question.answer_mode, len(question.choices), self.task.sequence.frame_count
            )
        except DecodeError as error:
            reasons.append(str(error))
        decoded: dict[str, Any] = {"answer": None if answer is None else msgspec.Raw(encode_answer(answer).encode())}
        try:
            seen = decode.read_evidence(
                move["evidence_bboxes"], {newest.frame_index}, CROP, CROP, self.method.convention
            )
            evidence = Evidence(seen.frame, from_crop(seen.box, newest.left))
            decoded |= {"crop_box": seen.box, "stitched_box": evidence.box, "box_key": seen.key}
        except DecodeError as error:
            reasons.append(str(error))
        self._record("solve", {"crop": newest.frame_id, "left": newest.left}, decoded | {"faults": reasons}, started)
        if reasons:
            return self._strike("; ".join(reasons), answer, evidence)
        return self._prediction("answered", "", answer, evidence)

    # -- what the model is shown --------------------------------------------------------------------------------------

    def messages(self) -> list[Message]:
        """The system prompt, then question and legal frames, every crop with its metadata, and the state at the end.

        What never changes comes first, so that a server can keep its work on the common beginning.
        """
        parts: list[Part] = [self.heading]
        for number, look in enumerate(self.looks, 1):
            newest = ", the newest" if number == len(self.looks) else ""
            parts += [f"Picture {number}{newest}: {picture_line(look.observation)}", look.picture]
        parts.append(
            render(
                "react_state",
                steps="\n".join(f"{n}. {step}" for n, step in enumerate(self.steps, 1)) or "none",
                seen=", ".join(f"{f:06d}" for f in sorted({look.observation.frame_index for look in self.looks}))
                or "none",
                used=len(self.looks),
                left=self.method.budget - len(self.looks),
                turns=self.method.most_calls - self.calls,
                error=f"Your last turn was malformed, and a second such turn ends the question: {self.error}"
                if self.error
                else "",
            )
        )
        return [Message("system", (self.system,)), Message("user", tuple(parts))]

    def _schema(self) -> dict[str, Any]:
        question = self.task.question
        return {
            "anyOf": [
                decode.closed_object(
                    {
                        "action": {"type": "string", "enum": ["observe"]},
                        "frame_id": decode.FRAME_ID_SCHEMA,
                        "angle_deg": {"type": "number"},
                    }
                ),
                decode.closed_object(
                    {
                        "action": {"type": "string", "enum": ["answer"]},
                        "answer": decode.answer_schema(question.answer_mode, question.choices),
                        "evidence_bboxes": decode.EVIDENCE_SCHEMA,
                    }
                ),
            ]
        }

    # -- what is kept -------------------------------------------------------------------------------------------------

    def ended(self, reason: str, answer: Answer | None = None, evidence: Evidence | None = None) -> Prediction:
        """The question as invalid; what could be read still counts."""
        return self._prediction("invalid", reason, answer, evidence)

    def _prediction(self, status: Any, reason: str, answer: Answer | None, evidence: Evidence | None) -> Prediction:
        return Prediction(
            status=status,
            answer=answer,
            evidence=evidence,
            raw=self.raw,
            reason=reason,
            n_observations=len(self.looks),
            n_model_calls=self.calls,
            prompt_tokens=self.prompt_tokens,
            completion_tokens=self.completion_tokens,
        )

    def _record(self, kind: Any, request: object, response: object, started: float) -> None:
        self.task.record(
            Step(
                kind=kind,
                request=msgspec.json.encode(request).decode(),
                response=msgspec.json.encode(response).decode(),
                seconds=time.perf_counter() - started,
            )
        )


def _metadata(observation: Observation) -> dict[str, Any]:
    return {
        "frame_id": observation.frame_id,
        "timestamp": round(observation.timestamp, 3),
        "angle_deg": observation.angle_deg,
        "fov_deg": round(observation.fov_deg, 2),
        "left": observation.left,
    }


def picture_line(observation: Observation) -> str:
    """One line that says where a picture was taken: what `observe` returned beside it, as JSON."""
    return msgspec.json.encode(_metadata(observation)).decode()
