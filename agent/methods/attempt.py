"""One attempt at a question, which all methods share: model calls, looks, their cost, and reading the last reply.

Each call, each look and the reading of the final reply is a step of the transcript. The attempt counts tokens and looks
where they happen and makes the prediction of these counts. Methods that cannot choose where to look get a fixed context
of whole panoramas.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final, NamedTuple, TypeVar

import msgspec

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.messages import Message, Part, metadata_line, metadata_of, picture_of, transcript
from jrdb_avr.agent.model.prompts import choice_lines, render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.answers import TIE, Answer, Evidence
from jrdb_avr.schema.errors import DecodeError, ObserveError
from jrdb_avr.schema.method import Observation, Panorama, Prediction, Question, Step, StepKind, Task, Verdict
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, angle_error, from_crop

Seen = TypeVar("Seen", Observation, Panorama)
Read = TypeVar("Read")

PANORAMAS: Final = 8
"""Panoramas in the context of the methods that cannot choose where to look."""

UNIFORM: Final = "evenly spaced by position among the legal ones, first and last included"
"""What `uniform_frames` selects, in the words of a run's manifest."""


def uniform_frames(frames: Sequence[int], n: int = PANORAMAS) -> tuple[int, ...]:
    """`n` of the ascending legal `frames`, evenly spaced by position among them; all where there are no more than `n`.

    Of m frames the i-th (from 0) is the one at position i * (m - 1) / (n - 1), rounded to the nearest, halves up: the
    first and the last are always among them, and no frame comes twice. n = 1 gives the one in the middle, the earlier
    of two.

    >>> uniform_frames(range(0, 100, 5), 4)
    (0, 30, 65, 95)
    """
    if n < 1:
        raise ValueError("a fixed context holds one panorama at least")
    if len(frames) <= n:
        return tuple(frames)
    last = len(frames) - 1
    if n == 1:
        return (frames[last // 2],)
    # Steps are longer than one position, so that rounding never meets the same frame twice.
    return tuple(frames[(2 * i * last + n - 1) // (2 * (n - 1))] for i in range(n))


def panorama_parts(panoramas: Sequence[Panorama]) -> tuple[Part, ...]:
    """Each panorama behind the line that numbers and places it."""
    return tuple(
        part
        for number, panorama in enumerate(panoramas, 1)
        for part in (f"Panorama {number}: {metadata_line(panorama)}", picture_of(panorama))
    )


def frame_list(panoramas: Sequence[Panorama]) -> str:
    """The frame ids of panoramas, with commas between."""
    return ", ".join(panorama.frame_id for panorama in panoramas)


def fixed_settings(n: int) -> dict[str, Any]:
    """The settings of a fixed context of `n` panoramas in a run's manifest."""
    return {"panoramas": n, "frames": UNIFORM}


IMAGE_SIZES: Final = {"panorama": [WIDTH, HEIGHT], "crop": [CROP, CROP]}
"""Width and height in pixels of the pictures that a model gets."""

DUPLICATE_DEG: Final = 1.0
"""A look this near an earlier one of the same frame, or nearer, is refused."""


def heading(question: Question) -> str:
    """The lines that open every task: question, mode, and the choices numbered from 1."""
    choices = choice_lines(question.choices)
    return render(
        "heading",
        question=question.question,
        mode=question.answer_mode,
        choices=f"Choices:\n{choices}" if choices else "No choices.",
    )


def final_parts(question: Question) -> dict[str, Any]:
    """The JSON Schemas of a final reply's keys."""
    return {
        "answer": decode.answer_schema(question.answer_mode, question.choices),
        "evidence_bboxes": decode.EVIDENCE_SCHEMA,
    }


def panorama_messages(task: Task, parts: Sequence[Part]) -> list[Message]:
    """The messages of a call with panoramas: the shared system text, the heading, and the parts of the stage.

    The stage's own instructions stand last, so that a server can keep its work on a common beginning.
    """
    system = render("panorama_system", fps=f"{task.sequence.fps:g}")
    return [Message("system", (system,)), Message("user", (heading(task.question), *parts))]


def shared_settings(convention: Convention) -> dict[str, Any]:
    """The settings that every method has in a run's manifest."""
    return {"convention": convention.settings(), "image_sizes": IMAGE_SIZES}


def history_settings(history: int | None) -> dict[str, Any]:
    """What a manifest says of a chat that sends only its last pictures; nothing of one that sends all."""
    return {} if history is None else {"history": history}


@dataclass(frozen=True)
class FixedContextMethod:
    """A method that answers from `n` evenly spaced panoramas; `stages` are the settings of its own calls."""

    name: ClassVar[str]
    stages: ClassVar[Mapping[str, int]]

    chat: Chat
    convention: Convention = CONTRACT
    n: int = PANORAMAS

    def settings(self) -> dict[str, Any]:
        """The method's settings in a run's manifest."""
        return {**fixed_settings(self.n), **self.stages, **shared_settings(self.convention)}


class ImageFrame(NamedTuple):
    """The pictures that a box may refer to: their frames, size in pixels, and left column in the panorama."""

    frames: tuple[int, ...]
    width: int
    height: int
    left: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.width, self.height

    def evidence(self, frame: int, box: Box) -> Evidence:
        """A box in one of these pictures as evidence."""
        return stitched_evidence(frame, from_crop(box, self.left))


def stitched_evidence(frame: int, box: Box) -> Evidence:
    """A box in stitched pixels as evidence, x in [0, 3760)."""
    x, y, w, h = box
    return Evidence(frame, (x % WIDTH, y, w, h))


def on_panoramas(panoramas: Sequence[Panorama]) -> ImageFrame:
    """A box lies in one of these panoramas."""
    return ImageFrame(tuple(panorama.frame_index for panorama in panoramas), WIDTH, HEIGHT, 0)


def on_crop(observation: Observation) -> ImageFrame:
    """The image of this crop, in which a model's box lies."""
    return ImageFrame((observation.frame_index,), CROP, CROP, observation.left)


@dataclass(frozen=True)
class ParsedReply:
    """A parsed final reply: answer and evidence, read independently; `faults` are the reasons why one was not read.

    refusal: why the newest output was not taken, where what counts is older; verdict: as in a prediction.
    """

    answer: Answer | None = None
    evidence: Evidence | None = None
    faults: tuple[str, ...] = ()
    refusal: str = ""
    verdict: Verdict | None = None

    def over(self, earlier: ParsedReply) -> ParsedReply:
        """What counts after an earlier reply: each part by the newest that could be read, and this one's faults."""
        return replace(self, answer=self.answer or earlier.answer, evidence=self.evidence or earlier.evidence)


@dataclass
class Attempt:
    """One question; used by one thread."""

    task: Task
    chat: Chat | None
    """None for a player that makes its calls elsewhere."""

    convention: Convention
    looks: int = 0
    calls: int = 0
    steps: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    raw: str = ""
    made: list[tuple[int, float]] = field(default_factory=list)
    """Frame and angle of each crop."""

    # -- calls and looks ----------------------------------------------------------------------------------------------

    def ask(self, messages: Sequence[Message], schema: Mapping[str, Any]) -> Reply:
        """One model call. What the server refuses is the client's EndpointError."""
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
        """One model call, its reply as one JSON object. Raises DecodeError."""
        return decode.reply_object(self.ask(messages, schema), self.convention)

    def ask_stage(
        self, parts: Sequence[Part], stage: str, schema: Mapping[str, Any], read: Callable[[dict[str, Any]], Read]
    ) -> Read:
        """What `read` makes of the reply to a stage over these parts; one that cannot be read is requested again.

        The second request gives the error. Raises DecodeError where the second reply cannot be read either.
        """
        try:
            return read(self.ask_object(panorama_messages(self.task, (*parts, stage)), schema))
        except DecodeError as error:
            again = (*parts, f"Your last reply could not be used: {error}", stage)
        return read(self.ask_object(panorama_messages(self.task, again), schema))

    def read_look(self, part: Mapping[str, Any]) -> tuple[int, float]:
        """Frame and angle of a look that the model requests. Raises DecodeError, also for a frame that is not legal."""
        frame, angle = decode.frame_id(part["frame_id"]), decode.angle(part["angle_deg"])
        if frame not in self.task.sequence.frames:
            raise DecodeError(f"frame_id {frame:06d} is none of the legal frames")
        return frame, angle

    def duplicate(self, frame: int, angle: float) -> str:
        """Why a look would repeat an earlier one, "" where it would not; the transcript records that it is refused."""
        for other, seen in self.made:
            if other == frame and float(angle_error(seen, angle)) <= DUPLICATE_DEG + TIE:
                reason = f"within {DUPLICATE_DEG:g} degree of the earlier look at angle {seen:g}"
                request = self._request(frame_index=frame, angle_deg=angle)
                self.record("observe", request, {"refused": reason}, time.perf_counter())
                return reason
        return ""

    def look(self, frame: int, angle: float) -> Observation:
        """A crop, counted as a look. Raises ObserveError."""
        observation = self._observe(self.task.observe, frame_index=frame, angle_deg=angle)
        self.made.append((frame, observation.angle_deg))
        return observation

    def panoramas(self, n: int) -> tuple[Panorama, ...]:
        """The `n` panoramas of a fixed context, each counted as a look. Raises ObserveError."""
        frames = uniform_frames(self.task.sequence.frames, n)
        if not frames:
            raise ObserveError(f"{self.task.question.sequence} has no panoramas: load a root that has its images")
        return tuple(self._observe(self.task.panorama, frame_index=frame) for frame in frames)

    def _observe(self, observe: Callable[..., Seen], **place: float) -> Seen:
        started, request = time.perf_counter(), self._request(**place)
        seen = observe(**request)
        self.looks += 1
        self.record("observe", request, metadata_of(seen), started)
        return seen

    def _request(self, **place: float) -> dict[str, Any]:
        return {"sequence": self.task.question.sequence, **place}

    def record(self, kind: StepKind, request: object, response: object, started: float) -> None:
        """Append a step to the transcript; `started` is the `time.perf_counter` before it."""
        self.task.record(
            Step(
                kind=kind,
                request=msgspec.json.encode(request).decode(),
                response=msgspec.json.encode(response).decode(),
                seconds=time.perf_counter() - started,
            )
        )
        self.steps += 1

    # -- reading what the model returned ------------------------------------------------------------------------------

    def read_answer(self, value: object) -> Answer:
        """The `answer` part of a reply, in the question's mode. Raises DecodeError."""
        question = self.task.question
        return decode.read_answer(value, question.answer_mode, len(question.choices), self.task.sequence.frame_count)

    def read_evidence(self, value: object, image: ImageFrame) -> Evidence:
        """The `evidence_bboxes` part of a reply that is not final. Raises DecodeError."""
        started = time.perf_counter()
        evidence, facts = self._place(value, image)
        self.record("solve", image._asdict(), facts, started)
        return evidence

    def parse_final(self, reply: Mapping[str, Any], image: ImageFrame) -> ParsedReply:
        """Parse a final reply: its `answer` and its `evidence_bboxes`, each valid without the other.

        Raises DecodeError for other keys: then nothing of the reply is the contract's.
        """
        unread = {"answer": None, "evidence_bboxes": None}
        parts = decode.only_keys({**unread, **reply}, unread, "the reply")
        started = time.perf_counter()
        (answer, placed), faults = decode.read_each(
            lambda: self.read_answer(parts["answer"]), lambda: self._place(parts["evidence_bboxes"], image)
        )
        evidence, place = placed or (None, {})
        self.record("solve", image._asdict(), {"answer": answer, **place, "faults": faults}, started)
        return ParsedReply(answer, evidence, faults)

    def _place(self, value: object, image: ImageFrame) -> tuple[Evidence, dict[str, Any]]:
        """The one box in stitched pixels, and its record in the transcript."""
        seen = decode.read_evidence(value, image.frames, image.size, self.convention)
        evidence = image.evidence(seen.frame, seen.box)
        return evidence, {"image_box": seen.box, "stitched_box": evidence.box, "box_key": seen.key}

    # -- the end ------------------------------------------------------------------------------------------------------

    def prediction(self, parsed: ParsedReply) -> Prediction:
        """The prediction: invalid where a part is missing that could not be read; what could be read counts."""
        missing = parsed.answer is None or parsed.evidence is None
        return Prediction(
            status="invalid" if parsed.faults and missing else "answered",
            answer=parsed.answer,
            evidence=parsed.evidence,
            raw=self.raw,
            reason="; ".join(parsed.faults) or parsed.refusal,
            verdict=parsed.verdict,
            n_observations=self.looks,
            n_model_calls=self.calls,
            prompt_tokens=self.prompt_tokens,
            completion_tokens=self.completion_tokens,
        )
