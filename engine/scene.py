"""One sequence as generation sees it: people at keyframes, and the in-memory graph that the generators search.

`Scene` holds the interval tables of a sequence as columns. People and keyframes are numbered in order; a person at a
keyframe is a *moment*, numbered `person * len(keyframes) + keyframe`, so moments of one person lie side by side.
`scene_graph` copies them into a Kùzu database of this one sequence:

    (Person)-[:Is]->(Moment)              where the person has a box, or is absent; no moment: it is unknown
    (Description)-[:Names]->(Moment)      the description chosen for this person at this keyframe
    (Person)-[:Does]->(Segment)           stable segments of actions
    (Moment)-[:Shift {by}]->(Moment)      the same person `by` frames later, for both directions of time.shift
    (Moment)-[:Step {relation}]->(Moment) to the one person who certainly has the relation while nobody else could
    (Moment)-[:Leads {relation}]->(Moment) the steps that lead to somebody
    (Description)-[:Fits {t}]->(Moment)   to the one person whom the description fits at keyframe t
    (Person)-[:Leaves]->(Absence)         between two boxes, with the keyframes before at which the person is present
    (Moment)-[:Keeps]->(Company)          from then on, as long as it is known who is in a relation with the person
    (Company)-[:Meets {met}]->(Person)    who is in that relation with the person, from which keyframe on

Steps and fits that lead to nobody end in one of three moments without a time, whose ids are EMPTY, SEVERAL and UNKNOWN
of `relations`; their own steps lead back to themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames
from jrdb_avr.schema.things import OBJECTS
from jrdb_avr.schema.vocabulary import ACTIONS, POSES

from . import views

Ints = npt.NDArray[np.integer[Any]]
"""Whole numbers: 64 bits wide, but for the columns of candidates that are millions."""


NOWHERE: Final = (-1, -2, -3)
"""Ids of the moments that stand for nobody: none could match, several certainly do, it cannot be told."""

NOBODY: Final = -1
"""Row number of a box that is not there, and the code of an unknown value."""

_TABLES: Final = (
    "sequence",
    "frames",
    "persons",
    "sightings",
    "actions",
    "segments",
    "memberships",
    "interactions",
    "beside",
    "handles",
    "objects",
)


@dataclass(frozen=True)
class Scene:
    """A sequence's facts as columns; rows of `boxes` are sorted by (track, frame)."""

    sequence: str
    fps: float
    layers: frozenset[str]
    keyframes: Ints
    tracks: Ints
    annotated: Ints
    images: Ints
    boxes: pa.Table
    actions: pa.Table
    segments: pa.Table
    memberships: pa.Table
    interactions: pa.Table
    beside: pa.Table
    handles: pa.Table
    objects: pa.Table
    persons_table: pa.Table

    # -- boxes ------------------------------------------------------------------------------------------------

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """A numeric or boolean column of `boxes` as floats, null as NaN."""
        return np.asarray(pc.cast(self.boxes[name], pa.float64()).to_numpy(), dtype=np.float64)

    def flag(self, name: str) -> Bools:
        """A boolean column of `boxes`, null as false."""
        return np.asarray(pc.fill_null(self.boxes[name], False).to_numpy(), dtype=bool)

    def codes(self, name: str, words: tuple[str, ...]) -> Ints:
        """A text column of `boxes` as indices into `words`; null and other words are NOBODY."""
        return coded(self.boxes[name], words)

    @cached_property
    def geometry(self) -> dict[str, Floats]:
        """Per box: x, y, w, h in stitched pixels and the angle of its centre in degrees."""
        return {name: self.column(name) for name in ("x", "y", "w", "h", "angle")}

    @cached_property
    def clear(self) -> Bools:
        """Per box: whether it is a clear view."""
        return self.flag("clear")

    @cached_property
    def listed(self) -> Bools:
        """Per box: whether the person has an action list."""
        return self.flag("listed")

    @cached_property
    def box_keys(self) -> Ints:
        """Sorted (person, frame) keys of the boxes."""
        person = np.searchsorted(self.tracks, self.boxes["track"].to_numpy())
        return np.asarray(person * _SPREAD + self.boxes["frame"].to_numpy(), dtype=np.int64)

    def box_rows(self, persons: Ints, frames: Ints) -> Ints:
        """Row in `boxes` of each (person, frame), NOBODY where there is no box."""
        keys = np.asarray(persons, dtype=np.int64) * _SPREAD + frames
        at = np.searchsorted(self.box_keys, keys)
        inside = np.minimum(at, max(len(self.box_keys) - 1, 0))
        if len(self.box_keys) == 0:
            return np.full(len(keys), NOBODY)
        return np.where(self.box_keys[inside] == keys, inside, NOBODY)

    def person_of(self, tracks: Ints) -> Ints:
        """Number of each track's person."""
        return np.searchsorted(self.tracks, tracks)

    def box_of(self, track: int, frame: int) -> int:
        """Row in `boxes` of one person at one frame, or NOBODY."""
        return self._row_of.get(track * _SPREAD + frame, NOBODY)

    @cached_property
    def _row_of(self) -> dict[int, int]:
        """Row in `boxes` by track and frame: a look-up costs a hundredth of what one in arrays does."""
        keys = self.boxes["track"].to_numpy() * np.int64(_SPREAD) + self.boxes["frame"].to_numpy()
        return dict(zip(keys.tolist(), range(len(keys)), strict=True))

    def moment_of(self, track: int, frame: int) -> int:
        """Number of a person's moment at a keyframe."""
        person, keyframe = np.searchsorted(self.tracks, track), np.searchsorted(self.keyframes, frame)
        return int(person) * len(self.keyframes) + int(keyframe)

    def possible_actions(self, track: int, frame: int) -> frozenset[str]:
        """Actions that a person may or may not perform at a frame: hard labels, and closed gaps."""
        actions, spans = self._open_spans
        inside = (spans[0] == track) & (spans[1] <= frame) & (frame <= spans[2])
        return frozenset(actions[i] for i in np.flatnonzero(inside).tolist())

    @cached_property
    def _open_spans(self) -> tuple[list[str], Ints]:
        rows = self.actions.filter(pc.invert(self.actions["certain"]))
        spans = [rows[name].to_numpy() for name in ("track", "first", "last")]
        return rows["action"].to_pylist(), np.stack(spans).astype(np.int64)

    # -- people and things --------------------------------------------------------------------------------------

    def person_codes(self, name: str, words: tuple[str, ...]) -> Ints:
        """A text column of the people as indices into `words`, per person; NOBODY where unknown."""
        codes = np.full(len(self.tracks), NOBODY)
        codes[self.person_of(self.persons_table["track"].to_numpy())] = coded(self.persons_table[name], words)
        return codes

    @cached_property
    def handled_categories(self) -> Ints:
        """Per row of `handles`: index into OBJECTS of the thing's category, NOBODY where unknown."""
        keys = zip(self.objects["object"].to_pylist(), self.objects["category_id"].to_pylist(), strict=True)
        things = dict(zip(keys, coded(self.objects["category"], OBJECTS).tolist(), strict=True))
        handled = zip(self.handles["object"].to_pylist(), self.handles["category_id"].to_pylist(), strict=True)
        return np.array([things.get(key, NOBODY) for key in handled], dtype=np.int64)

    # -- moments ----------------------------------------------------------------------------------------------

    @property
    def moment_count(self) -> int:
        return len(self.tracks) * len(self.keyframes)

    def persons(self, moments: Ints) -> Ints:
        return moments // len(self.keyframes)

    def frames(self, moments: Ints) -> Ints:
        """Frame of each moment."""
        return self.keyframes[moments % len(self.keyframes)]

    @cached_property
    def moment_rows(self) -> Ints:
        """Row in `boxes` of every moment, NOBODY where the person has no box."""
        moments = np.arange(self.moment_count)
        return self.box_rows(self.persons(moments), self.frames(moments))

    @cached_property
    def absent(self) -> Bools:
        """Per moment: the frame and both neighbours are annotated and hold no box of the person."""
        moments = np.arange(self.moment_count)
        persons, frames = self.persons(moments), self.frames(moments)
        gone = np.ones(len(moments), dtype=bool)
        for shift in (-KEYFRAME_STEP, 0, KEYFRAME_STEP):
            gone &= np.isin(frames + shift, self.annotated)
            gone &= self.box_rows(persons, frames + shift) == NOBODY
        return gone

    @cached_property
    def present(self) -> Bools:
        """(persons, keyframes): whether the person is in clear view."""
        rows = self.moment_rows
        there = (rows != NOBODY) & (self.clear[rows] if len(self.clear) else False)
        return np.asarray(there.reshape(len(self.tracks), len(self.keyframes)))

    def has_image(self, frames: Ints) -> Bools:
        """Whether each frame has an image; true everywhere where the sequence has none at all."""
        if "images" not in self.layers:
            return np.ones(len(frames), dtype=bool)
        return np.isin(frames, self.images)

    @cached_property
    def poses(self) -> Ints:
        """Per box: index into POSES of the one certain pose, else NOBODY."""
        return self.codes("pose", POSES)

    @cached_property
    def moment_poses(self) -> npt.NDArray[np.int8]:
        """Per moment: index into POSES of the one certain pose, else NOBODY."""
        poses = np.full(self.moment_count, NOBODY, dtype=np.int8)
        there = self.moment_rows != NOBODY
        poses[there] = self.poses[self.moment_rows[there]]
        return poses

    @cached_property
    def distances(self) -> Floats:
        """Per box: metres from the robot where the 3D box has lidar points, else NaN."""
        return np.where(self.flag("located"), self.column("distance"), np.nan)


_SPREAD: Final = 1 << 32


def coded(column: pa.ChunkedArray, words: tuple[str, ...]) -> Ints:
    """Texts as indices into `words`; null and other words are NOBODY."""
    found = pc.index_in(column, value_set=pa.array(words, pa.string()))
    return np.asarray(pc.fill_null(found, NOBODY).to_numpy(), dtype=np.int64)


def spread(scene: Scene, table: pa.Table) -> tuple[Ints, Ints]:
    """Every row of an interval table with every keyframe's number that it covers."""
    low = np.searchsorted(scene.keyframes, table["first"].to_numpy(), side="left")
    high = np.searchsorted(scene.keyframes, table["last"].to_numpy(), side="right")
    span = np.maximum(high - low, 0)
    row = np.repeat(np.arange(len(table)), span)
    return row, np.arange(len(row)) - np.repeat(np.cumsum(span) - span, span) + low[row]


def load_scene(store: Store, sequence: str) -> Scene:
    """Read a sequence's interval tables. Raises StoreError where one is missing."""
    return make_scene({kind: store.interval(kind, sequence) for kind in _TABLES})


def make_scene(tables: dict[str, pa.Table]) -> Scene:
    """A scene from the interval tables of one sequence, by kind, in any row order."""
    head = tables["sequence"].to_pylist()[0]
    grid = tables["frames"].sort_by("frame")
    known = pc.is_in(tables["actions"]["action"], value_set=pa.array(ACTIONS, pa.string()))
    named = pc.is_in(tables["segments"]["action"], value_set=pa.array(ACTIONS, pa.string()))
    order = [("track", "ascending"), ("action", "ascending"), ("first", "ascending"), ("last", "ascending")]
    return Scene(
        sequence=head["sequence"],
        fps=head["fps"],
        layers=frozenset(head["layers"]),
        keyframes=np.array(sorted(head["keyframes"]), dtype=np.int64),
        tracks=np.unique(np.concatenate([tables[k]["track"].to_numpy() for k in ("persons", "sightings")])).astype(
            np.int64
        ),
        annotated=grid.filter(grid["annotated"])["frame"].to_numpy().astype(np.int64),
        images=grid.filter(grid["image"])["frame"].to_numpy().astype(np.int64),
        boxes=tables["sightings"].sort_by([("track", "ascending"), ("frame", "ascending")]).combine_chunks(),
        actions=tables["actions"].filter(known).sort_by(order),
        segments=tables["segments"].filter(named).sort_by(order),
        memberships=tables["memberships"],
        interactions=tables["interactions"],
        beside=tables["beside"],
        handles=tables["handles"],
        objects=tables["objects"],
        persons_table=tables["persons"],
    )


_DDL: Final = (
    "CREATE NODE TABLE Person(id INT64 PRIMARY KEY, track INT64)",
    "CREATE NODE TABLE Moment(id INT64 PRIMARY KEY, t INT64, seen INT64, clear BOOLEAN, image BOOLEAN, "
    "ahead BOOLEAN, pose STRING, distance DOUBLE, angle DOUBLE)",
    "CREATE NODE TABLE Description(id INT64 PRIMARY KEY, conditions STRING)",
    "CREATE NODE TABLE Segment(id INT64 PRIMARY KEY, action STRING, `first` INT64, `last` INT64, start INT64, "
    "`end` INT64, quiet_from INT64, closed BOOLEAN, first_clear BOOLEAN, first_image BOOLEAN, first_ahead BOOLEAN, "
    "last_clear BOOLEAN, last_image BOOLEAN, last_ahead BOOLEAN, "
    "angle DOUBLE, held_from INT64, held_to INT64)",
    "CREATE NODE TABLE Absence(id INT64 PRIMARY KEY, leaves INT64, returns INT64, present_from INT64, clear BOOLEAN, "
    "image BOOLEAN, ahead BOOLEAN)",
    "CREATE NODE TABLE Company(id INT64 PRIMARY KEY, relation STRING, until INT64)",
    "CREATE REL TABLE `Is`(FROM Person TO Moment)",
    "CREATE REL TABLE Does(FROM Person TO Segment)",
    "CREATE REL TABLE Shift(FROM Moment TO Moment, by INT64)",
    "CREATE REL TABLE Step(FROM Moment TO Moment, relation STRING)",
    "CREATE REL TABLE Leads(FROM Moment TO Moment, relation STRING)",
    "CREATE REL TABLE Fits(FROM Description TO Moment, t INT64)",
    "CREATE REL TABLE Names(FROM Description TO Moment, id INT64, anchor BOOLEAN, general BOOLEAN, poseless BOOLEAN)",
    "CREATE REL TABLE Leaves(FROM Person TO Absence)",
    "CREATE REL TABLE Keeps(FROM Moment TO Company)",
    "CREATE REL TABLE Meets(FROM Company TO Person, met INT64, seen INT64, maybe INT64, image BOOLEAN)",
)
_GIVEN: Final = ("Description", "Absence", "Company", "Names", "Fits", "Step", "Leads", "Leaves", "Keeps", "Meets")


def scene_graph(scene: Scene, tables: Mapping[str, pa.Table], rules: Rules) -> Graph:
    """The searchable graph of a sequence, in memory; the caller closes it.

    `tables` hold the columns of what is not of the scene alone, by the names in `_GIVEN`.
    """
    graph = Graph.memory()
    for statement in _DDL:
        graph.execute(statement)
    persons = np.arange(len(scene.tracks))
    moments, table = _moments(scene, rules)
    nowhere = pa.table(
        [pa.array(NOWHERE, pa.int64()), *(pa.nulls(3, f.type) for f in list(table.schema)[1:])], table.schema
    )
    segments = _segments(scene, rules)
    graph.copy("Person", pa.table({"id": persons, "track": scene.tracks}))
    graph.copy("Moment", pa.concat_tables([table, nowhere]))
    graph.copy("Segment", segments)
    graph.copy("Is", pa.table({"from": scene.persons(moments), "to": moments}))
    doer = scene.person_of(scene.segments["track"].to_numpy())
    graph.copy("Does", pa.table({"from": doer, "to": segments["id"]}))
    for by in (-frames(rules.shift_s), frames(rules.shift_s)):
        graph.copy("Shift", _shift(scene, moments, by))
    for name in _GIVEN:
        graph.copy(name, tables[name])
    return graph


def _shift(scene: Scene, moments: Ints, by: int) -> pa.Table:
    """Edges between the moments of one person that lie `by` frames apart."""
    persons, times = scene.persons(moments), scene.frames(moments) + by
    at = np.minimum(np.searchsorted(scene.keyframes, times), len(scene.keyframes) - 1)
    there = scene.keyframes[at] == times
    source, target = moments[there], (persons * len(scene.keyframes) + at)[there]
    exists = np.isin(target, moments)
    source, target = source[exists], target[exists]
    return pa.table({"from": source, "to": target, "by": np.full(len(source), by)})


def _seen(scene: Scene, rows: Ints, rules: Rules) -> tuple[Bools, Bools]:
    """(clear, ahead) per row of `boxes`; false where there is no box."""
    if len(scene.boxes) == 0:
        return np.zeros(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
    there = rows != NOBODY
    in_front = views.ahead(scene.geometry["x"], scene.geometry["w"], rules.visible_share)
    return scene.clear[rows] & there, in_front[rows] & there


def _moments(scene: Scene, rules: Rules) -> tuple[Ints, pa.Table]:
    moments = np.flatnonzero((scene.moment_rows != NOBODY) | scene.absent)
    rows = scene.moment_rows[moments]
    clear, in_front = _seen(scene, rows, rules)
    there = pa.array(rows, mask=rows == NOBODY)
    times = scene.frames(moments)
    distance = pc.take(pa.array(scene.distances, from_pandas=True), there)
    return moments, pa.table(
        {
            "id": moments,
            "t": times,
            # 1 present, 0 absent, null unknown.
            "seen": pa.array(clear.astype(np.int64), mask=~clear & ~scene.absent[moments]),
            "clear": clear,
            "image": scene.has_image(times),
            "ahead": in_front,
            "pose": pc.take(
                pa.array(POSES, pa.string()), pc.take(pa.array(scene.poses, mask=scene.poses == NOBODY), there)
            ),
            "distance": distance,
            "angle": pc.take(pa.array(scene.geometry["angle"]), there),
        }
    )


def _segments(scene: Scene, rules: Rules) -> pa.Table:
    table = scene.segments
    persons = scene.person_of(table["track"].to_numpy())
    starts = scene.box_rows(persons, table["first"].to_numpy().astype(np.int64))
    angle = pc.take(pa.array(scene.geometry["angle"]), pa.array(starts, mask=starts == NOBODY))
    columns: dict[str, object] = {"id": np.arange(len(table))}
    for name in ("action", "first", "last", "start", "end", "quiet_from", "closed"):
        wide = pa.types.is_integer(table.schema.field(name).type)
        columns[name] = pc.cast(table[name], pa.int64()) if wide else table[name]
    for edge in ("first", "last"):
        times = table[edge].to_numpy().astype(np.int64)
        clear, in_front = _seen(scene, scene.box_rows(persons, times), rules)
        columns |= {f"{edge}_clear": clear, f"{edge}_image": scene.has_image(times), f"{edge}_ahead": in_front}
    held_from, held_to = _held_before(scene)
    return pa.table({**columns, "angle": angle, "held_from": held_from, "held_to": held_to})


def _held_before(scene: Scene) -> tuple[pa.Array, pa.Array]:
    """Per segment of a pose: the first and last keyframe of the other pose held, known at every keyframe of them, until
    the keyframe before the segment; null where there is none."""
    rows, keyframes = len(scene.segments), scene.keyframes
    if rows == 0 or len(keyframes) == 0:
        return pa.nulls(rows, pa.int64()), pa.nulls(rows, pa.int64())
    count, pose = len(keyframes), scene.moment_poses.astype(np.int64)
    # How many keyframes before each moment hold its pose without a break.
    moments = np.arange(scene.moment_count)
    place = moments % count
    joined = (place > 0) & (np.diff(keyframes, prepend=keyframes[0])[place] == KEYFRAME_STEP)
    joined &= (pose == np.roll(pose, 1)) & (pose != NOBODY)
    run = moments - np.maximum.accumulate(np.where(joined, 0, moments))
    # The keyframe that follows the start of each segment, and the one before it.
    own = coded(scene.segments["action"], POSES)
    after = np.searchsorted(keyframes, scene.segments["first"].to_numpy().astype(np.int64))
    inside = (after > 0) & (after < count) & (own != NOBODY)
    after = np.clip(after, 1, count - 1) if count > 1 else np.zeros(rows, np.int64)
    base = scene.person_of(scene.segments["track"].to_numpy()) * count
    held = pose[base + after - 1]
    inside &= (keyframes[after] - keyframes[after - 1] == KEYFRAME_STEP) & (held != NOBODY) & (held != own)
    inside &= pose[base + after] == own
    since = after - 1 - run[base + after - 1]
    return pa.array(keyframes[since], mask=~inside), pa.array(keyframes[after - 1], mask=~inside)
