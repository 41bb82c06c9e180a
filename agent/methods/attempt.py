"""Shared part of all methods: model calls, looks, counts of calls and looks, and the decoding of replies.

A step of the transcript is a call, a look, or the decoding of the final reply. The attempt counts calls, tokens and
looks, and the prediction states these counts. A method that cannot choose its looks gets whole panoramas.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple, TypeVar

import msgspec

from jrdb_avr.agent.methods.requests import heading, uniform_frames
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.messages import Message, Part, metadata_of, transcript
from jrdb_avr.agent.model.prompts import FOLDERS, ModeText, PromptSet, mode_text, render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.model.schemas import answer_schema, evidence_schema, frame_schema
from jrdb_avr.schema.answers import TIE, Answer, Evidence, encode_answer
from jrdb_avr.schema.errors import DecodeError, ObserveError
from jrdb_avr.schema.method import Observation, Panorama, Prediction, Step, StepKind, Task, Verdict
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, angle_error, from_crop

Seen = TypeVar("Seen", Observation, Panorama)
Read = TypeVar("Read")

DUPLICATE_DEG: Final = 1.0
"""Maximum angle in degrees between two looks at the same frame for the second look to be refused as a repetition."""


class ImageFrame(NamedTuple):
    """The pictures that a box of a reply may refer to.

    frames: the frames of the pictures. width, height: the size of each picture in pixels. left: the column of the
    panorama at the left edge of each picture.
    """

    frames: tuple[int, ...]
    width: int
    height: int
    left: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of each picture in pixels."""
        return self.width, self.height

    def evidence(self, frame: int, box: Box) -> Evidence:
        """Return the evidence that consists of a box in the picture of a frame.

        Args:
            frame: The frame.
            box: The box in pixels of the picture.

        Returns:
            The evidence in stitched pixels.
        """
        return stitched_evidence(frame, from_crop(box, self.left))


def stitched_evidence(frame: int, box: Box) -> Evidence:
    """Return the evidence that consists of a box on a panorama.

    Args:
        frame: The frame.
        box: The box in stitched pixels.

    Returns:
        The evidence, with x in [0, 3760).
    """
    x, y, w, h = box
    return Evidence(frame, (x % WIDTH, y, w, h))


def on_panoramas(panoramas: Sequence[Panorama]) -> ImageFrame:
    """Return the `ImageFrame` for boxes in panoramas.

    Args:
        panoramas: The panoramas.

    Returns:
        The frames and the size of the panoramas.
    """
    return ImageFrame(tuple(panorama.frame_index for panorama in panoramas), WIDTH, HEIGHT, 0)


def on_crop(observation: Observation) -> ImageFrame:
    """Return the `ImageFrame` for boxes in a crop.

    Args:
        observation: The crop.

    Returns:
        The frame, the size and the left column of the crop.
    """
    return ImageFrame((observation.frame_index,), CROP, CROP, observation.left)


@dataclass(frozen=True)
class ParsedReply:
    """A parsed final reply. The answer and the evidence are decoded independently.

    answer, evidence: the decoded parts, None if a part is missing or could not be read. faults: one reason per part
    that could not be read. refusal: why no final answer was accepted, or "". The prediction states this reason if there
    are no faults. verdict: how well the method's world model supports the answer, None without a world model.
    proposed: the answer that the model proposed to the world model last.
    """

    answer: Answer | None = None
    evidence: Evidence | None = None
    faults: tuple[str, ...] = ()
    refusal: str = ""
    verdict: Verdict | None = None
    proposed: Answer | None = None

    def over(self, earlier: ParsedReply) -> ParsedReply:
        """Fill in the missing parts of this reply from an earlier reply.

        Args:
            earlier: The earlier reply.

        Returns:
            The newest readable answer, the newest readable evidence, and the faults of this reply.
        """
        return replace(self, answer=self.answer or earlier.answer, evidence=self.evidence or earlier.evidence)


@dataclass
class Attempt:
    """State of one attempt to answer a question. Only one thread may use an attempt."""

    task: Task
    chat: Chat | None
    """The model. None if a player makes the moves, because a player makes no model calls."""

    convention: Convention
    prompts: PromptSet = "default"
    looks: int = 0
    calls: int = 0
    steps: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    raw: str = ""
    made: list[tuple[int, float]] = field(default_factory=list)
    """Frame and angle of each crop."""

    # -- texts --------------------------------------------------------------------------------------------------------

    @property
    def mode_text(self) -> ModeText:
        """The prompt lines of the question's answer mode."""
        return mode_text(self.task, self.prompts)

    def render(self, name: str, **slots: object) -> str:
        """Fill in a prompt of the attempt's set."""
        return render(FOLDERS[self.prompts] + name, **slots)

    def answer_schema(self, shown: Sequence[int] = ()) -> dict[str, Any]:
        """Return the JSON Schema of the `answer` part of a reply.

        Args:
            shown: The frames that an answer may name if the set of prompts is `paper`. In the set `default`, an answer
                may name every frame of the sequence.

        Returns:
            The schema.
        """
        question = self.task.question
        frames = shown if self.prompts == "paper" else range(self.task.sequence.frame_count)
        return answer_schema(question.answer_mode, question.choices, frames)

    def final_schema(self, shown: Sequence[int]) -> dict[str, Any]:
        """Return the JSON Schema of a final reply.

        Args:
            shown: The frames that the evidence may name, ascending.

        Returns:
            The schema of an object with the keys `answer` and `evidence_bboxes`.
        """
        evidence = evidence_schema(frame_schema(shown))
        return decode.closed_object({"answer": self.answer_schema(shown), "evidence_bboxes": evidence})

    # -- calls and looks ----------------------------------------------------------------------------------------------

    def ask(self, messages: Sequence[Message], schema: Mapping[str, Any]) -> Reply:
        """Make a model call.

        Args:
            messages: The chat.
            schema: The JSON Schema of the reply.

        Returns:
            The reply.

        Raises:
            EndpointError: If the server refuses the request.
        """
        assert self.chat is not None, "a player without a chat makes no calls here"
        started = time.perf_counter()
        reply = self.chat.complete(messages, schema)
        self.calls += 1
        self.prompt_tokens += reply.prompt_tokens
        self.completion_tokens += reply.completion_tokens
        self.raw = reply.content or reply.refusal or reply.reasoning
        self.record("model", transcript(messages), reply, started)
        return reply

    def ask_object(self, messages: Sequence[Message], schema: Mapping[str, Any]) -> dict[str, Any]:
        """Make a model call, and read its reply as one JSON object.

        Args:
            messages: The chat.
            schema: The JSON Schema of the reply.

        Returns:
            The object.

        Raises:
            DecodeError: If the reply is not one JSON object.
        """
        return decode.reply_object(self.ask(messages, schema), self.convention)

    def ask_stage(
        self, parts: Sequence[Part], stage: str, schema: Mapping[str, Any], read: Callable[[dict[str, Any]], Read]
    ) -> Read:
        """Make the model call of one stage. If its reply cannot be read, make a second call that states the error.

        Args:
            parts: The parts of the user message between the question and the instructions, such as panoramas.
            stage: The instructions of the stage, which come last.
            schema: The JSON Schema of the reply.
            read: Called with the JSON object of each reply. It returns what it reads, or raises DecodeError.

        Returns:
            The result of `read`.

        Raises:
            DecodeError: If neither reply can be read.
        """
        system = Message("system", (self.render("panorama_system", fps=f"{self.task.sequence.fps:g}"),))
        before = (heading(self.task.question), *parts)

        def ask(*faults: str) -> Read:
            # The instructions come last, so that a server can cache the common beginning of two calls.
            return read(self.ask_object([system, Message("user", (*before, *faults, stage))], schema))

        try:
            return ask()
        except DecodeError as error:
            fault = f"Your last reply could not be used: {error}"
        return ask(fault)

    def read_look(self, part: Mapping[str, Any]) -> tuple[int, float]:
        """Decode a look that the model requests.

        Args:
            part: The object with `frame_id` and `angle_deg`.

        Returns:
            The frame, and the angle in degrees.

        Raises:
            DecodeError: If one of the two values cannot be read, or if the frame is not a legal frame.
        """
        frame, angle = decode.frame_id(part["frame_id"]), decode.angle(part["angle_deg"])
        if frame not in self.task.sequence.frames:
            raise DecodeError(f"frame_id {frame:06d} is none of the legal frames")
        return frame, angle

    def duplicate(self, frame: int, angle: float) -> str:
        """Check whether a look repeats an earlier look. If it does, record that the look is refused.

        Args:
            frame: The frame.
            angle: The angle in degrees.

        Returns:
            The reason of the refusal, or "" if the look repeats no earlier look.
        """
        for earlier, earlier_angle in self.made:
            if earlier == frame and float(angle_error(earlier_angle, angle)) <= DUPLICATE_DEG + TIE:
                reason = f"within {DUPLICATE_DEG:g} degree of the earlier look at angle {earlier_angle:g}"
                request = self._request(frame_index=frame, angle_deg=angle)
                self.record("observe", request, {"refused": reason}, time.perf_counter())
                return reason
        return ""

    def look(self, frame: int, angle: float, given: Observation | None = None) -> Observation:
        """Make a look.

        Args:
            frame: The frame.
            angle: The angle in degrees.
            given: The crop of this look if it is already made, or None.

        Returns:
            The crop.

        Raises:
            ObserveError: If the picture cannot be made.
        """
        observe = self.task.observe if given is None else lambda **view: given
        observation = self._observe(observe, frame_index=frame, angle_deg=angle)
        self.made.append((frame, observation.angle_deg))
        return observation

    def panoramas(self, n: int) -> tuple[Panorama, ...]:
        """Return the panoramas of evenly spaced frames. Each panorama counts as a look.

        Args:
            n: The number of panoramas.

        Returns:
            The panoramas.

        Raises:
            ObserveError: If the sequence has no panoramas, or if a panorama cannot be read.
        """
        frames = uniform_frames(self.task.sequence.frames, n)
        if not frames:
            raise ObserveError(f"{self.task.question.sequence} has no panoramas: load a root that has its images")
        return tuple(self._observe(self.task.panorama, frame_index=frame) for frame in frames)

    def _observe(self, observe: Callable[..., Seen], **view: float) -> Seen:
        started, request = time.perf_counter(), self._request(**view)
        shown = observe(**request)
        self.looks += 1
        self.record("observe", request, metadata_of(shown), started)
        return shown

    def _request(self, **view: float) -> dict[str, Any]:
        return {"sequence": self.task.question.sequence, **view}

    def record(self, kind: StepKind, request: object, response: object, started: float) -> None:
        """Append a step to the transcript.

        Args:
            kind: The kind of step.
            request: The request, as JSON.
            response: The response, as JSON.
            started: The value of `time.perf_counter` when the step began.
        """
        self.task.record(
            Step(
                kind=kind,
                request=msgspec.json.encode(request).decode(),
                response=msgspec.json.encode(response).decode(),
                seconds=time.perf_counter() - started,
            )
        )
        self.steps += 1

    # -- replies ------------------------------------------------------------------------------------------------------

    def read_answer(self, value: object) -> Answer:
        """Decode the `answer` part of a reply under the question's answer mode.

        Args:
            value: The part.

        Returns:
            The answer.

        Raises:
            DecodeError: If the part does not fit.
        """
        question = self.task.question
        return decode.read_answer(value, question.answer_mode, len(question.choices), self.task.sequence.frame_count)

    def read_evidence(self, value: object, image: ImageFrame) -> Evidence:
        """Decode the `evidence_bboxes` part of a reply that is not the final reply.

        Args:
            value: The part.
            image: The pictures that the box may refer to.

        Returns:
            The evidence.

        Raises:
            DecodeError: If the part does not fit.
        """
        started = time.perf_counter()
        evidence, facts = self._read_box(value, image)
        self.record("solve", image._asdict(), facts, started)
        return evidence

    def parse_final(self, reply: Mapping[str, Any], image: ImageFrame) -> ParsedReply:
        """Parse a final reply. Its `answer` and its `evidence_bboxes` are decoded independently.

        Args:
            reply: The object of the reply.
            image: The pictures that the box may refer to.

        Returns:
            The parsed parts, and the faults of parts that could not be read.

        Raises:
            DecodeError: If the reply has a key other than `answer` and `evidence_bboxes`. A missing
                key counts as a fault of its part.
        """
        unread = {"answer": None, "evidence_bboxes": None}
        parts = decode.only_keys({**unread, **reply}, unread, "the reply")
        started = time.perf_counter()
        (answer, boxed), faults = decode.read_each(
            lambda: self.read_answer(parts["answer"]), lambda: self._read_box(parts["evidence_bboxes"], image)
        )
        evidence, record = boxed or (None, {})
        self.record("solve", image._asdict(), {"answer": answer, **record, "faults": faults}, started)
        return ParsedReply(answer, evidence, faults)

    def _read_box(self, value: object, image: ImageFrame) -> tuple[Evidence, dict[str, Any]]:
        """Decode the evidence box of a reply. Return the evidence, and the record of the box for the transcript."""
        reading = decode.read_evidence(value, image.frames, image.size, self.convention)
        evidence = image.evidence(reading.frame, reading.box)
        return evidence, {"image_box": reading.box, "stitched_box": evidence.box, "box_key": reading.key}

    # -- the end ------------------------------------------------------------------------------------------------------

    def prediction(self, parsed: ParsedReply) -> Prediction:
        """Return the prediction for a parsed reply, with the counts of this attempt.

        Args:
            parsed: The parsed reply. Parts that could not be read are missing in the prediction.

        Returns:
            The prediction. It is invalid if a part is missing because that part could not be read.
        """
        return Prediction(
            status="invalid" if parsed.faults and None in (parsed.answer, parsed.evidence) else "answered",
            answer=parsed.answer,
            evidence=parsed.evidence,
            raw=self.raw,
            reason="; ".join(parsed.faults) or parsed.refusal,
            verdict=parsed.verdict,
            proposed=None if parsed.proposed is None else encode_answer(parsed.proposed),
            n_observations=self.looks,
            n_model_calls=self.calls,
            prompt_tokens=self.prompt_tokens,
            completion_tokens=self.completion_tokens,
        )
