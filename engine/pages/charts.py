"""Where marks of the charts stand: pure geometry in percent of an axis or units of a view box; templates draw them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.engine.judged import SCORES

from .diagrams import shortened

NAME_CHARACTERS: Final = 64
"""Of a run's name at most; what is longer is cut, and marked so."""

_LETTER: Final = 6.9

TICKS: Final = (0, 20, 40, 60, 80, 100)
"""Percents that the axis of the intervals names."""


@dataclass(frozen=True)
class Whisker:
    """A share with its interval, places in percent of the axis; `kind` is one of `SCORES`."""

    kind: str
    x: float
    low: float
    high: float
    text: str


@dataclass(frozen=True)
class Group:
    """The whiskers of a run, with its name in short and whole and its label."""

    name: str
    title: str
    label: str
    whiskers: tuple[Whisker, ...]


def intervals(rows: Sequence[Mapping[str, Any]]) -> tuple[Group, ...]:
    """One group per row of the main table: answer, evidence and combined below each other."""
    groups = []
    for row in rows:
        whiskers = []
        for kind in SCORES:
            value = row.get(kind)
            if value is None:
                continue
            low, high = row.get(f"{kind}_low"), row.get(f"{kind}_high")
            text, bounds = f"{kind} {value:.2f}", (value, value)
            if low is not None and high is not None:
                text, bounds = f"{text} [{low:.2f}, {high:.2f}]", (low, high)
            whiskers.append(Whisker(kind, round(value, 3), round(bounds[0], 3), round(bounds[1], 3), text))
        name = _name(row)
        groups.append(Group(shortened(name, NAME_CHARACTERS), name, str(row.get("label") or ""), tuple(whiskers)))
    return tuple(groups)


def _name(row: Mapping[str, Any]) -> str:
    return str(row.get("run") or f"{row['method']}, {row['model']}")


@dataclass(frozen=True)
class Dot:
    """A run among the axes, answer to the right and evidence upwards; `number` is its place in the legend."""

    x: float
    y: float
    number: int
    name: str
    label: str
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
        dots.append(
            Dot(
                _place(row["answer"]),
                round(SQUARE - _place(row["evidence"]), 2),
                number,
                _name(row),
                str(row.get("label") or ""),
                text,
            )
        )
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
