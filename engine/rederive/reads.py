"""Read the answer of a plan: at stated times (posture, presence, distance, count) and at events (starts, absences).

Each `read_<read>` finds the answer of the plans with that read.
"""

from __future__ import annotations

from dataclasses import dataclass

from jrdb_avr.engine.rederive.actions import Segment
from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.plan import ResolvedPlan
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, Undefined
from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Number, Span, encode_answer
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Time
from jrdb_avr.schema.questions import NeededBox
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, frames
from jrdb_avr.schema.wording.text import stated_actions


@dataclass(frozen=True, slots=True)
class Reading:
    """An answer and what shows it.

    events: frames of the plan's events; decisive: frames in which the target's box shows the answer; more:
    boxes of others that must be seen.
    """

    answer: str
    events: dict[str, int]
    decisive: list[int]
    more: tuple[NeededBox, ...] = ()


def reading_of(found: ResolvedPlan) -> Reading:
    """Read the answer of a plan whose people are found. Raises Undefined where there is none."""
    reading: Reading = globals()[f"read_{found.plan.answer.read}"](found)
    return reading


def read_action(found: ResolvedPlan) -> Reading:
    """The pose at one time; at a later one it differs from that at the description's."""
    frame, rules = found.frame(0), found.rules
    if found.plan.answer.times[0] != found.described:
        found.wait(found.t0, frame, rules.long_wait_s if found.template == "later_action" else rules.min_wait_s)
    if found.annotations.absent(found.target, frame):
        raise Undefined("empty", f"the person is absent at frame {frame}")
    pose = found.annotations.pose(found.target, frame)
    if pose is None:
        raise Undefined("unknown", f"the pose at frame {frame} is unknown")
    found.check(pose not in stated_actions(found.plan), "the question's own words name the answer")
    if frame != found.t0:
        before = found.annotations.pose(found.target, found.t0)
        found.check(before not in (None, pose), "the pose at t0 is unknown, or the same as the answer")
    return Reading(pose, {}, [frame])


def read_presence(found: ResolvedPlan) -> Reading:
    """Whether the person is there at two times."""
    first, second = found.frame(0), found.frame(1)
    found.wait(found.t0, first, found.rules.min_wait_s)
    found.wait(first, second, found.rules.min_wait_s)
    present = [_present(found, frame) for frame in (first, second)]
    decisive = [frame for frame, there in zip((first, second), present, strict=True) if there]
    return Reading(PRESENCE_ANSWERS[3 - 2 * present[0] - present[1]], {}, decisive)


def _present(found: ResolvedPlan, frame: int) -> bool:
    if found.annotations.clear(found.target, frame):
        return True
    if found.annotations.absent(found.target, frame):
        return False
    raise Undefined("unknown", f"whether the person is present at frame {frame} is unknown")


def read_distance_change(found: ResolvedPlan) -> Reading:
    """How the distance from the robot changes between two times."""
    before, after = found.frame(0), found.frame(1)
    found.wait(before, after, found.rules.min_wait_s)
    start = found.annotations.distance(found.target, before)
    if start is None:
        raise Undefined("unknown", f"the distance at frame {before} is unknown")
    if not _present(found, after):
        return Reading(DISTANCE_ANSWERS[3], {}, [])
    end = found.annotations.distance(found.target, after)
    if end is None:
        raise Undefined("unknown", f"the distance at frame {after} is unknown")
    changed = end - start
    if abs(changed) >= found.rules.distance_changed_m:
        return Reading(DISTANCE_ANSWERS[0 if changed < 0 else 1], {}, [after])
    if abs(changed) < found.rules.distance_same_m:
        return Reading(DISTANCE_ANSWERS[2], {}, [after])
    raise Undefined("unknown", f"the distance changes by {abs(changed):.2f} m, neither much nor little")


def read_count(found: ResolvedPlan) -> Reading:
    """How many different people are in a relation with the target at any frame of a stretch of time.

    The stretch is known where the target's own labels tell of the relation at each of its keyframes, and nobody could
    be in it who is not for certain at another frame.
    """
    annotations, target = found.annotations, found.target
    first, last, relation = found.frame(0), found.frame(1), found.plan.answer.relation or ""
    found.wait(first, last, found.rules.long_wait_s)
    sized = any(condition.attribute == "group_size" for node in found.plan.nodes for condition in node.conditions)
    found.check(relation != SAME_GROUP or not sized, "the question's own words tell how large the group is")
    could: set[int] = set()
    does: dict[int, list[int]] = {}
    for frame in range(first, last + 1):
        if annotations.box(target, frame) is None:
            if frame in annotations.keyframes:
                raise Undefined("unknown", f"the person is not there at frame {frame}")
            continue
        for other in annotations.people(frame):
            fact = FALSE if other == target else _counts(annotations, relation, target, other, frame)
            if fact != FALSE:
                could.add(other)
            if fact == TRUE:
                does.setdefault(other, []).append(frame)
    if could - does.keys():
        raise Undefined("unknown", f"whether {min(could - does.keys())} is to be counted is unknown")
    found.check(len(does) >= found.rules.count_min, f"only {len(does)} people are to be counted")
    return Reading(encode_answer(Number(float(len(does)))), {}, [first], _counted(found, does))


def _counts(annotations: Annotations, relation: str, target: int, other: int, frame: int) -> int:
    """Return whether a person is in a relation with the target in clear view: unknown if one of both is not clear."""
    fact = annotations.related(relation, target, other, frame)
    if fact == FALSE or not annotations.judges_views:
        return fact
    if annotations.covered(other, frame):
        return FALSE
    return fact if annotations.clear(other, frame) and annotations.clear(target, frame) else UNKNOWN


def _counted(found: ResolvedPlan, does: dict[int, list[int]]) -> tuple[NeededBox, ...]:
    """Everybody counted, by track, at the first keyframe at which both can be seen, and the target there too."""
    annotations, target = found.annotations, found.target
    needed: list[NeededBox] = []
    looks: set[int] = set()
    for number, track in enumerate(sorted(does), start=1):
        seen = (
            frame
            for frame in does[track]
            if frame in annotations.keyframes and annotations.clear(track, frame) and annotations.clear(target, frame)
        )
        frame = next(seen, None)
        box = None if frame is None else annotations.box(track, frame)
        if frame is None or box is None:
            found.faults.append(f"person {track}, who is counted, is never in clear view together with the target")
            continue
        needed.append(NeededBox(f"b{number}", track, frame, *box, False))
        looks.add(frame)
    for frame in sorted(looks - {found.t0}):
        box = annotations.box(target, frame)
        if box is not None:
            needed.append(NeededBox(found.plan.target, target, frame, *box, False))
    return tuple(needed)


def read_start(found: ResolvedPlan) -> Reading:
    """When an action starts."""
    name = found.plan.answer.times[0]
    segment = _first_segment(found, name)
    found.wait(found.t0, segment.start, found.rules.min_wait_s)
    return Reading(encode_answer(FrameAnswer(segment.start)), {name: segment.start}, [segment.first])


def read_span(found: ResolvedPlan) -> Reading:
    """From when to when an action lasts."""
    start, end = found.plan.answer.times
    if found.plan.times[end].after != start or found.plan.times[end].action != found.plan.times[start].action:
        raise Undefined("unknown", "the span does not end what it starts")
    segment = _first_segment(found, start)
    found.wait(found.t0, segment.start, found.rules.min_wait_s)
    if not segment.closed:
        raise Undefined("unknown", "when the action ends is unknown")
    answer = encode_answer(Span(segment.start, segment.end))
    return Reading(answer, {start: segment.start, end: segment.end}, [segment.first, segment.last])


def read_start_view(found: ResolvedPlan) -> Reading:
    """When an action starts, and in which direction the person is seen then; another than at the description."""
    name, annotations = found.plan.answer.times[0], found.annotations
    segment = _first_segment(found, name)
    found.wait(found.t0, segment.start, found.rules.search_wait_s)
    if annotations.box(found.target, segment.first) is None:
        raise Undefined("unknown", f"the person has no box at frame {segment.first}")
    angle = annotations.angle(found.target, segment.first)
    turned = float(angle_error(angle, annotations.angle(found.target, found.t0)))
    found.check(turned > found.rules.turn_deg, f"the person has moved by no more than {found.rules.turn_deg:g} degrees")
    return Reading(encode_answer(FrameViewpoint(segment.start, angle)), {name: segment.start}, [segment.first])


def read_next_action(found: ResolvedPlan) -> Reading:
    """The pose that follows that of the description's time, held at every keyframe until then."""
    annotations, target, name = found.annotations, found.target, found.plan.answer.times[0]
    event = found.plan.times[name]
    if event.action is not None or event.after != found.described:
        raise Undefined("unknown", f"{name} is no end of the pose held at t0")
    held = annotations.pose(target, found.t0)
    if held is None:
        raise Undefined("unknown", f"the pose at frame {found.t0} is unknown")
    last = found.t0
    while annotations.pose(target, last + KEYFRAME_STEP) == held and last + KEYFRAME_STEP in annotations.keyframes:
        last += KEYFRAME_STEP
    following = last + KEYFRAME_STEP
    pose = annotations.pose(target, following) if following in annotations.keyframes else None
    if pose is None:
        raise Undefined("unknown", f"the pose at frame {following} is unknown")
    started = [s for s in annotations.segments(target, pose) if last < s.first <= following]
    if not started:
        raise Undefined("unknown", f"the pose at frame {following} is no clear start")
    found.wait(found.t0, last, found.rules.long_wait_s)
    return Reading(pose, {name: last}, [started[0].first])


def read_seconds_between(found: ResolvedPlan) -> Reading:
    """Seconds between the first starts of two actions, or those that the first absence lasts."""
    first, second = found.plan.answer.times
    if found.plan.times[first].event == "leaves":
        events = _absence(found, first, second)
        decisive = sorted(events.values())
    else:
        segments = [_first_segment(found, name) for name in (first, second)]
        found.check(segments[0].start < segments[1].start, "the two actions start in the other order")
        events = {first: segments[0].start, second: segments[1].start}
        decisive = [segment.first for segment in segments]
    found.wait(found.t0, events[first], found.rules.min_wait_s)
    apart = events[second] - events[first]
    found.check(apart >= frames(found.rules.gap_min_s), f"less than {found.rules.gap_min_s:g} s lie between the events")
    return Reading(encode_answer(Number(apart / FPS)), events, decisive)


def _absence(found: ResolvedPlan, leaves: str, returns: str) -> dict[str, int]:
    """The last frame before the first absence after t0, and the first one after it."""
    times, annotations, target = found.plan.times, found.annotations, found.target
    if times[returns] != Time(event="returns", of=found.plan.target, after=leaves):
        raise Undefined("unknown", f"{returns} does not end what begins at {leaves}")
    if times[leaves] != Time(event="leaves", of=found.plan.target, after=found.described):
        raise Undefined("unknown", f"{leaves} is no leaving after t0")
    later = [frame for frame in sorted(annotations.keyframes) if frame > found.t0]
    gone = next((frame for frame in later if annotations.absent(target, frame)), None)
    if gone is None:
        raise Undefined("empty", "the person is never absent")
    boxes = annotations.boxes(target)
    before = max(frame for frame in boxes if frame < gone)
    after = min((frame for frame in boxes if frame > gone), default=None)
    if after is None:
        raise Undefined("empty", "the person does not come back")
    unread = [frame for frame in annotations.frames_between(before, after) if not annotations.knows(frame)]
    if unread:
        raise Undefined("unknown", f"nobody labelled frame {unread[0]}")
    hidden = [frame for frame in later if frame <= before and not annotations.clear(target, frame)]
    if hidden:
        raise Undefined("unknown", f"whether the person is present at frame {hidden[0]} is unknown")
    return {leaves: before, returns: after}


def _first_segment(found: ResolvedPlan, name: str) -> Segment:
    """The stable segment that begins when the action is first anything but false after the description's time."""
    event, annotations, target = found.plan.times[name], found.annotations, found.target
    if event.event != "start" or event.of != found.plan.target or event.after != found.described:
        raise Undefined("unknown", f"{name} is no start of an action after a stated time")
    after, action = found.t0, event.action or ""
    if annotations.state(target, action, after) != FALSE:
        raise Undefined("unknown", f"the action is not certainly absent at frame {after}")
    # First, as it finds out the states of all frames together.
    segments = annotations.segments(target, action)
    for frame in annotations.grid:
        if frame <= after or annotations.state(target, action, frame) == FALSE:
            continue
        for segment in segments:
            if segment.first == frame:
                return segment
        raise Undefined("unknown", f"what happens at frame {frame} is no clear start")
    raise Undefined("empty", "the action does not start")
