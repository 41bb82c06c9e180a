"""Things of the sample world, and who handles which.

Things are carried (drawn with their owner: in the hand, below the body), moved along (trolleys), or stand in the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from jrdb_avr.loaders.synthetic.bonds import runs_of
from jrdb_avr.loaders.synthetic.motion import Motion
from jrdb_avr.loaders.synthetic.script import ACTION, POSE, Party, Rng, Script
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import OBJECTS, VERBS

NOBODY: Final = -1
RIGHT_HAND, LEFT_HAND, BELOW = range(3)
"""Where what a person handles is drawn with it: in a hand, or under the body."""

_IN_HAND: Final = {
    "typing": (("peripheral", "using"),),
    "talking on the phone": (("phone", "talking on"),),
    "eating sth": (("tableware", "using"),),
    "reading": (("document", "looking into"),),
    "writing": (("document", "handling/manipulating"),),
    "looking into sth": (("phone", "looking into"), ("box", "looking into"), ("bag", "looking into")),
    "holding sth": (
        ("bag", "holding"),
        ("phone", "holding"),
        ("waterbottle", "holding"),
        ("box", "carrying"),
        ("document", "holding"),
        ("umbrella", "holding"),
        ("jacket", "carrying"),
    ),
}
_IN_THE_WORLD: Final = {
    "looking at sth": "looking at",
    "pointing at sth": "presenting",
    "interaction with door": "opening",
}
_LOOKED_AT: Final = ("board", "poster", "television", "statues", "standee")
_DECOR: Final = ("table", "trash_bin", "chair/sofa", "shelf", "pole/trafficcone")
_RIDDEN: Final = {
    "sitting": ("chair/sofa", "sitting"),
    "cycling": ("bicycle/scooter", "riding"),
    "scootering": ("bicycle/scooter", "riding"),
    "skating": ("skateboard/segway/hoverboard", "riding"),
}
_MOVED: Final = {"pushing": ("trolley", "pushing", 0.85), "pulling": ("trolley", "pulling", -0.85)}
"""Category, verb, and metres before the person."""

SIZES: Final = {
    "table": (1.5, 0.72),
    "board": (1.4, 1.7),
    "poster": (0.8, 1.6),
    "television": (1.1, 1.5),
    "statues": (0.6, 1.7),
    "standee": (0.6, 1.6),
    "door": (0.9, 2.0),
    "trolley": (0.7, 0.42),
    "trash_bin": (0.45, 0.8),
    "chair/sofa": (0.5, 0.85),
    "shelf": (1.0, 1.5),
    "pole/trafficcone": (0.35, 0.7),
}
"""Width and height in metres of what stands in the world."""


@dataclass(frozen=True)
class Thing:
    """One thing: its category in `schema.things.OBJECTS`, a number within the category, and the person who carries or
    moves it (`NOBODY` for what stands in the world)."""

    category: str
    number: int
    owner: int
    standing: bool


@dataclass(frozen=True)
class Handling:
    """Runs of handling, each an array of n: ticks [first, last], the person's place, the thing's, the verb's, the hand
    (or BELOW), and a number in [0, 1) drawn once per run."""

    first: Ints
    last: Ints
    person: Ints
    thing: Ints
    verb: Ints
    hand: Ints
    draw: Floats


@dataclass(frozen=True)
class Things:
    """The things of a sequence. For those that stand or roll (`stands`, their places in `things`), by column:
    position in the world (frames, columns), and whether they are there."""

    things: tuple[Thing, ...]
    handling: Handling
    stands: tuple[int, ...]
    x: Floats
    y: Floats
    there: Bools


class _Shelf:
    """Things as they are made, numbered per category."""

    def __init__(self, rng: Rng) -> None:
        self.things: list[Thing] = []
        self.places: dict[int, tuple[float, float]] = {}
        self._count: dict[str, int] = {}
        self._own: dict[tuple[int, str], int] = {}
        # Some sequences count from 0.
        self._from = int(rng.integers(2))

    def new(self, category: str, owner: int, standing: bool) -> int:
        number = self._count.get(category, self._from)
        self._count[category] = number + 1
        self.things.append(Thing(category, number, owner, standing))
        return len(self.things) - 1

    def own(self, person: int, category: str, standing: bool) -> int:
        """The person's thing of a category, made when it is first needed."""
        if (person, category) not in self._own:
            self._own[person, category] = self.new(category, person, standing)
        return self._own[person, category]


def things_of(rng: Rng, script: Script, motion: Motion, tick: Ints) -> Things:
    """The things that a script needs, and some more that only stand about."""
    shelf = _Shelf(rng)
    seen, doors = _surroundings(rng, script, shelf)
    rows: list[tuple[int, int, int, int, int, int]] = []
    for person in range(len(script.people)):
        party = script.people[person].party
        for hand in (RIGHT_HAND, LEFT_HAND):
            for name, action in ACTION.items():
                for first, last in runs_of(script.actions[:, person, hand] == action):
                    found = _handled(rng, shelf, name, person, seen[party], doors[party])
                    if found is not None:
                        rows.append((first, last, person, found[0], VERBS.index(found[1]), hand))
        for name, (category, verb) in _RIDDEN.items():
            for first, last in runs_of(script.pose[:, person] == POSE[name]):
                rows.append((first, last, person, shelf.own(person, category, False), VERBS.index(verb), BELOW))
    table = np.array(sorted(rows), np.int64).reshape(-1, 6)
    begin, end, who, thing, verbs, hands = table.T
    handling = Handling(begin, end, who, thing, verbs, hands, rng.random(len(table)))
    return _placed(shelf, handling, motion, tick)


def _handled(
    rng: Rng, shelf: _Shelf, action: str, person: int, seen: list[int], door: int | None
) -> tuple[int, str] | None:
    if action in _IN_HAND:
        category, verb = _IN_HAND[action][int(rng.integers(len(_IN_HAND[action])))]
        return shelf.own(person, category, False), verb
    if action in _MOVED:
        category, verb, _ = _MOVED[action]
        return shelf.own(person, category, True), verb
    if action == "interaction with door" and door is not None:
        return door, ("opening", "closing")[int(rng.integers(2))]
    if action in _IN_THE_WORLD and seen:
        return seen[int(rng.integers(len(seen)))], _IN_THE_WORLD[action]
    return None


def _surroundings(rng: Rng, script: Script, shelf: _Shelf) -> tuple[list[list[int]], list[int | None]]:
    """Per party the things to look at and its door; all stand behind where the party moves, seen from the robot."""
    seen: list[list[int]] = []
    doors: list[int | None] = []
    for party in script.parties:
        done = set(script.actions[:, list(party.members)].ravel().tolist())
        looks = done & {ACTION["looking at sth"], ACTION["pointing at sth"]}
        kinds = [_LOOKED_AT[kind] for kind in rng.permutation(len(_LOOKED_AT))[:2].tolist()] if looks else []
        seen.append([_stand(rng, shelf, party, kind) for kind in kinds])
        doors.append(_stand(rng, shelf, party, "door") if ACTION["interaction with door"] in done else None)
        if not party.hidden and rng.random() < 0.4:
            _stand(rng, shelf, party, _DECOR[int(rng.integers(len(_DECOR)))])
    return seen, doors


def _stand(rng: Rng, shelf: _Shelf, party: Party, category: str) -> int:
    thing = shelf.new(category, NOBODY, True)
    angle = party.bearing + float(rng.uniform(-1, 1)) * party.spread
    radius = min(party.far, 13.0) + float(rng.uniform(0.9, 2.4))
    shelf.places[thing] = radius * float(np.cos(angle)), radius * float(np.sin(angle))
    return thing


def _placed(shelf: _Shelf, handling: Handling, motion: Motion, tick: Ints) -> Things:
    frames = len(tick)
    stands = tuple(k for k, thing in enumerate(shelf.things) if thing.standing)
    x, y = np.zeros((frames, len(stands))), np.zeros((frames, len(stands)))
    there = np.ones((frames, len(stands)), bool)
    for column, k in enumerate(stands):
        owner = shelf.things[k].owner
        if owner == NOBODY:
            x[:, column], y[:, column] = shelf.places[k]
            continue
        ahead, used = _pushed(handling, k, tick)
        there[:, column] = used
        # In the world: where the owner is, some way before or behind.
        yaw = motion.robot[:, 2]
        px, py, heading = motion.x[:, owner], motion.y[:, owner], motion.heading[:, owner]
        px, py = px + ahead * np.cos(heading), py + ahead * np.sin(heading)
        x[:, column] = motion.robot[:, 0] + np.cos(yaw) * px - np.sin(yaw) * py
        y[:, column] = motion.robot[:, 1] + np.sin(yaw) * px + np.cos(yaw) * py
    return Things(tuple(shelf.things), handling, stands, x, y, there)


def _pushed(handling: Handling, thing: int, tick: Ints) -> tuple[Floats, Bools]:
    """Per frame, metres before the owner and whether the thing is in use."""
    ahead, used = np.zeros(len(tick)), np.zeros(len(tick), bool)
    by_verb = {VERBS.index(verb): metres for _, verb, metres in _MOVED.values()}
    for row in np.flatnonzero(handling.thing == thing).tolist():
        during = (tick >= handling.first[row]) & (tick <= handling.last[row])
        ahead[during] = by_verb[int(handling.verb[row])]
        used |= during
    return ahead, used


def at_tick(handling: Handling, tick: int) -> list[tuple[int, int, int, int]]:
    """(person, thing, verb, hand) of a tick, in a fixed order; what is done with the hands before what is sat on."""
    now = np.flatnonzero((handling.first <= tick) & (tick <= handling.last))
    columns = (handling.person, handling.thing, handling.verb, handling.hand)
    rows = zip(*(column[now].tolist() for column in columns), strict=True)
    return sorted(rows, key=lambda row: (row[0], row[3], row))


def category_code(thing: Thing) -> int:
    """The thing's category in the standard numbering."""
    return OBJECTS.index(thing.category)
