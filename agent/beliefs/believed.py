"""Beliefs as rows of the world tables: which one takes the place of which, and how each is shown to the model."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

from jrdb_avr.agent.beliefs.grounding import NUMBERS
from jrdb_avr.schema.beliefs import TIMELESS, AttributeRow, RelationRow, SightingRow, name_of
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.relations import RELATIONS

Edge = SightingRow | AttributeRow | RelationRow

_SEVERAL = ("action", "interaction", "object")
"""Attributes of which an entity may have several at a frame, but one pose."""


def place_of(edge: Edge) -> Hashable:
    """What the edge is a statement of: a later one of the same place takes it.

    At a frame an entity has one sighting, one pose, and one value of every attribute but those of `_SEVERAL`; gender
    and age it has once. Of one source there is one first person to the left and one to the right; two people stand in
    one place of the source's own view, and otherwise in several relations, of which some hold both ways.
    """
    match edge:
        case SightingRow():
            return sighting_place(edge.source, edge.frame)
        case AttributeRow() if edge.name in TIMELESS:
            return ("has", edge.source, edge.name)
        case AttributeRow() if edge.name == "action" and edge.value in POSES:
            return ("has", edge.source, "pose", edge.first)
        case AttributeRow() if edge.name in _SEVERAL:
            return ("has", edge.source, edge.name, edge.first, edge.value)
        case AttributeRow():
            return ("has", edge.source, edge.name, edge.first)
    relation = RELATIONS.get(edge.name)
    match relation and relation.kind:
        case "first":
            return ("related", edge.source, edge.name, edge.first)
        case "person":
            return ("related", edge.source, "view", edge.first, edge.target)
        case "social" | "group":
            return ("related", frozenset((edge.source, edge.target)), edge.name, edge.first)
    return ("related", edge.source, edge.name, edge.first, edge.target)


def sighting_place(entity: str, frame: int) -> Hashable:
    """The place of an entity's sighting at a frame."""
    return ("sighted", entity, frame)


@dataclass(frozen=True, slots=True)
class Believed:
    """A current edge. kind, row: the name of the statement of `queries/reads/world` that gives it, and what it gives;
    shown: what the model is shown of it. Made once: both are asked for after every turn.
    """

    edge: Edge
    kind: str
    row: Mapping[str, Any]
    shown: Mapping[str, Any]

    @classmethod
    def of(cls, edge: Edge) -> Believed:
        """What is believed by this edge."""
        match edge:
            case SightingRow():
                return cls(edge, "sighted", _sighted_row(edge), _shown_sighting(edge))
            case AttributeRow():
                return cls(edge, "attributes", _attribute_row(edge), _shown_attribute(edge))
            case RelationRow():
                return cls(edge, "relations", _relation_row(edge), _shown_relation(edge))


def _sighted_row(edge: SightingRow) -> dict[str, Any]:
    box, written = edge.box._asdict(), edge.write
    return {"who": name_of(edge.source), "frame": edge.frame, "box": box, "angle": edge.angle, "written": written}


def _attribute_row(edge: AttributeRow) -> dict[str, Any]:
    told = {"who": name_of(edge.source), "name": edge.name, "value": edge.value, "number": edge.number}
    return told | {"first": edge.first, "last": edge.last}


def _relation_row(edge: RelationRow) -> dict[str, Any]:
    ends = {"source": name_of(edge.source), "name": edge.name, "target": name_of(edge.target)}
    return ends | {"first": edge.first, "last": edge.last}


def _shown_sighting(edge: SightingRow) -> dict[str, Any]:
    """The box in stitched pixels, x, y, w, h."""
    return {
        "observation": name_of(edge.target),
        "frame_id": f"{edge.frame:06d}",
        "angle_deg": round(edge.angle, 1),
        "box": [round(value, 1) for value in edge.box],
    }


def _shown_attribute(edge: AttributeRow) -> dict[str, Any]:
    """Name and value, at the frame where it holds at one only."""
    return {
        "name": edge.name,
        "value": edge.number if edge.name in NUMBERS else edge.value,
        **({} if edge.name in TIMELESS else {"frame_id": f"{edge.first:06d}"}),
        "observation": name_of(edge.target),
    }


def _shown_relation(edge: RelationRow) -> dict[str, Any]:
    """Who stands in which relation to whom, at which frame."""
    return {
        "source": name_of(edge.source),
        "name": edge.name,
        "target": name_of(edge.target),
        "frame_id": f"{edge.first:06d}",
        "observation": name_of(edge.observation),
    }
