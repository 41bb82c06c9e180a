"""Answers as a person reads them."""

from __future__ import annotations

from collections.abc import Sequence

from jrdb_avr.schema.answers import Answer, Choice, FrameAnswer, FrameViewpoint, Number, Span, decode_answer
from jrdb_avr.schema.errors import DecodeError


def readable(mode: str, text: str | None, choices: Sequence[str], fps: float) -> str:
    """A stored answer in words; what cannot be read under its mode as it stands, "" where there is none."""
    if not text:
        return ""
    try:
        return _words(decode_answer(mode, text), choices, fps)
    except DecodeError:
        return text


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
            return f"{answer.value:.2f}"


def _frame(frame: int, fps: float) -> str:
    return f"frame {frame} ({frame / fps:.1f} s)"
