"""Episode: a player looks and answers one question under the rules of the benchmark.

The first move must be a look. A look within 1 degree of an earlier look at the same frame is refused. A malformed move
counts as a move. The evidence is a box in the newest crop. A refused answer ends the episode only if the player sends
the same answer again. The prediction holds the newest readable answer and the newest readable box of the episode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple

from jrdb_avr.agent.methods.attempt import Attempt, ImageFrame, ParsedReply, on_crop
from jrdb_avr.agent.methods.requests import heading
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.prompts import PromptSet, frame_ranges
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.errors import DecodeError, RefusedError
from jrdb_avr.schema.method import Observation, Prediction, Question, Task
from jrdb_avr.schema.panorama import CROP

BUDGET: Final = 24
"""Default maximum number of looks."""

LOOK: Final = "Look at a frame in a direction: a picture 46 degrees wide; 180 is ahead, 90 left, 0 behind, 270 right."
SUBMIT: Final = "Give the final answer, with one box round the person in the newest picture, in thousandths of it."
"""Description of the tool `submit_answer` for a model. `LOOK` describes the tool `observe`."""


def most_moves(budget: int) -> int:
    """Return the maximum number of moves.

    Args:
        budget: The maximum number of looks.

    Returns:
        The number of moves.
    """
    return 2 * budget + 2


class Remaining(NamedTuple):
    """The number of looks and the number of moves that are left."""

    looks: int
    moves: int


class Episode:
    """Episode of one question. Each move is a look or an answer. Only one thread may use an episode.

    question: the public columns of the question. frames: the frames that can be observed, ascending. answered: whether
    an answer has ended the episode. turns: one line per move so far. error: why the last move was malformed, or "".

        episode = Episode(task)
        seen = episode.observe(150, 180.0)
        episode.submit(2, [{"frame_id": seen.frame_index, "bbox": [427, 250, 573, 708]}])
        prediction = episode.finished()
    """

    def __init__(
        self,
        task: Task,
        *,
        budget: int = BUDGET,
        convention: Convention = CONTRACT,
        chat: Chat | None = None,
        prompts: PromptSet = "default",
    ) -> None:
        """Begin the episode.

        Args:
            task: The question, with the functions that return its pictures.
            budget: The maximum number of looks.
            convention: How the player writes boxes.
            chat: The model that a method calls through `attempt`. None if the player calls no model through `attempt`.
            prompts: The set of prompts.
        """
        self.attempt = Attempt(task, chat, convention, prompts)
        self.question: Question = task.question
        self.frames: tuple[int, ...] = task.sequence.frames
        self.budget, self._most = budget, most_moves(budget)
        self.answered = False
        self.turns: list[str] = []
        self.error = ""
        self._kept = ParsedReply()
        self._refused: Mapping[str, Any] | None = None
        # Before the first look there is no picture, so that every box is refused.
        self._newest = ImageFrame((), CROP, CROP, 0)

    # -- texts of the player ------------------------------------------------------------------------------------------

    @property
    def prompt(self) -> str:
        """The rules and the question, for a player who has the tools `observe` and `submit_answer`."""
        return f"{self.rules('episode_tools')}\n\n{self.text}"

    def rules(self, turns: str) -> str:
        """Return the rules for a player.

        Args:
            turns: The name of the prompt that states the form of a move.

        Returns:
            The text.
        """
        text = self.attempt.mode_text
        return self.attempt.render(
            "episode_rules",
            turns=self.attempt.render(turns, answer_form=text.form),
            fps=f"{self.attempt.task.sequence.fps:g}",
            answer_rule=text.rule,
            budget=self.budget,
            calls=most_moves(self.budget),
        )

    @property
    def text(self) -> str:
        """The question with its choices, the legal frames, and a line of advice."""
        frames, advice = frame_ranges(self.frames), self.attempt.mode_text.advice
        return self.attempt.render("episode_task", heading=heading(self.question), frames=frames, advice=advice)

    @property
    def answer_schema(self) -> dict[str, Any]:
        """The JSON Schema of the arguments of `submit`."""
        return self.attempt.final_schema(self.frames)

    @property
    def left(self) -> Remaining:
        """The looks and moves that are left. Both are 0 after the final answer."""
        if self.answered:
            return Remaining(0, 0)
        return Remaining(self.budget - self.attempt.looks, self._most - len(self.turns))

    def force_answer(self) -> None:
        """Make the next move the last, which can only be an answer."""
        self.budget, self._most = self.attempt.looks, len(self.turns) + 1

    @property
    def over(self) -> bool:
        """Whether the episode has ended, so that no further move is accepted."""
        return self.left.moves <= 0

    # -- moves --------------------------------------------------------------------------------------------------------

    def observe(self, frame: int, angle: float) -> Observation:
        """Make a look.

        Args:
            frame: The index of the frame.
            angle: The angle in degrees.

        Returns:
            The crop.

        Raises:
            RefusedError: If the look is refused. The move counts nevertheless.
            ObserveError: If the picture is broken.
        """
        observation = self.move({"action": "observe", "angle_deg": angle} | _in_digits({"frame_id": frame}))
        assert observation is not None, "a look that is not refused returns what it shows"
        return observation

    def submit(self, answer: object, evidence: object) -> None:
        """Submit the final answer.

        Args:
            answer: The answer, in the form that `answer_schema` requires of the key `answer`. Frames may be numbers.
            evidence: The evidence, in the form that `answer_schema` requires of the key `evidence_bboxes`. Frames may
                be numbers.

        Raises:
            RefusedError: If the answer is refused. Its readable parts are kept.
        """
        boxes = [_in_digits(part) for part in evidence] if isinstance(evidence, list) else evidence
        self.move({"action": "answer", "answer": _in_digits(answer), "evidence_bboxes": boxes})

    def move(self, move: Mapping[str, Any]) -> Observation | None:
        """Make a move.

        Args:
            move: The move as a model writes it, such as `{"action": "observe", "frame_id": ..., ...}`.

        Returns:
            The crop if the move is a look, or None if the move is an answer.

        Raises:
            RefusedError: If the move is refused or malformed.
        """
        return self._carry_out(lambda: dict(move))

    def reply(self, reply: Reply) -> Observation | None:
        """Decode a model's reply as a move, and make the move.

        Args:
            reply: The reply.

        Returns:
            The crop if the move is a look, or None if the move is an answer.

        Raises:
            RefusedError: If the move is refused, or the reply cannot be read.
        """
        return self._carry_out(lambda: decode.reply_object(reply, self.attempt.convention))

    def spend_malformed(self, reason: str) -> None:
        """Count a reply without a move as a malformed move. An example is a reply that calls no tool.

        Args:
            reason: Why the reply is malformed.

        Raises:
            RefusedError: Always. The message is the reason.
        """

        def read() -> dict[str, Any]:
            raise DecodeError(reason)

        self._carry_out(read)

    def _carry_out(self, read: Callable[[], dict[str, Any]]) -> Observation | None:
        if self.over:
            raise RefusedError("the question is finished: no further move is taken")
        self.error = ""
        try:
            move = read()
            match move.get("action"):
                case "observe":
                    return self._observe(move)
                case "answer":
                    self._answer(move)
                    return None
                case _:
                    raise DecodeError('"action" must be "observe" or "answer"')
        except DecodeError as error:
            self.error = str(error)
            self._kept = replace(self._kept, faults=(self.error,))
            self.turns.append(f"malformed: {self.error}")
            raise RefusedError(self.error) from None

    def _observe(self, move: Mapping[str, Any]) -> Observation:
        decode.only_keys(move, ("action", "frame_id", "angle_deg"), "an observe turn")
        frame, angle = self.attempt.read_look(move)
        if not self.left.looks:
            raise DecodeError("no looks are left: answer now")
        look = f"look at frame {frame:06d}, angle {angle:g}"
        if reason := self.attempt.duplicate(frame, angle):
            self.turns.append(f"{look}: refused, {reason}")
            raise RefusedError(reason)
        observation = self.attempt.look(frame, angle)
        self._newest = on_crop(observation)
        self._refused = None
        self.turns.append(f"{look}: picture {self.attempt.looks}")
        return observation

    def _answer(self, move: dict[str, Any]) -> None:
        """Accept the answer. If it is not valid, keep its readable parts and raise DecodeError."""
        del move["action"]
        again, self._refused = move == self._refused, move
        parsed = self.attempt.parse_final(move, self._newest)
        self._kept = parsed.over(self._kept)
        self.answered = again or not parsed.faults
        if parsed.faults:
            raise DecodeError("; ".join(parsed.faults) if self.attempt.looks else "the first turn must look")
        self.turns.append("answer")

    # -- the end ------------------------------------------------------------------------------------------------------

    def finished(self) -> Prediction:
        """Return the prediction that results if the episode ends now. Each move counts as a model call.

        Returns:
            The prediction.
        """
        refusal = "" if self.answered else f"no answer was taken within {len(self.turns)} turns"
        prediction = self.attempt.prediction(replace(self._kept, refusal=refusal))
        return replace(prediction, n_model_calls=len(self.turns))


def _in_digits(part: Any) -> Any:
    """Return a part of a move with frame numbers as six digits, which is the form of replies."""
    if not isinstance(part, dict):
        return part
    return {key: f"{value:06d}" if "frame" in key and type(value) is int else value for key, value in part.items()}
