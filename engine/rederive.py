"""The second path: what a stored plan answers, read from the per-frame annotation tables alone.

Nothing here is shared with the intervals of the loaders or the queries of generation: facts, closed gaps, clear views,
stable segments and uniqueness are worked out once more, person by person and frame by frame, from `annotations/`. A
question stands only if both paths find the same answer.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import FrameAnswer, Span, encode_answer
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, Box
from jrdb_avr.schema.plan import Condition, Plan
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.vocabulary import (
    CLEAR_OCCLUSIONS,
    DISTANCE_ANSWERS,
    DISTANCE_BOUNDS_M,
    DISTANCE_WORDS,
    POSES,
    PRESENCE_ANSWERS,
)

Result = Literal["defined", "ambiguous", "empty", "unknown"]

FALSE, TRUE, UNKNOWN = 0, 1, 2
"""Values of a fact."""

_SLACK: Final = 1e-9
"""Decimals such as 0.55 lie on the edge they name."""

States = npt.NDArray[np.int8]


@dataclass(frozen=True, slots=True)
class NeededBox:
    """A box that must be seen to answer; `decisive` boxes show the answer itself."""

    node: str
    track: int
    frame: int
    box: Box
    decisive: bool


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the second path finds.

    `answer` is a choice's text or another answer's stored JSON, None unless the outcome is "defined". `times` are the
    frames of the plan's times (an event's as asked for), `faults` the rules of the template that do not hold.
    """

    outcome: Result
    answer: str | None = None
    target: int | None = None
    times: tuple[tuple[str, int], ...] = ()
    needed: tuple[NeededBox, ...] = ()
    faults: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Segment:
    """A stable stretch of an action: the frames with it, and the start and end as asked for."""

    first: int
    last: int
    start: int
    end: int
    closed: bool


@dataclass(frozen=True, slots=True)
class _Person2D:
    """One 2D box with what its record says."""

    box: Box
    occlusion: str | None
    no_eval: bool
    listed: bool


class _Unknown(Exception):  # noqa: N818 - not an error: the plan's answer is one of these outcomes
    """The plan has no answer, for the reason given."""

    def __init__(self, outcome: Result, reason: str) -> None:
        super().__init__(reason)
        self.outcome: Result = outcome


class Annotations:
    """One sequence's annotation tables, indexed by frame and by person."""

    def __init__(self, tables: dict[str, pa.Table], rules: Rules) -> None:
        self.rules = rules
        self.layers: dict[str, list[int]] = defaultdict(list)
        for layer, frame in _rows(tables["frames"], "layer", "frame"):
            self.layers[layer].append(frame)
        self._known = {layer: set(numbers) for layer, numbers in self.layers.items()}
        self.has_attributes = any(tables["boxes_2d"]["has_attributes"].to_pylist())
        self._people: dict[int, dict[int, _Person2D]] = defaultdict(dict)
        columns = ("frame", "track", "x", "y", "w", "h", "occlusion", "no_eval", "has_actions")
        for frame, track, x, y, w, h, occlusion, no_eval, listed in _rows(tables["boxes_2d"], *columns):
            self._people[frame][track] = _Person2D(Box(x, y, w, h), occlusion, bool(no_eval), listed)
        self._actions: dict[tuple[int, int], dict[str, int]] = defaultdict(dict)
        self._performed: set[tuple[int, str]] = set()
        for frame, track, action, difficulty in _rows(tables["actions"], "frame", "track", "action", "difficulty"):
            # An action written twice, as under two spellings, counts by its easier code; an unreadable code is hard.
            code, listed_actions = 3 if difficulty is None else difficulty, self._actions[frame, track]
            listed_actions[action] = min(code, listed_actions.get(action, code))
            self._performed.add((track, action))
        self._groups: dict[tuple[int, int], tuple[int, bool]] = {}
        for frame, track, cluster, difficulty in _rows(tables["groups"], "frame", "track", "cluster", "difficulty"):
            self._groups[frame, track] = (cluster, difficulty in (1, 2))
        self._distances: dict[tuple[int, int], float] = {}
        columns_3d = ("frame", "track", "cx", "cy", "distance", "num_points")
        for frame, track, cx, cy, distance, points in _rows(tables["boxes_3d"], *columns_3d):
            if points:
                self._distances[frame, track] = math.hypot(cx, cy) if distance is None else distance
        self._tracks: dict[int, list[int]] = defaultdict(list)
        for frame in sorted(self._people):
            for track in self._people[frame]:
                self._tracks[track].append(frame)
        annotated = sorted(self.layers.get("actions", []))
        self.step = _step(annotated)
        self.grid = range(annotated[0], annotated[-1] + 1, self.step) if annotated else range(0)
        self.keyframes = self._find_keyframes()
        self._states: dict[tuple[int, str], tuple[States, States]] = {}
        self._segments: dict[tuple[int, str], tuple[Segment, ...]] = {}

    @classmethod
    def read(cls, store: Store, sequence: str, rules: Rules) -> Annotations:
        """Read a sequence's tables; a layer that it lacks is empty. Raises StoreError for a broken file."""
        layers = ("frames", "boxes_2d", "actions", "groups", "boxes_3d")
        tables = {}
        for layer in layers:
            there = store.annotation_path(layer, sequence).exists()
            tables[layer] = store.annotation(layer, sequence) if there else ANNOTATIONS[layer].empty_table()
        return cls(tables, rules)

    def _find_keyframes(self) -> frozenset[int]:
        leading = next((layer for layer in ("actions", "2d", "3d") if self.layers.get(layer)), "")
        numbers = sorted(self.layers.get(leading, []))
        if numbers and _step(numbers) == 1:
            numbers = [f for f in range(numbers[0], numbers[-1] + 1) if f % KEYFRAME_STEP == 0]
        # Boxes in a frame that the 2D layer does not list: somebody else there could not be read.
        return frozenset(f for f in numbers if f in self._known.get("2d", set()) or not self._people.get(f))

    # -- a person at a frame --------------------------------------------------------------------------------------

    def boxes(self, track: int) -> dict[int, Box]:
        """Every 2D box of a person by frame."""
        return {frame: self._people[frame][track].box for frame in self._tracks.get(track, [])}

    def box(self, track: int, frame: int) -> Box | None:
        """The person's 2D box, if any."""
        person = self._people.get(frame, {}).get(track)
        return None if person is None else person.box

    def people(self, frame: int) -> list[int]:
        """Everybody with a 2D box at the frame."""
        return sorted(self._people.get(frame, {}))

    def clear(self, track: int, frame: int) -> bool:
        """Whether the person is in clear view."""
        person = self._people.get(frame, {}).get(track)
        if person is None or person.no_eval:
            return False
        if self.has_attributes and person.occlusion not in CLEAR_OCCLUSIONS:
            return False
        load, box = self.rules.load, person.box
        fits = load.clear_min_width <= box.w <= load.clear_max_width and box.h >= load.clear_min_height
        return fits and box.y >= 0 and box.y + box.h <= HEIGHT

    def absent(self, track: int, frame: int) -> bool:
        """Whether the person is certainly not there."""
        near = (frame - KEYFRAME_STEP, frame, frame + KEYFRAME_STEP)
        return all(f in self._known.get("2d", set()) and self.box(track, f) is None for f in near)

    def pose(self, track: int, frame: int) -> str | None:
        """The one certain pose, None where it is unknown."""
        poses = [(action, code) for action, code in self._actions.get((frame, track), {}).items() if action in POSES]
        if self.box(track, frame) is None or len(poses) != 1 or poses[0][1] > 2:
            return None
        return poses[0][0]

    def distance(self, track: int, frame: int) -> float | None:
        """Metres from the robot where the person has a 2D box, and a 3D box with lidar points."""
        return self._distances.get((frame, track)) if self.box(track, frame) is not None else None

    # -- actions over time ----------------------------------------------------------------------------------------

    def _raw(self, track: int, frame: int, action: str) -> int:
        person = self._people.get(frame, {}).get(track)
        if person is None or not person.listed:
            return UNKNOWN
        codes = self._actions.get((frame, track), {})
        if action in POSES:
            pose = self.pose(track, frame)
            return UNKNOWN if pose is None else TRUE if pose == action else FALSE
        return FALSE if action not in codes else TRUE if codes[action] <= 2 else UNKNOWN

    def states(self, track: int, action: str) -> tuple[States, States]:
        """Per frame of the action layer's grid: the fact, and 1 inside a closed gap (where the fact is unknown)."""
        key = (track, action)
        if key not in self._states:
            self._states[key] = self._work_out(track, action)
        return self._states[key]

    def _work_out(self, track: int, action: str) -> tuple[States, States]:
        states = np.full(len(self.grid), UNKNOWN, np.int8)
        gaps = np.zeros(len(self.grid), np.int8)
        named = []
        for frame in self._tracks.get(track, []):
            if frame in self.grid:
                place = self.grid.index(frame)
                states[place] = self._raw(track, frame, action)
                if action in self._actions.get((frame, track), {}):
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
        # Most facts are asked for at one frame only: working out all of the person's frames would take far longer.
        return UNKNOWN if self._in_gap(track, action, frame) else self._raw(track, frame, action)

    def _in_gap(self, track: int, action: str, frame: int) -> bool:
        """Whether a frame that does not name the action lies in a closed gap of it."""
        longest = self.rules.load.gap_frames
        if self.step != 1 or (track, action) not in self._performed or self._names(track, action, frame):
            return False
        before = next((d for d in range(1, longest + 1) if self._names(track, action, frame - d)), None)
        if before is None:
            return False
        return any(self._names(track, action, frame + d) for d in range(1, longest + 2 - before))

    def _names(self, track: int, action: str, frame: int) -> bool:
        """Whether the person has a box at the frame, one of the grid, whose list holds the action."""
        listed = action in self._actions.get((frame, track), {})
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

        place = 0
        while place < len(self.grid):
            if not inside(place):
                place += 1
                continue
            begin = place
            while place < len(self.grid) and inside(place):
                place += 1
            first, last = self.grid[begin], self.grid[place - 1]
            if last - first < least or not edge_at(first - edge, first - 1):
                continue
            if quiet_at(first - quiet, first - 1) and quiet_at(last + 1, last + quiet):
                yield Segment(first, last, first - half, last + half, edge_at(last + 1, last + edge))

    # -- conditions -----------------------------------------------------------------------------------------------

    def holds(self, condition: Condition, track: int, frame: int) -> int:
        """A condition of a description, of a person with a box at the frame."""
        if condition.action is not None:
            return self.state(track, condition.action, frame)
        match condition.attribute, condition.value:
            case "group_size", int(wanted):
                size = self.group_size(track, frame)
                return UNKNOWN if size is None else int(size == wanted)
            case "sector", str(wanted):
                return _among(wanted, self._sectors(track, frame))
            case "distance", str(wanted):
                return _among(wanted, self._distance_words(track, frame))
        # Gender, age, objects and interactions come from layers that these tables do not hold.
        return UNKNOWN

    def group_size(self, track: int, frame: int) -> int | None:
        """People in the person's group, oneself included; None where a membership that matters is unknown."""
        own = self._groups.get((frame, track))
        if own is None or frame not in self._known.get("2d", set()):
            return None
        rows = [self._groups.get((frame, other)) for other in self.people(frame)]
        if None in rows:
            return None
        members = [row for row in rows if row is not None and row[0] == own[0]]
        return len(members) if all(certain for _, certain in members) else None

    def _sectors(self, track: int, frame: int) -> list[str]:
        """The sectors that the person could be in: two near an edge."""
        box = self._people[frame][track].box
        angle = (box.x + box.w / 2) / WIDTH * 360
        found = []
        for word, center in (("ahead", 180.0), ("left", 90.0), ("behind", 0.0), ("right", 270.0)):
            away = abs((angle - center + 180) % 360 - 180)
            if away <= 45 + self.rules.load.sector_margin_deg + _SLACK:
                found.append(word)
        return found

    def _distance_words(self, track: int, frame: int) -> list[str]:
        metres = self.distance(track, frame)
        if metres is None:
            return list(DISTANCE_WORDS)
        margin = self.rules.load.distance_margin
        found = []
        for i, word in enumerate(DISTANCE_WORDS):
            low = DISTANCE_BOUNDS_M[i - 1] * (1 - margin) - _SLACK if i else -math.inf
            high = DISTANCE_BOUNDS_M[i] * (1 + margin) + _SLACK if i < len(DISTANCE_BOUNDS_M) else math.inf
            if low <= metres <= high:
                found.append(word)
        return found

    def find(self, conditions: tuple[Condition, ...], frame: int) -> tuple[Result, int | None]:
        """The one person of a description at a frame; `ambiguous`, `empty` or `unknown` where it is not one."""
        if frame not in self._known.get("2d", set()):
            return "unknown", None
        values: dict[int, list[int]] = {
            track: [self.holds(condition, track, frame) for condition in conditions] for track in self.people(frame)
        }
        could = [track for track, held in values.items() if FALSE not in held]
        does = [track for track in could if UNKNOWN not in values[track]]
        if len(does) > 1:
            return "ambiguous", None
        if not could:
            return "empty", None
        return ("defined", does[0]) if could == does else ("unknown", None)

    def has_image(self, frame: int) -> bool:
        """Whether the frame can be looked at; where the sequence has no image at all, nothing is asked of it."""
        return "images" not in self._known or frame in self._known["images"]


def _rows(table: pa.Table, *names: str) -> Iterator[tuple[Any, ...]]:
    return zip(*(table[name].to_pylist() for name in names), strict=True)


def _step(numbers: list[int]) -> int:
    """Frames between annotated frames: 15 where all lie whole seconds apart, else 1."""
    apart = math.gcd(*(b - a for a, b in itertools.pairwise(numbers)))
    return KEYFRAME_STEP if apart % KEYFRAME_STEP == 0 else 1


def _among(wanted: str, possible: list[str]) -> int:
    if wanted not in possible:
        return FALSE
    return TRUE if len(possible) == 1 else UNKNOWN


# -- plans --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Asked:
    """A plan with its person found. `faults` grows as rules of the template turn out not to hold."""

    annotations: Annotations
    plan: Plan
    target: int
    stated: dict[str, int]
    rules: Rules
    faults: list[str]

    def frame(self, position: int) -> int:
        """The stated frame at which the answer is read."""
        name = self.plan.asked()[position]
        if name not in self.stated:
            raise _Unknown("unknown", f"{name} is no stated time")
        return self.stated[name]

    def wait(self, before: int, after: int) -> None:
        """Note a fault where two times lie too near."""
        if after - before < frames(self.rules.min_wait_s):
            self.faults.append(f"frame {after} is less than {self.rules.min_wait_s:g} s after frame {before}")


_Reading = tuple[str, dict[str, int], list[int]]
"""The answer, the frames of the plan's events, and the frames whose boxes show the answer."""


def rederive(annotations: Annotations, plan: Plan, template: str, rules: Rules) -> Outcome:
    """What the plan answers, and which rules of its template do not hold.

    Plans with edges are not read: their outcome is unknown.
    """
    try:
        return _evaluate(annotations, plan, template, rules)
    except _Unknown as reason:
        return Outcome(reason.outcome, faults=(str(reason),))


def _evaluate(annotations: Annotations, plan: Plan, template: str, rules: Rules) -> Outcome:
    if plan.edges:
        raise _Unknown("unknown", "edges are not read")
    stated = {name: time.frame for name, time in plan.times.items() if time.frame is not None}
    root = next(node for node in plan.nodes if node.id == plan.root)
    if "t0" not in stated or any(condition.at not in (None, "t0") for condition in root.conditions):
        raise _Unknown("unknown", "the description does not hold at a stated time t0")
    t0 = stated["t0"]
    result, target = annotations.find(root.conditions, t0)
    if target is None:
        raise _Unknown(result, f"the description fits no one person for certain at frame {t0}")
    asked = _Asked(annotations, plan, target, stated, rules, [])
    _check_description(asked, root.conditions, template)
    read = _READERS.get(plan.answer.read)
    if read is None:
        raise _Unknown("unknown", f"the read {plan.answer.read!r} is not known")
    answer, events, shown = read(asked)
    looks = [(t0, not shown)] + [(frame, True) for frame in sorted(shown)]
    needed = []
    for frame, decisive in looks:
        box = annotations.box(target, frame)
        if box is None or not annotations.clear(target, frame):
            asked.faults.append(f"the person is not in clear view at frame {frame}")
        if not annotations.has_image(frame):
            asked.faults.append(f"frame {frame} has no image")
        if box is not None:
            needed.append(NeededBox(plan.target, target, frame, box, decisive))
    times = tuple(sorted((stated | events).items()))
    return Outcome("defined", answer, target, times, tuple(needed), tuple(asked.faults))


def _check_description(asked: _Asked, conditions: tuple[Condition, ...], template: str) -> None:
    annotations, t0 = asked.annotations, asked.stated["t0"]
    asked.faults.extend(
        f"frame {frame} is no keyframe" for frame in sorted(asked.stated.values()) if frame not in annotations.keyframes
    )
    for condition in conditions:
        rest = [other for other in conditions if other is not condition]
        could = [
            track
            for track in annotations.people(t0)
            if all(annotations.holds(other, track, t0) != FALSE for other in rest)
        ]
        if len(could) < 2:
            asked.faults.append("the description has a condition too many")
    if not 1 <= len(conditions) <= asked.rules.max_conditions:
        asked.faults.append(f"the description has {len(conditions)} conditions")
    if all(condition.attribute in ("sector", "distance") for condition in conditions[:1]) and len(conditions) == 1:
        asked.faults.append("a place alone is no description")
    if template == "change":
        if any(condition.action in POSES for condition in conditions):
            asked.faults.append("the description states a pose, which is what is asked")
        before, after = (annotations.pose(asked.target, frame) for frame in (t0, asked.frame(0)))
        if before is None or before == after:
            asked.faults.append("the pose at t0 is unknown, or the same as the answer")


def _read_action(asked: _Asked) -> _Reading:
    frame = asked.frame(0)
    asked.wait(asked.stated["t0"], frame)
    if asked.annotations.absent(asked.target, frame):
        raise _Unknown("empty", f"the person is absent at frame {frame}")
    pose = asked.annotations.pose(asked.target, frame)
    if pose is None:
        raise _Unknown("unknown", f"the pose at frame {frame} is unknown")
    return pose, {}, [frame]


def _read_presence(asked: _Asked) -> _Reading:
    first, second = asked.frame(0), asked.frame(1)
    asked.wait(asked.stated["t0"], first)
    asked.wait(first, second)
    present = [_present(asked, frame) for frame in (first, second)]
    place = {(True, True): 0, (True, False): 1, (False, True): 2, (False, False): 3}[present[0], present[1]]
    shown = [frame for frame, there in zip((first, second), present, strict=True) if there]
    return PRESENCE_ANSWERS[place], {}, shown


def _present(asked: _Asked, frame: int) -> bool:
    if asked.annotations.clear(asked.target, frame):
        return True
    if asked.annotations.absent(asked.target, frame):
        return False
    raise _Unknown("unknown", f"whether the person is present at frame {frame} is unknown")


def _read_distance(asked: _Asked) -> _Reading:
    before, after = asked.frame(0), asked.frame(1)
    asked.wait(before, after)
    start = asked.annotations.distance(asked.target, before)
    if start is None:
        raise _Unknown("unknown", f"the distance at frame {before} is unknown")
    if not _present(asked, after):
        return DISTANCE_ANSWERS[3], {}, []
    end = asked.annotations.distance(asked.target, after)
    if end is None:
        raise _Unknown("unknown", f"the distance at frame {after} is unknown")
    changed = end - start
    if changed <= -asked.rules.distance_changed_m:
        return DISTANCE_ANSWERS[0], {}, [after]
    if changed >= asked.rules.distance_changed_m:
        return DISTANCE_ANSWERS[1], {}, [after]
    if abs(changed) < asked.rules.distance_same_m:
        return DISTANCE_ANSWERS[2], {}, [after]
    raise _Unknown("unknown", f"the distance changes by {abs(changed):.2f} m, neither much nor little")


def _read_start(asked: _Asked) -> _Reading:
    name = asked.plan.asked()[0]
    segment = _first_segment(asked, name)
    return encode_answer(FrameAnswer(segment.start)), {name: segment.start}, [segment.first]


def _read_span(asked: _Asked) -> _Reading:
    start, end = asked.plan.asked()
    if asked.plan.times[end].after != start or asked.plan.times[end].action != asked.plan.times[start].action:
        raise _Unknown("unknown", "the span does not end what it starts")
    segment = _first_segment(asked, start)
    if not segment.closed:
        raise _Unknown("unknown", "when the action ends is unknown")
    answer = encode_answer(Span(segment.start, segment.end))
    return answer, {start: segment.start, end: segment.end}, [segment.first, segment.last]


def _first_segment(asked: _Asked, name: str) -> Segment:
    """The stable segment that begins when the action is first anything but false after the stated time."""
    event = asked.plan.times[name]
    if (
        event.event != "start"
        or event.of != asked.plan.target
        or event.action is None
        or event.after not in asked.stated
    ):
        raise _Unknown("unknown", f"{name} is no start of an action after a stated time")
    annotations, after, action = asked.annotations, asked.stated[event.after], event.action
    if annotations.state(asked.target, action, after) != FALSE:
        raise _Unknown("unknown", f"the action is not certainly absent at frame {after}")
    for frame in annotations.grid:
        if frame <= after or annotations.state(asked.target, action, frame) == FALSE:
            continue
        for segment in annotations.segments(asked.target, action):
            if segment.first == frame:
                asked.wait(after, segment.start)
                return segment
        raise _Unknown("unknown", f"what happens at frame {frame} is no clear start")
    raise _Unknown("empty", "the action does not start")


_READERS: Final[dict[str, Callable[[_Asked], _Reading]]] = {
    "action": _read_action,
    "presence": _read_presence,
    "distance_change": _read_distance,
    "start": _read_start,
    "span": _read_span,
}
