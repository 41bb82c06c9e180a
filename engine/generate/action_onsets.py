"""When and where people start actions: what action_search reads, here of people other than its target."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pyarrow as pa

from jrdb_avr.engine.generate.conditions import FALSE, TRUE, UNSURE
from jrdb_avr.engine.generate.scene import NOBODY, Scene
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP


class ActionOnsets:
    """Starts and states of a scene's actions, by person."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._spans: dict[tuple[int, str], list[tuple[int, int, bool]]] = defaultdict(list)
        for track, action, *span in _rows(scene.actions, "first", "last", "certain"):
            self._spans[track, action].append((span[0], span[1], span[2]))
        self._segments: dict[tuple[int, str], list[tuple[int, int, int]]] = defaultdict(list)
        for track, action, *times in _rows(scene.segments, "start", "quiet_from", "first"):
            self._segments[track, action].append((times[0], times[1], times[2]))

    def start(self, track: int, action: str, after: int) -> FrameViewpoint | None:
        """The first start after a frame at which the action is false, if it is certain."""
        for frame, quiet_from, first in self._segments[track, action]:
            if frame > after and quiet_from <= after:
                return viewpoint(self.scene, self.scene.box_of(track, first), frame)
        return None

    def could_start(self, track: int, action: str, stored: FrameViewpoint) -> bool:
        """Whether the person could be seen to start the action so near to `stored` that it would score.

        A start lies after the frame before the first one with the action, as the layer counts them, and not after it.
        """
        latest = stored.frame + KEYFRAME_STEP + self.scene.action_step - 1
        for frame in range(stored.frame - KEYFRAME_STEP, latest + 1):
            line = self.scene.box_of(track, frame)
            if line == NOBODY or not same_answer(viewpoint(self.scene, line, stored.frame), stored):
                continue
            before = self.state(track, action, frame - KEYFRAME_STEP)
            if self.state(track, action, frame) != FALSE and before != TRUE:
                return True
        return False

    def state(self, track: int, action: str, frame: int) -> int:
        """Whether the person performs the action at a frame; not sure without a box."""
        line = self.scene.box_of(track, frame)
        if line == NOBODY:
            return UNSURE
        covering = [certain for first, last, certain in self._spans[track, action] if first <= frame <= last]
        if action in POSES:
            pose = int(self.scene.poses[line])
            if pose == NOBODY or (not all(covering) and POSES[pose] != action):
                return UNSURE
            return TRUE if POSES[pose] == action else FALSE
        if any(covering):
            return TRUE
        return UNSURE if covering or not self.scene.listed[line] else FALSE

    def possible_poses(self, track: int, frame: int) -> set[str]:
        """The poses that labels leave open at a frame: doubtful labels, words that others may use, and closed gaps."""
        spans = {pose: self._spans.get((track, pose), []) for pose in POSES}
        return {pose for pose in POSES if any(a <= frame <= b and not certain for a, b, certain in spans[pose])}


def _rows(table: pa.Table, *columns: str) -> Iterator[tuple[Any, ...]]:
    return zip(*(table[name].to_pylist() for name in ("track", "action", *columns)), strict=True)


def start_of(scene: Scene, segment: int) -> FrameViewpoint:
    """The start of a stable segment, by its row: the stored frame, and where the person is seen at the first one."""
    row = {name: scene.segments[name][segment].as_py() for name in ("track", "start", "first")}
    return viewpoint(scene, scene.box_of(row["track"], row["first"]), row["start"])


def viewpoint(scene: Scene, line: int, frame: int) -> FrameViewpoint:
    """A frame, and the angle at which a row of `boxes` is seen, as an answer."""
    return FrameViewpoint(frame, float(scene.geometry["angle"][line]))
