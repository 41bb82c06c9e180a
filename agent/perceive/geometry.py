"""Places of people at one frame, derived from their boxes: facts that are true, false or unknown (None).

The words have the meaning of questions (docs/definitions.md). A fact is unknown if an unseen person in a part of the
circle that no look shows could change it. Boxes are in stitched pixels. All looks are looks at the frame of the boxes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Literal, NamedTuple

from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, ROBOT_SECTORS
from jrdb_avr.schema.panorama import (
    CROP,
    HEIGHT,
    WIDTH,
    Box,
    angle_error,
    angle_of_column,
    center_angle,
    clockwise,
    crop_left,
)
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import SLACK, LoadRules

Truth = bool | None
"""True, false, or None for unknown."""

Side = Literal["left", "right", ""]

_RULES: Final = LoadRules()

EDGE_DEG: Final = 5.0
"""Minimum degrees between a person and the edge of a look that surely shows the person."""

FIRST: Final = frozenset(label for label, row in RELATIONS.items() if row.kind == "first")
"""Relations with at most one target for each person."""

DERIVED: Final = FIRST | {label for label, row in RELATIONS.items() if row.kind == "window"}
"""Relations that boxes decide."""


class SeenColumns(NamedTuple):
    """Columns [left, left + width) of the panorama that a look shows. They may pass the seam."""

    left: float
    width: float


class Arc(NamedTuple):
    """A part of the circle: `span` degrees, clockwise from the panorama angle `start`."""

    start: float
    span: float

    @property
    def middle(self) -> float:
        """Panorama angle of the middle of the arc in degrees."""
        return (self.start + self.span / 2) % 360.0


CIRCLE: Final = Arc(0.0, 360.0)
"""The whole circle."""


def seen_from(angle_deg: float) -> SeenColumns:
    """Return the columns of a look at a panorama angle in degrees."""
    return SeenColumns(crop_left(angle_deg), CROP)


def around(angle_deg: float, reach_deg: float) -> Arc:
    """Return the arc of all angles that are at most `reach_deg` degrees from an angle."""
    return Arc((angle_deg - reach_deg) % 360.0, 2 * reach_deg)


def gaps(looks: Iterable[SeenColumns], arc: Arc) -> list[Arc]:
    """Return the parts of an arc that no look shows.

    Args:
        looks: Columns of the looks.
        arc: The arc.

    Returns:
        The parts, clockwise.
    """
    shown: list[tuple[float, float]] = []
    for look in looks:
        begin = clockwise(arc.start, angle_of_column(look.left))
        width = look.width * 360.0 / WIDTH
        # Because an arc may begin inside a look, the look counts again one turn earlier.
        shown += [(begin, begin + width), (begin - 360.0, begin + width - 360.0)]
    unseen, reached = [], 0.0
    for begin, end in sorted(shown):
        if begin > reached + SLACK and reached < arc.span - SLACK:
            unseen.append(Arc((arc.start + reached) % 360.0, min(begin, arc.span) - reached))
        reached = max(reached, end)
    if reached < arc.span - SLACK:
        unseen.append(Arc((arc.start + reached) % 360.0, arc.span - reached))
    return unseen


def covered(looks: Iterable[SeenColumns], arc: Arc = CIRCLE) -> bool:
    """Return whether looks together show a whole arc."""
    return not gaps(looks, arc)


def angle_of(box: Box) -> float:
    """Return the panorama angle of the middle of a box in degrees."""
    return center_angle(box.x, box.w)


def clear_size(box: Box) -> bool:
    """Return whether a box has the size and the rows of a clear view."""
    wide = _RULES.clear_min_width <= box.w <= _RULES.clear_max_width
    return wide and box.h >= _RULES.clear_min_height and box.y >= 0 and box.y + box.h <= HEIGHT


# -- of one person ----------------------------------------------------------------------------------------------------


def in_sector(angle_deg: float, word: str) -> Truth:
    """Return whether a panorama angle in degrees is in a sector of the robot, which is given by its word."""
    if word not in ROBOT_SECTORS:
        return None
    off = angle_error(angle_deg, ROBOT_SECTORS[word])
    if off <= _RULES.sector_true_deg + SLACK:
        return True
    return None if off <= _RULES.sector_false_deg + SLACK else False


def at_distance(metres: float, word: str) -> Truth:
    """Return whether a distance has a distance word. The result is unknown if two words may be right."""
    margin = _RULES.distance_margin
    lows = (-1.0, *(bound * (1 - margin) - SLACK for bound in DISTANCE_BOUNDS_M))
    highs = (*(bound * (1 + margin) + SLACK for bound in DISTANCE_BOUNDS_M), float("inf"))
    possible = [label for label, low, high in zip(DISTANCE_WORDS, lows, highs, strict=True) if low <= metres <= high]
    return word in possible and (True if len(possible) == 1 else None)


# -- of two people ----------------------------------------------------------------------------------------------------


def turn_to(source: Box, target: Box, side: Side) -> float:
    """Return the degrees in [0, 360) from the middle of one box to the middle of another, turning to a side."""
    turn = clockwise(angle_of(source), angle_of(target))
    return -turn % 360.0 if side == "left" else turn


def within_degrees(source: Box, target: Box, degrees: float, side: Side) -> Truth:
    """Return whether the target is at most `degrees` to one side of the source, as the robot sees them."""
    margin, turn = _RULES.neighbor_margin_deg, turn_to(source, target, side)
    if min(turn, 360.0 - turn) <= margin or abs(turn - degrees) <= margin:
        return None
    return turn < degrees


def first_beside(boxes: Mapping[str, Box], source: str, side: Side, looks: Sequence[SeenColumns]) -> dict[str, Truth]:
    """Return for each other person whether it is the first person on this side of the source, as the robot sees it.

    Args:
        boxes: Boxes of all people at a frame, by name, in stitched pixels.
        source: Name of the source.
        side: The side.
        looks: Looks at the frame.

    Returns:
        The truth by name of the target.
    """
    margin, reach = _RULES.neighbor_margin_deg, _RULES.neighbor_max_deg
    turns = {name: turn_to(boxes[source], box, side) for name, box in boxes.items() if name != source}
    near = [turn for name, turn in turns.items() if margin <= turn <= reach and clear_size(boxes[name])]
    truths: dict[str, Truth] = {}
    if not near:
        for target, turn in turns.items():
            # An unseen person just inside the reach may be as near as a target beyond the reach.
            doubtful = Arc(turn - margin, reach - turn + margin)
            beyond = turn > reach and (doubtful.span < 0 or covered(looks, _absolute(boxes[source], doubtful, side)))
            truths[target] = False if beyond else None
        return truths
    limit = min(near) + margin
    alone = sum(turn < limit for turn in turns.values()) == 1
    sure = alone and covered(looks, _absolute(boxes[source], Arc(0.0, limit), side))
    return {target: False if turn >= limit else True if sure else None for target, turn in turns.items()}


def _absolute(source: Box, turned: Arc, side: Side) -> Arc:
    """Return the arc that is given in degrees from the source to a side."""
    start = angle_of(source) + (-turned.start - turned.span if side == "left" else turned.start)
    return Arc(start % 360.0, turned.span)


def standing(relation: str, boxes: Mapping[str, Box], source: str, looks: Sequence[SeenColumns]) -> dict[str, Truth]:
    """Return for each other person whether a relation of `DERIVED` leads from the source to it.

    Args:
        relation: The relation.
        boxes: Boxes of all people at a frame, by name, in stitched pixels.
        source: Name of the source.
        looks: Looks at the frame.

    Returns:
        The truth by name of the target.
    """
    row = RELATIONS[relation]
    if row.kind == "first":
        return first_beside(boxes, source, row.side, looks)
    others = ((name, box) for name, box in boxes.items() if name != source)
    return {name: within_degrees(boxes[source], box, row.degrees, row.side) for name, box in others}


def deciding_arc(relation: str, source: Box) -> Arc:
    """Return the part of the circle in which a relation permits its target, given the box of its source."""
    row = RELATIONS[relation]
    if relation not in DERIVED:
        return CIRCLE
    reach = row.degrees if row.kind == "window" else _RULES.neighbor_max_deg
    return _absolute(source, Arc(0.0, reach), row.side)
