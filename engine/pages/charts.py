"""Where marks of the charts stand: pure geometry in the units of an SVG view box; templates draw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.engine.judged import SCORES

WIDTH: Final = 640.0
LABELS: Final = 170.0
"""Width kept for the names on the left."""

_ROW: Final = 15.0
_GAP: Final = 12.0


@dataclass(frozen=True)
class Whisker:
    """A share as a dot at `x` with its interval from `low` to `high`, at height `y`."""

    kind: str
    x: float
    low: float
    high: float
    y: float
    text: str


@dataclass(frozen=True)
class Group:
    """The whiskers of a run, and its name at height `y`."""

    name: str
    label: str
    y: float
    whiskers: tuple[Whisker, ...]


@dataclass(frozen=True)
class Intervals:
    """A dot-and-whisker chart over 0 to 100 percent."""

    width: float
    height: float
    left: float
    groups: tuple[Group, ...]
    ticks: tuple[tuple[float, str], ...]


def intervals(rows: Sequence[Mapping[str, Any]]) -> Intervals:
    """One group per row of the main table: answer, evidence and combined below each other."""
    groups = []
    top = 8.0
    for row in rows:
        whiskers = []
        for place, kind in enumerate(SCORES):
            value = row.get(kind)
            if value is None:
                continue
            low, high = row.get(f"{kind}_low"), row.get(f"{kind}_high")
            text = f"{kind} {value:.2f}"
            bounds = _x(value), _x(value)
            if low is not None and high is not None:
                text, bounds = f"{text} [{low:.2f}, {high:.2f}]", (_x(low), _x(high))
            whiskers.append(Whisker(kind, _x(value), *bounds, top + _ROW * (place + 0.5), text))
        groups.append(Group(_name(row), str(row.get("label", "")), top + _ROW * 1.5, tuple(whiskers)))
        top += _ROW * len(SCORES) + _GAP
    ticks = tuple((_x(value), f"{value}") for value in range(0, 101, 20))
    return Intervals(WIDTH, top + 16, LABELS, tuple(groups), ticks)


def _x(percent: float) -> float:
    return round(LABELS + (WIDTH - LABELS - 12) * percent / 100, 2)


def _name(row: Mapping[str, Any]) -> str:
    return str(row.get("run") or f"{row['method']}, {row['model']}")


@dataclass(frozen=True)
class Dot:
    """A run among the axes: answer to the right, evidence upwards, and where its name stands."""

    x: float
    y: float
    name: str
    label: str
    text: str
    name_x: float
    name_y: float
    anchor: str


SQUARE: Final = 320.0
_MARGIN: Final = 36.0


def scatter(rows: Sequence[Mapping[str, Any]]) -> tuple[Dot, ...]:
    """Answer against evidence, percent, in a square of `SQUARE`; names move down where they would lie on each other."""
    dots: list[Dot] = []
    for row in sorted(rows, key=lambda row: -(row.get("evidence") or 0)):
        if row.get("answer") is None or row.get("evidence") is None:
            continue
        x, y = _place(row["answer"]), round(SQUARE - _place(row["evidence"]), 2)
        right = x > SQUARE * 0.6
        name_y = y + 4
        for other in dots:
            if abs(other.name_y - name_y) < 13 and (other.anchor == "end") == right:
                name_y = other.name_y + 13
        text = f"answer {row['answer']:.2f}, evidence {row['evidence']:.2f}, combined {row['combined']:.2f}"
        name_x, anchor = (x - 8, "end") if right else (x + 8, "start")
        dots.append(Dot(x, y, _name(row), str(row.get("label", "")), text, name_x, name_y, anchor))
    return tuple(dots)


def _place(percent: float) -> float:
    return round(_MARGIN + (SQUARE - 2 * _MARGIN) * percent / 100, 2)


@dataclass(frozen=True)
class Part:
    """A part of a bar: from `x` on, `width` wide, in percent of the bar."""

    name: str
    x: float
    width: float
    times: int
    number: int


def stacked(counts: Sequence[tuple[str, int]]) -> tuple[Part, ...]:
    """A bar whose parts add up to 100; empty where there is nothing to show."""
    total = sum(times for _, times in counts)
    parts, x = [], 0.0
    for number, (name, times) in enumerate(counts):
        width = 100 * times / total if total else 0.0
        if times:
            parts.append(Part(name, round(x, 3), round(width, 3), times, number))
        x += width
    return tuple(parts)
