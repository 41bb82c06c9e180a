"""Find the person of a description by the marks: each condition is true, false or unknown of a sighting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from jrdb_avr.agent.policy.explorer import AROUND, BudgetExhausted, Explorer, Sighting
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.markers import ALONE
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules

_SWEEP: Final = tuple(180.0 + turn for turn in AROUND)
_RULES: Final = LoadRules()
_ALONE_SIZE: Final = 1
_MARK_ACTIONS: Final = 2
"""A mark has room for this many actions beside the pose."""


class FoundPerson(NamedTuple):
    """The person, or None; `missing` is the reason why not, or what was not certain."""

    sighting: Sighting | None
    missing: str = ""


def counts_group(conditions: Sequence[Condition]) -> bool:
    """Whether a description names the size of a group, which is only known after a look all round."""
    return any(c.attribute == "group_size" and c.value != _ALONE_SIZE for c in conditions)


def find(conditions: Sequence[Condition], frame: int, explorer: Explorer) -> FoundPerson:
    """Find the one person at a legal frame who satisfies every condition.

    The description fits one person alone, so looking ends at the first certain match; a group is counted all round
    first. Nobody is found where looks run out.
    """
    sized = counts_group(conditions)
    sector = next((ROBOT_SECTORS[str(c.value)] for c in conditions if c.attribute == "sector"), None)
    try:
        for angle in _SWEEP if sector is None or sized else (sector - 22.0, sector + 22.0, sector):
            explorer.look(frame, angle % 360.0)
            if not sized and (match := _only(conditions, explorer.at(frame))):
                return FoundPerson(match)
        return _count(conditions, frame, explorer) if sized else among(conditions, explorer.at(frame))
    except BudgetExhausted:
        return FoundPerson(None, "budget: the person was not found")


def among(conditions: Sequence[Condition], people: Sequence[Sighting]) -> FoundPerson:
    """The described one of the people read at a frame; where a condition is unknown, the only one who may fit."""
    if match := _only(conditions, people):
        return FoundPerson(match)
    fitting = possible(conditions, people)
    if len(fitting) == 1:
        return FoundPerson(fitting[0], "mark unreadable: not every condition could be read")
    return _nobody(fitting)


def _nobody(fitting: Sequence[Sighting]) -> FoundPerson:
    what = "several could fit, as not every condition could be read" if fitting else "nobody who was read fits"
    return FoundPerson(None, f"mark unreadable: {what}")


def _count(conditions: Sequence[Condition], frame: int, explorer: Explorer) -> FoundPerson:
    """The person in a group of the right size; where several may fit, hidden people are looked for a second away.

    A member of the described group who was read always fits: hidden people make a group look smaller, never larger.
    """
    people = explorer.at(frame)
    fitting = possible(conditions, people)
    if len(fitting) == 1:
        certain = _only(conditions, people)
        return FoundPerson(fitting[0], "" if certain else "mark unreadable: not all of the group was read")
    others: list[Sighting] = []
    for offset in (KEYFRAME_STEP, -KEYFRAME_STEP):
        then = explorer.legal(frame + offset)
        for person in fitting:
            explorer.look(then, person.angle)
        others += explorer.at(then)
    match = _only(conditions, people, others)
    return (
        FoundPerson(match, "mark unreadable: a group may be larger than what was read") if match else _nobody(fitting)
    )


def _only(
    conditions: Sequence[Condition], people: Sequence[Sighting], others: Sequence[Sighting] = ()
) -> Sighting | None:
    """Return the only person who certainly satisfies every condition; None if there is not exactly one."""
    certain = [p for p in people if all(holds(c, p, [*people, *others]) for c in conditions)]
    return certain[0] if len(certain) == 1 else None


def possible(conditions: Sequence[Condition], people: Sequence[Sighting]) -> list[Sighting]:
    """The people of whom no condition is false."""
    return [p for p in people if all(holds(c, p, people) is not False for c in conditions)]


def likely(conditions: Sequence[Condition], people: Sequence[Sighting], *, exact: bool) -> Sighting | None:
    """The best guess: of the people who may fit, whoever most conditions are true of, then the nearest to the camera.

    None where nobody may fit. Not `exact`: the people are seen at another time than the conditions hold at, so that
    nothing but gender and age rules anybody out.
    """

    def may_fit(person: Sighting) -> bool:
        ruling = (c for c in conditions if exact or c.at is None)
        return all(holds(c, person, people) is not False for c in ruling)

    def worth(person: Sighting) -> tuple[float, ...]:
        true = sum(holds(c, person, people) is True for c in conditions)
        # A mark that is read in part may hold more of the conditions than one that says something else.
        return (true, not person.complete, person.box.h, -person.identity)

    return max(filter(may_fit, people), key=worth, default=None)


def holds(condition: Condition, person: Sighting, people: Sequence[Sighting]) -> bool | None:
    """Whether a condition is true of a person; None where unknown. Groups are counted among `people`."""
    mark = person.mark
    if condition.action is not None and condition.action not in POSES:
        if condition.action in mark.actions:
            return True
        return None if len(mark.actions) >= _MARK_ACTIONS else False
    # A mark shows one interaction and one object, and a person may have several.
    if condition.interaction is not None:
        return mark.interaction == condition.interaction or _unless_other(person, mark.interaction)
    if condition.object is not None:
        return (mark.object, mark.verb) == (condition.object, condition.verb) or _unless_other(person, mark.object)
    if condition.attribute == "sector":
        off = angle_error(person.angle, ROBOT_SECTORS[str(condition.value)])
        return bool(off <= _RULES.sector_true_deg) or (None if off <= _RULES.sector_false_deg else False)
    if condition.attribute == "group_size":
        return _group_holds(condition, person, people)
    distance = None if mark.distance_dm is None else distance_word(mark.distance_dm / 10)
    read = {"gender": mark.gender, "age": mark.age, "distance": distance, "": mark.pose}[condition.attribute or ""]
    return None if read is None else read == (condition.action or condition.value)


def _unless_other(person: Sighting, other: str | None) -> bool | None:
    """False where the mark was read in full and is empty there; unknown where another value takes the one place."""
    return False if person.complete and other is None else None


def _group_holds(condition: Condition, person: Sighting, people: Sequence[Sighting]) -> bool | None:
    group = person.mark.group
    if group is None:
        return None
    if group == ALONE or condition.value == _ALONE_SIZE:
        return group == ALONE and condition.value == _ALONE_SIZE
    size = len({other.identity for other in people if other.mark.group == group})
    # Somebody of the group may be hidden.
    return None if size < int(str(condition.value)) else size == condition.value


def distance_word(metres: float) -> str:
    """The word for a distance in metres."""
    return DISTANCE_WORDS[sum(metres > bound for bound in DISTANCE_BOUNDS_M)]
