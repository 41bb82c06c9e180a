"""Sequences and rules of the keyframe layer of a graph. Also parameters for statements that query the layer."""

from __future__ import annotations

import re

import msgspec

from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.graph.parameters import strip_literals
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.graph import LAYER_NODES
from jrdb_avr.schema.rules import FPS, Rules, frames


def keyframe_values(rules: Rules) -> dict[str, int | float]:
    """Return the values of the parameters that statements about the keyframe layer may use beside `sequence`.

    Args:
        rules: Rules under which the layer was made.

    Returns:
        Values by the name of the parameter. Times are in frames, distances in metres and angles in degrees.
    """
    return {
        "wait": frames(rules.min_wait_s),
        "later": frames(rules.long_wait_s),
        "search": frames(rules.search_wait_s),
        "turn": rules.turn_deg,
        "gap": frames(rules.gap_min_s),
        "fps": FPS,
        "changed": rules.distance_changed_m,
        "same": rules.distance_same_m,
    }


_NODE = re.compile(rf":\s*`?({'|'.join(LAYER_NODES.keys() - {'Keyframes'})})\b", re.IGNORECASE)


def queries_layer(statement: str) -> bool:
    """Return whether a statement names a node table of the keyframe layer."""
    return bool(_NODE.search(strip_literals(statement)))


def stamp_statement() -> str:
    """Return the statement that reads, for each sequence of the layer, its name and the rules of the layer."""
    return read_statement("reads/keyframes.cypher")


def layer_stamp(graph: Graph) -> tuple[list[str], Rules | None]:
    """Read the sequences of a graph's keyframe layer, and the rules of that layer.

    Args:
        graph: Session on the graph.

    Returns:
        The names of the sequences in order, and the rules of the layer. Without a complete layer, there are no names,
        and the rules are None.
    """
    if not LAYER_NODES.keys() <= graph.tables():
        return [], None
    rows = graph.query(stamp_statement()).to_pylist()
    return [row["sequence"] for row in rows], msgspec.json.decode(rows[0]["rules"], type=Rules) if rows else None
