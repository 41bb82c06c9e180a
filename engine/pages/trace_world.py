"""The world model of a trace as it grew: what was written of each entity, and the relations between them, drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from jrdb_avr.engine.pages.svg import shortened
from jrdb_avr.engine.report.traces import Trace, Written
from jrdb_avr.schema.beliefs import ALWAYS

ROLES: Final = 6
"""Colours of people in `roles.css`."""

_NODE: Final = (126.0, 40.0)
_STRIDE: Final = 190.0
_ARC: Final = 32.0
_LETTER: Final = 6.4
_LETTERS: Final = 15
_WORDS: Final = 60
_MOST_NODES: Final = 40
"""Of a drawing; what a hostile run wrote beyond stands in the list alone."""


@dataclass(frozen=True)
class Said:
    """A piece of the world model: written at a step, replaced at `until`."""

    step: int
    until: int
    text: str


@dataclass
class Card:
    """An entity: what holds of it at any time, and what was seen of it by frame."""

    name: str
    role: int
    step: int
    kind: str
    about: list[Said] = field(default_factory=list)
    frames: dict[int, list[Said]] = field(default_factory=dict)

    @property
    def rows(self) -> list[tuple[int, int, list[Said]]]:
        """Frame, the step that first wrote of it, and what was written, in the order of time."""
        return [(frame, min(one.step for one in own), own) for frame, own in sorted(self.frames.items())]


@dataclass(frozen=True)
class Knot:
    """An entity as drawn: left edge, name in short and whole, and the step that made it."""

    x: float
    name: str
    title: str
    role: int
    step: int


@dataclass(frozen=True)
class Tie:
    """A relation as drawn: an arc from `x1` to `x2` of height `rise`."""

    x1: float
    x2: float
    rise: float
    step: int
    until: int
    text: str
    title: str


@dataclass(frozen=True)
class Web:
    """The entities that relations join, in a row, and the relations above them; `left`: where the drawing begins."""

    left: float
    size: tuple[float, float]
    node: tuple[float, float]
    knots: tuple[Knot, ...]
    ties: tuple[Tie, ...]


def entities(trace: Trace) -> dict[str, tuple[str, int]]:
    """Key of each entity -> its name and colour, in the order in which they were made."""
    made = [write.fact.entity for write in trace.writes if write.fact.entity is not None]
    return {entity.id: (entity.name, number % ROLES) for number, entity in enumerate(made)}


def cards(trace: Trace, names: Mapping[str, tuple[str, int]]) -> list[Card]:
    """Each entity with what was written of it."""
    found: dict[str, Card] = {}
    ends = _replaced(trace)
    for write in trace.writes:
        _write(write, ends.get(int(write.row["number"]), ALWAYS), found, names)
    return list(found.values())


def _write(write: Written, until: int, found: dict[str, Card], names: Mapping[str, tuple[str, int]]) -> None:
    step, fact = int(write.row["step"]), write.fact
    for freed in fact.freed:
        if freed in found:
            found[freed].about.append(Said(step, ALWAYS, "is nobody of the plan any more"))
    if (made := fact.entity) is not None:
        found[made.id] = Card(*names[made.id], step, made.kind)
        if made.node:
            found[made.id].about.append(Said(step, ALWAYS, f"is the plan's {made.node}"))
    if (now := fact.changed) is not None and now.id in found:
        text = f"is the plan's {now.node}" if now.node else f"is a {now.kind}"
        found[now.id].about.append(Said(step, ALWAYS, text))
    if (seen := fact.sighted) is not None and seen.source in found:
        where = Said(step, until, f"at {seen.angle:.0f}\N{DEGREE SIGN}")
        found[seen.source].frames.setdefault(seen.frame, []).append(where)
    if (has := fact.has) is not None and has.source in found:
        card, said = found[has.source], Said(step, until, f"{has.name}: {has.value}")
        if has.first == has.last:
            card.frames.setdefault(has.first, []).append(said)
        else:
            card.about.append(said)


def _replaced(trace: Trace) -> dict[int, int]:
    """The number of each write whose fact a later one replaced -> the step of that one."""
    return {number: int(write.row["step"]) for write in trace.writes for number in write.fact.replaced}


def relations(trace: Trace) -> list[Said]:
    """Every relation in words."""
    ends = _replaced(trace)
    return [
        Said(
            int(write.row["step"]),
            ends.get(int(write.row["number"]), ALWAYS),
            f"{_name(tie.source)}: {tie.name} \N{RIGHTWARDS ARROW} {_name(tie.target)}, frame {tie.first}",
        )
        for write in trace.writes
        if (tie := write.fact.related) is not None
    ]


def web(trace: Trace, names: Mapping[str, tuple[str, int]]) -> Web | None:
    """The relations as a drawing; None where there are none, or too many people for one."""
    made = {write.fact.entity.id: int(write.row["step"]) for write in trace.writes if write.fact.entity is not None}
    written = [(write, tie) for write in trace.writes if (tie := write.fact.related) is not None]
    joined = dict.fromkeys(key for _, tie in written for key in (tie.source, tie.target) if key in made)
    if not joined or len(joined) > _MOST_NODES:
        return None
    place = {key: number * _STRIDE + 1 for number, key in enumerate(joined)}
    ends = _replaced(trace)
    # The frame is said where it tells two of them apart.
    several = len({tie.first for _, tie in written}) > 1
    levels: list[list[tuple[float, float]]] = []
    ties = []
    for write, tie in written:
        if tie.source not in place or tie.target not in place:
            continue
        shift = _NODE[0] * (0.62 if place[tie.target] > place[tie.source] else 0.38)
        x1, x2 = place[tie.source] + shift, place[tie.target] + _NODE[0] - shift
        title = f"{tie.name}, frame {tie.first}"
        text = shortened(title if several else tie.name, _WORDS)
        half = max(abs(x1 - x2), _LETTER * len(text)) / 2 + 6
        extent = (x1 + x2) / 2 - half, (x1 + x2) / 2 + half
        rise = _ARC * (1 + _level(levels, extent))
        ties.append(Tie(x1, x2, rise, int(write.row["step"]), ends.get(int(write.row["number"]), ALWAYS), text, title))
    knots = (Knot(x, shortened(names[key][0], _LETTERS), *names[key], made[key]) for key, x in place.items())
    top = max((tie.rise for tie in ties), default=0.0) + 18
    # Words may reach beyond the people at the ends.
    reach = [end for level in levels for extent in level for end in extent]
    left, right = min(0.0, *reach), max((len(place) - 1) * _STRIDE + _NODE[0] + 2, *reach)
    return Web(left, (right - left, top + _NODE[1] + 2), _NODE, tuple(knots), tuple(ties))


def _level(levels: list[list[tuple[float, float]]], extent: tuple[float, float]) -> int:
    """The lowest level on which nothing stands between these two places; it is taken."""
    for number, taken in enumerate(levels):
        if all(extent[1] < low or high < extent[0] for low, high in taken):
            taken.append(extent)
            return number
    levels.append([extent])
    return len(levels) - 1


def _name(key: str) -> str:
    return key.rpartition("/")[2]
