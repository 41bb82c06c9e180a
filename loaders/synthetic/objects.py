"""Make the things of the sample world, and decide which person handles which thing.

Things are carried (drawn with their owner: in the hand, below the body), moved along (trolleys), or stand in the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from jrdb_avr.loaders.synthetic.interactions import RelationRuns
from jrdb_avr.loaders.synthetic.motion import Motion
from jrdb_avr.loaders.synthetic.script import ACTION, POSE, Party, Rng, Script, one_of, runs_of
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.things import VERBS

RIGHT_HAND, LEFT_HAND, BELOW = range(3)
"""Positions of handled things in a drawing: in a hand, or under the body."""

_IN_HAND: Final = {
    "typing": (("peripheral", "using"),),
    "talking on the phone": (("phone", "talking on"),),
    "eating sth": (("tableware", "using"),),
    "reading": (("document", "looking into"),),
    "writing": (("document", "handling/manipulating"),),
    "looking into sth": (("phone", "looking into"), ("box", "looking into"), ("bag", "looking into")),
    "holding sth": (
        *(("bag", "holding"), ("phone", "holding"), ("waterbottle", "holding"), ("box", "carrying")),
        *(("document", "holding"), ("umbrella", "holding"), ("jacket", "carrying")),
    ),
}
"""Categories and verbs of things that a person may hold, by action."""
_AHEAD: Final = {"pushing": 0.85, "pulling": -0.85}
"""Distance of the trolley before the person in metres, by action and verb."""
_IN_THE_WORLD: Final = {"looking at sth": "looking at", "pointing at sth": "presenting"}
_LOOKED_AT: Final = ("board", "poster", "television", "statues", "standee")
_DECOR: Final = ("table", "trash_bin", "chair/sofa", "shelf", "pole/trafficcone")
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
"""Width and height of standing things by category, in metres."""
_RIDDEN: Final = {
    "sitting": ("chair/sofa", "sitting"),
    "cycling": ("bicycle/scooter", "riding"),
    "scootering": ("bicycle/scooter", "riding"),
    "skating": ("skateboard/segway/hoverboard", "riding"),
}


@dataclass(frozen=True)
class Thing:
    """Thing with its category in `labels.OBJECTS`, its number in it, its owner, and its position without an owner.

    The owner is the person who carries or moves the thing. `standing` is true if the thing stands or rolls.
    """

    category: str
    number: int
    owner: int | None
    standing: bool
    position: tuple[float, float] = (0.0, 0.0)


class _Maker:
    """Maker of things with numbers per category. It decides which person handles which thing."""

    def __init__(self, rng: Rng, script: Script) -> None:
        self.things: list[Thing] = []
        self._rng = rng
        self._count: dict[str, int] = {}
        self._own: dict[tuple[int, str], int] = {}
        # Some sequences count from 0.
        self._from = int(rng.integers(2))
        self._surroundings = [self._around(script, party) for party in script.parties]

    def personal(self, person: int, category: str, standing: bool = False) -> int:
        """Return the person's thing of a category. Make it at the first call."""
        if (person, category) not in self._own:
            self._own[person, category] = self._new(category, person, standing)
        return self._own[person, category]

    def handled(self, action: str, person: int, party: int) -> tuple[int, str] | None:
        """Return the thing that a person handles by an action, and the verb."""
        visible, door = self._surroundings[party]
        if action in _IN_HAND:
            category, verb = one_of(self._rng, _IN_HAND[action])
            return self.personal(person, category), verb
        if action in _AHEAD:
            return self.personal(person, "trolley", standing=True), action
        if action == "interaction with door" and door is not None:
            return door, one_of(self._rng, ("opening", "closing"))
        if action in _IN_THE_WORLD and visible:
            return one_of(self._rng, visible), _IN_THE_WORLD[action]
        return None

    def _new(self, category: str, owner: int | None, standing: bool, position: tuple[float, float] = (0.0, 0.0)) -> int:
        number = self._count.get(category, self._from)
        self._count[category] = number + 1
        self.things.append(Thing(category, number, owner, standing, position))
        return len(self.things) - 1

    def _around(self, script: Script, party: Party) -> tuple[list[int], int | None]:
        """Make the things that the party looks at, its door, and decor, farther away than the party."""
        done = set(script.actions[:, list(party.members)].ravel().tolist())
        looks = any(ACTION[action] in done for action in _IN_THE_WORLD)
        kinds = [_LOOKED_AT[kind] for kind in self._rng.permutation(len(_LOOKED_AT))[:2].tolist()] if looks else []
        visible = [self._stand(party, kind) for kind in kinds]
        door = self._stand(party, "door") if ACTION["interaction with door"] in done else None
        if not party.hidden and self._rng.random() < 0.4:
            self._stand(party, one_of(self._rng, _DECOR))
        return visible, door

    def _stand(self, party: Party, category: str) -> int:
        angle = party.bearing + float(self._rng.uniform(-1, 1)) * party.spread
        radius = min(party.far, 13.0) + float(self._rng.uniform(0.9, 2.4))
        return self._new(category, None, True, (radius * float(np.cos(angle)), radius * float(np.sin(angle))))


class Things:
    """Return the things of a sequence: the things that a script needs, and some more that do not move.

    Things that do not move or that roll (`stands`, their places in `things`) have, by column, a position in the world
    (frames, columns), and whether they are present.
    """

    def __init__(self, rng: Rng, script: Script, motion: Motion, tick: Ints) -> None:
        maker = _Maker(rng, script)
        rows: list[tuple[int, ...]] = []
        for i, person in enumerate(script.people):
            for hand in (RIGHT_HAND, LEFT_HAND):
                for name, action in ACTION.items():
                    for first, stop in runs_of(script.actions[:, i, hand] == action):
                        made = maker.handled(name, i, person.party)
                        if made is not None:
                            rows.append((first, stop - 1, i, made[0], VERBS.index(made[1]), hand))
            for pose, (category, verb) in _RIDDEN.items():
                for first, stop in runs_of(script.pose[:, i] == POSE[pose]):
                    rows.append((first, stop - 1, i, maker.personal(i, category), VERBS.index(verb), BELOW))
        self.things, self.handling = maker.things, RelationRuns(rng, sorted(rows))
        self.stands = [k for k, thing in enumerate(self.things) if thing.standing]
        self.x, self.y = np.zeros((2, len(tick), len(self.stands)))
        self.present = np.ones(self.x.shape, bool)
        for column, k in enumerate(self.stands):
            owner = self.things[k].owner
            if owner is None:
                self.x[:, column], self.y[:, column] = self.things[k].position
                continue
            ahead, self.present[:, column] = _pushed(self.handling, k, tick)
            # In the world: where the owner is, some way before or behind.
            yaw, heading = motion.robot[:, 2], motion.heading[:, owner]
            px, py = motion.x[:, owner] + ahead * np.cos(heading), motion.y[:, owner] + ahead * np.sin(heading)
            self.x[:, column] = motion.robot[:, 0] + np.cos(yaw) * px - np.sin(yaw) * py
            self.y[:, column] = motion.robot[:, 1] + np.sin(yaw) * px + np.cos(yaw) * py


def _pushed(handling: RelationRuns, thing: int, tick: Ints) -> tuple[Floats, Bools]:
    """Return, per frame, the metres before the owner and whether the thing is in use."""
    ahead, used = np.zeros(len(tick)), np.zeros(len(tick), bool)
    for row in np.flatnonzero(handling.target == thing).tolist():
        during = (tick >= handling.first[row]) & (tick <= handling.last[row])
        ahead[during] = _AHEAD[VERBS[handling.label[row]]]
        used |= during
    return ahead, used
