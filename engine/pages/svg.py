"""Layout of two diagrams: the plan of a question, drawn as a graph, and a scatter plot of the scores of runs.

Positions and sizes are in units of the SVG view box. The width of a text is estimated from its number of characters.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from jrdb_avr.schema.plan import Condition, Plan, Time

NODE_WIDTH: Final = 165.0
_NODE_CHARACTERS: Final = 23
_NODE_HEAD: Final = 24.0
_NODE_LINE: Final = 13.0
_GAP: Final = 150.0
"""Distance between columns of nodes. The words of an edge fit into this distance."""
_WIDE_GAP: Final = 230.0
_GAP_CHARACTERS: Final = 22
_LANE_GAP: Final = 50.0

SQUARE: Final = 380.0
"""Side of the square scatter plot. It includes the margin `_MARGIN` on each side of the plotted area."""
_MARGIN: Final = 40.0
_LETTER: Final = 6.9
_LINE: Final = 12.0
_DOT: Final = 5.0
_STEP: Final = 6.0
_RINGS: Final = 60
_DIRECTIONS: Final = 16


def wrapped(text: str, characters: int) -> tuple[str, ...]:
    """Wrap a text between words.

    Args:
        text: The text.
        characters: Maximum number of characters in a line.

    Returns:
        The lines. A longer word is cut. An empty text gives one empty line.
    """
    return tuple(textwrap.wrap(text, characters, break_on_hyphens=False)) or ("",)


def shortened(text: str, characters: int) -> str:
    """Cut a text that is too long.

    Args:
        text: The text.
        characters: Maximum number of characters.

    Returns:
        The text. If it was cut, it ends in an ellipsis.
    """
    return text if len(text) <= characters else text[: characters - 1].rstrip() + "\N{HORIZONTAL ELLIPSIS}"


class PlanNode(NamedTuple):
    """A drawn node of a plan: the person's role, the node's upper left corner, and the conditions as lines of text."""

    role: str
    x: float
    y: float
    lines: tuple[str, ...]


class PlanEdge(NamedTuple):
    """The drawn relations from one node to another node: an SVG path, and the text in lines.

    `x` and `y` are the middle of the last line of text. If `behind` is true, the path crosses the text, so that the
    text needs a background.
    """

    path: str
    x: float
    y: float
    lines: tuple[str, ...]
    behind: bool


class PlanGraph:
    """Layout of a plan from left to right. Nodes have equal sizes.

    The column of a node is the number of relations between the root and the node. A relation to the next column is a
    straight line. A relation within a column is an arc on the right side. Other relations to the right are arcs above
    the nodes, and relations to the left are arcs below the nodes.

    Attributes:
        nodes: The drawn people and things of the plan.
        edges: The drawn relations of the plan, one for each pair of nodes and direction.
        node_height: Height of each node.
        top: Additional height above the nodes. 0 if nothing reaches above the nodes.
        width: Width of the drawing.
        height: Height of the drawing without `top`.
        times: One text for each time of the plan, such as "t0: frame 30".
        reads: The read of the answer, such as "action of a at t0".
    """

    def __init__(self, plan: Plan) -> None:
        distance = {plan.root: 0}
        for _ in plan.nodes:
            for source, target in plan.ways:
                if source in distance:
                    distance.setdefault(target, distance[source] + 1)
        columns: dict[int, list[str]] = {}
        for node in plan.nodes:
            columns.setdefault(distance[node.id], []).append(node.id)
        several = len(plan.times) > 1
        lines = {node.id: _node_lines(node.conditions, several, plan.things.get(node.id, "")) for node in plan.nodes}
        tall = self.node_height = _NODE_HEAD + _NODE_LINE * max(len(texts) for texts in lines.values()) + 4
        lanes, lane_height = max(len(members) for members in columns.values()), tall + _LANE_GAP
        # Edges between several lanes are slanted and need a wider gap for their words.
        stride = NODE_WIDTH + (_GAP if lanes == 1 else _WIDE_GAP)
        corners = {
            role: (1 + column * stride, (lane + (lanes - len(members)) / 2) * lane_height)
            for column, members in columns.items()
            for lane, role in enumerate(members)
        }
        self.nodes = [PlanNode(role, x, y, lines[role]) for role, (x, y) in corners.items()]
        self.times, self.reads = [_time(name, plan.times[name]) for name in plan.times], _read(plan)
        self.top, self.width, self.height = 0.0, max(columns) * stride + NODE_WIDTH + 3, lanes * lane_height - _LANE_GAP
        words: dict[tuple[str, str], tuple[str, ...]] = {}
        for edge in plan.edges:
            texts = wrapped(_timed(edge.relation, edge.at, several), _GAP_CHARACTERS)
            words[edge.source, edge.target] = words.get((edge.source, edge.target), ()) + texts
        self.edges = [
            self._edge(corners[source], corners[target], distance[target] - distance[source], texts)
            for (source, target), texts in words.items()
        ]

    def _edge(
        self, source: tuple[float, float], target: tuple[float, float], columns: int, lines: tuple[str, ...]
    ) -> PlanEdge:
        """Place an edge between the corners of two nodes that are `columns` apart, and make room for it."""
        (x1, y1), (x2, y2), tall, high = source, target, self.node_height, _NODE_LINE * len(lines)
        if columns == 1:
            x1, y1, y2 = x1 + NODE_WIDTH, y1 + tall / 2, y2 + tall / 2
            level = y1 == y2
            self.top = max(self.top, high + 10 - tall / 2)
            y = y1 - 7 if level else (y1 + y2 + high) / 2 - 3
            return PlanEdge(f"M{x1} {y1}L{x2} {y2}", (x1 + x2) / 2, y, lines, not level)
        if columns == 0:
            x1, y1, y2 = x1 + NODE_WIDTH, y1 + tall / 2, y2 + tall / 2
            # A cubic curve reaches three quarters of the way to its control points.
            apex = x1 + 0.75 * _GAP
            self.width = max(self.width, apex + _LETTER * _GAP_CHARACTERS / 2)
            path = f"M{x1} {y1}C{x1 + _GAP} {y1} {x1 + _GAP} {y2} {x1} {y2}"
            # The words are nearer to the source, because an edge in the other direction may have words too.
            return PlanEdge(path, apex, 0.65 * y1 + 0.35 * y2 + high / 2 - 3, lines, True)
        # Each arc is outside the arcs that were placed before, so that their words do not overlap.
        x1, x2 = x1 + 0.6 * NODE_WIDTH, x2 + 0.4 * NODE_WIDTH
        if columns > 1:
            apex = -self.top - 16
            y, self.top = apex - 5, high + 8 - apex
        else:
            y1, y2, apex = y1 + tall, y2 + tall, self.height + 16
            y = self.height = apex + high + 2
            self.height += 6
        pull = (4 * apex - (y1 + y2) / 2) / 3
        return PlanEdge(f"M{x1} {y1}C{x1} {pull} {x2} {pull} {x2} {y2}", (x1 + x2) / 2, y, lines, False)


def _time(name: str, time: Time) -> str:
    """Return a time of a plan in words, such as "t1: a starts walking after t0"."""
    if time.frame is not None:
        return f"{name}: frame {time.frame}"
    limits = [f"{word} {limit}" for word, limit in (("after", time.after), ("before", time.before)) if limit]
    if time.event is None:
        return f"{name}: some moment {' and '.join(limits)}"
    verb = f"{time.event}s" if time.event in ("start", "end") else time.event.replace("_", " a ")
    return " ".join([f"{name}:", time.of or "", verb, *([time.action] if time.action else []), *limits])


def _read(plan: Plan) -> str:
    """Return the read of a plan in words: the property, the person, and the times."""
    answer = plan.answer
    subject = answer.attribute or answer.read.replace("_", " ")
    counted = f" of '{answer.relation}'" if answer.relation else ""
    return f"{subject}{counted} of {answer.of} at {', '.join(answer.times)}"


def _node_lines(conditions: Sequence[Condition], several: bool, kind: str) -> tuple[str, ...]:
    """Return all conditions of a node as lines of text. They are not shortened: reviewers need the full text."""
    # Spaces allow a line break at the slashes between the names of objects.
    texts = [kind] * bool(kind)
    texts += [_timed(_condition(condition).replace("/", " / "), condition.at, several) for condition in conditions]
    return tuple(line for text in texts for line in wrapped(text, _NODE_CHARACTERS)) or ("any person",)


def _timed(text: str, at: str | None, several: bool) -> str:
    """Return `text`. If `at` is the name of a time and the plan has several times, append this name to the text."""
    return f"{text}, {at}" if several and at else text


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


class Dot(NamedTuple):
    """A run in the scatter plot.

    Attributes:
        x: Horizontal position of the dot.
        y: Vertical position of the dot.
        number: Number of the run in the legend.
        row: The run's row of the table `main`.
        label_x: Horizontal position of the centre of the printed number.
        label_y: Vertical position of the centre of the printed number.
        leads: Whether the printed number is so far from the dot that a line must connect the number with the dot.
    """

    x: float
    y: float
    number: int
    row: Mapping[str, Any]
    label_x: float
    label_y: float
    leads: bool


def scatter(rows: Sequence[Mapping[str, Any]]) -> list[Dot]:
    """Lay out a scatter plot of two scores: answer on the horizontal axis, and evidence on the vertical axis.

    Args:
        rows: Rows of the table `main`. A row is left out if its answer score or its evidence score is None.

    Returns:
        One dot per row, with the position of the printed number. If there is room, no number covers a dot or another
        number.
    """
    scale = (SQUARE - 2 * _MARGIN) / 100
    points = [
        (_MARGIN + scale * row["answer"], SQUARE - _MARGIN - scale * row["evidence"], rank, row)
        for rank, row in enumerate(rows, 1)
        if row.get("answer") is not None and row.get("evidence") is not None
    ]
    taken = [_Area(x - _DOT, y - _DOT, x + _DOT, y + _DOT) for x, y, *_ in points]
    dots = []
    for x, y, rank, row in points:
        area, leads = _free_area(x, y, _LETTER * len(str(rank)), taken)
        taken.append(area)
        dots.append(Dot(x, y, rank, row, (area.left + area.right) / 2, (area.top + area.bottom) / 2, leads))
    return dots


def budget_curves(rows: Sequence[Mapping[str, Any]]) -> list[list[dict[str, Any]]]:
    """Lay out curves of the combined score (vertical axis) against the budget of looks (horizontal axis).

    Args:
        rows: Rows of the table `looks`.

    Returns:
        The dots of each curve. A smaller budget than the budget of the row before begins a new curve.
    """
    side = SQUARE - 2 * _MARGIN
    most = max((row["looks"] for row in rows), default=1)
    curves: list[list[dict[str, Any]]] = []
    for row in rows:
        if not curves or row["looks"] <= curves[-1][-1]["row"]["looks"]:
            curves.append([])
        x, y = _MARGIN + side * row["looks"] / most, SQUARE - _MARGIN - side * row["combined"] / 100
        curves[-1].append({"x": x, "y": y, "row": row})
    return curves


class _Area(NamedTuple):
    """A rectangle that a dot or a number covers."""

    left: float
    top: float
    right: float
    bottom: float

    def meets(self, area: _Area) -> bool:
        """Return whether this rectangle and the rectangle `area` overlap."""
        return self.left < area.right and area.left < self.right and self.top < area.bottom and area.top < self.bottom


def _free_area(x: float, y: float, width: float, taken: Sequence[_Area]) -> tuple[_Area, bool]:
    """Return the area for a text beside a dot, and whether a line must connect the text with the dot.

    The area is the nearest one that overlaps no area in `taken`. If there is no such area, the area on the right side
    of the dot is returned.
    """
    for ring in range(_RINGS):
        far = _DOT + 1 + _STEP * ring
        for direction in range(_DIRECTIONS):
            turn = 2 * math.pi * direction / _DIRECTIONS
            middle = x + math.cos(turn) * (far + width / 2), y - math.sin(turn) * (far + _LINE / 2)
            area = _Area(middle[0] - width / 2, middle[1] - _LINE / 2, middle[0] + width / 2, middle[1] + _LINE / 2)
            inside = area.left > _MARGIN and area.right < SQUARE and area.top > 0 and area.bottom < SQUARE - _MARGIN
            if inside and not any(area.meets(covered) for covered in taken):
                return area, ring > 1
    # There is no free area, so the text covers something.
    return _Area(x + _DOT, y - _LINE / 2, x + _DOT + width, y + _LINE / 2), False
