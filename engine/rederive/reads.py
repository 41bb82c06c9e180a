"""What is read of a plan's target at stated times: postures, presence, distance and how many people it meets."""

from __future__ import annotations

from dataclasses import dataclass

from jrdb_avr.engine.rederive.plan import Asked
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, NeededBox, Undefined
from jrdb_avr.schema.answers import Number, encode_answer
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.wording import stated_actions


@dataclass(frozen=True, slots=True)
class Reading:
    """The answer; the frames of the plan's events; the frames whose boxes of the target decide, where there are any;
    and what else must be seen."""

    answer: str
    events: dict[str, int]
    shown: list[int]
    more: tuple[NeededBox, ...] = ()


def read_action(asked: Asked) -> Reading:
    """The pose at one time; at a later one it differs from that at the description's."""
    frame, rules = asked.frame(0), asked.rules
    if asked.plan.answer.times[0] != asked.described:
        asked.wait(asked.t0, frame, rules.long_wait_s if asked.template == "later_pose" else rules.min_wait_s)
    if asked.annotations.absent(asked.target, frame):
        raise Undefined("empty", f"the person is absent at frame {frame}")
    pose = asked.annotations.pose(asked.target, frame)
    if pose is None:
        raise Undefined("unknown", f"the pose at frame {frame} is unknown")
    asked.check(pose not in stated_actions(asked.plan), "the question's own words name the answer")
    if frame != asked.t0:
        before = asked.annotations.pose(asked.target, asked.t0)
        asked.check(before not in (None, pose), "the pose at t0 is unknown, or the same as the answer")
    return Reading(pose, {}, [frame])


def read_presence(asked: Asked) -> Reading:
    """Whether the person is there at two times."""
    first, second = asked.frame(0), asked.frame(1)
    asked.wait(asked.t0, first, asked.rules.min_wait_s)
    asked.wait(first, second, asked.rules.min_wait_s)
    present = [_present(asked, frame) for frame in (first, second)]
    place = {(True, True): 0, (True, False): 1, (False, True): 2, (False, False): 3}[present[0], present[1]]
    shown = [frame for frame, there in zip((first, second), present, strict=True) if there]
    return Reading(PRESENCE_ANSWERS[place], {}, shown)


def _present(asked: Asked, frame: int) -> bool:
    if asked.annotations.clear(asked.target, frame):
        return True
    if asked.annotations.absent(asked.target, frame):
        return False
    raise Undefined("unknown", f"whether the person is present at frame {frame} is unknown")


def read_distance(asked: Asked) -> Reading:
    """How the distance from the robot changes between two times."""
    before, after = asked.frame(0), asked.frame(1)
    asked.wait(before, after, asked.rules.min_wait_s)
    start = asked.annotations.distance(asked.target, before)
    if start is None:
        raise Undefined("unknown", f"the distance at frame {before} is unknown")
    if not _present(asked, after):
        return Reading(DISTANCE_ANSWERS[3], {}, [])
    end = asked.annotations.distance(asked.target, after)
    if end is None:
        raise Undefined("unknown", f"the distance at frame {after} is unknown")
    changed = end - start
    if changed <= -asked.rules.distance_changed_m:
        return Reading(DISTANCE_ANSWERS[0], {}, [after])
    if changed >= asked.rules.distance_changed_m:
        return Reading(DISTANCE_ANSWERS[1], {}, [after])
    if abs(changed) < asked.rules.distance_same_m:
        return Reading(DISTANCE_ANSWERS[2], {}, [after])
    raise Undefined("unknown", f"the distance changes by {abs(changed):.2f} m, neither much nor little")


def read_count(asked: Asked) -> Reading:
    """How many different people are in a relation with the target at any frame of a stretch of time.

    The stretch is known where the target's own labels tell of the relation at each of its keyframes, and nobody could
    be in it who is not for certain at another frame.
    """
    annotations, target = asked.annotations, asked.target
    first, last, relation = asked.frame(0), asked.frame(1), asked.plan.answer.relation or ""
    asked.wait(first, last, asked.rules.long_wait_s)
    sized = any(condition.attribute == "group_size" for node in asked.plan.nodes for condition in node.conditions)
    asked.check(relation != SAME_GROUP or not sized, "the question's own words tell how large the group is")
    could: set[int] = set()
    does: dict[int, list[int]] = {}
    for frame in range(first, last + 1):
        if annotations.box(target, frame) is None:
            if frame in annotations.keyframes:
                raise Undefined("unknown", f"the person is not there at frame {frame}")
            continue
        for other in annotations.people(frame):
            fact = FALSE if other == target else annotations.related(relation, target, other, frame)
            if fact != FALSE:
                could.add(other)
            if fact == TRUE:
                does.setdefault(other, []).append(frame)
    if could - does.keys():
        raise Undefined("unknown", f"whether {min(could - does.keys())} is to be counted is unknown")
    asked.check(len(does) >= asked.rules.count_min, f"only {len(does)} people are to be counted")
    return Reading(encode_answer(Number(float(len(does)))), {}, [first], _counted(asked, does))


def _counted(asked: Asked, does: dict[int, list[int]]) -> tuple[NeededBox, ...]:
    """Everybody counted, by track, at the first keyframe at which both can be seen, and the target there too."""
    annotations, target = asked.annotations, asked.target
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
            asked.faults.append(f"person {track}, who is counted, is never in clear view together with the target")
            continue
        needed.append(NeededBox(f"b{number}", track, frame, box, False))
        looks.add(frame)
    for frame in sorted(looks - {asked.t0}):
        box = annotations.box(target, frame)
        if box is not None:
            needed.append(NeededBox(asked.plan.target, target, frame, box, False))
    return tuple(needed)
