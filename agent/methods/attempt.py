"""One attempt at a question, which all methods share: model calls, looks, their cost, and reading the last reply.

Each call, each look and the reading of the final reply is a step of the transcript. The attempt counts tokens and looks
where they happen and makes the prediction of these counts. Methods that cannot choose where to look get a fixed context
of whole panoramas.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple

import msgspec

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.messages import Message, Part, Picture, crop_metadata, transcript
from jrdb_avr.agent.model.prompts import choice_lines, render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.answers import TIE, Answer, Evidence, encode_answer
from jrdb_avr.schema.errors import DecodeError, ObserveError
from jrdb_avr.schema.method import Observation, Panorama, Prediction, Question, Step, StepKind, Task
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, angle_error, from_crop

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


def panorama_picture(panorama: Panorama) -> Picture:
    """The panorama as it is stored: its file's bytes, not encoded anew."""
    return Picture(f"{panorama.sequence} {panorama.frame_id} panorama", panorama.jpeg)


def panorama_metadata(panorama: Panorama) -> dict[str, Any]:
    """The metadata of a panorama that a model gets: frame id, and seconds from frame 0."""
    return {"frame_id": panorama.frame_id, "timestamp": round(panorama.timestamp, 3)}


def panorama_line(panorama: Panorama) -> str:
    """`panorama_metadata` as JSON on one line."""
    return msgspec.json.encode(panorama_metadata(panorama)).decode()


def panorama_parts(panoramas: Sequence[Panorama]) -> tuple[Part, ...]:
    """Each panorama behind the line that numbers and places it."""
    return tuple(
        part
        for number, panorama in enumerate(panoramas, 1)
        for part in (f"Panorama {number}: {panorama_line(panorama)}", panorama_picture(panorama))
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


def duplicate(made: Iterable[tuple[int, float]], frame: int, angle: float) -> str:
    """Why a look would repeat one of those made, each a frame and an angle; "" where it would not."""
    for other, seen in made:
        if other == frame and float(angle_error(seen, angle)) <= DUPLICATE_DEG + TIE:
            return f"within {DUPLICATE_DEG:g} degree of the earlier look at angle {seen:g}"
    return ""


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

    frames: frozenset[int]
    width: int
    height: int
    left: int


def on_panoramas(panoramas: Sequence[Panorama]) -> ImageFrame:
    """A box lies in one of these panoramas."""
    return ImageFrame(frozenset(panorama.frame_index for panorama in panoramas), WIDTH, HEIGHT, 0)


def on_crop(observation: Observation) -> ImageFrame:
    """A box lies in this crop."""
    return ImageFrame(frozenset((observation.frame_index,)), CROP, CROP, observation.left)


def _image_facts(image: ImageFrame) -> dict[str, Any]:
    return {"frames": sorted(image.frames), "width": image.width, "height": image.height, "left": image.left}


@dataclass(frozen=True)
class ParsedReply:
    """A parsed final reply: answer and evidence, read independently; `faults` are the reasons why one was not read."""

    answer: Answer | None = None
    evidence: Evidence | None = None
    faults: tuple[str, ...] = ()


@dataclass
class Attempt:
    """One question; used by one thread."""

    task: Task
    chat: Chat
    convention: Convention
    looks: int = 0
    calls: int = 0
    steps: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0
    raw: str = ""

    # -- calls and looks ----------------------------------------------------------------------------------------------

    def ask(self, messages: Sequence[Message], schema: Mapping[str, Any]) -> Reply:
        """One model call. What the server refuses is the client's EndpointError."""
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

    def look(self, frame: int, angle: float) -> Observation:
        """A crop, counted as a look. Raises ObserveError."""
        started = time.perf_counter()
        request = self._request_of(frame, angle)
        observation = self.task.observe(**request)
        self.looks += 1
        self.record("observe", request, crop_metadata(observation), started)
        return observation

    def refuse_look(self, frame: int, angle: float, reason: str) -> None:
        """Record in the transcript a look that is not made."""
        self.record("observe", self._request_of(frame, angle), {"refused": reason}, time.perf_counter())

    def _request_of(self, frame: int, angle: float) -> dict[str, Any]:
        return {"sequence": self.task.question.sequence, "frame_index": frame, "angle_deg": angle}

    def panoramas(self, n: int) -> tuple[Panorama, ...]:
        """The `n` panoramas of a fixed context, each counted as a look. Raises ObserveError."""
        sequence = self.task.question.sequence
        if not self.task.sequence.frames:
            raise ObserveError(f"{sequence} has no panoramas: load a root that has its images")
        panoramas = []
        for frame in uniform_frames(self.task.sequence.frames, n):
            request: dict[str, Any] = {"sequence": sequence, "frame_index": frame}
            started = time.perf_counter()
            panorama = self.task.panorama(**request)
            self.looks += 1
            self.record("observe", request, panorama_metadata(panorama), started)
            panoramas.append(panorama)
        return tuple(panoramas)

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
        self.record("solve", _image_facts(image), facts, started)
        return evidence

    def parse_final(self, reply: Mapping[str, Any], image: ImageFrame) -> ParsedReply:
        """Parse a final reply: its `answer` and its `evidence_bboxes`, each valid without the other.

        Raises DecodeError for other keys: then nothing of the reply is the contract's.
        """
        unread = {"answer": None, "evidence_bboxes": None}
        parts = decode.only_keys({**unread, **reply}, unread, "the reply")
        started = time.perf_counter()
        facts: dict[str, Any] = {"answer": None}
        faults = []
        answer: Answer | None = None
        evidence: Evidence | None = None
        try:
            answer = self.read_answer(parts["answer"])
            facts["answer"] = msgspec.Raw(encode_answer(answer).encode())
        except DecodeError as error:
            faults.append(str(error))
        try:
            evidence, place = self._place(parts["evidence_bboxes"], image)
            facts |= place
        except DecodeError as error:
            faults.append(str(error))
        self.record("solve", _image_facts(image), facts | {"faults": faults}, started)
        return ParsedReply(answer, evidence, tuple(faults))

    def _place(self, value: object, image: ImageFrame) -> tuple[Evidence, dict[str, Any]]:
        """The one box in stitched pixels, x in [0, 3760), and its record in the transcript."""
        seen = decode.read_evidence(value, image.frames, image.width, image.height, self.convention)
        x, y, w, h = from_crop(seen.box, image.left)
        evidence = Evidence(seen.frame, (x % WIDTH, y, w, h))
        return evidence, {"image_box": seen.box, "stitched_box": evidence.box, "box_key": seen.key}

    # -- the end ------------------------------------------------------------------------------------------------------

    def prediction(self, parsed: ParsedReply) -> Prediction:
        """The prediction: invalid where anything could not be read, and what could be read still counts."""
        return Prediction(
            status="invalid" if parsed.faults else "answered",
            answer=parsed.answer,
            evidence=parsed.evidence,
            raw=self.raw,
            reason="; ".join(parsed.faults),
            n_observations=self.looks,
            n_model_calls=self.calls,
            prompt_tokens=self.prompt_tokens,
            completion_tokens=self.completion_tokens,
        )

    def invalid(self, reason: str) -> Prediction:
        """The question ended with nothing to score."""
        return self.prediction(ParsedReply(faults=(reason,)))
