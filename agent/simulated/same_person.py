"""Who is the same person in several pictures, by place and looks alone: the model's own guess where `ids` is off.

A person's looks are the colour of the mark's frame, as that of clothes, with gender and age. Pictures are taken in
their order, so a person keeps the name when another picture follows. Names are numbers of which the last octal digit
is the colour: whoever is remembered by name alone is remembered with the colour.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from jrdb_avr.agent.policy.explorer import Look, Sighting
from jrdb_avr.schema.markers import ALONE, FRAME_COLORS
from jrdb_avr.schema.panorama import WIDTH, Box, angle_error, iou
from jrdb_avr.schema.rules import FPS

_COLORS: Final = len(FRAME_COLORS)
_MOST_UNLIKE: Final = 3.0
"""Beyond this, somebody is new."""
_SAME_BOX: Final = 0.5
_LONGEST_S: Final = 5.0
"""A person may be anywhere after so many seconds."""
_DIFFERS: Final = {"colour": 2.5, "gender": 1.0, "age": 0.5}


def told_apart(looks: Sequence[Look], written: Mapping[str, Mapping[int, Box]] | None = None) -> tuple[Look, ...]:
    """The looks with names in place of identities: whom the model takes for the same person has the same name.

    `written`: people who have a name already, by the look's name: their names, and their boxes in that picture.
    Partners and groups are named likewise.
    """
    written = written or {}
    newest = max((name for names in written.values() for name in names), default=0)
    people: dict[int, list[tuple[Look, Sighting]]] = {}
    groups: dict[tuple[int, int], int] = {}
    named = []
    for look in looks:
        names = _names(look, people, written.get(look.name, {}), newest)
        newest = max([newest, *names])
        named.append(_renamed(look, names, groups))
        for name, seen in zip(names, look.sightings, strict=True):
            people.setdefault(name, []).append((look, seen))
    return tuple(named)


def _names(
    look: Look, people: Mapping[int, Sequence[tuple[Look, Sighting]]], written: Mapping[int, Box], newest: int
) -> list[int]:
    """The name of each person in a look; no two have the same, and new ones are beyond the newest so far."""
    costs = [
        (cost, name, place)
        for place, seen in enumerate(look.sightings)
        for name, before in people.items()
        if (cost := _unlike(name, before, look, seen)) <= _MOST_UNLIKE
    ]
    costs += [
        (-overlap, name, place)
        for place, seen in enumerate(look.sightings)
        for name, box in written.items()
        if (overlap := iou(look.box_inside(seen), box)) >= _SAME_BOX
    ]
    names: dict[int, int] = {}
    for _, name, place in sorted(costs):
        if place not in names and name not in names.values():
            names[place] = name
    for place, seen in enumerate(look.sightings):
        if place not in names:
            newest = (newest // _COLORS + 1) * _COLORS + _color(seen)
            names[place] = newest
    return [names[place] for place in range(len(look.sightings))]


def _color(seen: Sighting) -> int:
    return seen.identity % _COLORS


def _unlike(name: int, before: Sequence[tuple[Look, Sighting]], look: Look, seen: Sighting) -> float:
    """How unlike somebody is to a person seen before, at the time nearest to it."""
    other, known = min(before, key=lambda entry: abs(entry[1].frame - seen.frame))
    seconds = min(abs(known.frame - seen.frame) / FPS, _LONGEST_S)
    place = float(angle_error(known.angle, seen.angle)) / (1 + 12 * seconds)
    size = abs(math.log(_height(other, known) / _height(look, seen))) / (0.15 + 0.15 * seconds)
    pairs = {
        "colour": (name % _COLORS, _color(seen)),
        "gender": (known.mark.gender, seen.mark.gender),
        "age": (known.mark.age, seen.mark.age),
    }
    return place + size + sum(_DIFFERS[what] for what, (a, b) in pairs.items() if None not in (a, b) and a != b)


def _height(look: Look, seen: Sighting) -> float:
    """The height of a box in pixels of a whole panorama of full size."""
    return max(seen.box.h, 1.0) * (WIDTH / look.size[0] if look.panorama else 1.0)


def _renamed(look: Look, names: Sequence[int], groups: dict[tuple[int, int], int]) -> Look:
    """The look with these names. A group goes by a number of its own frame, that of a member who has been seen."""
    of_identity = {seen.identity: name for seen, name in zip(look.sightings, names, strict=True)}
    numbers: dict[int | None, int | None] = {None: None, ALONE: ALONE}
    for group in dict.fromkeys(seen.mark.group for seen in look.sightings):
        if group not in numbers:
            members = [n for s, n in zip(look.sightings, names, strict=True) if s.mark.group == group]
            known = [groups[look.frame, name] for name in members if (look.frame, name) in groups]
            numbers[group] = number = known[0] if known else max(groups.values(), default=ALONE) + 1
            groups.update({(look.frame, name): number for name in members})
    sightings = tuple(
        replace(
            seen,
            mark=replace(
                seen.mark,
                identity=name,
                partner=None if seen.mark.partner is None else of_identity.get(seen.mark.partner),
                group=numbers[seen.mark.group],
            ),
        )
        for seen, name in zip(look.sightings, names, strict=True)
    )
    return replace(look, sightings=sightings)
