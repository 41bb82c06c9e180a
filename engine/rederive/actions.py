"""Actions over time: poses, actions with closed gaps, and stable segments."""

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
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames

POSE_NAMES: Final = frozenset(POSES)
GridFacts = npt.NDArray[np.int8]


@dataclass(frozen=True, slots=True)
class Segment:
    """A stable stretch of an action: the frames with it, and the start and end that a question means."""

    first: int
    last: int
    start: int
    end: int
    closed: bool


@dataclass(frozen=True, eq=False)
class Listed:
    """The list of actions of one person at one frame: their codes, which are written, and which are poses."""

    codes: Mapping[str, int]
    written: frozenset[str]
    poses: frozenset[str]

    @cached_property
    def pose(self) -> str | None:
        """The one certain pose, None where there is none."""
        if len(self.poses) != 1:
            return None
        (pose,) = self.poses
        return pose if self.codes[pose] <= 2 else None

    def with_action(self, action: str, difficulty: int | None) -> Listed:
        """The list with one more row."""
        # An action written twice, as under two spellings, counts by its easier code; an unreadable code is hard.
        code = 3 if difficulty is None else difficulty
        codes = {**self.codes, action: min(code, self.codes.get(action, code))}
        for other in also_said(action):
            codes.setdefault(other, 3)
        return Listed(codes, self.written | {action}, self.poses | ({action} & POSE_NAMES))


NOTHING: Final = Listed({}, frozenset(), frozenset())
"""The list that names no action."""


class ActionFacts(PersonBoxes):
    """The action labels of one sequence, in addition to its boxes."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        # By track and frame. Lists with the same rows are one object: there are millions of few different ones.
        self._actions: dict[int, dict[int, Listed]] = defaultdict(dict)
        extended: dict[tuple[Listed, str, int | None], Listed] = {}
        actions = tables["actions"]
        for frame, track, action, difficulty in rows(actions, "frame", "track", "action", "difficulty"):
            listed_actions = self._actions[track]
            key = listed_actions.get(frame, NOTHING), action, difficulty
            if key not in extended:
                extended[key] = key[0].with_action(action, difficulty)
            listed_actions[frame] = extended[key]
        self._performed = {
            (track, said)
            for track, action in distinct_rows(actions, "track", "action")
            for said in (action, *also_said(action))
        }
        annotated = sorted(self.layers.get("actions", []))
        self.step = step_of(annotated)
        self.grid = range(annotated[0], annotated[-1] + 1, self.step) if annotated else range(0)
        self._states: dict[tuple[int, str], tuple[GridFacts, GridFacts]] = {}
        self._segments: dict[tuple[int, str], tuple[Segment, ...]] = {}

    def pose(self, track: int, frame: int) -> str | None:
        """The one certain pose, None where it is unknown, as it is of covered people."""
        person = self._people.get(frame, {}).get(track)
        told = person is not None and person.listed and not self.covered(track, frame)
        return self._listed_actions(track, frame).pose if told else None

    def _listed_actions(self, track: int, frame: int) -> Listed:
        return self._actions.get(track, {}).get(frame, NOTHING)

    def _raw(self, track: int, frame: int, action: str) -> int:
        person = self._people.get(frame, {}).get(track)
        if person is None:
            return UNKNOWN
        listed = self._listed_actions(track, frame)
        if action in listed.codes:
            certain = listed.codes[action] <= 2 and (action not in POSES or (person.listed and listed.pose == action))
            return TRUE if certain and not self.covered(track, frame) else UNKNOWN
        told = person.listed and (action not in POSES or listed.pose is not None)
        return FALSE if told else UNKNOWN

    def states(self, track: int, action: str) -> tuple[GridFacts, GridFacts]:
        """Per frame of the action layer's grid: the fact, and 1 inside a closed gap (where the fact is unknown)."""
        key = (track, action)
        if key not in self._states:
            self._states[key] = self._compute_states(track, action)
        return self._states[key]

    def _compute_states(self, track: int, action: str) -> tuple[GridFacts, GridFacts]:
        states = np.full(len(self.grid), UNKNOWN, np.int8)
        gaps = np.zeros(len(self.grid), np.int8)
        named = []
        for frame in self._tracks.get(track, []):
            if frame in self.grid:
                place = self.grid.index(frame)
                states[place] = self._raw(track, frame, action)
                if action in self._listed_actions(track, frame).codes:
                    named.append(place)
        if self.step == 1:
            for before, after in itertools.pairwise(named):
                if 0 < after - before - 1 <= self.rules.load.gap_frames:
                    states[before + 1 : after] = UNKNOWN
                    gaps[before + 1 : after] = 1
        return states, gaps

    def state(self, track: int, action: str, frame: int) -> int:
        """The fact at a frame; unknown off the action layer's grid."""
        if frame not in self.grid:
            return UNKNOWN
        if (track, action) in self._states:
            return int(self._states[track, action][0][self.grid.index(frame)])
        # Most facts are needed at one frame only: computing all of the person's frames would take far longer.
        return UNKNOWN if self._in_gap(track, action, frame) else self._raw(track, frame, action)

    def _in_gap(self, track: int, action: str, frame: int) -> bool:
        """Whether a frame that does not name the action lies in a closed gap of it."""
        longest = self.rules.load.gap_frames
        if self.step != 1 or (track, action) not in self._performed or self._names(track, action, frame):
            return False
        return in_closed_gap(lambda near: self._names(track, action, near), frame, longest)

    def writes(self, track: int, action: str, frame: int) -> bool:
        """Return whether the action itself is in the person's list at the frame, whatever its difficulty."""
        return action in self._listed_actions(track, frame).written

    def _names(self, track: int, action: str, frame: int) -> bool:
        """Whether the person has a box at the frame, one of the grid, whose list holds the action."""
        listed = action in self._listed_actions(track, frame).codes
        return listed and frame in self.grid and self.box(track, frame) is not None

    def segments(self, track: int, action: str) -> tuple[Segment, ...]:
        """The stable segments of an action, in time."""
        key = (track, action)
        if key not in self._segments:
            self._segments[key] = tuple(self._find_segments(track, action))
        return self._segments[key]

    def _find_segments(self, track: int, action: str) -> Iterator[Segment]:
        load, (states, gaps) = self.rules.load, self.states(track, action)
        least, edge, quiet = (frames(s) for s in (load.segment_min_s, load.segment_edge_s, load.segment_quiet_s))
        half = 0 if self.step == 1 else KEYFRAME_STEP // 2

        def false(frame: int) -> bool:
            return bool(states[self.grid.index(frame)] == FALSE)

        def inside(place: int) -> bool:
            return bool(gaps[place]) or (states[place] == TRUE and self.clear(track, self.grid[place]))

        def quiet_at(low: int, high: int) -> bool:
            """False at every grid frame in [low, high]; what lies beyond the grid does not count."""
            return all(false(f) for f in range(low, high + 1) if f in self.grid)

        def edge_at(low: int, high: int) -> bool:
            """False and clear at every grid frame in [low, high], all of which exist."""
            steps = [f for f in range(low, high + 1) if (f - self.grid.start) % self.step == 0]
            return all(f in self.grid and false(f) and self.clear(track, f) for f in steps)

        for held, run in itertools.groupby(range(len(self.grid)), inside):
            places = list(run)
            first, last = self.grid[places[0]], self.grid[places[-1]]
            if not held or last - first < least or not edge_at(first - edge, first - 1):
                continue
            if quiet_at(first - quiet, first - 1) and quiet_at(last + 1, last + quiet):
                yield Segment(first, last, first - half, last + half, edge_at(last + 1, last + edge))
