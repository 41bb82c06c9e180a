"""Where marks of the charts stand: pure geometry in the units of an SVG view box; templates draw them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.engine.judged import SCORES

from .diagrams import shortened

WIDTH: Final = 1040.0
NAME_CHARACTERS: Final = 40
"""Of a run's name at most; what is longer is cut, and marked so."""

_LETTER: Final = 6.9
_ROW: Final = 13.0
_GAP: Final = 10.0


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
    """The whiskers of a run, and its name, in short and whole, at height `y`."""

    name: str
    title: str
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
    names = [shortened(_name(row), NAME_CHARACTERS) for row in rows]
    left = round(16 + _LETTER * max((len(name) for name in names), default=0), 2)

    def x_of(percent: float) -> float:
        return round(left + (WIDTH - left - 14) * percent / 100, 2)

    groups = []
    top = 8.0
    for name, row in zip(names, rows, strict=True):
        whiskers = []
        for place, kind in enumerate(SCORES):
            value = row.get(kind)
            if value is None:
                continue
            low, high = row.get(f"{kind}_low"), row.get(f"{kind}_high")
            text = f"{kind} {value:.2f}"
            bounds = x_of(value), x_of(value)
            if low is not None and high is not None:
                text, bounds = f"{text} [{low:.2f}, {high:.2f}]", (x_of(low), x_of(high))
            whiskers.append(Whisker(kind, x_of(value), *bounds, top + _ROW * (place + 0.5), text))
        groups.append(Group(name, _name(row), top + _ROW * 1.5, tuple(whiskers)))
        top += _ROW * len(SCORES) + _GAP
    ticks = tuple((x_of(value), f"{value}") for value in range(0, 101, 20))
    return Intervals(WIDTH, top + 16, left, tuple(groups), ticks)


def _name(row: Mapping[str, Any]) -> str:
    return str(row.get("run") or f"{row['method']}, {row['model']}")


@dataclass(frozen=True)
class Dot:
    """A run among the axes, answer to the right and evidence upwards; `number` is its place in the legend."""

    x: float
    y: float
    number: int
    name: str
    text: str


@dataclass(frozen=True)
class Tag:
    """The numbers of the dots that lie on or close to each other, beside them."""

    x: float
    y: float
    anchor: str
    text: str


SQUARE: Final = 380.0
_MARGIN: Final = 40.0
_CLOSE: Final = 11.0


def scatter(rows: Sequence[Mapping[str, Any]]) -> tuple[Dot, ...]:
    """Answer against evidence, percent, in a square of `SQUARE`; rows without the two are left out."""
    dots = []
    for number, row in enumerate(rows, 1):
        if row.get("answer") is None or row.get("evidence") is None:
            continue
        text = f"answer {row['answer']:.2f}, evidence {row['evidence']:.2f}, combined {row['combined']:.2f}"
        dots.append(Dot(_place(row["answer"]), round(SQUARE - _place(row["evidence"]), 2), number, _name(row), text))
    return tuple(dots)


def tags(dots: Sequence[Dot]) -> tuple[Tag, ...]:
    """One tag for the dots that would lie on each other's numbers, however many runs score alike."""
    clusters: list[list[Dot]] = []
    for dot in sorted(dots, key=lambda dot: (dot.x, dot.y)):
        near = next((own for own in clusters if any(math.dist((o.x, o.y), (dot.x, dot.y)) < _CLOSE for o in own)), None)
        if near is None:
            clusters.append([dot])
        else:
            near.append(dot)
    found = []
    for own in clusters:
        right = max(dot.x for dot in own)
        y = round(sum(dot.y for dot in own) / len(own) + 4, 2)
        text = ", ".join(str(number) for number in sorted(dot.number for dot in own))
        inside = right + 8 + _LETTER * len(text) < SQUARE
        found.append(Tag(right + 8, y, "start", text) if inside else Tag(min(d.x for d in own) - 8, y, "end", text))
    return tuple(found)


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


def stacked(counts: Sequence[tuple[str, int]], total: int) -> tuple[Part, ...]:
    """A bar of parts in percent of `total`; empty where there is nothing to show."""
    parts, x = [], 0.0
    for number, (name, times) in enumerate(counts):
        width = 100 * times / total if total else 0.0
        if times:
            parts.append(Part(name, round(x, 3), round(width, 3), times, number))
        x += width
    return tuple(parts)
