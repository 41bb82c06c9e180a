"""Which frames a sequence's layers know, at which step, and its keyframes."""

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
    """The frames a layer should know: first, first + step, ..., last. Frames beyond it do not exist for the layer."""

    first: int
    last: int
    step: int

    def index(self, frame: Ints) -> Ints:
        """Number of a frame on the grid, from 0; meaningless for frames off the grid."""
        return (frame - self.first) // self.step

    def holds(self, frame: Ints) -> Bools:
        """Whether frames lie on the grid."""
        return np.asarray((frame >= self.first) & (frame <= self.last) & ((frame - self.first) % self.step == 0))

    @property
    def size(self) -> int:
        return (self.last - self.first) // self.step + 1


@dataclass(frozen=True)
class Clock:
    """When frames were taken: seconds since the epoch of stamped frames, ascending. Without stamps frames are 1/15 s.

    Between stamped frames time runs evenly; before the first and after the last one frame takes 1/15 s.
    """

    frame: Ints
    stamp: Floats

    def seconds(self, frame: Ints) -> Floats:
        """Seconds of frames, counted from frame 0."""
        if not len(self.frame):
            return frame / FPS
        return self._epoch(frame) - float(self._epoch(np.zeros(1, np.int64))[0])

    def _epoch(self, frame: Ints) -> Floats:
        """Seconds counted from the first stamp: small numbers keep their digits."""
        inside = np.interp(frame, self.frame, self.stamp - self.stamp[0])
        beyond = np.minimum(frame - self.frame[0], 0) + np.maximum(frame - self.frame[-1], 0)
        return np.asarray(inside + beyond / FPS)


@dataclass(frozen=True)
class Timeline:
    """Frames of one sequence. `layers` holds the annotated frames of each layer that knows any, ascending."""

    sequence: str
    layers: dict[str, Ints]
    keyframes: Ints
    frames: Ints
    """Every frame of any layer but the timestamps, which may reach further than the labels, and of any box."""
    clock: Clock

    def seconds(self, frame: Ints) -> Floats:
        """Seconds of frames, counted from frame 0, by the sequence's clock."""
        return self.clock.seconds(frame)

    def span(self, first: Ints, last: Ints) -> dict[str, Any]:
        """The four columns of an interval: inclusive frames and their seconds."""
        return {"first": first, "last": last, "first_s": self.seconds(first), "last_s": self.seconds(last)}

    def table(self, kind: str, columns: Mapping[str, Any]) -> pa.Table:
        """The interval table of a kind from its columns but the sequence; others are left out."""
        schema = INTERVALS[kind]
        first, *names = schema.names
        rows = len(columns[names[0]])
        return pa.table({first: constant(self.sequence, rows), **{name: columns[name] for name in names}}).cast(schema)

    def frames_of(self, layer: str) -> Ints:
        return self.layers.get(layer, np.empty(0, np.int64))

    def grid(self, layer: str) -> Grid | None:
        """The layer's grid, None where the sequence lacks the layer."""
        frames = self.frames_of(layer)
        return Grid(int(frames[0]), int(frames[-1]), step_of(frames)) if len(frames) else None

    @property
    def action_step(self) -> int:
        """Step of the layer that sets the keyframes: actions, else 2D, else 3D."""
        return step_of(self.frames_of(_leading(self.layers)))


def step_of(frames: Ints) -> int:
    """15 where all frames lie whole seconds apart (or there is one), else 1."""
    return KEYFRAME_STEP if len(frames) < 2 or np.gcd.reduce(np.diff(frames)) % KEYFRAME_STEP == 0 else 1


def timeline(sequence: str, frames: pa.Table, box_frames: Ints, timestamps: pa.Table) -> Timeline:
    """Read the tables `frames` and `timestamps`. `box_frames`: frames with a 2D box, listed in the table or not.

    A keyframe with boxes that the 2D layer does not list holds people who could not be read: nothing unique or absent
    is known of it, so it is left out of the keyframes.
    """
    numbers = whole_numbers(frames, "frame")
    rows = {layer: pc.equal(frames["layer"], layer).to_numpy() for layer in LAYERS}
    layers = {layer: np.sort(numbers[here]) for layer, here in rows.items() if here.any()}
    leading = layers.get(_leading(layers), np.empty(0, np.int64))
    if not len(leading) or step_of(leading) == KEYFRAME_STEP:
        keyframes = leading
    else:
        first = -(-int(leading[0]) // KEYFRAME_STEP) * KEYFRAME_STEP
        keyframes = np.arange(first, int(leading[-1]) + 1, KEYFRAME_STEP, dtype=np.int64)
    unread = np.setdiff1d(box_frames, layers.get("2d", np.empty(0, np.int64)))
    known = np.union1d(numbers[~rows["timestamps"]], box_frames)
    images = timestamps.filter(pc.equal(timestamps["sensor"], "images"))
    clock = Clock(whole_numbers(images, "frame"), images["timestamp"].to_numpy())
    return Timeline(sequence, layers, np.setdiff1d(keyframes, unread), known, clock)


def _leading(layers: dict[str, Ints]) -> str:
    return next((layer for layer in ("actions", "2d", "3d") if layer in layers), "")


def sequence_table(line: Timeline, has_attributes: bool) -> pa.Table:
    """The one row of the interval table `sequence`."""
    row = {
        "sequence": line.sequence,
        "fps": FPS,
        "frame_count": int(line.frames[-1]) + 1 if len(line.frames) else 0,
        "layers": list(line.layers),
        "action_step": line.action_step,
        "keyframes": line.keyframes.tolist(),
        "has_attributes": has_attributes,
    }
    return pa.Table.from_pylist([row], INTERVALS["sequence"])


def frames_table(line: Timeline) -> pa.Table:
    """The interval table `frames`: one row per frame of any layer, and per keyframe that no layer has."""
    every = np.union1d(line.frames, line.keyframes)
    of = {"keyframe": line.keyframes, "annotated": line.frames_of("2d"), "image": line.frames_of("images")}
    here = {name: np.isin(every, frames) for name, frames in of.items()}
    return line.table("frames", {"frame": every, "seconds": line.seconds(every), **here})
