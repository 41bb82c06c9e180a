"""Diagrams of a question: its plan as a graph, and what its people do over time, as places in an SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

from jrdb_avr.schema.plan import Condition, Plan

NODE_WIDTH: Final = 150.0
NODE_HEIGHT: Final = 58.0
_COLUMN: Final = 330.0
_LANE: Final = 92.0

TIMELINE_WIDTH: Final = 900.0
_LABELS: Final = 190.0
_ROW: Final = 17.0
_LINE_CHARACTERS: Final = 30


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


@dataclass(frozen=True)
class PlanGraph:
    """A plan as drawn: nodes in columns by their distance from the root."""

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
    height = max(1, *(lane + 1 for _, lane in lanes.values())) * _LANE
    counts = {number: sum(c == number for c, _ in lanes.values()) for number in column.values()}
    places = {
        role: (1 + c * _COLUMN, (height - counts[c] * _LANE) / 2 + lane * _LANE + (_LANE - NODE_HEIGHT) / 2)
        for role, (c, lane) in lanes.items()
    }
    nodes = tuple(
        PlanNode(node.id, *places[node.id], tuple(_condition(c) for c in node.conditions), node.id == plan.target)
        for node in plan.nodes
    )
    edges = []
    for edge in plan.edges:
        (x1, y1), (x2, y2) = places[edge.source], places[edge.target]
        ends = x1 + NODE_WIDTH, y1 + NODE_HEIGHT / 2, x2, y2 + NODE_HEIGHT / 2
        edges.append(PlanEdge(*ends, wrapped(edge.relation, _LINE_CHARACTERS)))
    width = max(x for x, _ in places.values()) + NODE_WIDTH + 2
    return PlanGraph(width, height, nodes, tuple(edges), tuple(_times(plan)), _asks(plan))


def wrapped(text: str, characters: int) -> tuple[str, ...]:
    """A text in lines of at most so many characters, broken between words."""
    lines: list[str] = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > characters:
            lines.append(word)
        else:
            lines[-1] = f"{lines[-1]} {word}".strip()
    return tuple(lines)


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
    return f"{plan.answer.read.replace('_', ' ')}{counted} of {plan.answer.of} at {', '.join(plan.asked())}"


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
    """A row of the timeline: whose, what it shows, and where."""

    role: str
    label: str
    spans: tuple[Span, ...]


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
    """A row as drawn: its middle's height, and whether it is the first of its person."""

    y: float
    role: str
    label: str
    first: bool
    bars: tuple[Bar, ...]


@dataclass(frozen=True)
class Moment:
    """A named time as a vertical line."""

    x: float
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
        return round(_LABELS + (TIMELINE_WIDTH - _LABELS - 6) * frame / max(frame_count, 1), 2)

    rows = []
    y = 34.0
    before = ""
    for line in lines:
        y += 8.0 if line.role != before and before else 0.0
        bars = tuple(
            Bar(
                x(span.first),
                max(x(span.last + 1) - x(span.first), 1.0),
                span.kind,
                span.certain,
                f"{line.label}: frames {span.first} to {span.last}" + ("" if span.certain else " (unknown)"),
            )
            for span in line.spans
        )
        rows.append(Row(y, line.role, line.label, line.role != before, bars))
        before = line.role
        y += _ROW
    seconds = frame_count / fps
    step = next((s for s in (1, 2, 5, 10, 20, 30, 60, 120, 300) if seconds / s <= 12), 600)
    ticks = tuple((x(s * fps), f"{s} s") for s in range(0, int(seconds) + 1, step))
    marks = tuple(Moment(x(frame), name, frame) for name, frame in sorted(moments.items(), key=lambda item: item[1]))
    return Timeline(TIMELINE_WIDTH, y + 22, _LABELS, _ROW, tuple(rows), marks, ticks)


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
