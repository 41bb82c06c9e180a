"""Diagrams of a question: its plan as a graph, and what its people do over time, as places in an SVG.

Where marks of the charts stand: pure geometry in percent of an axis or units of a view box; templates draw them.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

from jrdb_avr.engine.report.scored_runs import SCORES
from jrdb_avr.schema.plan import Condition, Plan

NODE_WIDTH: Final = 165.0
_NODE_CHARACTERS: Final = 23
_NODE_HEAD: Final = 24.0
_NODE_LINE: Final = 13.0
_GAP: Final = 150.0
"""Between columns; the words of an edge stand in it."""
_WIDE_GAP: Final = 230.0
_GAP_CHARACTERS: Final = 22
_LANE_GAP: Final = 50.0

TIMELINE_WIDTH: Final = 1040.0
_LABELS: Final = 262.0
_ROW: Final = 17.0
_LABEL_CHARACTERS: Final = 38
_LEAST: Final = 3.0
"""Of a bar: what holds in one frame must be seen beside the line of a named time."""

_MOMENT_Y: Final = 11.0
_MOMENT_ROOM: Final = 28.0
"""Between the names of two times that stand beside each other."""


# -- the plan ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PlanNode:
    """A person of the plan: upper left corner, role, and lines that describe it."""

    role: str
    x: float
    y: float
    lines: tuple[str, ...]
    target: bool


@dataclass(frozen=True)
class PlanEdge:
    """A relation between the middles of two sides, its words in the middle."""

    x1: float
    y1: float
    x2: float
    y2: float
    words: tuple[str, ...]

    @property
    def level(self) -> bool:
        """Whether the words can stand above the line; else they stand in it."""
        return self.y1 == self.y2


@dataclass(frozen=True)
class PlanGraph:
    """A plan as drawn: nodes of one size in columns by their distance from the root, `top` room above for words."""

    node: tuple[float, float]
    top: float
    width: float
    height: float
    nodes: tuple[PlanNode, ...]
    edges: tuple[PlanEdge, ...]
    times: tuple[str, ...]
    asks: str


def plan_graph(plan: Plan) -> PlanGraph:
    """Lay a plan out."""
    column = {plan.root: 0}
    for _ in plan.nodes:
        for edge in plan.edges:
            if edge.source in column:
                column.setdefault(edge.target, column[edge.source] + 1)
    lanes: dict[str, tuple[int, int]] = {}
    for node in plan.nodes:
        beside = sum(column[other] == column[node.id] for other in lanes)
        lanes[node.id] = column[node.id], beside
    several = len(plan.times) > 1
    lines = {node.id: _node_lines(node.conditions, several) for node in plan.nodes}
    tall = _NODE_HEAD + _NODE_LINE * max(1, *(len(own) for own in lines.values())) + 4
    lane_height = tall + _LANE_GAP
    height = max(1, *(lane + 1 for _, lane in lanes.values())) * lane_height - _LANE_GAP
    counts = {number: sum(c == number for c, _ in lanes.values()) for number in column.values()}
    # Beside each other they are drawn slanted, and the words of a slanted line stand in it.
    gap = _GAP if max(counts.values()) == 1 else _WIDE_GAP
    places = {
        role: (1 + c * (NODE_WIDTH + gap), (height + _LANE_GAP - counts[c] * lane_height) / 2 + lane * lane_height)
        for role, (c, lane) in lanes.items()
    }
    nodes = tuple(PlanNode(node.id, *places[node.id], lines[node.id], node.id == plan.target) for node in plan.nodes)
    edges = []
    for edge in plan.edges:
        (x1, y1), (x2, y2) = places[edge.source], places[edge.target]
        ends = x1 + NODE_WIDTH, y1 + tall / 2, x2, y2 + tall / 2
        edges.append(PlanEdge(*ends, wrapped(_timed(edge.relation, edge.at, several), _GAP_CHARACTERS)))
    width = max(x for x, _ in places.values()) + NODE_WIDTH + 2
    top = max((_NODE_LINE * len(edge.words) + 10 - tall / 2 for edge in edges), default=0.0)
    return PlanGraph(
        (NODE_WIDTH, tall), max(top, 0.0), width, height, nodes, tuple(edges), tuple(_times(plan)), _asks(plan)
    )


def _node_lines(conditions: Sequence[Condition], several: bool) -> tuple[str, ...]:
    """Every condition, whole: a reviewer must not judge by half of one."""
    # A list of things in one word may be broken at its strokes.
    texts = [_timed(_condition(condition).replace("/", " / "), condition.at, several) for condition in conditions]
    return tuple(line for text in texts for line in wrapped(text, _NODE_CHARACTERS)) or ("anybody",)


def _timed(text: str, at: str | None, several: bool) -> str:
    """What holds, with its time where the plan has several."""
    return f"{text}, {at}" if several and at else text


def wrapped(text: str, characters: int) -> tuple[str, ...]:
    """A text in lines of at most so many characters, broken between words."""
    return tuple(textwrap.wrap(text, characters, break_on_hyphens=False)) or ("",)


def shortened(text: str, characters: int) -> str:
    """A text of at most so many characters; what is cut is marked."""
    return text if len(text) <= characters else text[: characters - 1].rstrip() + "\N{HORIZONTAL ELLIPSIS}"


def _condition(condition: Condition) -> str:
    match condition:
        case Condition(attribute=str(name)):
            return f"{name.replace('_', ' ')}: {condition.value}"
        case Condition(action=str(action)):
            return action
        case Condition(object=str(thing)):
            return f"{condition.verb} {thing}"
        case _:
            return f"{condition.interaction} with someone"


def _times(plan: Plan) -> list[str]:
    words = []
    for name, time in plan.times.items():
        if time.frame is not None:
            words.append(f"{name}: frame {time.frame}")
        else:
            what = f" {time.action}" if time.action else ""
            words.append(f"{name}: {time.of} {time.event}s{what} after {time.after}".replace("ss ", "s "))
    return words


def _asks(plan: Plan) -> str:
    counted = f" of '{plan.answer.relation}'" if plan.answer.relation else ""
    return f"{plan.answer.read.replace('_', ' ')}{counted} of {plan.answer.of} at {', '.join(plan.answer.times)}"


# -- the timeline -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Span:
    """A stretch of a row, frames inclusive; `kind` says how it is drawn; `certain` is false where it is unknown."""

    first: int
    last: int
    kind: str
    certain: bool = True


@dataclass(frozen=True)
class Line:
    """A row of the timeline: whose, what it shows, and where; `asked`: the plan speaks of it."""

    role: str
    label: str
    spans: tuple[Span, ...]
    asked: bool = False


@dataclass(frozen=True)
class Bar:
    """A span as drawn."""

    x: float
    width: float
    kind: str
    certain: bool
    title: str


@dataclass(frozen=True)
class Row:
    """A row as drawn: its upper edge, its label in short and whole, and whether it is the first of its person."""

    y: float
    role: str
    label: str
    title: str
    asked: bool
    first: bool
    bars: tuple[Bar, ...]


@dataclass(frozen=True)
class Moment:
    """A named time as a vertical line, its name at height `y`."""

    x: float
    y: float
    name: str
    frame: int


@dataclass(frozen=True)
class Timeline:
    """A timeline as drawn."""

    width: float
    height: float
    left: float
    row: float
    rows: tuple[Row, ...]
    moments: tuple[Moment, ...]
    ticks: tuple[tuple[float, str], ...]


def timeline(lines: Sequence[Line], moments: Mapping[str, int], frame_count: int, fps: float) -> Timeline:
    """Rows over the frames from 0 to `frame_count` - 1."""

    def x(frame: float) -> float:
        return round(_LABELS + (TIMELINE_WIDTH - _LABELS - 24) * frame / max(frame_count, 1), 2)

    rows = []
    y = 38.0
    before = ""
    for line in lines:
        y += 8.0 if line.role != before and before else 0.0
        bars = tuple(
            Bar(
                x(span.first),
                max(x(span.last + 1) - x(span.first), _LEAST),
                span.kind,
                span.certain,
                f"{line.label}: frames {span.first} to {span.last}" + ("" if span.certain else " (unknown)"),
            )
            for span in line.spans
        )
        label = shortened(line.label, _LABEL_CHARACTERS)
        rows.append(Row(y, line.role, label, line.label, line.asked, line.role != before, bars))
        before = line.role
        y += _ROW
    seconds = frame_count / fps
    step = next((s for s in (1, 2, 5, 10, 20, 30, 60, 120, 300) if seconds / s <= 12), 600)
    ticks = tuple((x(s * fps), f"{s} s") for s in range(0, int(seconds) + 1, step))
    marks: list[Moment] = []
    for name, frame in sorted(moments.items(), key=lambda item: (item[1], item[0])):
        beside = bool(marks) and x(frame) - marks[-1].x < _MOMENT_ROOM and marks[-1].y == _MOMENT_Y
        marks.append(Moment(x(frame), _MOMENT_Y + 12 * beside, name, frame))
    return Timeline(TIMELINE_WIDTH, y + 22, _LABELS, _ROW, tuple(rows), tuple(marks), ticks)


def runs_of(frames: Sequence[int], step: int) -> list[tuple[int, int]]:
    """Frames in ascending order as stretches without a gap of more than `step`."""
    if not frames:
        return []
    starts = [frames[0], *(b for a, b in pairwise(frames) if b - a > step)]
    ends = [*(a for a, b in pairwise(frames) if b - a > step), frames[-1]]
    return list(zip(starts, ends, strict=True))


def proof_rows(proofs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Proofs as rows to be shown, those of a kind together."""
    before, rows = "", []
    for proof in proofs:
        rows.append({**proof, "first": proof["kind"] != before})
        before = proof["kind"]
    return rows


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
