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

from jrdb_avr.schema.panorama import FOCAL_ROWS, HEIGHT, HORIZON_ROW, WIDTH
from jrdb_avr.schema.rules import KEYFRAME_STEP
from jrdb_avr.schema.vocabulary import POSES

from .motion import Motion, move, to_robot
from .script import Party, Person, Rng, write_script

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

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
    """An opaque partition that stands on the floor: ends in the world (metres), height, grey level and hue."""

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
    number of the second whose states hold; `phase`: first frame of tick 1.
    """

    name: str
    seed: int
    frames: int
    phase: int
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


def rng_of(seed: int, *names: str) -> Rng:
    """A generator of random numbers that depends on nothing but the seed and the names."""
    text = "/".join([str(seed), *names]).encode()
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text).digest()[:16], "big"))


def build(name: str, seed: int, frames: int, people: int) -> World:
    """Simulate a sequence of `frames` frames with about `people` people in view."""
    phase = 4 + int(rng_of(seed, name, "phase").integers(0, KEYFRAME_STEP - 6))
    tick = (np.arange(frames) - phase) // KEYFRAME_STEP + 1
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
    return World(
        name=name,
        seed=seed,
        frames=frames,
        phase=phase,
        people=script.people,
        parties=script.parties,
        panels=panels,
        motion=motion,
        tick=tick,
        present=present,
        apart=script.apart[tick],
        pose=pose,
        actions=script.actions[tick],
        cluster=_clusters(script.people, script.apart)[tick],
        distance=distance,
        height=height,
        width=width,
        boxes=boxes,
        covered=_covered(boxes, _ground_rows(distance), present, distance, order, panel_boxes, panel_distance),
        panel_boxes=panel_boxes,
        panel_distance=panel_distance,
        order=order,
    )


def person_boxes(motion: Motion, distance: Floats, height: Floats, width: Floats) -> Ints:
    """Boxes (frames, people, 4) of bodies of these heights and widths, metres."""
    azimuth = np.arctan2(motion.y, motion.x)
    column = WIDTH * (0.5 - azimuth / (2 * np.pi))
    half = WIDTH * np.arctan2(width / 2, distance) / (2 * np.pi)
    feet = FLOOR + motion.z
    top = HORIZON_ROW - FOCAL_ROWS * (feet + height) / distance
    bottom = HORIZON_ROW - FOCAL_ROWS * feet / distance
    left, right = np.round(column - half), np.round(column + half)
    top, bottom = np.clip(np.round(top), 0, HEIGHT), np.clip(np.round(bottom), 0, HEIGHT)
    return np.stack([left, top, right - left, bottom - top], axis=-1).astype(np.int64)


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
            ends.append(WIDTH * (0.5 - np.arctan2(y, x) / (2 * np.pi)))
        mx, my = to_robot(robot, np.full(frames, (panel.x0 + panel.x1) / 2), np.full(frames, (panel.y0 + panel.y1) / 2))
        distance = np.hypot(mx, my)
        turn = (ends[1] - ends[0] + WIDTH / 2) % WIDTH - WIDTH / 2
        left = np.where(turn > 0, ends[0], ends[0] + turn)
        top = HORIZON_ROW - FOCAL_ROWS * (FLOOR + panel.height) / distance
        bottom = HORIZON_ROW - FOCAL_ROWS * FLOOR / distance
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
    return np.clip(np.round(HORIZON_ROW - FOCAL_ROWS * FLOOR / distance), 0, HEIGHT).astype(np.int64)


def _covered(
    boxes: Ints,
    ground: Ints,
    present: Bools,
    distance: Floats,
    order: Ints,
    panel_boxes: Ints,
    panel_distance: Floats,
) -> Floats:
    """Share of each box that lies behind nearer ones, counted on a raster of `GRID` pixels; 0 for the absent.

    A person's box covers with the steps below it, down to the row `ground`.
    """
    frames, count = distance.shape
    covered = np.zeros((frames, count))
    across, down = WIDTH // GRID, HEIGHT // GRID
    # Three turns side by side: a box over the seam is one slice, written in all its copies.
    taken = np.zeros((down, 3 * across), np.uint8)
    for frame in range(frames):
        taken[:] = 0
        panels = sorted(range(panel_distance.shape[1]), key=lambda i: -panel_distance[frame, i])
        for i in order[frame].tolist():
            if not present[frame, i]:
                continue
            while panels and panel_distance[frame, panels[-1]] < distance[frame, i]:
                x, y, w, h = panel_boxes[frame, panels.pop()].tolist()
                _take(taken, x, y, w, h, y + h, across)
            x, y, w, h = boxes[frame, i].tolist()
            covered[frame, i] = _take(taken, x, y, w, h, max(y + h, int(ground[frame, i])), across)
    return covered


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
