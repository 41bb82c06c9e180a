"""Answers as a person reads them."""

from __future__ import annotations

from collections.abc import Sequence

from jrdb_avr.schema.answers import Answer, Choice, FrameAnswer, FrameViewpoint, Number, Span, decode_answer
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.plan import Plan


def readable(mode: str, text: str | None, choices: Sequence[str], fps: float, unit: str = "") -> str:
    """A stored answer in words; what cannot be read under its mode as it stands, "" where there is none.

    `unit` is that of a number, as `unit_of` names it.
    """
    if not text:
        return ""
    try:
        said = _words(decode_answer(mode, text), choices, fps)
    except DecodeError:
        return text
    return f"{said} {unit}" if unit else said


def unit_of(plan: Plan) -> str:
    """What the number that a plan asks for counts."""
    return {"seconds_between": "s", "count": "people"}.get(plan.answer.read, "")


def _words(answer: Answer, choices: Sequence[str], fps: float) -> str:
    match answer:
        case Choice():
            known = 1 <= answer.choice <= len(choices)
            return f"{answer.choice}: {choices[answer.choice - 1]}" if known else f"{answer.choice}: no such choice"
        case FrameAnswer():
            return _frame(answer.frame, fps)
        case Span():
            return f"from {_frame(answer.start_frame, fps)} to {_frame(answer.end_frame, fps)}"
        case FrameViewpoint():
            return f"{_frame(answer.frame, fps)}, angle {answer.angle_deg:.1f}\N{DEGREE SIGN}"
        case Number():
            return f"{answer.value:.2f}".removesuffix(".00")


def _frame(frame: int, fps: float) -> str:
    return f"frame {frame} ({frame / fps:.1f} s)"
