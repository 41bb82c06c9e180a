"""Actions over time: lists of labels, facts with closed gaps, and stable segments."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.engine.rederive.people import PersonBoxes
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, also_said, distinct_rows, in_closed_gap, rows, step_of
from jrdb_avr.schema.choice_labels import CALLED
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames

POSE_NAMES: Final = frozenset(POSES)
GridFacts = npt.NDArray[np.int8]


@dataclass(frozen=True, slots=True)
class Segment:
    """Stable segment of an action: one stretch of time with certain labels and clear edges.

    Attributes:
        first: First frame with the action.
        last: Last frame with the action.
        start: Start of the action as the answers of questions have it.
        end: End of the action as the answers of questions have it.
        closed: Whether the end is certain.
    """

    first: int
    last: int
    start: int
    end: int
    closed: bool


@dataclass(frozen=True, eq=False)
class ActionList:
    """Action labels of one person in one frame.

    Attributes:
        codes: Difficulty of each action. An action without a label has the code 3 if `also_said` of a label has it.
        written: Actions with a label.
        poses: Poses with a label.
    """

    codes: Mapping[str, int]
    written: frozenset[str]
    poses: frozenset[str]

    @cached_property
    def pose(self) -> str | None:
        """The only pose of the list, or None if it is not certain or not the only one."""
        if len(self.poses) != 1:
            return None
        (pose,) = self.poses
        return pose if self.codes[pose] <= 2 else None

    def with_action(self, action: str, difficulty: int | None) -> ActionList:
        """Return the list with one more label."""
        # The easier code counts, because an action may have two spellings in one list. An unreadable code is hard.
        code = 3 if difficulty is None else difficulty
        codes = {**self.codes, action: min(code, self.codes.get(action, code))}
        for wider in also_said(action):
            codes.setdefault(wider, 3)
        return ActionList(codes, self.written | {action}, self.poses | ({action} & POSE_NAMES))


EMPTY_LIST: Final = ActionList({}, frozenset(), frozenset())
"""List without labels."""


class ActionFacts(PersonBoxes):
    """Boxes of one sequence with the action labels.

    Attributes:
        step: Number of frames between annotated frames of the action layer.
        grid: Frames of the action layer from its first to its last annotated frame.
    """

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        # By track and frame. Equal lists share one object, because millions of lists have few distinct contents.
        self._actions: dict[int, dict[int, ActionList]] = defaultdict(dict)
        extended: dict[tuple[ActionList, str, int | None], ActionList] = {}
        actions = tables["actions"]
        for frame, track, action, difficulty in rows(actions, "frame", "track", "action", "difficulty"):
            lists = self._actions[track]
            key = lists.get(frame, EMPTY_LIST), action, difficulty
            if key not in extended:
                extended[key] = key[0].with_action(action, difficulty)
            lists[frame] = extended[key]
        self._performed = {
            (track, label)
            for track, action in distinct_rows(actions, "track", "action")
            for label in (action, *also_said(action))
        }
        annotated = sorted(self.layers.get("actions", []))
        self.step = step_of(annotated)
        self.grid = range(annotated[0], annotated[-1] + 1, self.step) if annotated else range(0)
        self._states: dict[tuple[int, str], tuple[GridFacts, GridFacts]] = {}
        self._segments: dict[tuple[int, str], tuple[Segment, ...]] = {}

    # -- labels of one frame --------------------------------------------------------------------------------------

    def _list(self, track: int, frame: int) -> ActionList:
        return self._actions.get(track, {}).get(frame, EMPTY_LIST)

    def _is_complete(self, track: int, frame: int) -> bool:
        """Return whether the person has a box, and the whole list of the person's actions was read."""
        person = self._people.get(frame, {}).get(track)
        return person is not None and person.listed

    def pose(self, track: int, frame: int) -> str | None:
        """Return the certain pose of the person. None if the pose is unknown or the person is covered."""
        certain = self._is_complete(track, frame) and not self.covered(track, frame)
        return self._list(track, frame).pose if certain else None

    def written(self, track: int, frame: int) -> frozenset[str]:
        """Return the actions with a label of any difficulty. Empty without a box."""
        return frozenset() if self.box(track, frame) is None else self._list(track, frame).written

    def certain(self, track: int, frame: int) -> frozenset[str]:
        """Return the actions that are certain by the labels alone, whatever the view.

        A pose is certain only if the list is complete and has no other pose.
        """
        labels = self._list(track, frame)
        pose = labels.pose if self._is_complete(track, frame) else None
        easy = {action for action in self.written(track, frame) if labels.codes[action] <= 2}
        return frozenset(action for action in easy if action == pose or action not in POSE_NAMES)

    def performs(self, track: int, action: str, frame: int) -> int:
        """Return whether the person performs an action, by the rules of choices and proofs.

        Only the labels of this frame count. The action is false only if the list is complete and has no label that
        overlaps the action in meaning (`CALLED`). A pose is false only beside one certain pose. For a covered person,
        every action is unknown.
        """
        if self.box(track, frame) is None or self.covered(track, frame):
            return UNKNOWN
        if action in self.certain(track, frame):
            return TRUE
        labels = self._list(track, frame)
        callable_so = any(label == action or action in CALLED.get(label, ()) for label in labels.written)
        if callable_so or not self._is_complete(track, frame) or (action in POSE_NAMES and labels.pose is None):
            return UNKNOWN
        return FALSE

    @cached_property
    def shown_actions(self) -> frozenset[str]:
        """Actions that are certain for a person in clear view at a keyframe."""
        shown: set[str] = set()
        for track, lists in self._actions.items():
            for frame in self.keyframes & lists.keys():
                new = self.certain(track, frame) - shown
                if new and self.clear(track, frame):
                    shown |= new
        return frozenset(shown)

    # -- facts with closed gaps -----------------------------------------------------------------------------------

    def _state_by_labels(self, track: int, frame: int, action: str) -> int:
        """Return the fact by the labels of the frame alone, without closed gaps."""
        if self.box(track, frame) is None:
            return UNKNOWN
        labels, complete = self._list(track, frame), self._is_complete(track, frame)
        if action in labels.codes:
            certain = labels.codes[action] <= 2 and (action not in POSES or (complete and labels.pose == action))
            return TRUE if certain and not self.covered(track, frame) else UNKNOWN
        return FALSE if complete and (action not in POSES or labels.pose is not None) else UNKNOWN

    def states(self, track: int, action: str) -> tuple[GridFacts, GridFacts]:
        """Compute an action of a person over time.

        Args:
            track: Track of the person.
            action: Action.

        Returns:
            Two arrays over the frames of `grid`: the fact, and 1 inside a closed gap, where the fact is unknown.
        """
        key = (track, action)
        if key not in self._states:
            self._states[key] = self._compute_states(track, action)
        return self._states[key]

    def _compute_states(self, track: int, action: str) -> tuple[GridFacts, GridFacts]:
        states = np.full(len(self.grid), UNKNOWN, np.int8)
        gaps = np.zeros(len(self.grid), np.int8)
        labelled = []
        for frame in self._tracks.get(track, []):
            if frame in self.grid:
                index = self.grid.index(frame)
                states[index] = self._state_by_labels(track, frame, action)
                if action in self._list(track, frame).codes:
                    labelled.append(index)
        if self.step == 1:
            for before, after in itertools.pairwise(labelled):
                if 0 < after - before - 1 <= self.rules.load.gap_frames:
                    states[before + 1 : after] = UNKNOWN
                    gaps[before + 1 : after] = 1
        return states, gaps

    def state(self, track: int, action: str, frame: int) -> int:
        """Return the fact at a frame. It is unknown in frames that are not in `grid`."""
        if frame not in self.grid:
            return UNKNOWN
        if (track, action) in self._states:
            return int(self._states[track, action][0][self.grid.index(frame)])
        # Because most facts are needed at one frame only, and computing all frames takes far longer.
        return UNKNOWN if self._in_gap(track, action, frame) else self._state_by_labels(track, frame, action)

    def _in_gap(self, track: int, action: str, frame: int) -> bool:
        """Return whether a frame without the action is in a closed gap of it."""
        longest = self.rules.load.gap_frames
        if self.step != 1 or (track, action) not in self._performed or self._has_label(track, action, frame):
            return False
        return in_closed_gap(lambda near: self._has_label(track, action, near), frame, longest)

    def _has_label(self, track: int, action: str, frame: int) -> bool:
        """Return whether the person has a box at a frame of `grid`, with a list that has the action."""
        labelled = action in self._list(track, frame).codes
        return labelled and frame in self.grid and self.box(track, frame) is not None

    # -- segments -------------------------------------------------------------------------------------------------

    def segments(self, track: int, action: str) -> tuple[Segment, ...]:
        """Return the stable segments of an action, in order of time."""
        key = (track, action)
        if key not in self._segments:
            self._segments[key] = tuple(self._find_segments(track, action))
        return self._segments[key]

    def _find_segments(self, track: int, action: str) -> Iterator[Segment]:
        load, (states, gaps) = self.rules.load, self.states(track, action)
        least, edge, quiet = (frames(s) for s in (load.segment_min_s, load.segment_edge_s, load.segment_quiet_s))
        half = 0 if self.step == 1 else KEYFRAME_STEP // 2

        def is_false(frame: int) -> bool:
            return bool(states[self.grid.index(frame)] == FALSE)

        def is_inside(index: int) -> bool:
            return bool(gaps[index]) or (states[index] == TRUE and self.clear(track, self.grid[index]))

        def is_quiet(low: int, high: int) -> bool:
            """Return whether the action is false at every frame of `grid` in [low, high]."""
            return all(is_false(f) for f in range(low, high + 1) if f in self.grid)

        def is_edge(low: int, high: int) -> bool:
            """Return whether all frames of the grid's step in [low, high] exist, clear and without the action."""
            steps = [f for f in range(low, high + 1) if (f - self.grid.start) % self.step == 0]
            return all(f in self.grid and is_false(f) and self.clear(track, f) for f in steps)

        for held, run in itertools.groupby(range(len(self.grid)), is_inside):
            indexes = list(run)
            first, last = self.grid[indexes[0]], self.grid[indexes[-1]]
            if not held or last - first < least or not is_edge(first - edge, first - 1):
                continue
            if is_quiet(first - quiet, first - 1) and is_quiet(last + 1, last + quiet):
                yield Segment(first, last, first - half, last + half, is_edge(last + 1, last + edge))
