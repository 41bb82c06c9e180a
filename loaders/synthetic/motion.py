"""Compute paths of the robot and the people per frame, in the robot's frame (x forward, y left)."""

from __future__ import annotations

import numpy as np

from jrdb_avr.loaders.synthetic.script import GAITS, Rng, Script
from jrdb_avr.schema.arrays import Floats, Ints
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import FPS

LEAST_DISTANCE = 1.7
"""Minimum distance of people from the robot, in metres."""
STEP_RISE = 0.2
"""Vertical speed on stairs, in metres per second."""


def to_robot(robot: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return world points in the robot's frame. `robot` (..., 3) must broadcast with the points."""
    dx, dy = x - robot[..., 0], y - robot[..., 1]
    c, s = np.cos(robot[..., 2]), np.sin(robot[..., 2])
    return c * dx + s * dy, -s * dx + c * dy


class Motion:
    """Positions per frame: the robot (frames, 3) in the world, and people (frames, people) in the robot's frame.

    Units are metres and radians. The robot has x, y and yaw. `z` is the height of the feet above the floor.
    """

    def __init__(self, rng: Rng, script: Script, ticks: Ints) -> None:
        """Compute the paths of a sequence. `ticks` is the tick of each frame."""
        robot = self.robot = _robot(rng, len(ticks))
        speed_of = np.array([GAITS.get(name, (0.0, 0.0))[1] for name in POSES])
        lead = [party.members[0] for party in script.parties]
        speed = np.where(script.moving, speed_of[script.pose[:, lead]], 0.0)[ticks]
        base_x, base_y, course = _party_paths(rng, script, speed, robot)
        party = np.array([person.party for person in script.people])
        offset_x, offset_y = _offsets(rng, script, ticks)
        x, y = to_robot(robot[:, None, :], base_x[:, party] + offset_x, base_y[:, party] + offset_y)
        push = _push(x, y)
        self.x, self.y = x * push, y * push
        course = course[:, party] - robot[:, 2:3]
        heading = np.where(speed[:, party] > 0, course, _facing(rng, script, ticks, self.x, self.y, robot))
        self.z, self.heading = _heights(script, ticks), np.arctan2(np.sin(heading), np.cos(heading))


def _robot(rng: Rng, frames: int) -> Floats:
    """Return the robot's path. It stops in some sequences. In others it drifts within a few metres and turns."""
    t = np.arange(frames) / FPS
    out = np.zeros((frames, 3))
    if rng.random() < 0.3:
        return out
    for axis, reach in ((0, 1.6), (1, 1.2), (2, 0.25)):
        period = rng.uniform(40, 80)
        out[:, axis] = reach * np.sin(2 * np.pi * t / period + rng.uniform(0, 2 * np.pi)) * rng.uniform(0.5, 1.0)
    return out


def _party_paths(rng: Rng, script: Script, speed: Floats, robot: Floats) -> Floats:
    """Return world x, y and courses of the parties, (3, frames, parties), between waypoints in their zones."""
    frames, count = speed.shape
    zones = np.array([(party.near, party.far, party.bearing, party.spread) for party in script.parties])
    near, far, bearing, spread = np.ascontiguousarray(zones.T)

    def waypoints() -> Floats:
        angle = bearing + rng.uniform(-1, 1, count) * spread
        radius = rng.uniform(near, far)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)

    position, goal = waypoints(), waypoints()
    course = np.arctan2(*(goal - position).T[::-1])
    paths = np.empty((3, frames, count))
    for frame in range(frames):
        gap = goal - position
        reached = np.hypot(gap[:, 0], gap[:, 1]) < 0.4
        if reached.any():
            # Of some next places the farthest: people walk straight for seconds, not round in circles.
            offsets = np.stack([waypoints() for _ in range(4)])
            distance = np.hypot(*np.moveaxis(offsets - position, -1, 0))
            farthest = offsets[distance.argmax(axis=0), np.arange(count)]
            goal = np.where(reached[:, None], farthest, goal)
            gap = goal - position
        turn = np.arctan2(gap[:, 1], gap[:, 0]) - course
        turn = np.arctan2(np.sin(turn), np.cos(turn))
        course = course + np.clip(turn, -0.25, 0.25)
        step = speed[frame] / FPS
        position = position + step[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
        # Round the robot, not through it.
        distance = position - robot[frame, :2]
        position = robot[frame, :2] + distance * _push(distance[:, 0], distance[:, 1])[:, None]
        paths[:, frame] = position[:, 0], position[:, 1], course
    return paths


def _push(x: Floats, y: Floats) -> Floats:
    """Return the factor of distances from the robot, so that no person is too near."""
    push: Floats = np.maximum(1.0, LEAST_DISTANCE / np.maximum(np.hypot(x, y), 1e-6))
    return push


def _offsets(rng: Rng, script: Script, ticks: Ints) -> tuple[Floats, Floats]:
    """Return offsets of members in their party, (frames, people), in metres. Members apart are some metres away."""
    count = len(script.people)
    angle, radius = np.zeros(count), np.zeros(count)
    for party in script.parties:
        size = len(party.members)
        if size > 1:
            start = rng.uniform(0, 2 * np.pi)
            angle[list(party.members)] = start + 2 * np.pi * np.arange(size) / size
            radius[list(party.members)] = 0.45 + 0.13 * size
    reach = np.where(script.apart, 2.2 + radius, radius)[ticks]
    # Nobody jumps: joining and leaving take two seconds.
    window = 31
    padded = np.pad(reach, ((window // 2, window // 2), (0, 0)), mode="edge")
    total = np.cumsum(np.vstack([np.zeros((1, count)), padded]), axis=0)
    smooth = (total[window:] - total[:-window]) / window
    return smooth * np.cos(angle), smooth * np.sin(angle)


def _facing(rng: Rng, script: Script, ticks: Ints, x: Floats, y: Floats, robot: Floats) -> Floats:
    """Return headings of people at rest, in the robot's frame: to the middle of the party, or a random direction."""
    out = np.empty_like(x)
    for party in script.parties:
        members = list(party.members)
        if len(members) > 1:
            middle_x, middle_y = (axis[:, members].mean(axis=1, keepdims=True) for axis in (x, y))
            out[:, members] = np.arctan2(middle_y - y[:, members], middle_x - x[:, members])
        else:
            out[:, members] = rng.uniform(-np.pi, np.pi) - robot[:, 2:3]
    return out


def _heights(script: Script, ticks: Ints) -> Floats:
    """Return the height of feet above the floor in metres, (frames, people)."""
    rise = np.array([STEP_RISE * ((name == "going upstairs") - (name == "going downstairs")) for name in POSES])
    return np.maximum(0.0, np.cumsum(rise[script.pose[ticks]] / FPS, axis=0))
