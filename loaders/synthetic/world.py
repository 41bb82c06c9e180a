"""A sequence of the sample world: everything that its label files and pictures are made of.

`build` is a pure function of (seed, name, size): no file and no other sequence changes it. Arrays are per frame and
person, (frames, people).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.bonds import Bonds, bonds_of
from jrdb_avr.loaders.synthetic.motion import Motion, move, to_robot
from jrdb_avr.loaders.synthetic.objects import SIZES, Things, things_of
from jrdb_avr.loaders.synthetic.script import Party, Person, Rng, write_script
from jrdb_avr.loaders.synthetic.skeleton import joints
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, row_of_height
from jrdb_avr.schema.rules import KEYFRAME_STEP

FLOOR: Final = -0.76
"""Height of the floor in the rig's frame, metres."""
FARTHEST: Final = 20.0
"""Metres: nobody is labelled beyond."""

_WIDTHS: Final = {"walking": 0.72, "sitting": 0.72, "bending": 0.85, "cycling": 1.25, "lying": 1.5, "running": 0.85}
_HEIGHTS: Final = {"sitting": 0.74, "bending": 0.68, "lying": 0.36, "cycling": 1.04, "scootering": 1.05}
BODY_WIDTH: Final = np.array([_WIDTHS.get(name, 0.62) for name in POSES])
"""Metres across, per pose."""
BODY_HEIGHT: Final = np.array([_HEIGHTS.get(name, 1.0) for name in POSES])
"""Share of a person's height, per pose."""

GRID: Final = 4
"""Pixels per cell of the raster that coverage is counted on."""


@dataclass(frozen=True)
class Panel:
    """An opaque partition that stands on the floor: its ends in the world and its height, metres."""

    x0: float
    y0: float
    x1: float
    y1: float
    height: float


@dataclass(frozen=True)
class World:
    """One simulated sequence.

    `present`: the person has a place in view. `boxes` (frames, people, 4): x, y, w, h in whole stitched pixels, x may
    be negative or reach past 3760, rows cut at the image. `covered`: share of the box behind nearer people and panels.
    `panel_boxes` (frames, panels, 4) and `panel_distance` (frames, panels) likewise. `cluster` numbers groups; people
    who share one are together. `order` (frames, people): places from the nearest to the farthest. `tick` (frames):
    number of the tick whose states hold; `starts` (ticks + 1): first frame of each tick, then `frames`.
    `thing_boxes` (frames, standing things, 4) and `thing_distance` (frames, standing things; infinite where the thing
    is not there) by column of `things.stands`.
    `joints` (frames, people, 17, 2): stitched pixels, not cut at the image nor wrapped at the seam; `joint_covered`
    (frames, people, 17): behind something nearer.
    """

    name: str
    seed: int
    frames: int
    starts: Ints
    people: tuple[Person, ...]
    parties: tuple[Party, ...]
    panels: tuple[Panel, ...]
    motion: Motion
    tick: Ints
    present: Bools
    apart: Bools
    pose: Ints
    actions: Ints
    cluster: Ints
    distance: Floats
    height: Floats
    width: Floats
    boxes: Ints
    covered: Floats
    panel_boxes: Ints
    panel_distance: Floats
    order: Ints
    bonds: Bonds
    things: Things
    thing_boxes: Ints
    thing_distance: Floats
    joints: npt.NDArray[np.float32]
    joint_covered: Bools


def rng_of(seed: int, *names: str) -> Rng:
    """A generator of random numbers that depends on nothing but the seed and the names."""
    text = "/".join([str(seed), *names]).encode()
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text).digest()[:16], "big"))


def build(name: str, seed: int, frames: int, people: int) -> World:
    """Simulate a sequence of `frames` frames with about `people` people in view."""
    starts = _starts(rng_of(seed, name, "starts"), frames)
    tick = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    script = write_script(rng_of(seed, name, "script"), int(tick[-1]) + 1, people)
    motion = move(rng_of(seed, name, "motion"), script, tick)
    panels = _panels(rng_of(seed, name, "panels"), script.parties)
    pose = script.pose[tick]
    tall = np.array([person.height for person in script.people])
    height, width = tall * BODY_HEIGHT[pose], BODY_WIDTH[pose] * (tall / 1.72)
    distance = np.hypot(motion.x, motion.y)
    present = script.present[tick] & (distance <= FARTHEST)
    boxes = person_boxes(motion, distance, height, width)
    present &= boxes[..., 3] > 4
    panel_boxes, panel_distance = _panel_boxes(panels, motion.robot)
    order = np.argsort(distance, axis=1, kind="stable")
    actions = script.actions[tick]
    bodies = _bodies(motion, boxes, body_rows(motion.z, distance, height), pose, actions)
    things = things_of(rng_of(seed, name, "things"), script, motion, tick)
    thing_boxes, thing_distance = _thing_boxes(things, motion.robot)
    covered, joint_covered = _covered(
        boxes,
        _ground_rows(distance),
        present,
        distance,
        order,
        np.concatenate([panel_boxes, thing_boxes], axis=1),
        np.concatenate([panel_distance, thing_distance], axis=1),
        bodies,
    )
    return World(
        name=name,
        seed=seed,
        frames=frames,
        starts=starts,
        people=script.people,
        parties=script.parties,
        panels=panels,
        motion=motion,
        tick=tick,
        present=present,
        apart=script.apart[tick],
        pose=pose,
        actions=actions,
        cluster=_clusters(script.people, script.apart)[tick],
        distance=distance,
        height=height,
        width=width,
        boxes=boxes,
        covered=covered,
        panel_boxes=panel_boxes,
        panel_distance=panel_distance,
        order=order,
        bonds=bonds_of(rng_of(seed, name, "bonds"), script),
        things=things,
        thing_boxes=thing_boxes,
        thing_distance=thing_distance,
        joints=bodies,
        joint_covered=joint_covered,
    )


def _starts(rng: Rng, frames: int) -> Ints:
    """First frame of each tick, then `frames`: one tick begins between any two keyframes, not near either.

    Each at a place of its own: where changes may fall in one second tells nothing of the next.
    """
    keyframes = np.arange(0, frames, KEYFRAME_STEP)
    starts = keyframes + rng.integers(4, KEYFRAME_STEP - 2, len(keyframes))
    return np.concatenate([[0], starts[starts < frames], [frames]])


def person_boxes(motion: Motion, distance: Floats, height: Floats, width: Floats) -> Ints:
    """Boxes (frames, people, 4) of bodies of these heights and widths, metres."""
    return _upright(_columns(motion.x, motion.y), distance, body_rows(motion.z, distance, height), width)


def _columns(x: Floats, y: Floats) -> Floats:
    """Columns, not wrapped, of points in the robot's frame."""
    return np.asarray(WIDTH * (0.5 - np.arctan2(y, x) / (2 * np.pi)))


def _upright(column: Floats, distance: Floats, rows: Floats, width: Floats) -> Ints:
    """Boxes (..., 4) in whole pixels of what stands upright round a column and is `width` metres across."""
    half = WIDTH * np.arctan2(width / 2, distance) / (2 * np.pi)
    left, right = np.round(column - half), np.round(column + half)
    top, bottom = np.moveaxis(np.clip(np.round(rows), 0, HEIGHT), -1, 0)
    return np.stack([left, top, right - left, bottom - top], axis=-1).astype(np.int64)


def body_rows(feet: Floats, distance: Floats, height: Floats | float) -> Floats:
    """Rows (..., 2) of the top and the bottom of bodies, not cut at the image; `feet` is metres above the floor."""
    low = FLOOR + feet
    rows = [row_of_height(low + height, distance), row_of_height(low, distance)]
    return np.array(np.stack(rows, axis=-1), np.float64)


def turned(motion: Motion) -> tuple[Floats, Floats]:
    """How people face, as the robot sees it: across (-1 left, 1 right) and toward the robot (1, or -1 away)."""
    off: Floats = motion.heading - np.arctan2(motion.y, motion.x)
    return -np.sin(off), -np.cos(off)


def gait(frames: int, people: int) -> Floats:
    """Phase of each person's stride, radians, (frames, people)."""
    phase: Floats = np.arange(frames, dtype=np.float64)[:, None] * 0.5 + np.arange(people)
    return phase


def _bodies(motion: Motion, boxes: Ints, rows: Floats, pose: Ints, actions: Ints) -> npt.NDArray[np.float32]:
    """Joints in pixels, (frames, people, 17, 2)."""
    frames, people = pose.shape
    side, toward = turned(motion)
    stride = gait(frames, people)
    out = np.empty((frames, people, 17, 2), np.float32)
    # Some frames at a time: the work would else take several times the memory of the result.
    for start in range(0, frames, 128):
        part = slice(start, start + 128)
        flat = joints(
            pose[part].ravel(),
            actions[part].reshape(-1, actions.shape[-1]),
            side[part].ravel(),
            toward[part].ravel(),
            stride[part].ravel(),
        ).reshape(-1, people, 17, 2)
        x, w = boxes[part, :, 0, None], boxes[part, :, 2, None]
        top, bottom = rows[part, :, 0, None], rows[part, :, 1, None]
        out[part, :, :, 0] = x + (0.5 + flat[..., 0]) * w
        out[part, :, :, 1] = top + flat[..., 1] * (bottom - top)
    return out


def _thing_boxes(things: Things, robot: Floats) -> tuple[Ints, Floats]:
    """Boxes and distances of standing things, by column of `things.stands`."""
    sizes = np.array([SIZES[things.things[k].category] for k in things.stands]).reshape(-1, 2)
    x, y = to_robot(robot[:, None, :], things.x, things.y)
    distance = np.maximum(np.hypot(x, y), 0.8)
    rows = body_rows(np.zeros_like(distance), distance, sizes[:, 1])
    return _upright(_columns(x, y), distance, rows, sizes[:, 0]), np.where(things.there, distance, np.inf)


def _panels(rng: Rng, parties: tuple[Party, ...]) -> tuple[Panel, ...]:
    """A partition before each crowd, wide enough to hide most of it."""
    bearings = sorted({party.bearing for party in parties if party.hidden})
    panels = []
    for bearing in bearings:
        near = float(rng.uniform(6.2, 7.2))
        half = near * np.tan(0.36)
        middle = np.array([np.cos(bearing), np.sin(bearing)]) * near
        across = np.array([-np.sin(bearing), np.cos(bearing)]) * half
        a, b = middle - across, middle + across
        panels.append(Panel(float(a[0]), float(a[1]), float(b[0]), float(b[1]), float(rng.uniform(1.55, 1.8))))
    return tuple(panels)


def _panel_boxes(panels: tuple[Panel, ...], robot: Floats) -> tuple[Ints, Floats]:
    """Each panel as one upright rectangle at the distance of its middle."""
    frames = len(robot)
    boxes, away = np.zeros((frames, len(panels), 4), np.int64), np.zeros((frames, len(panels)))
    for i, panel in enumerate(panels):
        ends = []
        for wx, wy in ((panel.x0, panel.y0), (panel.x1, panel.y1)):
            x, y = to_robot(robot, np.full(frames, wx), np.full(frames, wy))
            ends.append(_columns(x, y))
        mx, my = to_robot(robot, np.full(frames, (panel.x0 + panel.x1) / 2), np.full(frames, (panel.y0 + panel.y1) / 2))
        distance = np.hypot(mx, my)
        turn = (ends[1] - ends[0] + WIDTH / 2) % WIDTH - WIDTH / 2
        left = np.where(turn > 0, ends[0], ends[0] + turn)
        top, bottom = np.moveaxis(body_rows(np.zeros(frames), distance, panel.height), -1, 0)
        boxes[:, i] = np.round(np.stack([left, top, np.abs(turn), bottom - top], axis=-1)).astype(np.int64)
        away[:, i] = distance
    return boxes, away


def _clusters(people: tuple[Person, ...], apart: Bools) -> Ints:
    """Group numbers per tick: one per party, and one of their own for those apart or alone."""
    party = np.array([person.party for person in people])
    own = int(party.max()) + 1 + np.arange(len(people))
    return np.where(apart, own, party)


def _ground_rows(distance: Floats) -> Ints:
    """Rows of the floor at these distances, inside the image."""
    return np.clip(np.round(row_of_height(np.full_like(distance, FLOOR), distance)), 0, HEIGHT).astype(np.int64)


def _covered(
    boxes: Ints,
    ground: Ints,
    present: Bools,
    distance: Floats,
    order: Ints,
    obstacle_boxes: Ints,
    obstacle_distance: Floats,
    bodies: npt.NDArray[np.float32],
) -> tuple[Floats, Bools]:
    """Share of each box that lies behind nearer ones, counted on a raster of `GRID` pixels, and which joints do so.

    0 and False for the absent. A person's box covers with the steps below it, down to the row `ground`; obstacles
    (panels and things) cover their boxes.
    """
    frames, count = distance.shape
    covered = np.zeros((frames, count))
    joint_covered = np.zeros((frames, count, 17), bool)
    across, down = WIDTH // GRID, HEIGHT // GRID
    # Three turns side by side: a box over the seam is one slice, written in all its copies.
    taken = np.zeros((down, 3 * across), np.uint8)
    cells = taken.ravel()
    for frame in range(frames):
        taken[:] = 0
        row = np.clip(bodies[frame, :, :, 1] // GRID, 0, down - 1).astype(np.int64)
        column = (bodies[frame, :, :, 0] // GRID).astype(np.int64) % across + across
        place = row * (3 * across) + column
        nearest = np.argsort(-obstacle_distance[frame], kind="stable").tolist()
        away = obstacle_distance[frame].tolist()
        for i in order[frame].tolist():
            if not present[frame, i]:
                continue
            while nearest and away[nearest[-1]] < distance[frame, i]:
                x, y, w, h = obstacle_boxes[frame, nearest.pop()].tolist()
                _take(taken, x, y, w, h, y + h, across)
            x, y, w, h = boxes[frame, i].tolist()
            joint_covered[frame, i] = cells[place[i]]
            covered[frame, i] = _take(taken, x, y, w, h, max(y + h, int(ground[frame, i])), across)
    return covered, joint_covered


def _take(taken: npt.NDArray[np.uint8], x: int, y: int, w: int, h: int, foot: int, across: int) -> float:
    """The share of the box already taken; then takes all of it, and what is below it down to the row `foot`."""
    left = round(x / GRID) % across + across
    right = left + max(1, round(w / GRID))
    top, bottom = y // GRID, max(y // GRID + 1, (y + h) // GRID)
    share = np.count_nonzero(taken[top:bottom, left:right]) / ((bottom - top) * (right - left))
    bottom = max(bottom, foot // GRID)
    for turn in (-across, 0, across):
        taken[top:bottom, left + turn : right + turn] = 1
    return share
