"""When somebody starts an action after t0, and where: the read of action_search, of others than its target."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP
from jrdb_avr.schema.vocabulary import POSES

from .scene import NOBODY, Scene

FALSE, TRUE, UNKNOWN = 0, 1, 2


@dataclass(frozen=True)
class Start:
    """An action's start as it is asked for, and the direction in which the person is seen then."""

    frame: int
    angle: float

    def near(self, frame: int, angle: float) -> bool:
        """Whether a frame and direction would score against this start."""
        return abs(frame - self.frame) <= round(FPS) and float(angle_error(angle, self.angle)) <= 20.0


class Watched:
    """Starts and states of a scene's actions, by person."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._spans: dict[tuple[int, str], list[tuple[int, int, bool]]] = defaultdict(list)
        columns = ("track", "action", "first", "last", "certain")
        for track, action, first, last, certain in zip(
            *(scene.actions[name].to_pylist() for name in columns), strict=True
        ):
            self._spans[track, action].append((first, last, certain))
        self._segments: dict[tuple[int, str], list[tuple[int, int, int]]] = defaultdict(list)
        columns = ("track", "action", "start", "quiet_from", "first")
        for track, action, *times in zip(*(scene.segments[name].to_pylist() for name in columns), strict=True):
            self._segments[track, action].append((times[0], times[1], times[2]))

    def start(self, track: int, action: str, after: int) -> Start | None:
        """The first start after a frame at which the action is false, if it is certain."""
        for frame, quiet_from, first in self._segments[track, action]:
            if frame > after and quiet_from <= after:
                return Start(frame, float(self.scene.geometry["angle"][self.scene.box_of(track, first)]))
        return None

    def could_start(self, track: int, action: str, stored: Start) -> bool:
        """Whether the person could be seen to start the action so near to `stored` that it would score."""
        for frame in range(stored.frame - KEYFRAME_STEP, stored.frame + KEYFRAME_STEP + 1):
            line = self.scene.box_of(track, frame)
            if line == NOBODY or not stored.near(frame, float(self.scene.geometry["angle"][line])):
                continue
            before = self.state(track, action, frame - KEYFRAME_STEP)
            if self.state(track, action, frame) != FALSE and before != TRUE:
                return True
        return False

    def state(self, track: int, action: str, frame: int) -> int:
        """Whether the person performs the action at a frame; unknown without a box."""
        line = self.scene.box_of(track, frame)
        if line == NOBODY:
            return UNKNOWN
        covering = [certain for first, last, certain in self._spans[track, action] if first <= frame <= last]
        if action in POSES:
            pose = int(self.scene.poses[line])
            if pose == NOBODY or (not all(covering) and POSES[pose] != action):
                return UNKNOWN
            return TRUE if POSES[pose] == action else FALSE
        if any(covering):
            return TRUE
        return UNKNOWN if covering or not self.scene.listed[line] else FALSE


def start_of(scene: Scene, segment: int) -> Start:
    """The start of a stable segment, by its row."""
    row = {name: scene.segments[name][segment].as_py() for name in ("track", "start", "first")}
    return Start(row["start"], float(scene.geometry["angle"][scene.box_of(row["track"], row["first"])]))
