"""Answer modes: one record per mode, with all properties that the program needs.

A record says how answers of its mode are stored, written in a reply, scored, balanced, guessed and shown. The lines of
its prompts are `agent/prompts/answer_<mode>.md`, and the reads of a plan that give it `agent_reads_<mode>.md` there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal

import msgspec

from jrdb_avr.schema.answers import (
    TIE,
    Answer,
    AnswerMode,
    Choice,
    FrameAnswer,
    FrameViewpoint,
    Number,
    Span,
    frames_iou,
)
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Read
from jrdb_avr.schema.rules import FPS

Kind = Literal["choice", "frame", "angle", "decimal"]
"""A part of an answer: the number of a choice, a frame, an angle in degrees, or a number in quotes."""

Guesser = Literal["uniform", "most_frequent", "by_choice", "constant", "offset"]
"""A guesser that knows no picture: see `engine/generate/blind.py`."""

_COLUMNS: Final = {"frame": "start", "start_frame": "start", "end_frame": "end", "angle_deg": "angle", "value": "value"}
"""The column of a candidate that holds each field of a stored answer."""


@dataclass(frozen=True)
class Part:
    """A part of an answer in a reply: its key, its kind, and its label in a form."""

    key: str
    kind: Kind
    label: str


@dataclass(frozen=True)
class Mode:
    """An answer mode.

    type: the stored struct. parts: the parts of an answer, in the order of the struct's fields; a single choice is
    written in a reply without its key. same: whether an answer scores against the true one, with a second's frames.
    asks: the mode in a word or two, in tables. words: a stored answer in words, with its fields in braces. aim: maximum
    score of a blind guesser. guessers: the blind guessers that can give an answer. smallest_read: the read of a plan
    about which nothing is known. bin_edges_s: edges in seconds between the bins in which answers are balanced.
    """

    name: AnswerMode
    type: type[Answer]
    parts: tuple[Part, ...]
    same: Callable[[Any, Any, int], bool]
    asks: str
    words: str
    aim: float
    guessers: tuple[Guesser, ...]
    smallest_read: Read
    bin_edges_s: tuple[float, ...] = ()
    # Made at import: threads that meet a type first at the same time crash the decoder.
    _decoder: msgspec.json.Decoder[Any] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_decoder", msgspec.json.Decoder(self.type))

    @property
    def is_choice(self) -> bool:
        """Whether an answer is the number of a choice."""
        return self.parts[0].kind == "choice"

    @cached_property
    def fields(self) -> tuple[tuple[str, Kind], ...]:
        """The fields of the struct with their kinds."""
        names = self.type.__struct_fields__
        return tuple((name, part.kind) for name, part in zip(names, self.parts, strict=True))

    def build(self, *fields: Any) -> Answer:
        """Return an answer of this mode.

        Args:
            fields: The values of the struct's fields, in their order.

        Returns:
            The answer.
        """
        struct: Callable[..., Answer] = self.type
        return struct(*fields)

    def make(self, frames: Sequence[int], angle_deg: float, value: float = 1.0) -> Answer:
        """Return an answer of this mode, of the given parts.

        Args:
            frames: The frames, as many as the mode has at least.
            angle_deg: The panorama angle in degrees.
            value: The number.

        Returns:
            The answer; the first choice if it is a choice.
        """
        rest = iter(frames)
        fixed: dict[Kind, float] = {"choice": 1, "angle": angle_deg, "decimal": value}
        return self.build(*(next(rest) if kind == "frame" else fixed[kind] for _, kind in self.fields))

    def decode(self, text: str) -> Answer:
        """Read a stored answer.

        Args:
            text: Its JSON.

        Returns:
            The answer.

        Raises:
            DecodeError: The text does not fit the mode or holds a number that is not finite.
        """
        try:
            answer: Answer = self._decoder.decode(text)
        except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as error:
            raise DecodeError(f"answer of mode {self.name}: {error}") from None
        for name, kind in self.fields:
            value = getattr(answer, name)
            if kind in ("angle", "decimal") and not math.isfinite(value):
                raise DecodeError(f"answer of mode {self.name}: {value} is not a finite number")
        return answer

    @property
    def stored_json(self) -> tuple[str, ...] | None:
        """The JSON of a stored answer in pieces, with the names of candidates' columns between them.

        None if the answer is a choice, because choices are drawn later.

        >>> MODES["span"].stored_json
        ('{"start_frame":', 'start', ',"end_frame":', 'end', '}')
        """
        if self.is_choice:
            return None
        pieces = [piece for name, _ in self.fields for piece in (f',"{name}":', _COLUMNS[name])]
        return "{" + pieces[0][1:], *pieces[1:], "}"


_OFFSET_EDGES_S: Final = (3.0, 6.0, 10.0, 15.0, 21.0)
_FRAME: Final = Part("frame_id", "frame", "frame")


def _same_frame(given: FrameAnswer | FrameViewpoint, truth: FrameAnswer | FrameViewpoint, second: int) -> bool:
    return abs(given.frame - truth.frame) <= second


def _same_viewpoint(given: FrameViewpoint, truth: FrameViewpoint, second: int) -> bool:
    near = math.isfinite(given.angle_deg) and _same_frame(given, truth, second)
    return near and float(angle_error(given.angle_deg, truth.angle_deg)) <= 20.0 + TIE


MODES: Final[Mapping[str, Mode]] = {
    mode.name: mode
    for mode in (
        Mode(
            "multiple_choice",
            Choice,
            (Part("choice", "choice", "choice"),),
            same=lambda given, truth, _second: given == truth,
            asks="choice",
            words="{choice}",
            aim=0.35,
            guessers=("uniform", "most_frequent", "by_choice"),
            smallest_read="action",
        ),
        Mode(
            "frame",
            FrameAnswer,
            (_FRAME,),
            same=_same_frame,
            asks="frame",
            words="{frame}",
            aim=0.25,
            guessers=("constant", "offset"),
            smallest_read="start",
            bin_edges_s=_OFFSET_EDGES_S,
        ),
        Mode(
            "span",
            Span,
            (Part("start_frame", "frame", "first frame"), Part("end_frame", "frame", "last frame")),
            same=lambda given, truth, _second: frames_iou(given, truth) >= 0.5,
            asks="span",
            words="from {start_frame} to {end_frame}",
            aim=0.25,
            guessers=("constant", "offset"),
            smallest_read="span",
            bin_edges_s=_OFFSET_EDGES_S,
        ),
        Mode(
            "frame_viewpoint",
            FrameViewpoint,
            (_FRAME, Part("angle_deg", "angle", "angle in degrees")),
            same=_same_viewpoint,
            asks="frame and angle",
            words="{frame}, angle {angle_deg}",
            aim=0.25,
            guessers=("constant", "offset"),
            smallest_read="start_view",
            bin_edges_s=_OFFSET_EDGES_S,
        ),
        Mode(
            "number",
            Number,
            (Part("value", "decimal", "number"),),
            same=lambda given, truth, _second: (
                given.value > 0 and truth.value > 0 and 0.5 <= given.value / truth.value <= 2.0
            ),
            asks="seconds",
            words="{value}",
            aim=0.58,
            guessers=("constant",),
            smallest_read="count",
            bin_edges_s=(5.0, 10.0, 20.0, 40.0),
        ),
    )
}
"""The answer modes by name."""

_OF_TYPE: Final = {mode.type: mode for mode in MODES.values()}


def mode_of(answer: Answer) -> Mode:
    """Return the mode of an answer.

    Args:
        answer: An answer.

    Returns:
        The mode with its type.
    """
    return _OF_TYPE[type(answer)]


def frames_of_answer(answer: Answer) -> list[int]:
    """Return the frames that an answer names.

    Args:
        answer: An answer.

    Returns:
        The frames in the order of its fields.
    """
    return [getattr(answer, name) for name, kind in mode_of(answer).fields if kind == "frame"]


def decode_answer(mode: str, text: str) -> Answer:
    """Read a stored answer.

    Args:
        mode: The name of its mode.
        text: Its JSON.

    Returns:
        The answer.

    Raises:
        DecodeError: The mode is unknown, or the text does not fit it or holds a number that is not finite.
    """
    if mode not in MODES:
        raise DecodeError(f"{mode!r} is no answer mode; use one of {', '.join(MODES)}")
    return MODES[mode].decode(text)


def same_answer(given: Answer | None, truth: Answer, second: int = round(FPS)) -> bool:
    """Return whether an answer scores against the true one; every bound is inclusive.

    Args:
        given: The answer of a method; None scores against nothing.
        truth: The true answer.
        second: The frames of a second.

    Returns:
        Whether both are of one mode and its rule `same` holds.
    """
    mode = mode_of(truth)
    return type(given) is mode.type and mode.same(given, truth, second)
