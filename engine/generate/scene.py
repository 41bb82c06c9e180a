"""One sequence as generation sees it: its interval tables as columns, and people at keyframes.

People and keyframes are numbered in order. A person at a keyframe is a *moment*, numbered
`person * len(keyframes) + keyframe`, so that the moments of one person lie side by side.

Stretches without a box between two boxes of a person, in which the person is certainly absent.
"""

from __future__ import annotations

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
from jrdb_avr.schema.things import OBJECTS

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
        return flags(self.boxes, name)

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
        """How many moments there are: every person at every keyframe, with a box or without."""
        return len(self.tracks) * len(self.keyframes)

    def persons(self, moments: Ints) -> Ints:
        """Number of each moment's person."""
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


def flags(table: pa.Table, name: str) -> Bools:
    """A column of booleans; null is false."""
    return np.asarray(pc.fill_null(table[name], False).to_numpy(), dtype=bool)


def spread(scene: Scene, table: pa.Table) -> tuple[Ints, Ints]:
    """Every row of an interval table with every keyframe's number that it covers."""
    low = np.searchsorted(scene.keyframes, table["first"].to_numpy(), side="left")
    high = np.searchsorted(scene.keyframes, table["last"].to_numpy(), side="right")
    span = np.maximum(high - low, 0)
    row = np.repeat(np.arange(len(table)), span)
    return row, np.arange(len(row)) - np.repeat(np.cumsum(span) - span, span) + low[row]


def moments_of(scene: Scene, table: pa.Table, who: str, row: Ints, keyframe: Ints) -> Ints:
    """Moments of rows of a table at keyframes, both by number as `spread` gives them; `who` is a column of tracks."""
    return scene.person_of(table[who].to_numpy())[row] * len(scene.keyframes) + keyframe


def load_scene(store: Store, sequence: str) -> Scene:
    """Read a sequence's interval tables. Raises StoreError where one is missing."""
    return make_scene({kind: store.interval(kind, sequence) for kind in _TABLES})


def weight(store: Store, sequence: str) -> int:
    """How long a sequence takes, compared with others: its number of 2D boxes."""
    return int(pq.read_metadata(store.interval_path("sightings", sequence)).num_rows)


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


def absence_tables(scene: Scene, rules: Rules) -> dict[str, pa.Table]:
    """The graph's tables `Absence` and `Leaves`.

    leaves: the last frame before, with a box; returns: the first one after. Between them no frame is unannotated, and
    at one keyframe or more the person is absent. present_from: the first keyframe from which on the person is present
    at every keyframe before `leaves`; null where it is not present at the last of them. clear and image hold of both
    frames; ahead: both boxes are seen straight ahead.
    """
    person, leaves, returns, rows = _absences(scene)
    keyframes, count = scene.keyframes, len(scene.keyframes)
    since = np.full(len(person), NOBODY)
    if len(person):
        last = np.searchsorted(keyframes, leaves) - 1
        since = np.where(last < 0, NOBODY, _present_since(scene)[person, np.maximum(last, 0)])
    x, w = scene.geometry["x"], scene.geometry["w"]
    ahead = views.ahead(x, w, rules.visible_share)
    number = np.arange(len(person))
    return {
        "Absence": pa.table(
            {
                "id": number,
                "leaves": leaves,
                "returns": returns,
                "present_from": pa.array(keyframes[np.maximum(since, 0)] if count else since, mask=since == NOBODY),
                "clear": scene.clear[rows] & scene.clear[rows + 1],
                "image": scene.has_image(leaves) & scene.has_image(returns),
                "ahead": ahead[rows] & ahead[rows + 1],
            }
        ),
        "Leaves": pa.table({"from": person, "to": number}),
    }


def _absences(scene: Scene) -> tuple[Ints, Ints, Ints, Ints]:
    """Person, last frame before, first frame after, and the row in `boxes` of the last frame before."""
    track, frame = (scene.boxes[name].to_numpy().astype(np.int64) for name in ("track", "frame"))
    rows = np.flatnonzero((track[1:] == track[:-1]) & (frame[1:] > frame[:-1] + 1))
    person, leaves, returns = scene.person_of(track[rows]), frame[rows], frame[rows + 1]
    # How many keyframes before each the person is absent at.
    gone = scene.absent.reshape(len(scene.tracks), len(scene.keyframes))
    before = np.pad(np.cumsum(gone, axis=1), ((0, 0), (1, 0)))
    low, high = np.searchsorted(scene.keyframes, leaves, side="right"), np.searchsorted(scene.keyframes, returns)
    absent = before[person, high] > before[person, low]
    kept = absent & _annotated_between(scene.annotated, leaves, returns)
    return person[kept], leaves[kept], returns[kept], rows[kept]


def _annotated_between(annotated: Ints, first: Ints, last: Ints) -> Bools:
    """Whether every frame of the 2D layer's grid strictly between two of its frames is annotated."""
    steps = np.diff(annotated)
    step = KEYFRAME_STEP if np.all(steps % KEYFRAME_STEP == 0) else 1
    known = np.searchsorted(annotated, last) - np.searchsorted(annotated, first, side="right")
    return np.asarray(known == -((first - last) // step) - 1)


def _present_since(scene: Scene) -> Ints:
    """(persons, keyframes): the first keyframe from which on the person is present until this one, or NOBODY."""
    place = np.arange(len(scene.keyframes))
    missed = np.maximum.accumulate(np.where(scene.present, NOBODY, place), axis=1)
    return np.where(scene.present, missed + 1, NOBODY)
