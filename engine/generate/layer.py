"""The small layer of the graph that generators search, as rows of its tables.

(Person)-[:At]->(Moment)                  a person at a keyframe: with a box, or certainly absent
(Name)-[:Describes]->(Moment)             a description that fits one person at a keyframe
(Moment)-[:Leads {relation}]->(Moment)    the only target of a relation
(Moment)-[:Doing]->(Action)               an action that may be the true choice of a question
(Person)-[:Acts]->(Segment)               a stable segment of an action
(Person)-[:Leaves]->(Absence)             a certain absence between two boxes
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.choices import different_labels, true_labels
from jrdb_avr.engine.generate.describe import conditions_json, describe, find_leads
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS
from jrdb_avr.schema.labels import ACTIONS, POSES
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, Rules, frames

_TYPES: Final = {
    "STRING": pa.string(),
    "STRING[]": pa.list_(pa.string()),
    "INT64": pa.int64(),
    "BOOLEAN": pa.bool_(),
    "DOUBLE": pa.float64(),
}

TableRow = dict[str, Any]


@dataclass
class Layer:
    """The layer of one sequence.

    Attributes:
        facts: Facts of the sequence.
        rows: Rows by table, in the columns of the table.
        names: Conditions of each name by id.
        segments: Rows of `Segment` by id, each with the column `track`.
        boxes: Columns of sightings by track and frame.
        images: Frames that have an image, or empty if the sequence has no images.
        present: Actions that a person in clear view certainly does at a keyframe.
        low: First id of a node.
        length: Number of frames of the sequence.
        fps: Frames per second.
        action_step: Frames from one list of actions to the next.
    """

    facts: Facts
    rows: dict[str, list[TableRow]] = field(default_factory=lambda: defaultdict(list))
    names: dict[int, tuple[Condition, ...]] = field(default_factory=dict)
    segments: dict[int, TableRow] = field(default_factory=dict)
    boxes: Mapping[tuple[int, int], TableRow] = field(default_factory=dict)
    images: frozenset[int] = frozenset()
    present: frozenset[str] = frozenset()
    low: int = 0
    length: int = 0
    fps: float = FPS
    action_step: int = KEYFRAME_STEP

    def has_image(self, frame: int) -> bool:
        """Return whether a frame has an image, or the sequence has no images at all."""
        return not self.images or frame in self.images

    def tables(self) -> Iterator[tuple[str, pa.Table]]:
        """Yield the name and the rows of each table that has rows, nodes first."""
        for name, columns in LAYER_NODES.items():
            types = dict(column.strip("`").split()[:2] for column in columns.replace("`", "").split(", "))
            yield from self._table(name, types)
        for name, (source, target, more) in LAYER_RELS.items():
            ends = {"from": "STRING" if source == "Person" else "INT64"}
            ends["to"] = "STRING" if target == "Action" else "INT64"
            yield from self._table(name, ends | dict(column.split() for column in more))

    def _table(self, name: str, types: Mapping[str, str]) -> Iterator[tuple[str, pa.Table]]:
        if rows := self.rows[name]:
            yield name, pa.table({c: pa.array([row[c] for row in rows], _TYPES[kind]) for c, kind in types.items()})


def read_layer(store: Store, graph: Graph, sequence: str, rules: Rules, low: int = 0) -> Layer:
    """Make the layer of a sequence of a store.

    Args:
        store: Store with the interval tables of the sequence.
        graph: Graph with the scene of the sequence.
        sequence: Name of the sequence.
        rules: Rules of descriptions, and thresholds.
        low: First id of a node.

    Returns:
        The layer.

    Raises:
        StoreError: If a table is missing or broken.
    """
    tables = {name: store.interval(name, sequence) for name in ("sequence", "frames", "sightings", "segments")}
    (layers,) = tables["sequence"]["layers"].to_pylist()
    facts = Facts(graph, sequence, rules.load, with_faces="pose" in layers)
    return make_layer(facts, sequence, tables, rules, low)


def make_layer(facts: Facts, sequence: str, tables: Mapping[str, pa.Table], rules: Rules, low: int = 0) -> Layer:
    """Make the layer of a sequence.

    Args:
        facts: Facts of the sequence.
        sequence: Name of the sequence.
        tables: Interval tables `sequence`, `frames`, `sightings` and `segments` of the sequence.
        rules: Rules of descriptions, and thresholds.
        low: First id of a node.

    Returns:
        The layer.
    """
    images = frozenset(row["frame"] for row in tables["frames"].select(["frame", "image"]).to_pylist() if row["image"])
    columns = tables["sightings"].select(["track", "frame", "x", "y", "w", "h", "angle", "clear"]).to_pylist()
    layer = Layer(facts, boxes={(row["track"], row["frame"]): row for row in columns}, images=images, low=low)
    (head,) = tables["sequence"].to_pylist()
    layer.fps, layer.action_step, layer.length = head["fps"], head["action_step"], head["frame_count"]
    layer.present = frozenset().union(*count_actions(facts).values())
    x, w = (np.array([row[side] for row in columns], dtype=np.float64) for side in "xw")
    for row, ahead in zip(columns, views.ahead(x, w, rules.visible_share).tolist(), strict=True):
        row["ahead"] = ahead
    ids = _add_moments(layer, sequence, rules, low)
    for (who, frame), number in ids.items():
        if who not in facts.uncovered[frame]:
            continue
        for one in describe(facts, sequence, who, frame, rules):
            name = low + len(layer.names)
            layer.names[name] = one.conditions
            row = {"id": name, "sequence": sequence, "conditions": f"[{conditions_json(one.conditions)}]"}
            layer.rows["Name"].append(row | {"general": one.general})
            layer.rows["Describes"].append({"from": name, "to": number})
        for relation, target in find_leads(facts, who, frame).items():
            layer.rows["Leads"].append({"from": number, "to": ids[target, frame], "relation": relation})
    _add_segments(layer, sequence, tables["segments"].to_pylist(), low)
    _add_absences(
        layer, sequence, sorted(row["frame"] for row in tables["frames"].to_pylist() if row["annotated"]), low
    )
    return layer


def count_actions(facts: Facts) -> dict[int, Counter[str]]:
    """Return how many people in clear view certainly do each action, by keyframe."""
    numbers: dict[int, Counter[str]] = defaultdict(Counter)
    for frame, people in facts.people.items():
        for who, row in people.items():
            if row["clear"]:
                numbers[frame].update(facts.lists[who][frame].certain)
    return numbers


def _add_moments(layer: Layer, sequence: str, rules: Rules, low: int) -> dict[tuple[int, int], int]:
    """Add the moments of all people; return their ids by track and frame."""
    facts, step = layer.facts, frames(rules.shift_s)
    tracks = sorted({who for people in facts.people.values() for who in people})
    ids, seen = {}, {}
    for place, (who, frame) in enumerate((who, frame) for who in tracks for frame in facts.keyframes):
        present = facts.seen(who, frame).present
        seen[who, frame] = None if present is None else int(present)
        if present is not None or who in facts.people.get(frame, {}):
            ids[who, frame] = low + place
    for (who, frame), number in ids.items():
        sighting, box = facts.people.get(frame, {}).get(who, {}), layer.boxes.get((who, frame), {})
        row = {"id": number, "sequence": sequence, "track": who, "frame": frame, "seen": seen[who, frame]}
        row |= {"earlier": seen.get((who, frame - step)), "later": seen.get((who, frame + step))}
        row |= {"clear": bool(sighting.get("clear")), "image": layer.has_image(frame), "ahead": box.get("ahead", False)}
        row["not_doing"] = different_labels(facts.labels(who, frame))
        layer.rows["Doing"] += [{"from": number, "to": label} for label in true_labels(facts.lists[who], frame)]
        row |= {"distance": facts.seen(who, frame).distance, "angle": sighting.get("angle")}
        layer.rows["Moment"].append(row)
        layer.rows["At"].append({"from": f"{sequence}/{who}", "to": number})
    return ids


def _add_segments(layer: Layer, sequence: str, segments: Iterable[TableRow], low: int) -> None:
    some = [row for row in segments if row["action"] in ACTIONS]
    some.sort(key=lambda row: (row["track"], row["action"], row["first"], row["last"]))
    for number, row in enumerate(some, start=low):
        own = {name: row[name] for name in ("action", "first", "last", "start", "end", "quiet_from", "closed")}
        for edge in ("first", "last"):
            box = layer.boxes.get((row["track"], row[edge]), {})
            own |= {f"{edge}_clear": bool(box.get("clear")), f"{edge}_ahead": box.get("ahead", False)}
            own[f"{edge}_image"] = layer.has_image(row[edge])
        own["angle"] = layer.boxes.get((row["track"], row["first"]), {}).get("angle")
        own["held_from"], own["held_to"] = _held_before(layer.facts, row["track"], row["action"], row["first"])
        layer.segments[number] = {"id": number, "sequence": sequence, "track": row["track"], **own}
        layer.rows["Segment"].append(layer.segments[number])
        layer.rows["Acts"].append({"from": f"{sequence}/{row['track']}", "to": number})


def _held_before(facts: Facts, who: int, action: str, first: int) -> tuple[int | None, int | None]:
    """Return the first and the last keyframe of the other posture that is held until a segment of a posture begins."""
    after = next((frame for frame in facts.keyframes if frame >= first), None)
    if action not in POSES or after is None or after - KEYFRAME_STEP not in facts.keyframe_set:
        return None, None
    until = since = after - KEYFRAME_STEP
    held = facts.pose(who, until)
    if held in (None, action) or facts.pose(who, after) != action:
        return None, None
    while since - KEYFRAME_STEP in facts.keyframe_set and facts.pose(who, since - KEYFRAME_STEP) == held:
        since -= KEYFRAME_STEP
    return since, until


def _add_absences(layer: Layer, sequence: str, annotated: Sequence[int], low: int) -> None:
    """Add the absences: between two boxes no frame is unannotated, and the person is absent at a keyframe."""
    facts, grid = layer.facts, np.array(annotated, dtype=np.int64)
    step = KEYFRAME_STEP if np.all(np.diff(grid) % KEYFRAME_STEP == 0) else 1
    by_track: dict[int, list[int]] = defaultdict(list)
    for who, frame in sorted(layer.boxes):
        by_track[who].append(frame)
    for who, shown in by_track.items():
        for leaves, returns in pairwise(shown):
            between = [frame for frame in facts.keyframes if leaves < frame < returns]
            if not any(facts.is_absent(who, frame) for frame in between):
                continue
            known = int(np.searchsorted(grid, returns) - np.searchsorted(grid, leaves, side="right"))
            if known != -((leaves - returns) // step) - 1:
                continue
            present_from = None
            for frame in reversed([frame for frame in facts.keyframes if frame < leaves]):
                if not facts.seen(who, frame).present:
                    break
                present_from = frame
            boxes = [layer.boxes[who, frame] for frame in (leaves, returns)]
            row = {"id": low + len(layer.rows["Absence"]), "sequence": sequence, "leaves": leaves, "returns": returns}
            row |= {"present_from": present_from, "clear": all(box["clear"] for box in boxes)}
            row |= {"image": layer.has_image(leaves) and layer.has_image(returns)}
            layer.rows["Absence"].append(row | {"ahead": all(box["ahead"] for box in boxes)})
            layer.rows["Leaves"].append({"from": f"{sequence}/{who}", "to": row["id"]})
