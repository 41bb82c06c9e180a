"""Answers and evidence, as a store keeps them.

`schema/answer_modes.py` defines how an answer of each mode is written in a reply, scored and shown.

The stored JSON of an answer depends on the question's answer mode:
`{"choice": 2}` (1-based), `{"frame": 150}`, `{"start_frame": 10, "end_frame": 95}`,
`{"frame": 150, "angle_deg": 210.0}`, `{"value": 12.5}`.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

AnswerMode = Literal["multiple_choice", "frame", "span", "frame_viewpoint", "number"]

TIE: Final = 1e-9
"""Tolerance at inclusive bounds. Rounding may move a value slightly past its bound, for example an angle in degrees."""

_FRAME_LIMIT: Final = 10_000_000
_Frame = Annotated[int, msgspec.Meta(ge=0, le=_FRAME_LIMIT)]


class Choice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Answer to a multiple-choice question: the position of a choice, counted from 1."""

    choice: Annotated[int, msgspec.Meta(ge=1, le=1000)]


class FrameAnswer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Answer that names a time by its frame number."""

    frame: _Frame


class Span(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Answer that names a span of time by its first and last frame. Both frames belong to the span."""

    start_frame: _Frame
    end_frame: _Frame


class FrameViewpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Answer that names a frame and an angle. The angle, in degrees, is a person's panorama angle in that frame."""

    frame: _Frame
    angle_deg: float


class Number(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Answer that is a number of seconds or of people."""

    value: float


Answer = Choice | FrameAnswer | Span | FrameViewpoint | Number


class Evidence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Box around the person that the answer is about, in one frame. `box` is (x, y, w, h) in stitched pixels."""

    frame: _Frame
    box: tuple[float, float, float, float]


def encode_answer(answer: Answer) -> str:
    """Return the stored JSON of an answer."""
    return msgspec.json.encode(answer).decode()


def frames_iou(a: Span, b: Span) -> float:
    """Return the intersection over union of two spans.

    The result is the number of frames that both spans contain, divided by the number of frames that at least one span
    contains. The result is 0 if a span ends before it starts.
    """
    if a.end_frame < a.start_frame or b.end_frame < b.start_frame:
        return 0.0
    both = min(a.end_frame, b.end_frame) - max(a.start_frame, b.start_frame) + 1
    if both <= 0:
        return 0.0
    return both / (a.end_frame - a.start_frame + 1 + b.end_frame - b.start_frame + 1 - both)
