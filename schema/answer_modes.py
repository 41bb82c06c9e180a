"""Answer modes, such as a choice or a span of frames. Each mode is a record with all properties that the program needs.

A record says how answers of its mode are stored, written in a model's reply, scored and shown. It also says how blind
guessers guess answers of the mode, and how the selection of questions balances these answers. The prompt lines about a
mode are in `agent/prompts/answer_<mode>.md`. The file `agent_reads_<mode>.md` in that folder is for agents that make
plans. It lists the values that a plan can request to get an answer of the mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
"""Kind of one value in an answer: position of a choice, frame, angle in degrees, or decimal number in quotes."""

Guesser = Literal["uniform", "constant", "offset"]
"""Name of a blind guesser, which sees no picture. `engine/generate/blind.py` defines the guessers."""

_COLUMNS: Final = {"frame": "start", "start_frame": "start", "end_frame": "end", "angle_deg": "angle", "value": "value"}
"""Columns of candidates that hold the values of an answer, by the name of the answer's field."""


@dataclass(frozen=True)
class Part:
    """One value of an answer in a model's reply.

    Attributes:
        key: Key of the value in the JSON of the reply.
        kind: Kind of the value.
        label: Label of the input field for the value on the page of `play`.
    """

    key: str
    kind: Kind
    label: str


@dataclass(frozen=True)
class Mode:
    """An answer mode, which decides the form of an answer and the rule that scores it.

    Attributes:
        name: Name of the mode, as in the column `answer_mode` of questions.
        type: Struct that stores an answer.
        parts: Values of an answer, in the order of the struct's fields. In a model's reply, a choice is a bare number.
            An answer of another mode is a JSON object with the keys of its parts.
        same: Scoring rule. It is called with the given answer, the true answer and the number of frames per second, and
            returns whether the given answer is right.
        asks: Name of the requested value, such as "seconds", as tables show it.
        phrase: Format string that shows an answer to a person. The names of the struct's fields are in braces.
        aim: Maximum share of right answers that a blind guesser should reach, 0 to 1.
        guessers: Names of the blind guessers that can give an answer of this mode.
        smallest_read: Value that the fallback plan requests. This plan is used if no other plan could be made.
        bin_edges_s: Edges, in seconds, between bins of answers. The selection of questions balances the number of
            questions per bin.
    """

    name: AnswerMode
    type: type[Answer]
    parts: tuple[Part, ...]
    same: Callable[[Any, Any, int], bool]
    asks: str
    phrase: str
    aim: float
    guessers: tuple[Guesser, ...]
    smallest_read: Read
    bin_edges_s: tuple[float, ...] = ()

    @property
    def is_choice(self) -> bool:
        """Whether an answer of this mode is a choice."""
        return self.parts[0].kind == "choice"

    @cached_property
    def fields(self) -> tuple[tuple[str, Kind], ...]:
        """Name and kind of each field of the struct, in the struct's order."""
        names = self.type.__struct_fields__
        return tuple((name, part.kind) for name, part in zip(names, self.parts, strict=True))

    def build(self, *fields: Any) -> Answer:
        """Return an answer of this mode with the given values.

        Args:
            fields: Values of the struct's fields, in the struct's order.

        Returns:
            The answer.
        """
        struct: Callable[..., Answer] = self.type
        return struct(*fields)

    def written(self, answer: Answer) -> Any:
        """Return an answer of this mode in the form of a model's reply."""
        texts: dict[str, Callable[[Any], Any]] = {
            "choice": int,
            "frame": "{:06d}".format,
            "angle": lambda angle: round(angle, 1),
            "decimal": "{:g}".format,
        }
        values = [getattr(answer, name) for name, _ in self.fields]
        parts = {part.key: texts[part.kind](value) for part, value in zip(self.parts, values, strict=True)}
        return next(iter(parts.values())) if self.is_choice else parts

    def make(self, frames: Sequence[int], angle_deg: float, value: float = 1.0) -> Answer:
        """Return an answer of this mode. Values that an answer of this mode does not contain are ignored.

        Args:
            frames: Frames for the frame fields, in the order of the fields. There may be more frames than fields.
            angle_deg: Panorama angle in degrees.
            value: Number of seconds or people.

        Returns:
            The answer. If the mode is multiple choice, the answer is choice 1.
        """
        rest = iter(frames)
        fixed: dict[Kind, float] = {"choice": 1, "angle": angle_deg, "decimal": value}
        return self.build(*(next(rest) if kind == "frame" else fixed[kind] for _, kind in self.fields))

    def decode(self, text: str) -> Answer:
        """Read a stored answer of this mode.

        Args:
            text: JSON of the answer.

        Returns:
            The answer.

        Raises:
            DecodeError: If the text does not fit the mode, or has a number that is not finite.
        """
        try:
            answer: Answer = _DECODERS[self.name].decode(text)
        except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as error:
            raise DecodeError(f"answer of mode {self.name}: {error}") from None
        for name, kind in self.fields:
            value = getattr(answer, name)
            if kind in ("angle", "decimal") and not math.isfinite(value):
                raise DecodeError(f"answer of mode {self.name}: {value} is not a finite number")
        return answer

    @property
    def stored_json(self) -> tuple[str, ...] | None:
        """Template of a stored answer's JSON, or None if the answer is a choice.

        The tuple has JSON texts at even positions, and names of columns of candidates at odd positions. To get the JSON
        of a candidate's answer, replace each name by the candidate's value in that column. Choices have no template,
        because the order of the choices is drawn after the candidates are found.

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
            phrase="{choice}",
            aim=0.35,
            guessers=("uniform", "constant"),
            smallest_read="action",
        ),
        Mode(
            "frame",
            FrameAnswer,
            (_FRAME,),
            same=_same_frame,
            asks="frame",
            phrase="{frame}",
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
            phrase="from {start_frame} to {end_frame}",
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
            phrase="{frame}, angle {angle_deg}",
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
            phrase="{value}",
            aim=0.58,
            guessers=("constant",),
            smallest_read="count",
            bin_edges_s=(5.0, 10.0, 20.0, 40.0),
        ),
    )
}
"""Answer modes by name."""

# Created at import, because msgspec crashes if two threads make the first decoder of a type at the same time.
_DECODERS: Final = {mode.name: msgspec.json.Decoder(mode.type) for mode in MODES.values()}
_OF_TYPE: Final = {mode.type: mode for mode in MODES.values()}


def mode_of(answer: Answer) -> Mode:
    """Return the mode of an answer.

    Args:
        answer: Answer of any mode.

    Returns:
        The mode that has answers of this type.
    """
    return _OF_TYPE[type(answer)]


def frames_of_answer(answer: Answer) -> list[int]:
    """Return the frames that an answer names.

    Args:
        answer: Answer of any mode.

    Returns:
        A list of frames. It has the first and the last frame of a span, or the frame of another answer. The list is
        empty if the answer does not name a frame.
    """
    return [getattr(answer, name) for name, kind in mode_of(answer).fields if kind == "frame"]


def decode_answer(mode: str, text: str) -> Answer:
    """Read a stored answer of any mode.

    Args:
        mode: Name of the answer's mode.
        text: JSON of the answer.

    Returns:
        The answer.

    Raises:
        DecodeError: If the mode is unknown, or the text does not fit the mode or has a number that is not finite.
    """
    if mode not in MODES:
        raise DecodeError(f"{mode!r} is no answer mode; use one of {', '.join(MODES)}")
    return MODES[mode].decode(text)


def same_answer(given: Answer | None, truth: Answer, second: int = round(FPS)) -> bool:
    """Return whether a method's answer is right. An answer exactly at the bound of a tolerance is right.

    Args:
        given: Answer of a method, or None, which is never right.
        truth: True answer.
        second: Number of frames per second.

    Returns:
        Whether both answers have the same mode, and the mode's rule `same` accepts the given answer.
    """
    mode = mode_of(truth)
    return type(given) is mode.type and mode.same(given, truth, second)
