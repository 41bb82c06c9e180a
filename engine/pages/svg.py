"""Layout of two diagrams: the plan of a question, drawn as a graph, and a scatter plot of the scores of runs.

Positions and sizes are in units of the SVG view box. The width of a text is estimated from its number of characters.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from jrdb_avr.schema.plan import Condition, Plan

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
        The lines. An empty text gives one empty line.
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
    """A drawn relation of a plan: the two ends of its line, and its text in lines.

    The line begins at the right side of one node and ends at the left side of another node.
    """

    x1: float
    y1: float
    x2: float
    y2: float
    lines: tuple[str, ...]


class PlanGraph:
    """Layout of a plan from left to right. Nodes have equal sizes.

    The column of a node is the number of relations between the root and the node.

    Attributes:
        nodes: The drawn people of the plan.
        edges: The drawn relations of the plan.
        node_height: Height of each node.
        top: Additional height above the nodes for the words of relations. 0 if no words reach above the nodes.
        width: Width of the drawing.
        height: Height of the drawing without `top`.
    """

    def __init__(self, plan: Plan) -> None:
        distance = {plan.root: 0}
        for _ in plan.nodes:
            for edge in plan.edges:
                if edge.source in distance:
                    distance.setdefault(edge.target, distance[edge.source] + 1)
        columns: dict[int, list[str]] = {}
        for node in plan.nodes:
            columns.setdefault(distance[node.id], []).append(node.id)
        several = len(plan.times) > 1
        lines = {node.id: _node_lines(node.conditions, several) for node in plan.nodes}
        tall = self.node_height = _NODE_HEAD + _NODE_LINE * max(len(members) for members in lines.values()) + 4
        lanes, lane_height = max(len(members) for members in columns.values()), tall + _LANE_GAP
        # Edges between several lanes are slanted and need a wider gap for their words.
        stride = NODE_WIDTH + (_GAP if lanes == 1 else _WIDE_GAP)
        corners = {
            role: (1 + column * stride, (lane + (lanes - len(members)) / 2) * lane_height)
            for column, members in columns.items()
            for lane, role in enumerate(members)
        }
        self.nodes = [PlanNode(role, x, y, lines[role]) for role, (x, y) in corners.items()]
        self.edges = []
        for edge in plan.edges:
            (x1, y1), (x2, y2) = corners[edge.source], corners[edge.target]
            lines_of_edge = wrapped(_timed(edge.relation, edge.at, several), _GAP_CHARACTERS)
            self.edges.append(PlanEdge(x1 + NODE_WIDTH, y1 + tall / 2, x2, y2 + tall / 2, lines_of_edge))
        self.top = max([0.0, *(_NODE_LINE * len(edge.lines) + 10 - tall / 2 for edge in self.edges)])
        self.width = max(columns) * stride + NODE_WIDTH + 3
        self.height = lanes * lane_height - _LANE_GAP


def _node_lines(conditions: Sequence[Condition], several: bool) -> tuple[str, ...]:
    """Return all conditions of a node as lines of text. They are not shortened: reviewers need the full text."""
    # Spaces allow a line break at the slashes between the names of objects.
    texts = [_timed(_condition(condition).replace("/", " / "), condition.at, several) for condition in conditions]
    return tuple(line for text in texts for line in wrapped(text, _NODE_CHARACTERS)) or ("anybody",)


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
