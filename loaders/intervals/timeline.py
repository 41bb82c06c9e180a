"""Frames of a sequence: the frames that each layer has, the step between them, the keyframes and the times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.labelfiles.columns import constant, whole_numbers
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP
from jrdb_avr.schema.tables import INTERVALS, LAYERS


@dataclass(frozen=True)
class Grid:
    """Frames that a layer should have: first, first + step, ..., last.

    A frame outside this range does not exist for the layer.
    """

    first: int
    last: int
    step: int

    def index(self, frame: Ints) -> Ints:
        """Return the index of each frame on the grid, from 0.

        The result has no meaning for frames that are not on the grid.
        """
        return (frame - self.first) // self.step

    def holds(self, frame: Ints) -> Bools:
        """Return whether each frame is on the grid."""
        return np.asarray((frame >= self.first) & (frame <= self.last) & ((frame - self.first) % self.step == 0))

    @property
    def size(self) -> int:
        """Return the number of frames of the grid."""
        return (self.last - self.first) // self.step + 1


@dataclass(frozen=True)
class Clock:
    """Times of frames. `stamp` has the seconds since the epoch of the frames in `frame`, which are ascending.

    Between two stamped frames, time runs evenly. A frame before the first stamp or after the last one lasts 1/15 s.
    Without stamps, every frame lasts 1/15 s.
    """

    frame: Ints
    stamp: Floats

    def seconds(self, frame: Ints) -> Floats:
        """Return the times of frames in seconds after frame 0."""
        if not len(self.frame):
            return frame / FPS
        return self._epoch(frame) - float(self._epoch(np.zeros(1, np.int64))[0])

    def _epoch(self, frame: Ints) -> Floats:
        """Return seconds after the first stamp. Because these numbers are small, they keep their digits."""
        inside = np.interp(frame, self.frame, self.stamp - self.stamp[0])
        beyond = np.minimum(frame - self.frame[0], 0) + np.maximum(frame - self.frame[-1], 0)
        return np.asarray(inside + beyond / FPS)


@dataclass(frozen=True)
class Timeline:
    """Frames of one sequence. `layers` has the annotated frames of each layer that has any, ascending."""

    sequence: str
    layers: dict[str, Ints]
    keyframes: Ints
    frames: Ints
    """All frames with a box or in a layer, without frames that only the timestamps have.

    Timestamps may continue after the labels.
    """
    clock: Clock

    def span(self, first: Ints, last: Ints) -> dict[str, Any]:
        """Return the four columns of intervals: first and last frame, and their times in seconds."""
        times = {"first_s": self.clock.seconds(first), "last_s": self.clock.seconds(last)}
        return {"first": first, "last": last, **times}

    def table(self, kind: str, columns: Mapping[str, Any]) -> pa.Table:
        """Return an interval table.

        Args:
            kind: Name of the table.
            columns: Columns without the column `sequence`. Columns that the table does not have are left out.
        """
        schema = INTERVALS[kind]
        first, *names = schema.names
        rows = len(columns[names[0]])
        return pa.table({first: constant(self.sequence, rows), **{name: columns[name] for name in names}}).cast(schema)

    def frames_of(self, layer: str) -> Ints:
        """Return the annotated frames of a layer, ascending. The array is empty if the sequence lacks the layer."""
        return self.layers.get(layer, np.empty(0, np.int64))

    def grid(self, layer: str) -> Grid | None:
        """Return the grid of a layer, or None if the sequence lacks the layer."""
        frames = self.frames_of(layer)
        return Grid(int(frames[0]), int(frames[-1]), step_of(frames)) if len(frames) else None


def step_of(frames: Ints) -> int:
    """Find the step of a layer.

    Args:
        frames: Frames of the layer, ascending.

    Returns:
        15 if all frames are whole seconds apart, otherwise 1. The step of fewer than two frames is 15.
    """
    return KEYFRAME_STEP if len(frames) < 2 or np.gcd.reduce(np.diff(frames)) % KEYFRAME_STEP == 0 else 1


def timeline(sequence: str, frames: pa.Table, box_frames: Ints, timestamps: pa.Table) -> Timeline:
    """Derive the frames of a sequence.

    A keyframe is left out if it has boxes although the 2D layer does not list it. Such a frame has people with unusable
    records, so no person is known to be unique or absent there.

    Args:
        sequence: Name of the sequence.
        frames: Annotation table `frames`.
        box_frames: Frames with a 2D box, ascending.
        timestamps: Annotation table `timestamps`.

    Returns:
        The frames.
    """
    numbers = whole_numbers(frames, "frame")
    rows = {layer: pc.equal(frames["layer"], layer).to_numpy() for layer in LAYERS}
    layers = {layer: np.sort(numbers[listed]) for layer, listed in rows.items() if listed.any()}
    leading = layers.get(_leading(layers), np.empty(0, np.int64))
    if not len(leading) or step_of(leading) == KEYFRAME_STEP:
        keyframes = leading
    else:
        first = -(-int(leading[0]) // KEYFRAME_STEP) * KEYFRAME_STEP
        keyframes = np.arange(first, int(leading[-1]) + 1, KEYFRAME_STEP, dtype=np.int64)
    unread = np.setdiff1d(box_frames, layers.get("2d", np.empty(0, np.int64)))
    every = np.union1d(numbers[~rows["timestamps"]], box_frames)
    images = timestamps.filter(pc.equal(timestamps["sensor"], "images"))
    clock = Clock(whole_numbers(images, "frame"), images["timestamp"].to_numpy())
    return Timeline(sequence, layers, np.setdiff1d(keyframes, unread), every, clock)


def _leading(layers: dict[str, Ints]) -> str:
    """Return the layer that decides the keyframes: actions, otherwise 2D, otherwise 3D."""
    return next((layer for layer in ("actions", "2d", "3d") if layer in layers), "")


def sequence_table(line: Timeline, visibility: str) -> pa.Table:
    """Derive the interval table `sequence`, which has one row.

    Args:
        line: Frames of the sequence.
        visibility: What decides who is in clear view: "attributes", "geometry" or "nothing".
    """
    row = {
        "fps": FPS,
        "frame_count": int(line.frames[-1]) + 1 if len(line.frames) else 0,
        "layers": list(line.layers),
        "action_step": step_of(line.frames_of(_leading(line.layers))),
        "keyframes": line.keyframes.tolist(),
        "visibility": visibility,
    }
    return line.table("sequence", {name: [value] for name, value in row.items()})


def frames_table(line: Timeline) -> pa.Table:
    """Derive the interval table `frames`, which has one row per frame of any layer, and per keyframe that no layer has.

    Args:
        line: Frames of the sequence.
    """
    every = np.union1d(line.frames, line.keyframes)
    of = {"keyframe": line.keyframes, "annotated": line.frames_of("2d"), "image": line.frames_of("images")}
    masks = {name: np.isin(every, frames) for name, frames in of.items()}
    return line.table("frames", {"frame": every, "seconds": line.clock.seconds(every), **masks})
