"""Facts of the chain of thought: what the panoramas show of the question's person, in sentences, and read back.

The reply that follows the facts answers from them alone. A picture is used again only for the box of whoever stands
where a fact says that the person does.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from jrdb_avr.agent.policy.explorer import Look, Sighting
from jrdb_avr.agent.policy.searches import count_people
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.schema.labels import AGES, GENDERS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import Box, angle_error
from jrdb_avr.schema.things import OBJECTS, VERBS

_MOST: Final = 12
_NEAR_DEG: Final = 3.0
"""Whoever stands this near the angle of a fact may be its person."""
_FACT: Final = r"Fact \d+: "
_SEEN: Final = re.compile(_FACT + r"Frame (\d{6}): the person stands at panorama angle (\d{1,3}): (.*)\.")
_UNCLEAR: Final = re.compile(_FACT + r"What could not be made out: (.*)\.")
_COUNTED: Final = re.compile(_FACT + r"People whom the question counts: (\d{1,4})\.")
_METRES: Final = re.compile(r"([0-9.]{1,6}) m away")
_IN_COMPANY: Final = " with somebody"
_PERSON: Final = 1
"""The identity of the facts' person, of whom alone they tell."""


def write_facts(state: EpisodeState, person: Sighting | None) -> list[str]:
    """Sentences on what is counted, on every sighting of the person, and on what could not be made out."""
    found = []
    if person is not None:
        if state.plan.answer.read == "count":
            found.append(f"People whom the question counts: {count_people(state, person)}.")
        sightings = state.explorer.sightings(person.identity)[::-1]
        found += [_sentence(seen) for seen in sorted(sightings, key=lambda one: one.frame)]
    found += [f"What could not be made out: {reason}." for reason in state.missing]
    return found[:_MOST] or ["Nobody in the pictures fits the description."]


def _sentence(seen: Sighting) -> str:
    mark = seen.mark
    parts = [
        mark.gender,
        mark.age,
        mark.pose,
        *mark.actions,
        None if mark.interaction is None else f"{mark.interaction}{_IN_COMPANY}",
        None if mark.object is None or mark.verb is None else f"{mark.verb} {mark.object}",
        None if mark.distance_dm is None else f"{mark.distance_dm / 10:g} m away",
    ]
    what = ", ".join(text for text in parts if text) or "no more can be told"
    return f"Frame {seen.frame:06d}: the person stands at panorama angle {round(seen.angle) % 360}: {what}."


@dataclass(frozen=True)
class Facts:
    """Facts read back: the looks as far as they tell of them, what was counted, and what could not be made out."""

    looks: tuple[Look, ...]
    counted: int | None
    missing: tuple[str, ...]


def known_facts(lines: Sequence[str], looks: Sequence[Look]) -> Facts | None:
    """The facts among a prompt's lines, in place of what its pictures show; None where there are none."""
    if not any(re.match(_FACT, line) for line in lines):
        return None
    seen = {int(found[1]): _sighting(int(found[1]), float(found[2]), found[3]) for found in _all(_SEEN, lines)}
    told = tuple(
        Look(look.frame, look.angle, (seen[look.frame],) if look.frame in seen else (), look.panorama, size=look.size)
        for look in looks
    )
    counted = next((int(found[1]) for found in _all(_COUNTED, lines)), None)
    return Facts(told, counted, tuple(found[1] for found in _all(_UNCLEAR, lines)))


def _all(pattern: re.Pattern[str], lines: Sequence[str]) -> list[re.Match[str]]:
    return [found for line in lines if (found := pattern.fullmatch(line))]


def _sighting(frame: int, angle: float, what: str) -> Sighting:
    """The sighting that a sentence tells of, at no place in its picture."""
    parts = what.split(", ")
    metres = next((float(found[1]) for part in parts if (found := _METRES.fullmatch(part))), None)
    verb, thing = next(
        ((v, part.removeprefix(f"{v} ")) for part in parts for v in VERBS if _handles(part, v)), ("", "")
    )
    mark = Mark(
        _PERSON,
        gender=_first(parts, GENDERS),
        age=_first(parts, AGES),
        pose=_first(parts, POSES),
        actions=tuple(part for part in parts if part in OTHER_ACTIONS),
        distance_dm=None if metres is None else round(metres * 10),
        interaction=next((part.removesuffix(_IN_COMPANY) for part in parts if part.endswith(_IN_COMPANY)), None),
        object=thing or None,
        verb=verb or None,
    )
    return Sighting(frame, mark, Box(0, 0, 0, 0), True, angle)


def _first(parts: Sequence[str], words: Sequence[str]) -> str | None:
    return next((part for part in parts if part in words), None)


def _handles(part: str, verb: str) -> bool:
    return part.removeprefix(f"{verb} ") in OBJECTS and part.startswith(f"{verb} ")


def shown_there(fact: Sighting, looks: Sequence[Look]) -> tuple[Look, Sighting] | None:
    """The picture and the sighting in it of whoever stands where a fact says; None where nobody does."""
    there = [
        (float(angle_error(fact.angle, seen.angle)), number, look, seen)
        for number, look in enumerate(looks)
        if look.frame == fact.frame
        for seen in look.sightings
    ]
    off, _, look, seen = min(there, key=lambda one: one[:2], default=(360.0, 0, None, None))
    return None if look is None or seen is None or off > _NEAR_DEG else (look, seen)
