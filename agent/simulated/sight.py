"""People at each frame of a store's sequences, read from the annotations.

A frame between two labelled frames shows the labels of the nearest labelled frame. People that the annotations call
covered are not in the list, because they count for no question.
"""

from __future__ import annotations

import functools
import math
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.agent.simulated.people import Person
from jrdb_avr.queries.opaque import key_path, opaque_names
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import DecodeError, StoreError
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, INTERACTIONS, PERSON_SECTORS, POSES
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.relations import PAIR_REACH_M, RELATIONS, SAME_GROUP, person_frame_label

_SEQUENCES: Final = 8
_FRAMES: Final = 4096
"""Maximum numbers of sequences and of frames in memory."""

_SECTOR_EDGES: Final = (30.0, 45.0, 135.0, 145.0)
"""Degrees from a person's heading at which front, front side, side, back side and back meet."""
_PERSON_TIES: Final = tuple(label for label, row in RELATIONS.items() if row.kind == "person")

Row = dict[str, Any]


class Sight:
    """Annotated people of a store's sequences. Many threads may share an object."""

    def __init__(self, store: Store) -> None:
        """Open a store with annotations. Raise StoreError if it has none."""
        self._store = store
        self._loaded = frozenset(store.manifest().sequences)
        if not self._loaded:
            raise StoreError(
                f"{store.path} has no annotations, which the simulated model reads: serve the model from the store "
                "with annotations (python -m jrdb_avr.agent.simulated --store S), then give --base-url and --simulated"
            )
        opaque = opaque_names(store, self._loaded) if key_path(store).exists() else {}
        self._names = {hidden: name for name, hidden in opaque.items()}
        self._sequence = functools.lru_cache(_SEQUENCES)(functools.partial(_Sequence, store))
        self._frame = functools.lru_cache(_FRAMES)(lambda name, frame: self._sequence(name).people(frame))

    @functools.cached_property
    def sequences(self) -> Mapping[str, str]:
        """Sequence of each question by its text. Texts of questions about several sequences are left out."""
        table = self._store.questions("questions", ["question", "sequence"])
        names: dict[str, set[str]] = defaultdict(set)
        for text, sequence in zip(table["question"].to_pylist(), table["sequence"].to_pylist(), strict=True):
            names[text].add(sequence)
        return {text: sequence for text, (sequence, *others) in names.items() if not others}

    def people(self, sequence: str, frame: int) -> tuple[Person, ...]:
        """Return the people of a frame.

        Args:
            sequence: Name of the sequence. It may be the opaque name.
            frame: Index of the frame.

        Returns:
            The people, by track.

        Raises:
            DecodeError: If the store has no such sequence.
        """
        name = self._names.get(sequence, sequence)
        if name not in self._loaded:
            raise DecodeError(f"the simulated model's store has no sequence {sequence[:60]!r}")
        return self._frame(name, frame)


class _Layer:
    """Rows of one table by frame, and the frames that the annotators labelled."""

    def __init__(self, table: pa.Table, frames: Iterable[int], columns: Sequence[str]) -> None:
        self._frames = sorted(frames)
        self._rows: dict[int, list[tuple[Any, ...]]] = defaultdict(list)
        for frame, *row in zip(*(table[name].to_pylist() for name in ("frame", *columns)), strict=True):
            self._rows[frame].append(tuple(row))

    def rows(self, frame: int) -> list[tuple[Any, ...]]:
        """Return the rows of the labelled frame that is nearest to a frame. Of two, take the earlier one."""
        index = bisect_left(self._frames, frame)
        near = self._frames[max(index - 1, 0) : index + 1]
        return self._rows.get(min(near, key=lambda at: abs(at - frame)), []) if near else []


class _Sequence:
    """Annotations of one sequence."""

    def __init__(self, store: Store, name: str) -> None:
        frames = store.annotation("frames", name, ["layer", "frame"])

        def layer(table: pa.Table, label: str, *columns: str) -> _Layer:
            return _Layer(table, frames.filter(pc.equal(frames["layer"], label))["frame"].to_pylist(), columns)

        self._sightings = layer(store.interval("sightings", name), "2d", *_SIGHTING)
        self._actions = layer(store.annotation("actions", name), "actions", "track", "action")
        self._interactions = layer(store.annotation("interactions", name), "interactions", "track", "partner", "label")
        self._handles = layer(store.annotation("handles", name), "handles", "track", "object", "category_id", "verb")
        self._things = {
            (row["object"], row["category_id"]): row["category"] for row in store.interval("objects", name).to_pylist()
        }
        self._constant: dict[int, dict[str, frozenset[str]]] = defaultdict(dict)
        for row in store.interval("demographics", name).to_pylist():
            if row["chosen"]:
                self._constant[row["track"]][row["attribute"]] = frozenset((row["value"],))

    def people(self, frame: int) -> tuple[Person, ...]:
        """Return the people of a frame who are not covered, by track."""
        rows = [dict(zip(_SIGHTING, row, strict=True)) for row in self._sightings.rows(frame)]
        rows = sorted((row for row in rows if not row["covered"]), key=lambda row: row["track"])
        labels, social = self._labels(frame), self._social(frame)
        return tuple(
            Person(
                track := row["track"],
                Box(*(row[side] for side in "xywh")),
                self._constant[track] | _known_labels(row, labels[track] | {"interaction": {*social[track]}}),
                _ties(row, rows, social[track]),
                row["distance"],
            )
            for row in rows
        )

    def _labels(self, frame: int) -> dict[int, dict[str, set[str]]]:
        """Return the labels of each person at a frame: poses, other actions and handled things."""
        table: dict[int, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        for track, action in self._actions.rows(frame):
            table[track]["pose" if action in POSES else "action"].add(action)
        for track, thing, category, verb in self._handles.rows(frame):
            if name := self._things.get((thing, category)):
                table[track]["object"].add(f"{verb}: {name}")
        return table

    def _social(self, frame: int) -> dict[int, dict[str, set[int]]]:
        """Return the partners of each person at a frame, by interaction."""
        table: dict[int, dict[str, set[int]]] = defaultdict(lambda: defaultdict(set))
        for track, partner, label in self._interactions.rows(frame):
            table[track][label].add(partner)
            table[partner][label].add(track)
        return table


_SIGHTING: Final = (
    *("track", "x", "y", "w", "h", "covered", "listed", "interactions_listed", "handles_listed"),
    *("cluster", "located", "distance", "cx", "cy", "heading"),
)
_LISTS: Final = {"pose": "listed", "action": "listed", "object": "handles_listed", "interaction": "interactions_listed"}
"""Column that says whether the annotators' list of a name is complete."""


def _known_labels(row: Row, labels: Mapping[str, set[str]]) -> dict[str, frozenset[str]]:
    """Return the values of each name, if the annotators' list of the name is complete or not empty."""
    return {name: frozenset(labels.get(name, ())) for name, column in _LISTS.items() if row[column] or labels.get(name)}


def _ties(row: Row, rows: Sequence[Row], social: Mapping[str, set[int]]) -> dict[str, frozenset[int]]:
    """Return the partners of a person by relation. An unknown relation is missing."""
    ties = {label: frozenset(partners) for label, partners in social.items()}
    if row["interactions_listed"]:
        ties = dict.fromkeys(INTERACTIONS, frozenset[int]()) | ties
    others = [neighbor for neighbor in rows if neighbor is not row]
    if row["cluster"] is not None:
        ties[SAME_GROUP] = frozenset(neighbor["track"] for neighbor in others if neighbor["cluster"] == row["cluster"])
    if row["located"] and row["heading"] is not None:
        sides = {neighbor["track"]: _side(row, neighbor) for neighbor in others if neighbor["located"]}
        ties |= {label: frozenset(track for track in sides if sides[track] == label) for label in _PERSON_TIES}
    return ties


def _side(source: Row, target: Row) -> str | None:
    """Return the label of a person's place as seen from another person, or None if the two are far apart."""
    dx, dy = target["cx"] - source["cx"], target["cy"] - source["cy"]
    metres = math.hypot(dx, dy)
    if metres >= PAIR_REACH_M:
        return None
    bearing = math.degrees(math.atan2(dy, dx) - source["heading"])
    bearing = (bearing + 180.0) % 360.0 - 180.0
    ring = sum(abs(bearing) > edge for edge in _SECTOR_EDGES)
    # The sectors go round from the front over the left.
    sector = [*PERSON_SECTORS][ring if bearing >= 0 else -ring % len(PERSON_SECTORS)]
    return person_frame_label(sector, DISTANCE_WORDS[sum(metres > bound for bound in DISTANCE_BOUNDS_M)])
