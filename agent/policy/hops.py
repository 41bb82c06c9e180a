"""Follow a plan's relations from person to person, among the people whose marks were read in one frame.

Everybody within reach of the relation has to be read first, so the policy looks all round at the frame. A person who
cannot be read does not exist for the policy, and a hop may then lead to somebody else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from jrdb_avr.agent.policy.explorer import AROUND, Explorer, Sighting
from jrdb_avr.agent.policy.finding import distance_word
from jrdb_avr.schema.labels import PERSON_SECTORS
from jrdb_avr.schema.markers import ALONE
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import RELATIONS, person_frame_label

_REACH_DEG: Final = 60.0
"""How far away the first to the left or right may be."""

_NEAR_M: Final = 5.0
"""People farther apart have no relation of front and back."""

_SECTOR_EDGES: Final = (30.0, 45.0, 135.0, 145.0)
"""Bearings off somebody's heading at which front, front side, side, back side and back meet."""


def look_round(explorer: Explorer, frame: int) -> list[Sighting]:
    """Everybody whose mark can be read in a legal frame. Raises BudgetExhausted when looks run out."""
    for turn in AROUND:
        explorer.look(frame, (180.0 + turn) % 360.0)
    return explorer.at(frame)


def path(plan: Plan, root: Sighting, people: Sequence[Sighting]) -> dict[str, Sighting]:
    """The person of each node, from the one described, up to the first hop that leads to nobody or to several."""
    known = {plan.root: root}
    # Nodes stand in the order in which they are reached.
    for node in (node for node in plan.nodes if node.id != plan.root):
        leading = [edge for edge in plan.edges if edge.target == node.id]
        met = {seen.identity for seen in known.values()}
        reached = [
            seen
            for seen in people
            if seen.identity not in met
            and all(related(edge.relation, known[edge.source], seen, people) for edge in leading)
        ]
        if len(reached) != 1:
            break
        known[node.id] = reached[0]
    return known


def related(relation: str, source: Sighting, target: Sighting, people: Sequence[Sighting]) -> bool:
    """Whether the target has the relation to the source, by their marks and where they stand among the people read."""
    row = RELATIONS[relation]
    # Degrees turn from the source to the left or to the right.
    turn = -1 if row.side == "left" else 1
    match row.kind:
        case "group":
            return source.mark.group not in (None, ALONE) and source.mark.group == target.mark.group
        case "social":
            # A mark has room for one relation of a person: that of two people may stand on either of them.
            return _tells(source, relation, target) or _tells(target, relation, source)
        case "first":
            # Not by object: the source may have been read in another look at the same frame.
            others = [seen for seen in people if seen.identity != source.identity]
            turns = {seen.identity: turn * (seen.angle - source.angle) % 360.0 for seen in others}
            own = turns[target.identity]
            return own <= _REACH_DEG and own == min(turns.values())
        case "window":
            return 0 < turn * (target.angle - source.angle) % 360.0 <= row.degrees
        case "person":
            return _seen_from(source, target) == relation


def _tells(person: Sighting, label: str, partner: Sighting) -> bool:
    return person.mark.interaction == label and person.mark.partner == partner.identity


def _seen_from(source: Sighting, target: Sighting) -> str | None:
    """The sector of the target in the source's own frame; None where a mark lacks what decides, or it is too far."""
    if source.mark.heading_deg is None or source.mark.distance_dm is None or target.mark.distance_dm is None:
        return None
    (x0, y0), (x1, y1) = _place(source), _place(target)
    metres = math.hypot(x1 - x0, y1 - y0)
    if metres > _NEAR_M:
        return None
    bearing = math.degrees(math.atan2(y1 - y0, x1 - x0)) - source.mark.heading_deg
    bearing = (bearing + 180.0) % 360.0 - 180.0
    ring = sum(abs(bearing) > edge for edge in _SECTOR_EDGES)
    # PERSON_SECTORS go round from the front over the left.
    sector = [*PERSON_SECTORS][ring if bearing >= 0 else -ring % len(PERSON_SECTORS)]
    return person_frame_label(sector, distance_word(metres))


def _place(seen: Sighting) -> tuple[float, float]:
    """Metres ahead of the robot and to its left."""
    azimuth, metres = math.radians(180.0 - seen.angle), (seen.mark.distance_dm or 0) / 10
    return metres * math.cos(azimuth), metres * math.sin(azimuth)
