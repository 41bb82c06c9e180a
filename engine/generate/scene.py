"""One sequence as generation sees it: its interval tables as columns, and people at keyframes.

People and keyframes are numbered in order. A person at a keyframe is a *moment*, numbered
`person * len(keyframes) + keyframe`, so that the moments of one person lie side by side.

An *absence* is a stretch without a box between two boxes of a person, in which the person is certainly absent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.engine.generate import views
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.labels import ACTIONS, POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules
from jrdb_avr.schema.tables import LABELED
from jrdb_avr.schema.things import OBJECTS

Ints = npt.NDArray[np.integer[Any]]
"""Whole numbers: 64 bits wide, but for the columns of candidates that are millions."""

NOWHERE: Final = (-1, -2, -3)
NO_MATCH, SEVERAL, UNDECIDED = NOWHERE
"""Ids of the moments that stand for nobody: none could match, several certainly do, it cannot be decided."""

NOBODY: Final = -1
"""Row number of a box that is not there, and the code of an unknown value."""

_SPREAD: Final = 1 << 32
"""Factor of the person in a key made of person and frame."""

_AS_THEY_ARE: Final = ("memberships", "interactions", "beside", "handles", "objects", "persons")
_TABLES: Final = ("sequence", "frames", "sightings", "actions", "segments", *_AS_THEY_ARE)


@dataclass(frozen=True)
class Scene:
    """A sequence's facts as columns; rows of `boxes` are sorted by (track, frame)."""

    sequence: str
    fps: float
    frame_count: int
    action_step: int
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
    persons: pa.Table

    # -- boxes ------------------------------------------------------------------------------------------------

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """A numeric or boolean column of `boxes` as floats, null as NaN."""
        return np.asarray(pc.cast(self.boxes[name], pa.float64()).to_numpy(), dtype=np.float64)

    def flag(self, name: str) -> Bools:
        """A boolean column of `boxes`, null as false."""
        return flags(self.boxes, name)

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
    def poses(self) -> Ints:
        """Per box: index into POSES of the one certain pose, else NOBODY."""
        return coded(self.boxes["pose"], POSES)

    @cached_property
    def distances(self) -> Floats:
        """Per box: metres from the robot where the 3D box has lidar points, else NaN."""
        return np.where(self.flag("located"), self.column("distance"), np.nan)

    @cached_property
    def box_keys(self) -> Ints:
        """Sorted (person, frame) keys of the boxes."""
        return np.asarray(self.person_of(ints(self.boxes, "track")) * _SPREAD + ints(self.boxes, "frame"))

    def box_rows(self, persons: Ints, frames: Ints) -> Ints:
        """Row in `boxes` of each (person, frame), NOBODY where there is no box."""
        return find_sorted(np.asarray(persons, dtype=np.int64) * _SPREAD + frames, self.box_keys)

    def person_of(self, tracks: Ints) -> Ints:
        """Number of each track's person."""
        return np.searchsorted(self.tracks, tracks)

    def box_of(self, track: int, frame: int) -> int:
        """Row in `boxes` of one person at one frame, or NOBODY."""
        return self._row_of.get((track, frame), NOBODY)

    @cached_property
    def _row_of(self) -> dict[tuple[int, int], int]:
        """Row in `boxes` by track and frame: a look-up costs a hundredth of what one in arrays does."""
        keys = zip(*(ints(self.boxes, name).tolist() for name in ("track", "frame")), strict=True)
        return {key: row for row, key in enumerate(keys)}

    def has_image(self, frames: Ints) -> Bools:
        """Whether each frame has an image; true everywhere where the sequence has none at all."""
        if "images" not in self.layers:
            return np.ones(len(frames), dtype=bool)
        return np.isin(frames, self.images)

    # -- moments ----------------------------------------------------------------------------------------------

    @property
    def moment_count(self) -> int:
        """How many moments there are: every person at every keyframe, with a box or without."""
        return len(self.tracks) * len(self.keyframes)

    def people(self, moments: Ints) -> Ints:
        """Number of each moment's person."""
        return moments // len(self.keyframes)

    def moments(self, tracks: Ints, frames: Ints) -> Ints:
        """Number of each track's moment at a keyframe."""
        return self.person_of(tracks) * len(self.keyframes) + np.searchsorted(self.keyframes, frames)

    def frames(self, moments: Ints) -> Ints:
        """Frame of each moment."""
        return self.keyframes[moments % len(self.keyframes)]

    def track(self, moment: int) -> int:
        """Track of one moment's person."""
        return int(self.tracks[moment // len(self.keyframes)])

    def absent_at(self, track: int, frame: int) -> bool:
        """Whether a person is certainly absent at a keyframe."""
        persons, keyframes = self._numbers
        return bool(self.absent.item(persons[track] * len(self.keyframes) + keyframes[frame]))

    @cached_property
    def _numbers(self) -> tuple[dict[int, int], dict[int, int]]:
        """Number of each track's person, and of each keyframe."""
        persons, keyframes = (
            {one: number for number, one in enumerate(c.tolist())} for c in (self.tracks, self.keyframes)
        )
        return persons, keyframes

    @cached_property
    def moment_rows(self) -> Ints:
        """Row in `boxes` of every moment, NOBODY where the person has no box."""
        moments = np.arange(self.moment_count)
        return self.box_rows(self.people(moments), self.frames(moments))

    @cached_property
    def seen_moments(self) -> Ints:
        """The moments at which the person has a box."""
        return np.flatnonzero(self.moment_rows != NOBODY)

    @cached_property
    def absent(self) -> Bools:
        """Per moment: the frame and both neighbours are annotated and hold no box of the person."""
        moments = np.arange(self.moment_count)
        persons, frames = self.people(moments), self.frames(moments)
        gone = np.ones(len(moments), dtype=bool)
        for shift in (-KEYFRAME_STEP, 0, KEYFRAME_STEP):
            gone &= np.isin(frames + shift, self.annotated)
            gone &= self.box_rows(persons, frames + shift) == NOBODY
        return gone

    @cached_property
    def present(self) -> Bools:
        """(persons, keyframes): whether the person is in clear view."""
        there = np.zeros(self.moment_count, dtype=bool)
        there[self.seen_moments] = self.clear[self.moment_rows[self.seen_moments]]
        return there.reshape(len(self.tracks), len(self.keyframes))

    @cached_property
    def moment_poses(self) -> npt.NDArray[np.int8]:
        """Per moment: index into POSES of the one certain pose, else NOBODY."""
        poses = np.full(self.moment_count, NOBODY, dtype=np.int8)
        poses[self.seen_moments] = self.poses[self.moment_rows[self.seen_moments]]
        return poses

    def covered(self, table: pa.Table, *people: str) -> tuple[Ints, ...]:
        """Every row of an interval table once per keyframe that it covers: row number, then the moments of the people
        in these columns of tracks."""
        low = np.searchsorted(self.keyframes, table["first"].to_numpy(), side="left")
        high = np.searchsorted(self.keyframes, table["last"].to_numpy(), side="right")
        span = np.maximum(high - low, 0)
        row = np.repeat(np.arange(len(table)), span)
        keyframe = np.arange(len(row)) - np.repeat(np.cumsum(span) - span, span) + low[row]
        return row, *(self.person_of(table[who].to_numpy())[row] * len(self.keyframes) + keyframe for who in people)


# -- columns ------------------------------------------------------------------------------------------------------


def find_sorted(values: Ints, keys: Ints) -> Ints:
    """Index of each value in the ascending keys, NOBODY where it is not among them."""
    if not len(keys):
        return np.full(values.shape, NOBODY)
    at = np.minimum(np.searchsorted(keys, values), len(keys) - 1)
    return np.where(keys[at] == values, at, NOBODY)


def match_rows(wanted: Sequence[Ints], among: Sequence[Ints]) -> Ints:
    """Per row of some columns, the row of other columns with the same numbers, from 0 on; NOBODY where none has."""
    key, keys = np.zeros(len(wanted[0]), np.int64), np.zeros(len(among[0]), np.int64)
    for one, other in zip(wanted, among, strict=True):
        size = 1 + int(max(one.max(initial=0), other.max(initial=0)))
        key, keys = key * size + one, keys * size + other
    order = np.argsort(keys)
    at = find_sorted(key, keys[order])
    return np.where(at == NOBODY, NOBODY, np.append(order, NOBODY)[at])


def ints(table: pa.Table, name: str) -> Ints:
    """A column of whole numbers; null is NOBODY."""
    return np.asarray(pc.fill_null(table[name], NOBODY).to_numpy(), dtype=np.int64)


def flags(table: pa.Table, name: str) -> Bools:
    """A column of booleans; null is false."""
    return np.asarray(pc.fill_null(table[name], False).to_numpy(), dtype=bool)


def coded(column: pa.ChunkedArray, words: tuple[str, ...]) -> Ints:
    """Texts as indices into `words`; null and other words are NOBODY."""
    found = pc.index_in(column, value_set=pa.array(words, pa.string()))
    return np.asarray(pc.fill_null(found, NOBODY).to_numpy(), dtype=np.int64)


def named(codes: Ints, words: tuple[str, ...]) -> pa.Array:
    """The words of indices into `words`; NOBODY is null."""
    return pc.take(pa.array(words, pa.string()), masked(codes))


def masked(numbers: Ints) -> pa.Array:
    """Numbers as an Arrow column; NOBODY is null."""
    return pa.array(numbers, mask=numbers == NOBODY)


# -- reading ------------------------------------------------------------------------------------------------------


def load_scene(store: Store, sequence: str) -> Scene:
    """Read a sequence's interval tables. Raises StoreError where one is missing."""
    return make_scene({kind: (store.facts if kind in LABELED else store.interval)(kind, sequence) for kind in _TABLES})


def box_count(store: Store, sequence: str) -> int:
    """Number of a sequence's 2D boxes, by which the time it takes is estimated."""
    return int(pq.read_metadata(store.interval_path("sightings", sequence)).num_rows)


def make_scene(tables: dict[str, pa.Table]) -> Scene:
    """A scene from the interval tables of one sequence, by kind, in any row order."""
    head = tables["sequence"].to_pylist()[0]
    grid = tables["frames"].sort_by("frame")
    order = [(name, "ascending") for name in ("track", "action", "first", "last")]
    actions, segments = (
        table.filter(pc.is_in(table["action"], value_set=pa.array(ACTIONS, pa.string()))).sort_by(order)
        for table in (tables["actions"], tables["segments"])
    )
    return Scene(
        sequence=head["sequence"],
        fps=head["fps"],
        frame_count=head["frame_count"],
        action_step=head["action_step"],
        layers=frozenset(head["layers"]),
        keyframes=np.array(sorted(head["keyframes"]), dtype=np.int64),
        tracks=np.union1d(ints(tables["persons"], "track"), ints(tables["sightings"], "track")),
        annotated=ints(grid.filter(grid["annotated"]), "frame"),
        images=ints(grid.filter(grid["image"]), "frame"),
        boxes=tables["sightings"].sort_by([("track", "ascending"), ("frame", "ascending")]).combine_chunks(),
        actions=actions,
        segments=segments,
        **{name: tables[name] for name in _AS_THEY_ARE},
    )


def handled_categories(scene: Scene) -> Ints:
    """Per row of `handles`: index into OBJECTS of the thing's category, NOBODY where unknown."""
    codes = coded(scene.objects["category"], OBJECTS).tolist()
    categories = dict(zip(_things(scene.objects), codes, strict=True))
    return np.array([categories.get(thing, NOBODY) for thing in _things(scene.handles)], dtype=np.int64)


def _things(table: pa.Table) -> list[tuple[int, int]]:
    return list(zip(table["object"].to_pylist(), table["category_id"].to_pylist(), strict=True))


# -- absences -----------------------------------------------------------------------------------------------------


def absence_tables(scene: Scene, rules: Rules) -> dict[str, pa.Table]:
    """The graph's tables `Absence` and `Leaves`.

    leaves: the last frame before, with a box; returns: the first one after. Between them no frame is unannotated, and
    at one keyframe or more the person is absent. present_from: the first keyframe from which on the person is present
    at every keyframe before `leaves`; null where it is not present at the last of them. clear and image hold of both
    frames; ahead: both boxes are seen straight ahead.
    """
    person, leaves, returns, rows = _absences(scene)
    last = np.searchsorted(scene.keyframes, leaves) - 1
    since = np.full(len(person), NOBODY)
    since[last >= 0] = _present_since(scene)[person[last >= 0], last[last >= 0]]
    ahead = views.ahead(scene.geometry["x"], scene.geometry["w"], rules.visible_share)
    number = np.arange(len(person))
    absences = {
        "id": number,
        "leaves": leaves,
        "returns": returns,
        "present_from": pc.take(pa.array(scene.keyframes), masked(since)),
        "clear": scene.clear[rows] & scene.clear[rows + 1],
        "image": scene.has_image(leaves) & scene.has_image(returns),
        "ahead": ahead[rows] & ahead[rows + 1],
    }
    return {"Absence": pa.table(absences), "Leaves": pa.table({"from": person, "to": number})}


def _absences(scene: Scene) -> tuple[Ints, Ints, Ints, Ints]:
    """Person, last frame before, first frame after, and the row in `boxes` of the last frame before."""
    track, frame = ints(scene.boxes, "track"), ints(scene.boxes, "frame")
    rows = np.flatnonzero((track[1:] == track[:-1]) & (frame[1:] > frame[:-1] + 1))
    person, leaves, returns = scene.person_of(track[rows]), frame[rows], frame[rows + 1]
    # How many keyframes before each the person is absent at.
    gone = scene.absent.reshape(len(scene.tracks), len(scene.keyframes))
    before = np.pad(np.cumsum(gone, axis=1), ((0, 0), (1, 0)))
    low, high = np.searchsorted(scene.keyframes, leaves, side="right"), np.searchsorted(scene.keyframes, returns)
    absent = before[person, high] > before[person, low]
    known = absent & _annotated_between(scene.annotated, leaves, returns)
    return person[known], leaves[known], returns[known], rows[known]


def _annotated_between(annotated: Ints, first: Ints, last: Ints) -> Bools:
    """Whether every frame of the 2D layer's grid strictly between two of its frames is annotated."""
    step = KEYFRAME_STEP if np.all(np.diff(annotated) % KEYFRAME_STEP == 0) else 1
    known = np.searchsorted(annotated, last) - np.searchsorted(annotated, first, side="right")
    return np.asarray(known == -((first - last) // step) - 1)


def _present_since(scene: Scene) -> Ints:
    """(persons, keyframes): the first keyframe from which on the person is present until this one, or NOBODY."""
    place = np.arange(len(scene.keyframes))
    missed = np.maximum.accumulate(np.where(scene.present, NOBODY, place), axis=1)
    return np.where(scene.present, missed + 1, NOBODY)
