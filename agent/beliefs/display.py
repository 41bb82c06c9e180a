"""What a model is shown of its world model: the result of `get_graph`, from the rows of `queries/reads/world`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from jrdb_avr.agent.beliefs.arguments import NUMBERS
from jrdb_avr.schema.beliefs import TIMELESS
from jrdb_avr.schema.panorama import WIDTH

if TYPE_CHECKING:
    from jrdb_avr.queries.compiler.beliefs import BeliefRows

Row = Mapping[str, Any]


def shown_graph(rows: BeliefRows, missing: Sequence[str] = ()) -> dict[str, Any]:
    """Observations, current beliefs in the order in which they were written, and what the plan still lacks.

    A belief stands at the frame at which it holds, if it holds at one only; boxes are in stitched pixels, x, y, w, h.
    """
    sightings, attributes, relations = (
        sorted(rows[name], key=lambda row: row["written"]) for name in ("sighted", "attributes", "relations")
    )
    entities = [
        {"id": one["who"], "kind": one["kind"]}
        | ({"node": one["node"]} if one["node"] else {})
        | {
            "sightings": [_sighting(row) for row in sightings if row["who"] == one["who"]],
            "attributes": [_attribute(row) for row in attributes if row["who"] == one["who"]],
        }
        for one in sorted(rows["entities"], key=lambda row: row["number"])
    ]
    looks = [
        {"observation": f"o{row['look']}", **described(row["frame"], row["angle"], row["width"])}
        for row in sorted(rows["looks"], key=lambda row: row["look"])
    ]
    return {
        "observations": looks,
        "entities": entities,
        "relations": [_relation(row) for row in relations],
        "missing": list(missing),
    }


def described(frame: int, angle: float, width: int) -> dict[str, Any]:
    """An observation in the words of a call."""
    return _at(frame) | ({"panorama": True} if width == WIDTH else {"angle_deg": angle})


def _sighting(row: Row) -> dict[str, Any]:
    box = [round(row["box"][side], 1) for side in "xywh"]
    return {**_look(row), **_at(row["frame"]), "angle_deg": round(row["angle"], 1), "box": box}


def _attribute(row: Row) -> dict[str, Any]:
    value = row["number"] if row["name"] in NUMBERS else row["value"]
    return {"name": row["name"], "value": value, **({} if row["name"] in TIMELESS else _at(row["first"])), **_look(row)}


def _relation(row: Row) -> dict[str, Any]:
    return {name: row[name] for name in ("source", "name", "target")} | _at(row["first"]) | _look(row)


def _look(row: Row) -> dict[str, str]:
    return {"observation": f"o{row['look']}"}


def _at(frame: int) -> dict[str, str]:
    return {"frame_id": f"{frame:06d}"}
