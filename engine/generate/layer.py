"""The small layer of the graph that generators search, as rows of its tables.

(Person)-[:At]->(Moment)                  a person at a keyframe: with a box, or certainly absent
(Name)-[:Describes]->(Moment)             a description that fits one person at a keyframe
(Moment)-[:Leads {relation}]->(Moment)    the only target of a relation
(Moment)-[:Doing]->(Action)               an action that may be the true choice of a question
(Person)-[:Acts]->(Segment)               a stable segment of an action
(Person)-[:Leaves]->(Absence)             a certain absence between two boxes
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from itertools import pairwise, product, takewhile
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.choices import different_labels, false_labels, true_labels
from jrdb_avr.engine.generate.describe import describe, find_leads
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.keyframes import keyframe_values
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, row_schema
from jrdb_avr.schema.labels import ACTIONS, POSES
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames, rules_hash

TableRow = dict[str, Any]

_CONDITIONS: Final = msgspec.json.Decoder(tuple[Condition, ...])


class Layer:
    """The layer of one sequence.

    Attributes:
        graph: Graph with the scene of the sequence.
        sequence: Name of the sequence.
        rules: Rules of descriptions and generators, and thresholds.
        facts: Facts of the sequence.
        head: Row of the interval table `sequence`.
        frames: Frames that methods may look at: those with an image, or all annotated ones without images.
        segments: Rows of the interval table `segments` by id, each with its id and the angle of its first box.
        boxes: Columns of sightings by track and frame. `ahead` is whether the view straight ahead shows the box.
        present: Actions that a person in clear view certainly does at a keyframe.
        low: First id of a node.
    """

    def __init__(self, store: Store, graph: Graph, sequence: str, rules: Rules, low: int = 0) -> None:
        """Make the layer of a sequence of a store.

        Args:
            store: Store with the interval tables of the sequence.
            graph: Graph with the scene of the sequence.
            sequence: Name of the sequence.
            rules: Rules of descriptions, and thresholds.
            low: First id of a node.

        Raises:
            StoreError: If a table is missing or broken.
        """
        (self.head,), frames_of, segments = (
            store.interval(name, sequence).to_pylist() for name in ("sequence", "frames", "segments")
        )
        boxes = store.interval("sightings", sequence, ["track", "frame", *"xywh", "angle", "clear"]).to_pylist()
        self.low, self.sequence, self.rules, self.graph = low, sequence, rules, graph
        self.facts = Facts(graph, sequence, rules.load, with_faces="pose" in self.head["layers"])
        self._rows: dict[str, list[TableRow]] = defaultdict(list)
        self.present = frozenset().union(*self.facts.counts.values())
        shown = "image" if "images" in self.head["layers"] else "annotated"
        self.frames = sorted(row["frame"] for row in frames_of if row[shown])
        self._images = {row["frame"] for row in frames_of if row["image"]}
        x, w = (np.array([row[side] for row in boxes], dtype=np.float64) for side in "xw")
        for row, ahead in zip(boxes, views.ahead(x, w, rules.visible_share).tolist(), strict=True):
            row["ahead"] = ahead
        self.boxes = {(row["track"], row["frame"]): row for row in boxes}
        some = [row for row in segments if row["action"] in ACTIONS]
        some.sort(key=lambda row: (row["track"], row["action"], row["first"], row["last"]))
        self.segments = {
            number: row | {"id": number, "angle": self._shown(row["track"], row["first"])["angle"]}
            for number, row in enumerate(some, start=low)
        }
        self._annotated = sorted(row["frame"] for row in frames_of if row["annotated"])

    @cached_property
    def names(self) -> dict[int, tuple[Condition, ...]]:
        """Conditions of each description of the sequence, by the id of its node `Name` in the stored layer."""
        rows = self.graph.query(read_statement("reads/names.cypher"), {"sequence": self.sequence}).to_pylist()
        return {row["id"]: _CONDITIONS.decode(row["conditions"]) for row in rows}

    @cached_property
    def false_labels(self) -> Callable[[int, int], frozenset[str]]:
        """Function that returns the actions that may be wrong choices, by track and keyframe."""
        lists = self.facts.lists
        return cache(lambda track, frame: false_labels(lists[track], frame))

    def search(self, name: str) -> list[TableRow]:
        """Run a generator over the stored layer and return its rows."""
        text = read_statement(f"generators/{name}.cypher")
        values = {**keyframe_values(self.rules), "sequence": self.sequence}
        rows: list[TableRow] = self.graph.query(text, {key: values[key] for key in parameters(text)}).to_pylist()
        return rows

    def has_image(self, frame: int) -> bool:
        """Return whether a frame has an image, or the sequence has no images at all."""
        return not self._images or frame in self._images

    def tables(self) -> Iterator[tuple[str, pa.Table]]:
        """Make the rows of the layer. Yield the name and the rows of each table that has rows, nodes first."""
        stamp = {"rules_hash": rules_hash(self.rules), "rules": msgspec.json.encode(self.rules).decode()}
        self._rows["Keyframes"].append(stamp | {"sequence": self.sequence})
        self._add_names(self._add_moments())
        self._add_segments()
        self._add_absences()
        nodes = {**SCENE_NODES, **LAYER_NODES}
        for name in (*LAYER_NODES, *LAYER_RELS):
            if rows := self._rows[name]:
                yield name, pa.Table.from_pylist(rows, row_schema(name, nodes, LAYER_RELS))

    def _shown(self, track: int, frame: int) -> TableRow:
        """Return whether a box is clear, the frame has an image and the view ahead has the box, and the box's angle."""
        box = self.boxes.get((track, frame), {"clear": False, "ahead": False, "angle": None})
        return {"image": self.has_image(frame)} | {name: box[name] for name in ("clear", "ahead", "angle")}

    def _add_moments(self) -> dict[tuple[int, int], int]:
        """Add the moments of all people; return their ids by track and frame."""
        facts, sequence, step = self.facts, self.sequence, frames(self.rules.shift_s)
        tracks = sorted({track for people in facts.people.values() for track in people})
        ids, seen = {}, {}
        for number, (track, frame) in enumerate(product(tracks, facts.keyframes), start=self.low):
            present = facts.seen(track, frame).present
            seen[track, frame] = None if present is None else int(present)
            if present is not None or (track, frame) in self.boxes:
                ids[track, frame] = number
        for (track, frame), number in ids.items():
            row = {"id": number, "sequence": sequence, "track": track, "frame": frame, "seen": seen[track, frame]}
            row |= {"earlier": seen.get((track, frame - step)), "later": seen.get((track, frame + step))}
            row |= {"not_doing": different_labels(facts.labels(track, frame)), **self._shown(track, frame)}
            self._rows["Moment"].append(row | {"distance": facts.seen(track, frame).distance})
            self._rows["At"].append({"from": f"{sequence}/{track}", "to": number})
            self._rows["Doing"] += [{"from": number, "to": label} for label in true_labels(facts.lists[track], frame)]
        return ids

    def _add_names(self, ids: dict[tuple[int, int], int]) -> None:
        """Add the descriptions of people who are not covered, and the targets of their relations."""
        facts, sequence = self.facts, self.sequence
        for (track, frame), number in ids.items():
            if track not in facts.uncovered[frame]:
                continue
            for conditions, general in describe(facts, sequence, track, frame, self.rules).items():
                name = self.low + len(self._rows["Name"])
                row = {"id": name, "sequence": sequence, "conditions": msgspec.json.encode(conditions).decode()}
                self._rows["Name"].append(row | {"general": general})
                self._rows["Describes"].append({"from": name, "to": number})
            for relation, target in find_leads(facts, track, frame).items():
                self._rows["Leads"].append({"from": number, "to": ids[target, frame], "relation": relation})

    def _add_segments(self) -> None:
        for number, row in self.segments.items():
            track = row["track"]
            held = _held_before(self.facts, track, row["action"], row["first"])
            own = {"held_from": held[0], "held_to": held[1]}
            for edge in ("last", "first"):
                shown = self._shown(track, row[edge])
                own |= {f"{edge}_{name}": shown[name] for name in ("clear", "image", "ahead")}
            self._rows["Segment"].append(row | own)
            self._rows["Acts"].append({"from": f"{row['sequence']}/{track}", "to": number})

    def _add_absences(self) -> None:
        """Add the absences: between two boxes no frame is unannotated, and the person is absent at a keyframe."""
        facts, sequence, annotated = self.facts, self.sequence, self._annotated
        step = KEYFRAME_STEP if all((later - frame) % KEYFRAME_STEP == 0 for frame, later in pairwise(annotated)) else 1
        for (track, leaves), (same, returns) in pairwise(sorted(self.boxes)):
            known = bisect_left(annotated, returns) - bisect_right(annotated, leaves)
            if track != same or known != -((leaves - returns) // step) - 1:
                continue
            between = range(bisect_right(facts.keyframes, leaves), bisect_left(facts.keyframes, returns))
            if not any(facts.is_absent(track, facts.keyframes[number]) for number in between):
                continue
            present = {frame: facts.seen(track, frame).present for frame in facts.keyframes if frame < leaves}
            row = {"id": self.low + len(self._rows["Absence"]), "sequence": sequence, "leaves": leaves}
            row |= {"returns": returns, "present_from": min(takewhile(present.get, reversed(present)), default=None)}
            first, last = self._shown(track, leaves), self._shown(track, returns)
            row |= {name: first[name] and last[name] for name in ("clear", "image", "ahead")}
            self._rows["Absence"].append(row)
            self._rows["Leaves"].append({"from": f"{sequence}/{track}", "to": row["id"]})


def _held_before(facts: Facts, track: int, action: str, first: int) -> tuple[int | None, int | None]:
    """Return the first and the last keyframe of the other posture that is held until a segment of a posture begins."""
    after = next((frame for frame in facts.keyframes if frame >= first), -1)
    until = after - KEYFRAME_STEP
    held = facts.pose(track, until)
    if action not in POSES or held in (None, action) or facts.pose(track, after) != action:
        return None, None
    return min(takewhile(lambda frame: facts.pose(track, frame) == held, range(until, -1, -KEYFRAME_STEP))), until
