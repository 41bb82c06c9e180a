"""Parameters of statements over the keyframe layer of a stored graph, and the stamp of that layer."""

from __future__ import annotations

from typing import Final

import msgspec

from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.graph import KEYFRAME_NODES
from jrdb_avr.schema.rules import FPS, Rules, frames

SPAN: Final = 1 << 32
"""Number of node ids reserved for each sequence of a layer; the range of a sequence begins at its `low`."""


def keyframe_values(rules: Rules, low: int) -> dict[str, int | float]:
    """Return the values of all parameters that statements over the layer may use.

    Args:
        rules: Rules under which the layer was made.
        low: First id of the sequence.

    Returns:
        Values by parameter name: ids, or quantities in frames, metres or degrees.
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
"""Statement that reads the stamp of a layer: a row per sequence, with the rules of the layer."""


def layer_stamp(graph: Graph) -> tuple[dict[str, int], Rules | None]:
    """Return the first id of each sequence in the keyframe layer, and the rules of the layer.

    Returns:
        Ids by sequence, and rules; an empty dictionary and None if the graph has no complete layer.
    """
    if not KEYFRAME_NODES.keys() <= graph.tables():
        return {}, None
    rows = graph.query(STAMP).to_pylist()
    lows = {row["sequence"]: row["low"] for row in rows}
    return lows, msgspec.json.decode(rows[0]["rules"], type=Rules) if rows else None
