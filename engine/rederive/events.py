"""What is read of a plan's target at events: starts, ends, what comes next, and the time between two of them."""

from __future__ import annotations

from jrdb_avr.engine.rederive.actions import Segment
from jrdb_avr.engine.rederive.plan import Asked
from jrdb_avr.engine.rederive.reads import Reading
from jrdb_avr.engine.rederive.truth import FALSE, Undefined
from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Number, Span, encode_answer
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Time
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, frames


def read_start(asked: Asked) -> Reading:
    """When an action starts."""
    name = asked.plan.answer.times[0]
    segment = _first_segment(asked, name)
    asked.wait(asked.t0, segment.start, asked.rules.min_wait_s)
    return Reading(encode_answer(FrameAnswer(segment.start)), {name: segment.start}, [segment.first])


def read_span(asked: Asked) -> Reading:
    """From when to when an action lasts."""
    start, end = asked.plan.answer.times
    if asked.plan.times[end].after != start or asked.plan.times[end].action != asked.plan.times[start].action:
        raise Undefined("unknown", "the span does not end what it starts")
    segment = _first_segment(asked, start)
    asked.wait(asked.t0, segment.start, asked.rules.min_wait_s)
    if not segment.closed:
        raise Undefined("unknown", "when the action ends is unknown")
    answer = encode_answer(Span(segment.start, segment.end))
    return Reading(answer, {start: segment.start, end: segment.end}, [segment.first, segment.last])


def read_start_view(asked: Asked) -> Reading:
    """When an action starts, and in which direction the person is seen then; another than at the description."""
    name, annotations = asked.plan.answer.times[0], asked.annotations
    segment = _first_segment(asked, name)
    asked.wait(asked.t0, segment.start, asked.rules.search_wait_s)
    if annotations.box(asked.target, segment.first) is None:
        raise Undefined("unknown", f"the person has no box at frame {segment.first}")
    angle = annotations.angle(asked.target, segment.first)
    turned = float(angle_error(angle, annotations.angle(asked.target, asked.t0)))
    asked.check(turned > asked.rules.turn_deg, f"the person has moved by no more than {asked.rules.turn_deg:g} degrees")
    return Reading(encode_answer(FrameViewpoint(segment.start, angle)), {name: segment.start}, [segment.first])


def read_next_action(asked: Asked) -> Reading:
    """The pose that follows that of the description's time, held at every keyframe until then."""
    annotations, target, name = asked.annotations, asked.target, asked.plan.answer.times[0]
    event = asked.plan.times[name]
    if event.action is not None or event.after != asked.described:
        raise Undefined("unknown", f"{name} is no end of the pose held at t0")
    held = annotations.pose(target, asked.t0)
    if held is None:
        raise Undefined("unknown", f"the pose at frame {asked.t0} is unknown")
    last = asked.t0
    while annotations.pose(target, last + KEYFRAME_STEP) == held and last + KEYFRAME_STEP in annotations.keyframes:
        last += KEYFRAME_STEP
    following = last + KEYFRAME_STEP
    pose = annotations.pose(target, following) if following in annotations.keyframes else None
    if pose is None:
        raise Undefined("unknown", f"the pose at frame {following} is unknown")
    started = [s for s in annotations.segments(target, pose) if last < s.first <= following]
    if not started:
        raise Undefined("unknown", f"the pose at frame {following} is no clear start")
    asked.wait(asked.t0, last, asked.rules.long_wait_s)
    return Reading(pose, {name: last}, [started[0].first])


def read_seconds_between(asked: Asked) -> Reading:
    """Seconds between the first starts of two actions, or those that the first absence lasts."""
    first, second = asked.plan.answer.times
    if asked.plan.times[first].event == "leaves":
        events = _absence(asked, first, second)
        shown = sorted(events.values())
    else:
        segments = [_first_segment(asked, name) for name in (first, second)]
        asked.check(segments[0].start < segments[1].start, "the two actions start in the other order")
        events = {first: segments[0].start, second: segments[1].start}
        shown = [segment.first for segment in segments]
    asked.wait(asked.t0, events[first], asked.rules.min_wait_s)
    apart = events[second] - events[first]
    asked.check(apart >= frames(asked.rules.gap_min_s), f"less than {asked.rules.gap_min_s:g} s lie between the events")
    return Reading(encode_answer(Number(apart / FPS)), events, shown)


def _absence(asked: Asked, leaves: str, returns: str) -> dict[str, int]:
    """The last frame before the first absence after t0, and the first one after it."""
    times, annotations, target = asked.plan.times, asked.annotations, asked.target
    if times[returns] != Time(event="returns", of=asked.plan.target, after=leaves):
        raise Undefined("unknown", f"{returns} does not end what begins at {leaves}")
    if times[leaves] != Time(event="leaves", of=asked.plan.target, after=asked.described):
        raise Undefined("unknown", f"{leaves} is no leaving after t0")
    later = [frame for frame in sorted(annotations.keyframes) if frame > asked.t0]
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


def _first_segment(asked: Asked, name: str) -> Segment:
    """The stable segment that begins when the action is first anything but false after the description's time."""
    event, annotations, target = asked.plan.times[name], asked.annotations, asked.target
    if event.event != "start" or event.of != asked.plan.target or event.after != asked.described:
        raise Undefined("unknown", f"{name} is no start of an action after a stated time")
    after, action = asked.t0, event.action or ""
    if annotations.state(target, action, after) != FALSE:
        raise Undefined("unknown", f"the action is not certainly absent at frame {after}")
    for frame in annotations.grid:
        if frame <= after or annotations.state(target, action, frame) == FALSE:
            continue
        for segment in annotations.segments(target, action):
            if segment.first == frame:
                return segment
        raise Undefined("unknown", f"what happens at frame {frame} is no clear start")
    raise Undefined("empty", "the action does not start")
