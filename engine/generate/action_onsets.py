"""When and where somebody starts an action after t0: what action_search reads, here of people other than its target."""

from __future__ import annotations

from collections import defaultdict

from jrdb_avr.engine.generate.conditions import FALSE, TRUE, UNKNOWN
from jrdb_avr.engine.generate.scene import NOBODY, Scene
from jrdb_avr.schema.answers import FrameViewpoint, same_answer
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP


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

    def start(self, track: int, action: str, after: int) -> FrameViewpoint | None:
        """The first start after a frame at which the action is false, if it is certain."""
        for frame, quiet_from, first in self._segments[track, action]:
            if frame > after and quiet_from <= after:
                return viewpoint(self.scene, self.scene.box_of(track, first), frame)
        return None

    def could_start(self, track: int, action: str, stored: FrameViewpoint) -> bool:
        """Whether the person could be seen to start the action so near to `stored` that it would score."""
        for frame in range(stored.frame - KEYFRAME_STEP, stored.frame + KEYFRAME_STEP + 1):
            line = self.scene.box_of(track, frame)
            if line == NOBODY or not same_answer(viewpoint(self.scene, line, frame), stored):
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


def start_of(scene: Scene, segment: int) -> FrameViewpoint:
    """The start of a stable segment, by its row: the frame asked for, and where the person is seen at the first one."""
    row = {name: scene.segments[name][segment].as_py() for name in ("track", "start", "first")}
    return viewpoint(scene, scene.box_of(row["track"], row["first"]), row["start"])


def viewpoint(scene: Scene, line: int, frame: int) -> FrameViewpoint:
    """A frame, and the angle at which a row of `boxes` is seen, as an answer."""
    return FrameViewpoint(frame, float(scene.geometry["angle"][line]))
