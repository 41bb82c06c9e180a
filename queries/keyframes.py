"""Sequences and rules of the keyframe layer of a graph. Also parameters for statements that query the layer."""

from __future__ import annotations

from typing import Final

import msgspec

from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.graph import KEYFRAME_NODES
from jrdb_avr.schema.rules import FPS, Rules, frames

SPAN: Final = 1 << 32
"""Number of node ids that are reserved for each sequence. The ids of a sequence begin at its parameter `low`."""


def keyframe_values(rules: Rules, low: int) -> dict[str, int | float]:
    """Return the values of all parameters that statements about the keyframe layer may use.

    Args:
        rules: Rules under which the layer was made.
        low: First node id of the sequence.

    Returns:
        Values by the name of the parameter. Times are in frames, distances in metres and angles in degrees.
    """
    return {
        "low": low,
        "high": low + SPAN,
        "wait": frames(rules.min_wait_s),
        "later": frames(rules.long_wait_s),
        "search": frames(rules.search_wait_s),
        "by": frames(rules.shift_s),
        "turn": rules.turn_deg,
        "gap": frames(rules.gap_min_s),
        "least": rules.count_min,
        "fps": FPS,
        "changed": rules.distance_changed_m,
        "same": rules.distance_same_m,
    }


STAMP: Final = (
    "MATCH (k:Keyframes) RETURN k.low AS low, k.sequence AS sequence, k.rules_hash AS rules_hash, k.rules AS rules "
    "ORDER BY low"
)
"""Statement that returns one row per sequence of the layer: its first id, its name, and the rules of the layer."""


def layer_stamp(graph: Graph) -> tuple[dict[str, int], Rules | None]:
    """Read the sequences of a graph's keyframe layer, and the rules of that layer.

    Args:
        graph: Session on the graph.

    Returns:
        A dictionary with the first node id of each sequence, by the name of the sequence. Also the rules of the
        layer. If the graph lacks a complete layer, the result is an empty dictionary and None.
    """
    if not KEYFRAME_NODES.keys() <= graph.tables():
        return {}, None
    rows = graph.query(STAMP).to_pylist()
    lows = {row["sequence"]: row["low"] for row in rows}
    return lows, msgspec.json.decode(rows[0]["rules"], type=Rules) if rows else None
