"""Simulate a sequence of the sample world, for its label files and pictures."""

from __future__ import annotations

import hashlib
from typing import Final

import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.interactions import interactions_of
from jrdb_avr.loaders.synthetic.motion import Motion, to_robot
from jrdb_avr.loaders.synthetic.objects import SIZES, Things
from jrdb_avr.loaders.synthetic.script import Rng, Script
from jrdb_avr.loaders.synthetic.skeleton import JOINTS, joints
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, row_of_height
from jrdb_avr.schema.rules import KEYFRAME_STEP

FLOOR: Final = -0.76
"""Height of the floor in the rig's frame, metres."""
FARTHEST: Final = 20.0
"""Maximum distance of labelled people, in metres."""
OCCLUSION_BOUNDS: Final = (0.08, 0.30, 0.90)
"""Maximum covered shares of fully visible, mostly visible and severely occluded people."""

_WIDTHS: Final = {"walking": 0.72, "sitting": 0.72, "bending": 0.85, "cycling": 1.25, "lying": 1.5, "running": 0.85}
_HEIGHTS: Final = {"sitting": 0.74, "bending": 0.68, "lying": 0.36, "cycling": 1.04, "scootering": 1.05}
BODY_WIDTH: Final = np.array([_WIDTHS.get(name, 0.62) for name in POSES])
"""Width by pose, in metres."""
BODY_HEIGHT: Final = np.array([_HEIGHTS.get(name, 1.0) for name in POSES])
"""Height by pose, as a share of the person's height."""

GRID: Final = 4
"""Pixels per cell of the raster for coverage."""
_ACROSS: Final = WIDTH // GRID


class World:
    """Simulated sequence of about `size` people in view: a pure function of (name, seed, frames, size).

    No file and no other sequence changes it. Arrays are per frame and person, (frames, people), where nothing else is
    stated. `tick` (frames): number of the tick whose states hold; `starts` (ticks + 1): first frame of each tick, then
    `frames`. `present`: the person has a place in view. `boxes` (frames, people, 4): x, y, w, h in whole stitched
    pixels, x may be negative or reach past 3760, rows cut at the image. `covered`: share of the box behind nearer
    people and partitions; `occlusion`: its place in OCCLUSIONS; `hidden`: severely occluded or worse. `boxed`: the
    person has a 2D box in the label files. `panel_boxes` (frames, partitions, 4) and `panel_distance` (frames,
    partitions) likewise. `cluster` numbers groups; people who share one are together. `thing_boxes` (frames, standing
    things, 4) and `thing_distance` (frames, standing things; infinite where the thing is not there) by column of
    `things.stands`. `joints` (frames, people, 17, 2): stitched pixels, not cut at the image nor wrapped at the seam;
    `joint_covered` (frames, people, 17): behind something nearer. `turned`: how people face, as the robot sees it:
    across (-1 left, 1 right) and toward the robot (1, or -1 away).
    """

    def __init__(self, name: str, seed: int, frames: int, size: int) -> None:
        self.name, self.seed, self.frames = name, seed, frames
        self.starts = _starts(self.rng("starts"), frames)
        tick = self.tick = np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))
        script = Script(self.rng("script"), int(tick[-1]) + 1, size)
        self.people, self.parties = script.people, script.parties
        motion = self.motion = Motion(self.rng("motion"), script, tick)
        self.pose, self.actions, self.apart = script.pose[tick], script.actions[tick], script.apart[tick]
        self.cluster = _clusters(script)[tick]
        self.interactions = interactions_of(self.rng("bonds"), script)
        self.things = Things(self.rng("things"), script, motion, tick)
        tall = np.array([person.height for person in self.people])
        self.height, self.width = tall * BODY_HEIGHT[self.pose], BODY_WIDTH[self.pose] * (tall / 1.72)
        self.distance = np.hypot(motion.x, motion.y)
        rows = body_rows(motion.z, self.distance, self.height)
        self.boxes = _upright(_columns(motion.x, motion.y), self.distance, rows, self.width)
        self.present = script.present[tick] & (self.distance <= FARTHEST) & (self.boxes[..., 3] > 4)
        off: Floats = motion.heading - np.arctan2(motion.y, motion.x)
        self.turned: tuple[Floats, Floats] = (-np.sin(off), -np.cos(off))
        self.joints = self._joints(rows)
        self.panel_boxes, self.panel_distance = _panel_boxes(_panels(self.rng("panels"), script), motion.robot)
        self.thing_boxes, self.thing_distance = self._thing_boxes()
        self.covered, self.joint_covered = self._covered()
        self.occlusion = np.asarray(np.digitize(self.covered, OCCLUSION_BOUNDS), np.int64)
        self.hidden: Bools = self.occlusion >= 2
        # Dropouts of the annotators; shorter than three keyframes, so that none ever looks like an absence.
        self.boxed = self.present & ~(spans(self.rng("dropouts"), self.hidden, 0.0006, 6, 22) & self.hidden)

    def rng(self, *names: str) -> Rng:
        """Return a generator of random numbers that depends only on the seed, the sequence and the names."""
        text = "/".join([str(self.seed), self.name, *names]).encode()
        return np.random.default_rng(int.from_bytes(hashlib.sha256(text).digest()[:16], "big"))

    def named(self, *digits: int) -> bool:
        """Return whether the sequence's name ends in "_" and one of `digits`, which select faults of its files."""
        return self.name.endswith(tuple(f"_{digit}" for digit in digits))

    def _joints(self, rows: Floats) -> npt.NDArray[np.float32]:
        frames, people = self.pose.shape
        # Phase of each person's stride, radians.
        stride = np.arange(frames, dtype=np.float64)[:, None] * 0.5 + np.arange(people)
        out = np.empty((frames, people, len(JOINTS), 2), np.float32)
        # Some frames at a time: the work would else take several times the memory of the result.
        for start in range(0, frames, 128):
            part = slice(start, start + 128)
            pose, actions = self.pose[part].ravel(), self.actions[part].reshape(-1, self.actions.shape[-1])
            side, toward, phase = (item[part].ravel() for item in (*self.turned, stride))
            flat = joints(pose, actions, side, toward, phase).reshape(-1, people, len(JOINTS), 2)
            x, w = self.boxes[part, :, 0, None], self.boxes[part, :, 2, None]
            top, bottom = rows[part, :, 0, None], rows[part, :, 1, None]
            out[part, :, :, 0] = x + (0.5 + flat[..., 0]) * w
            out[part, :, :, 1] = top + flat[..., 1] * (bottom - top)
        return out

    def _thing_boxes(self) -> tuple[Ints, Floats]:
        """Compute boxes and distances of standing things, by column of `things.stands`."""
        things = self.things
        sizes = np.array([SIZES[things.things[k].category] for k in things.stands]).reshape(-1, 2)
        x, y = to_robot(self.motion.robot[:, None, :], things.x, things.y)
        distance = np.maximum(np.hypot(x, y), 0.8)
        rows = body_rows(np.zeros_like(distance), distance, sizes[:, 1])
        return _upright(_columns(x, y), distance, rows, sizes[:, 0]), np.where(things.present, distance, np.inf)

    def _covered(self) -> tuple[Floats, Bools]:
        """Compute the share of each box behind nearer boxes, on a raster of `GRID` pixels, and the covered joints.

        0 and False for the absent. A person's box covers with the steps below it, down to the floor; partitions and
        things cover their boxes.
        """
        distance, boxes = self.distance, self.boxes
        obstacle_boxes = np.concatenate([self.panel_boxes, self.thing_boxes], axis=1)
        obstacle_distance = np.concatenate([self.panel_distance, self.thing_distance], axis=1)
        floor = np.clip(np.round(row_of_height(np.full_like(distance, FLOOR), distance)), 0, HEIGHT).astype(np.int64)
        covered, joint_covered = np.zeros(distance.shape), np.zeros(self.joints.shape[:3], bool)
        # From the nearest person to the farthest.
        order = np.argsort(distance, axis=1, kind="stable")
        # Three turns side by side: a box over the seam is one slice, written in all its copies.
        taken = np.zeros((HEIGHT // GRID, 3 * _ACROSS), np.uint8)
        cells = taken.ravel()
        for frame in range(self.frames):
            taken[:] = 0
            row = np.clip(self.joints[frame, :, :, 1] // GRID, 0, len(taken) - 1).astype(np.int64)
            column = (self.joints[frame, :, :, 0] // GRID).astype(np.int64) % _ACROSS + _ACROSS
            index = row * (3 * _ACROSS) + column
            nearest = np.argsort(-obstacle_distance[frame], kind="stable").tolist()
            far = obstacle_distance[frame].tolist()
            for i in order[frame].tolist():
                if not self.present[frame, i]:
                    continue
                while nearest and far[nearest[-1]] < distance[frame, i]:
                    _take(taken, obstacle_boxes[frame, nearest.pop()].tolist(), 0)
                joint_covered[frame, i] = cells[index[i]]
                covered[frame, i] = _take(taken, boxes[frame, i].tolist(), int(floor[frame, i]))
        return covered, joint_covered


def spans(rng: Rng, where: Bools, per_frame: float, least: int, most: int) -> Bools:
    """Return random spans of `least` to `most` frames. They begin at frames of `where`, with the chance per frame."""
    out = np.zeros_like(where)
    starts = np.argwhere(where & (rng.random(where.shape) < per_frame))
    for frame, person in starts.tolist():
        out[frame : frame + int(rng.integers(least, most + 1)), person] = True
    return out


def body_rows(feet: Floats, distance: Floats, height: Floats) -> Floats:
    """Return rows (..., 2) of top and bottom of bodies, not cut at the image. `feet` is metres above the floor."""
    low = FLOOR + feet
    rows = [row_of_height(low + height, distance), row_of_height(low, distance)]
    return np.array(np.stack(rows, axis=-1), np.float64)


def _starts(rng: Rng, frames: int) -> Ints:
    """Return the first frame of each tick, then `frames`. One tick begins between any two keyframes.

    Each at a place of its own: where changes may fall in one second does not show where they fall in the next.
    """
    keyframes = np.arange(0, frames, KEYFRAME_STEP)
    starts = keyframes + rng.integers(4, KEYFRAME_STEP - 2, len(keyframes))
    return np.concatenate([[0], starts[starts < frames], [frames]])


def _columns(x: Floats, y: Floats) -> Floats:
    """Return columns, not wrapped, of points in the robot's frame."""
    return np.asarray(WIDTH * (0.5 - np.arctan2(y, x) / (2 * np.pi)))


def _upright(column: Floats, distance: Floats, rows: Floats, width: Floats) -> Ints:
    """Return boxes (..., 4) in whole pixels of upright things around a column that are `width` metres across."""
    half = WIDTH * np.arctan2(width / 2, distance) / (2 * np.pi)
    left, right = np.round(column - half), np.round(column + half)
    top, bottom = np.moveaxis(np.clip(np.round(rows), 0, HEIGHT), -1, 0)
    return np.stack([left, top, right - left, bottom - top], axis=-1).astype(np.int64)


def _panels(rng: Rng, script: Script) -> Floats:
    """Return an opaque partition before each crowd, wide enough to hide most of it.

    Shape: (n, 5). A row has the ends (x, y, x, y) in the world and the height, in metres.
    """
    panels = []
    for bearing in sorted({party.bearing for party in script.parties if party.hidden}):
        near = float(rng.uniform(6.2, 7.2))
        half = near * np.tan(0.36)
        middle = np.array([np.cos(bearing), np.sin(bearing)]) * near
        across = np.array([-np.sin(bearing), np.cos(bearing)]) * half
        panels.append([*(middle - across), *(middle + across), rng.uniform(1.55, 1.8)])
    return np.array(panels, np.float64).reshape(-1, 5)


def _panel_boxes(panels: Floats, robot: Floats) -> tuple[Ints, Floats]:
    """Compute each partition as one upright rectangle at the distance of its middle."""
    x0, y0, x1, y1, height = np.ascontiguousarray(panels.T)
    points = ((x0, y0), (x1, y1), ((x0 + x1) / 2, (y0 + y1) / 2))
    begin, end, middle = (to_robot(robot[:, None, :], x, y) for x, y in points)
    distance = np.hypot(*middle)
    first = _columns(*begin)
    turn = (_columns(*end) - first + WIDTH / 2) % WIDTH - WIDTH / 2
    left = np.where(turn > 0, first, first + turn)
    top, bottom = np.moveaxis(body_rows(np.zeros_like(distance), distance, height), -1, 0)
    return np.round(np.stack([left, top, np.abs(turn), bottom - top], axis=-1)).astype(np.int64), distance


def _clusters(script: Script) -> Ints:
    """Return group numbers per tick: one per party, and a number for each person apart or alone."""
    party = np.array([person.party for person in script.people])
    return np.where(script.apart, int(party.max()) + 1 + np.arange(len(party)), party)


def _take(taken: npt.NDArray[np.uint8], box: list[int], floor: int) -> float:
    """Return the taken share of a box. Then take the box, and the pixels below it down to the floor."""
    x, y, w, h = box
    left = round(x / GRID) % _ACROSS + _ACROSS
    right = left + max(1, round(w / GRID))
    top, bottom = y // GRID, max(y // GRID + 1, (y + h) // GRID)
    share = np.count_nonzero(taken[top:bottom, left:right]) / ((bottom - top) * (right - left))
    bottom = max(bottom, floor // GRID)
    for turn in (-_ACROSS, 0, _ACROSS):
        taken[top:bottom, left + turn : right + turn] = 1
    return share
