"""Finding the person of a description by its mark: each condition is true, false or unknown of a sighting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from jrdb_avr.agent.policy.explorer import AROUND, Eyes
from jrdb_avr.agent.simulated.requests import Sighting
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, POSES
from jrdb_avr.schema.markers import ALONE
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import KEYFRAME_STEP

_SECTOR_ANGLES: Final = {"ahead": 180.0, "right": 270.0, "behind": 0.0, "left": 90.0}
_SWEEP: Final = tuple(180.0 + turn for turn in AROUND)

ALONE_SIZE: Final = 1

_SHOWN_ACTIONS: Final = 2
"""A mark has room for this many actions beside the pose."""


@dataclass(frozen=True)
class Found:
    """The person, or None; `missing` says why not, or what was not certain."""

    sighting: Sighting | None
    missing: str = ""


def find(conditions: Sequence[Condition], frame: int, eyes: Eyes) -> Found:
    """The one person at a legal frame of whom every condition is true.

    The description fits one person alone, so looking ends at the first certain match; a group must first be counted
    all round. Raises Spent when looks run out.
    """
    sized = any(c.attribute == "group_size" and c.value != ALONE_SIZE for c in conditions)
    angles: tuple[float, ...]
    sectors = [str(c.value) for c in conditions if c.attribute == "sector"]
    if sectors and not sized:
        middle = _SECTOR_ANGLES[sectors[0]]
        angles = (middle - 22.0, middle + 22.0, middle)
    else:
        angles = _SWEEP
    for angle in angles:
        eyes.look(frame, angle % 360.0)
        if not sized and (match := _only(conditions, eyes.at(frame), ())):
            return Found(match)
    return _count(conditions, frame, eyes) if sized else among(conditions, eyes.at(frame))


def among(conditions: Sequence[Condition], people: Sequence[Sighting]) -> Found:
    """The one of everybody who was read at a frame; where not every condition could be read, the one who is left."""
    if match := _only(conditions, people, ()):
        return Found(match)
    fitting = possible(conditions, people)
    if len(fitting) == 1:
        return Found(fitting[0], "mark unreadable: not every condition could be read")
    return _nobody(fitting)


def _nobody(fitting: Sequence[Sighting]) -> Found:
    what = "several could fit, as not every condition could be read" if fitting else "nobody who was read fits"
    return Found(None, f"mark unreadable: {what}")


def _count(conditions: Sequence[Condition], frame: int, eyes: Eyes) -> Found:
    """The person in a group of the right size; where several could be, those hidden are sought a second away.

    Somebody who was read and is in the group asked for is always among those who could be: hidden people make a group
    look smaller, never larger.
    """
    people = eyes.at(frame)
    fitting = possible(conditions, people)
    match = _only(conditions, people, ())
    if len(fitting) == 1:
        return Found(fitting[0], "" if match else "mark unreadable: not all of the group was read")
    others: list[Sighting] = []
    for offset in (KEYFRAME_STEP, -KEYFRAME_STEP):
        then = eyes.legal(frame + offset)
        for person in fitting:
            eyes.look(then, person.angle)
        others += eyes.at(then)
    match = _only(conditions, people, others)
    if match is None:
        return _nobody(fitting)
    return Found(match, "mark unreadable: a group may be larger than what was read")


def _only(conditions: Sequence[Condition], people: Sequence[Sighting], others: Sequence[Sighting]) -> Sighting | None:
    """The only one of the people of whom every condition is true, if there is one."""
    certain = [p for p in people if all(holds(c, p, [*people, *others]) for c in conditions)]
    return certain[0] if len(certain) == 1 else None


def possible(conditions: Sequence[Condition], people: Sequence[Sighting]) -> list[Sighting]:
    """Those of whom no condition is false."""
    return [p for p in people if all(holds(c, p, people) is not False for c in conditions)]


def likely(conditions: Sequence[Condition], people: Sequence[Sighting], *, exact: bool) -> Sighting | None:
    """The best guess: of those who could fit, whoever most is true of, then the nearest to the camera.

    None where nobody could. Not `exact`: the people are seen at another time than the conditions hold at, so that
    nothing but gender and age is false of anybody.
    """

    def could(person: Sighting) -> bool:
        held = ((c, holds(c, person, people)) for c in conditions)
        return all(truth is not False or not (exact or c.at is None) for c, truth in held)

    def worth(person: Sighting) -> tuple[float, ...]:
        true = sum(holds(c, person, people) is True for c in conditions)
        # Where a mark is read in part, more may be true than where it says something else.
        return (true, not person.complete, person.box.h, -person.mark.identity)

    return max(filter(could, people), key=worth, default=None)


def holds(condition: Condition, person: Sighting, people: Sequence[Sighting]) -> bool | None:
    """Whether a condition is true of a person; None where unknown. Groups are counted among `people`."""
    mark = person.mark
    if condition.action is not None:
        if condition.action in POSES:
            return None if mark.pose is None else mark.pose == condition.action
        if condition.action in mark.actions:
            return True
        return None if len(mark.actions) >= _SHOWN_ACTIONS else False
    if condition.interaction is not None:
        if mark.interaction == condition.interaction:
            return True
        # A mark shows one interaction, and a person may be in several.
        return False if person.complete and mark.interaction is None else None
    if condition.object is not None:
        if (mark.object, mark.verb) == (condition.object, condition.verb):
            return True
        # A mark shows one thing, and a person may handle several.
        return False if person.complete and mark.object is None else None
    match condition.attribute:
        case "gender":
            return None if mark.gender is None else mark.gender == condition.value
        case "age":
            return None if mark.age is None else mark.age == condition.value
        case "sector":
            return bool(angle_error(person.angle, _SECTOR_ANGLES[str(condition.value)]) <= 45.0)
        case "distance":
            return None if mark.distance_dm is None else distance_word(mark.distance_dm / 10) == condition.value
        case _:
            return _group_holds(condition, person, people)


def _group_holds(condition: Condition, person: Sighting, people: Sequence[Sighting]) -> bool | None:
    if person.mark.group is None:
        return None
    if person.mark.group == ALONE or condition.value == ALONE_SIZE:
        return person.mark.group == ALONE and condition.value == ALONE_SIZE
    size = len({other.mark.identity for other in people if other.mark.group == person.mark.group})
    if size == condition.value:
        return True
    # Somebody of the group may be hidden.
    return None if size < int(str(condition.value)) else False


def distance_word(metres: float) -> str:
    """The word for a distance in metres."""
    return DISTANCE_WORDS[sum(metres > bound for bound in DISTANCE_BOUNDS_M)]
