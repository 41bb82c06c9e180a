"""Read the answer of a plan at stated times (action, presence, distance, count) or at events (starts, absences).

A function `read_<read>` reads the answer of a plan with that read. It raises Undefined if the plan has no answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from jrdb_avr.engine.rederive.actions import Segment
from jrdb_avr.engine.rederive.choices import check_choices, is_supported
from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.plan import ResolvedPlan
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, Undefined
from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Number, Span, encode_answer
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS, answer_of_choice
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Time
from jrdb_avr.schema.questions import NeededBox
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, frames


@dataclass(frozen=True, slots=True)
class Reading:
    """An answer with the frames and boxes that show it.

    Attributes:
        answer: An action or a fixed answer for a question with choices, else the stored JSON.
        events: Frames of the plan's events by name.
        decisive: Frames with a box of the target that shows the answer.
        more: Boxes of further people that must be seen.
    """

    answer: str
    events: dict[str, int]
    decisive: list[int]
    more: tuple[NeededBox, ...] = ()


def reading_of(resolved: ResolvedPlan, choices: Sequence[str] = ()) -> Reading:
    """Read the answer of a plan.

    Args:
        resolved: The plan with its people.
        choices: Texts of the question's choices. Questions about actions have no answer without them.

    Returns:
        The answer. The rules that the question breaks are noted in `resolved`.

    Raises:
        Undefined: If the plan has no answer.
    """
    if choices:
        resolved = replace(resolved, choices=tuple(map(answer_of_choice, choices)))
    reading: Reading = globals()[f"read_{resolved.plan.answer.read}"](resolved)
    return reading


def read_action(resolved: ResolvedPlan) -> Reading:
    """Read the only choice that is true at the time asked.

    If the time asked is later than the description, the choice must be false at the time of the description.
    """
    annotations, target = resolved.annotations, resolved.target
    frame, rules = resolved.frame(0), resolved.rules
    later = resolved.plan.answer.times[0] != resolved.described
    if later:
        least = rules.long_wait_s if resolved.template == "later_action" else rules.min_wait_s
        resolved.wait(resolved.t0, frame, least)
    if annotations.absent(target, frame):
        raise Undefined("empty", f"the person is absent at frame {frame}")
    true = [choice for choice in resolved.choices if annotations.performs(target, choice, frame) == TRUE]
    if len(true) != 1:
        raise Undefined("ambiguous" if true else "unknown", f"{len(true)} choices are certain at frame {frame}")
    (action,) = true
    check_choices(resolved, action, frame)
    supported = is_supported(annotations, target, action, frame)
    resolved.check(supported, f"{action!r} is not certain one second before or after frame {frame}")
    new = not later or annotations.performs(target, action, resolved.t0) == FALSE
    resolved.check(new, f"{action!r} is not certainly false at frame {resolved.t0}")
    return Reading(action, {}, [frame])


def compare_action(resolved: ResolvedPlan, action: str) -> str:
    """Compare what a person does with the answer of a question.

    Args:
        resolved: A perturbed plan with its people.
        action: The answer of the question.

    Returns:
        "same" if the person certainly performs the action, "different" if certainly not, "empty" if the person is
        absent, else "unknown".

    Raises:
        Undefined: If the time of the answer is not stated.
    """
    frame = resolved.frame(0)
    if resolved.annotations.absent(resolved.target, frame):
        return "empty"
    fact = resolved.annotations.performs(resolved.target, action, frame)
    return {TRUE: "same", FALSE: "different"}.get(fact, "unknown")


def read_presence(resolved: ResolvedPlan) -> Reading:
    """Read whether the person is present at two times."""
    first, second = resolved.frame(0), resolved.frame(1)
    resolved.wait(resolved.t0, first, resolved.rules.min_wait_s)
    resolved.wait(first, second, resolved.rules.min_wait_s)
    present = [_present(resolved, frame) for frame in (first, second)]
    decisive = [frame for frame, in_view in zip((first, second), present, strict=True) if in_view]
    return Reading(PRESENCE_ANSWERS[3 - 2 * present[0] - present[1]], {}, decisive)


def _present(resolved: ResolvedPlan, frame: int) -> bool:
    if resolved.annotations.clear(resolved.target, frame):
        return True
    if resolved.annotations.absent(resolved.target, frame):
        return False
    raise Undefined("unknown", f"whether the person is present at frame {frame} is unknown")


def read_distance_change(resolved: ResolvedPlan) -> Reading:
    """Read how the distance from the robot changes between two times."""
    before, after = resolved.frame(0), resolved.frame(1)
    resolved.wait(before, after, resolved.rules.min_wait_s)
    start = resolved.annotations.distance(resolved.target, before)
    if start is None:
        raise Undefined("unknown", f"the distance at frame {before} is unknown")
    if not _present(resolved, after):
        return Reading(DISTANCE_ANSWERS[3], {}, [])
    end = resolved.annotations.distance(resolved.target, after)
    if end is None:
        raise Undefined("unknown", f"the distance at frame {after} is unknown")
    changed = end - start
    if abs(changed) >= resolved.rules.distance_changed_m:
        return Reading(DISTANCE_ANSWERS[0 if changed < 0 else 1], {}, [after])
    if abs(changed) < resolved.rules.distance_same_m:
        return Reading(DISTANCE_ANSWERS[2], {}, [after])
    raise Undefined("unknown", f"the distance changes by {abs(changed):.2f} m, neither much nor little")


def read_count(resolved: ResolvedPlan) -> Reading:
    """Read how many different people are in a relation with the target at any frame between two times.

    The number is known if two conditions hold. The target has a box at each keyframe. Each person who may be in the
    relation at some frame is certainly in it at another frame, or at the same one.
    """
    annotations, target = resolved.annotations, resolved.target
    first, last, relation = resolved.frame(0), resolved.frame(1), resolved.plan.answer.relation or ""
    resolved.wait(first, last, resolved.rules.long_wait_s)
    sized = any(condition.attribute == "group_size" for node in resolved.plan.nodes for condition in node.conditions)
    resolved.check(relation != SAME_GROUP or not sized, "the question's words state the size of the group")
    could: set[int] = set()
    does: dict[int, list[int]] = {}
    for frame in range(first, last + 1):
        if annotations.box(target, frame) is None:
            if frame in annotations.keyframes:
                raise Undefined("unknown", f"the person has no box at frame {frame}")
            continue
        for partner in annotations.people(frame):
            fact = FALSE if partner == target else _counts(annotations, relation, target, partner, frame)
            if fact != FALSE:
                could.add(partner)
            if fact == TRUE:
                does.setdefault(partner, []).append(frame)
    if could - does.keys():
        raise Undefined("unknown", f"whether {min(could - does.keys())} is to be counted is unknown")
    resolved.check(len(does) >= resolved.rules.count_min, f"only {len(does)} people are to be counted")
    return Reading(encode_answer(Number(float(len(does)))), {}, [first], _counted(resolved, does))


def _counts(annotations: Annotations, relation: str, target: int, partner: int, frame: int) -> int:
    """Return whether a partner counts: in the relation with the target, while both are in clear view."""
    fact = annotations.related(relation, target, partner, frame)
    if fact == FALSE or not annotations.judges_views:
        return fact
    if annotations.covered(partner, frame):
        return FALSE
    return fact if annotations.clear(partner, frame) and annotations.clear(target, frame) else UNKNOWN


def _counted(resolved: ResolvedPlan, does: dict[int, list[int]]) -> tuple[NeededBox, ...]:
    """Return the boxes of all counted people and of the target, each at the first keyframe with clear views of both."""
    annotations, target = resolved.annotations, resolved.target
    needed: list[NeededBox] = []
    looks: set[int] = set()
    for index, track in enumerate(sorted(does), start=1):
        clear_frames = (
            frame
            for frame in does[track]
            if frame in annotations.keyframes and annotations.clear(track, frame) and annotations.clear(target, frame)
        )
        frame = next(clear_frames, None)
        box = None if frame is None else annotations.box(track, frame)
        if frame is None or box is None:
            resolved.faults.append(f"person {track}, who is counted, is never in clear view together with the target")
            continue
        needed.append(NeededBox(f"b{index}", track, frame, *box, False))
        looks.add(frame)
    for frame in sorted(looks - {resolved.t0}):
        box = annotations.box(target, frame)
        if box is not None:
            needed.append(NeededBox(resolved.plan.target, target, frame, *box, False))
    return tuple(needed)


def read_start(resolved: ResolvedPlan) -> Reading:
    """Read the start of an action."""
    name = resolved.plan.answer.times[0]
    segment = _first_segment(resolved, name)
    resolved.wait(resolved.t0, segment.start, resolved.rules.min_wait_s)
    return Reading(encode_answer(FrameAnswer(segment.start)), {name: segment.start}, [segment.first])


def read_span(resolved: ResolvedPlan) -> Reading:
    """Read the start and the end of an action."""
    start, end = resolved.plan.answer.times
    if resolved.plan.times[end].after != start or resolved.plan.times[end].action != resolved.plan.times[start].action:
        raise Undefined("unknown", "the end is not that of the action that starts")
    segment = _first_segment(resolved, start)
    resolved.wait(resolved.t0, segment.start, resolved.rules.min_wait_s)
    if not segment.closed:
        raise Undefined("unknown", "the end of the action is unknown")
    answer = encode_answer(Span(segment.start, segment.end))
    return Reading(answer, {start: segment.start, end: segment.end}, [segment.first, segment.last])


def read_start_view(resolved: ResolvedPlan) -> Reading:
    """Read the start of an action, and the direction of the person at the start. The person must have moved."""
    name, annotations = resolved.plan.answer.times[0], resolved.annotations
    segment = _first_segment(resolved, name)
    resolved.wait(resolved.t0, segment.start, resolved.rules.search_wait_s)
    if annotations.box(resolved.target, segment.first) is None:
        raise Undefined("unknown", f"the person has no box at frame {segment.first}")
    angle = annotations.angle(resolved.target, segment.first)
    turned = float(angle_error(angle, annotations.angle(resolved.target, resolved.t0)))
    resolved.check(
        turned > resolved.rules.turn_deg, f"the person has moved by no more than {resolved.rules.turn_deg:g} degrees"
    )
    return Reading(encode_answer(FrameViewpoint(segment.start, angle)), {name: segment.start}, [segment.first])


def read_next_action(resolved: ResolvedPlan) -> Reading:
    """Read the next pose of a person. The pose at the description must be certain at every keyframe until then."""
    annotations, target, name = resolved.annotations, resolved.target, resolved.plan.answer.times[0]
    event = resolved.plan.times[name]
    if event.action is not None or event.after != resolved.described:
        raise Undefined("unknown", f"{name} is not the end of the pose at t0")
    first_pose = annotations.pose(target, resolved.t0)
    if first_pose is None:
        raise Undefined("unknown", f"the pose at frame {resolved.t0} is unknown")
    last = resolved.t0
    while (
        annotations.pose(target, last + KEYFRAME_STEP) == first_pose and last + KEYFRAME_STEP in annotations.keyframes
    ):
        last += KEYFRAME_STEP
    following = last + KEYFRAME_STEP
    pose = annotations.pose(target, following) if following in annotations.keyframes else None
    if pose is None:
        raise Undefined("unknown", f"the pose at frame {following} is unknown")
    started = [s for s in annotations.segments(target, pose) if last < s.first <= following]
    if not started:
        raise Undefined("unknown", f"the pose at frame {following} has no clear start")
    resolved.wait(resolved.t0, last, resolved.rules.long_wait_s)
    check_choices(resolved, pose, following)
    return Reading(pose, {name: last}, [started[0].first])


def read_seconds_between(resolved: ResolvedPlan) -> Reading:
    """Read the seconds between the first starts of two actions, or the duration of the first absence."""
    first, second = resolved.plan.answer.times
    if resolved.plan.times[first].event == "leaves":
        events = _absence(resolved, first, second)
        decisive = sorted(events.values())
    else:
        segments = [_first_segment(resolved, name) for name in (first, second)]
        resolved.check(segments[0].start < segments[1].start, "the two actions start in the other order")
        events = {first: segments[0].start, second: segments[1].start}
        decisive = [segment.first for segment in segments]
    resolved.wait(resolved.t0, events[first], resolved.rules.min_wait_s)
    apart = events[second] - events[first]
    resolved.check(
        apart >= frames(resolved.rules.gap_min_s), f"less than {resolved.rules.gap_min_s:g} s lie between the events"
    )
    return Reading(encode_answer(Number(apart / FPS)), events, decisive)


def _absence(resolved: ResolvedPlan, leaves: str, returns: str) -> dict[str, int]:
    """Return the last frame before the first absence after t0, and the first frame after that absence."""
    times, annotations, target = resolved.plan.times, resolved.annotations, resolved.target
    if times[returns] != Time(event="returns", of=resolved.plan.target, after=leaves):
        raise Undefined("unknown", f"{returns} is not the end of the absence that begins at {leaves}")
    if times[leaves] != Time(event="leaves", of=resolved.plan.target, after=resolved.described):
        raise Undefined("unknown", f"{leaves} is not the beginning of an absence after t0")
    later = [frame for frame in sorted(annotations.keyframes) if frame > resolved.t0]
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
        raise Undefined("unknown", f"frame {unread[0]} was not annotated")
    hidden = [frame for frame in later if frame <= before and not annotations.clear(target, frame)]
    if hidden:
        raise Undefined("unknown", f"whether the person is present at frame {hidden[0]} is unknown")
    return {leaves: before, returns: after}


def _first_segment(resolved: ResolvedPlan, name: str) -> Segment:
    """Return the first stable segment after t0. Before its first frame, the action must be false since t0."""
    event, annotations, target = resolved.plan.times[name], resolved.annotations, resolved.target
    if event.event != "start" or event.of != resolved.plan.target or event.after != resolved.described:
        raise Undefined("unknown", f"{name} is not the start of an action after a stated time")
    after, action = resolved.t0, event.action or ""
    if annotations.state(target, action, after) != FALSE:
        raise Undefined("unknown", f"the action is not certainly absent at frame {after}")
    # Compute the segments first, because this computes the states of all frames at once.
    segments = annotations.segments(target, action)
    for frame in annotations.grid:
        if frame <= after or annotations.state(target, action, frame) == FALSE:
            continue
        for segment in segments:
            if segment.first == frame:
                return segment
        raise Undefined("unknown", f"the action has no clear start at frame {frame}")
    raise Undefined("empty", "the action does not start")
