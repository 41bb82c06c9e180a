"""Answers, evidence, and when two answers are the same.

The stored JSON of an answer is one of five payloads, told apart by the question's answer mode:
`{"choice": 2}` (1-based), `{"frame": 150}`, `{"start_frame": 10, "end_frame": 95}`,
`{"frame": 150, "angle_deg": 210.0}`, `{"value": 12.5}`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Final, Literal

import msgspec

from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.rules import FPS

AnswerMode = Literal["multiple_choice", "frame", "span", "frame_viewpoint", "number"]

TIE: Final = 1e-9
"""Tolerance at inclusive bounds: rounding may move an angle in degrees, or a share, that lies exactly on one."""

_FRAME_LIMIT: Final = 10_000_000
_Frame = Annotated[int, msgspec.Meta(ge=0, le=_FRAME_LIMIT)]


class Choice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Answer to a multiple-choice question: the number of the choice, from 1."""

    choice: Annotated[int, msgspec.Meta(ge=1, le=1000)]


class FrameAnswer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A moment, as a frame number."""

    frame: _Frame


class Span(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A stretch of time, both frames inclusive."""

    start_frame: _Frame
    end_frame: _Frame


class FrameViewpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A moment and the panorama angle, in degrees, that shows the person then."""

    frame: _Frame
    angle_deg: float


class Number(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Seconds, or a count of people."""

    value: float


Answer = Choice | FrameAnswer | Span | FrameViewpoint | Number

ANSWER_TYPES: Final[dict[str, type[Answer]]] = {
    "multiple_choice": Choice,
    "frame": FrameAnswer,
    "span": Span,
    "frame_viewpoint": FrameViewpoint,
    "number": Number,
}


def uninformed_answer(mode: AnswerMode, frame: int, angle: float) -> Answer:
    """The answer to give if nothing tells it, about a person seen at a frame and a panorama angle in degrees."""
    match mode:
        case "multiple_choice":
            return Choice(1)
        case "frame":
            return FrameAnswer(frame)
        case "span":
            return Span(frame, frame)
        case "frame_viewpoint":
            return FrameViewpoint(frame, angle)
        case "number":
            return Number(1.0)


# Made at import: threads that meet a type first at the same time crash the decoder.
_DECODERS: Final[dict[type[Answer], msgspec.json.Decoder[Any]]] = {
    kind: msgspec.json.Decoder(kind) for kind in ANSWER_TYPES.values()
}


class Evidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One box in one frame, in stitched pixels: (x, y, w, h)."""

    frame: _Frame
    box: tuple[float, float, float, float]


def encode_answer(answer: Answer) -> str:
    """The stored JSON of an answer."""
    return msgspec.json.encode(answer).decode()


def decode_answer(mode: str, text: str) -> Answer:
    """Read a stored answer. Raises DecodeError where it does not fit the mode or holds no finite number."""
    kind = ANSWER_TYPES.get(mode)
    if kind is None:
        raise DecodeError(f"{mode!r} is no answer mode; use one of {', '.join(ANSWER_TYPES)}")
    try:
        answer: Answer = _DECODERS[kind].decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as error:
        raise DecodeError(f"answer of mode {mode}: {error}") from None
    value = getattr(answer, "angle_deg", getattr(answer, "value", 0.0))
    if not math.isfinite(value):
        raise DecodeError(f"answer of mode {mode}: {value} is not a finite number")
    return answer


def frames_iou(a: Span, b: Span) -> float:
    """Intersection over union of two spans as sets of inclusive frames; a reversed span is empty and gives 0."""
    if a.end_frame < a.start_frame or b.end_frame < b.start_frame:
        return 0.0
    both = min(a.end_frame, b.end_frame) - max(a.start_frame, b.start_frame) + 1
    if both <= 0:
        return 0.0
    return both / (a.end_frame - a.start_frame + 1 + b.end_frame - b.start_frame + 1 - both)


def same_answer(given: Answer | None, truth: Answer, second: int = round(FPS)) -> bool:
    """Whether `given` scores against `truth`; every bound is inclusive and a missing answer never scores.

    frame: within `second` frames; span: temporal IoU >= 0.5; frame_viewpoint: the frame, and within 20 degrees;
    number: both positive, ratio within [0.5, 2]; choice: equal. Answers of different kinds are never the same.
    """
    match given, truth:
        case Choice(), Choice():
            return given.choice == truth.choice
        case FrameAnswer(), FrameAnswer():
            return abs(given.frame - truth.frame) <= second
        case Span(), Span():
            return frames_iou(given, truth) >= 0.5
        case FrameViewpoint(), FrameViewpoint():
            return (
                math.isfinite(given.angle_deg)
                and abs(given.frame - truth.frame) <= second
                and float(angle_error(given.angle_deg, truth.angle_deg)) <= 20.0 + TIE
            )
        case Number(), Number():
            return given.value > 0 and truth.value > 0 and 0.5 <= given.value / truth.value <= 2.0
        case _:
            return False
