"""Decide which people are in a sequence of the sample world, and their states, which change once per second.

Time runs in *ticks* of about a second. Each holds one state of every person, and begins between two keyframes
(the first with the sequence). Arrays have the shape (ticks, people).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import AGES, GENDERS, OTHER_ACTIONS, POSES

Rng = np.random.Generator
_Choice = TypeVar("_Choice")

POSE: Final = {name: i for i, name in enumerate(POSES)}
ACTION: Final = {name: i for i, name in enumerate(OTHER_ACTIONS)}
NONE: Final = -1

GAITS: Final = {
    "walking": (0.40, 1.1),
    "running": (0.13, 2.4),
    "cycling": (0.15, 2.6),
    "skating": (0.10, 1.9),
    "scootering": (0.10, 1.9),
    "going upstairs": (0.12, 0.5),
    "going downstairs": (0.0, 0.5),
}
"""Share of each gait, and its speed in metres per second. People who went up the stairs come down again."""
PATIENT_REST: Final = 0.55
"""Share of rests of patient parties with one held pose. The other rests have two, with a moment between them."""
STILL_POSES: Final = {"standing": 0.46, "sitting": 0.36, "bending": 0.13, "lying": 0.05}
PATIENT: Final = 0.65
"""Share of patient parties among parties of one or two in the open.

They hold a pose for thirteen seconds or longer, change to another for a moment, and hold one again.
"""
POSE_SECONDS: Final = (13, 22)
"""Range of the seconds of a patient person's pose, without the upper bound."""
HIDDEN: Final = 0.29
"""Share of parties behind the partitions."""
SPREAD: Final = 0.4
"""Maximum angle between the bearing and the motion of a party in the open, in radians."""

ETHNICITIES: Final = ("Caucasian/White", "Negroid/Black", "Mongoloid/Asian", "Others")
"""Spellings in the label files."""

_ON_THE_MOVE: Final = (
    *("holding sth", "looking at robot", "looking at sth", "talking on the phone"),
    *("pointing at sth", "pushing", "pulling", "greeting gestures"),
)
_AT_REST: Final = (
    *("holding sth", "looking at robot", "looking into sth", "looking at sth", "typing", "interaction with door"),
    *("eating sth", "talking on the phone", "pointing at sth", "reading", "greeting gestures", "writing"),
)
_FOR_LONG: Final = ("holding sth", "looking at sth", "looking at robot", "looking into sth")


def one_of(rng: Rng, choices: Sequence[_Choice]) -> _Choice:
    """Return a random choice. All choices are equally likely."""
    return choices[int(rng.integers(len(choices)))]


def runs_of(where: Bools) -> list[tuple[int, int]]:
    """Return the first index of each run of True, and the index after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


@dataclass(frozen=True)
class Person:
    """Constant properties of a person. `identity` chooses the colours and does not depend on `track`."""

    track: int
    identity: int
    party: int
    gender: str
    age: str
    ethnicity: str
    height: float


@dataclass(frozen=True)
class Party:
    """People who come and move together inside a polar zone, in metres and radians.

    `hidden` parties are the crowd behind the partitions. `patient` parties stay and hold their poses for long.
    """

    members: tuple[int, ...]
    hidden: bool
    patient: bool
    near: float
    far: float
    bearing: float
    spread: float


class Script:
    """States per tick: pose and up to two actions (NONE for no action), presence, and distance from the party.

    Poses and actions are indexes of the vocabularies. A party either moves or rests.
    """

    def __init__(self, rng: Rng, ticks: int, people: int) -> None:
        """Make the script of a sequence with about `people` people in view at a time."""
        self.parties = _parties(rng, people)
        self.people = _persons(rng, self.parties)
        count = len(self.people)
        self.present = np.ones((ticks, count), bool)
        self.apart = np.zeros((ticks, count), bool)
        self.pose = np.zeros((ticks, count), np.int64)
        self.actions = np.full((ticks, count, 2), NONE, np.int64)
        self.moving = np.zeros((ticks, len(self.parties)), bool)
        for index, party in enumerate(self.parties):
            move, shared = _party_moves(rng, ticks, party)
            self.moving[:, index] = move
            present_ticks = _party_presence(rng, ticks, party)
            for member in party.members:
                self.present[:, member] = present_ticks
                single = _member_poses(rng, move, shared, party.patient)
                # Some do as the first of their party does: they have the same pose.
                follows = member != party.members[0] and rng.random() < 0.4
                self.pose[:, member] = self.pose[:, party.members[0]] if follows else single
                self.actions[:, member, 0] = _member_actions(rng, move)
                self.actions[:, member, 1] = _long_action(rng, move, self.actions[:, member, 0])
            if len(party.members) > 1:
                _conversations(rng, party, move, self.actions)
                _separations(rng, party, ticks, self.apart)
        _passers_by(rng, self.parties, self.present)


def _passers_by(rng: Rng, parties: tuple[Party, ...], present: Bools) -> None:
    """Shorten the presence of an eighth of the lone people in the crowd to a second or two."""
    lone = [party.members[0] for party in parties if party.hidden and len(party.members) == 1]
    ticks = len(present)
    for person in lone[::8] if len(parties) > 8 else ():
        start = int(rng.integers(0, max(1, ticks - 2)))
        present[:, person] = False
        present[start : start + int(rng.integers(1, 3)), person] = True


def _parties(rng: Rng, people: int) -> tuple[Party, ...]:
    """Return parties until their people, weighted by presence, reach the requested number."""
    parties: list[Party] = []
    count = 0
    # People come and go: about three in four of those in the script are in view at a time.
    total = max(2, round(people / 0.77))
    first_bearing = float(rng.uniform(-np.pi, np.pi))
    hidden_bearings = rng.permutation(4) * (np.pi / 2) + rng.uniform(-0.35, 0.35, 4)
    while count < total:
        hidden = bool(rng.random() < HIDDEN)
        size = int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.40, 0.24, 0.14, 0.10, 0.07, 0.05]))
        size = min(size, total - count)
        members = tuple(range(count, count + size))
        count += size
        if hidden:
            bearing = float(hidden_bearings[rng.integers(4)])
            parties.append(Party(members, True, False, 8.5, 12.5, bearing, 0.33))
        else:
            patient = bool(size <= 2 and rng.random() < PATIENT)
            near, far = [(2.6, 6.0), (3.5, 9.0), (6.0, 14.0)][int(rng.choice(3, p=[0.4, 0.4, 0.2]))]
            # Spread round the robot by the golden angle: neighbours in time are far apart, and all are covered evenly.
            bearing = (first_bearing + 2.39996 * sum(not item.hidden for item in parties) + np.pi) % (2 * np.pi) - np.pi
            parties.append(Party(members, False, patient, near, far, float(bearing), SPREAD))
    return tuple(parties)


def _persons(rng: Rng, parties: tuple[Party, ...]) -> tuple[Person, ...]:
    count = sum(len(party.members) for party in parties)
    tracks = rng.permutation(count + count // 4)[:count].tolist()
    if 0 not in tracks:
        tracks[0] = 0
    identities = rng.permutation(4096)[:count].tolist()
    party_of = {member: index for index, party in enumerate(parties) for member in party.members}
    persons = []
    for i, (track, identity) in enumerate(zip(tracks, identities, strict=True)):
        age = AGES[int(rng.choice(5, p=[0.12, 0.14, 0.42, 0.2, 0.12]))]
        gender = one_of(rng, GENDERS)
        height = float(np.clip(rng.normal(1.25 if age == "childhood" else 1.72, 0.07), 1.1, 1.92))
        ethnicity = ETHNICITIES[track % len(ETHNICITIES)]
        persons.append(Person(track, identity, party_of[i], gender, age, ethnicity, height))
    return tuple(persons)


def _pick(rng: Rng, table: dict[str, float]) -> str:
    names = list(table)
    weights = np.array([table[name] for name in names])
    return names[int(rng.choice(len(names), p=weights / weights.sum()))]


def _party_moves(rng: Rng, ticks: int, party: Party) -> tuple[Bools, Ints]:
    """Return the ticks with motion of the party, and the pose of its members then."""
    move = np.zeros(ticks, bool)
    shared = np.full(ticks, POSE["standing"], np.int64)
    tick = 0
    moves = bool(rng.random() < 0.5)
    upstairs = False
    while tick < ticks:
        if moves:
            # Stairs are a little away from the robot.
            ways = {
                name: 1.0 if party.patient else share
                for name, (share, _) in GAITS.items()
                if share and (party.near > 3 or name != "going upstairs")
            }
            name = "going downstairs" if upstairs else _pick(rng, ways)
            # What went up for so many seconds comes down for as many.
            length = 4 if "stairs" in name else int(rng.integers(3, 8))
            upstairs = name == "going upstairs"
            move[tick : tick + length] = True
            shared[tick : tick + length] = POSE[name]
            # Now and then the gait changes on the way.
            moves = bool(not upstairs and rng.random() < 0.3)
        else:
            once = party.patient and rng.random() < PATIENT_REST
            length = int(rng.integers(*POSE_SECONDS if once else _RESTS[party.hidden, party.patient]))
            moves = True
        tick += length
    return move, shared


_RESTS: Final = {(True, False): (8, 30), (False, False): (4, 15), (False, True): (30, 46)}
"""Ranges of the seconds of rest of other, hidden and patient parties, without the upper bounds."""


def _party_presence(rng: Rng, ticks: int, party: Party) -> Bools:
    present_ticks = np.ones(ticks, bool)
    if party.patient and rng.random() < 0.5:
        return present_ticks
    chance = rng.random()
    if chance < 0.35:
        present_ticks[: int(rng.integers(2, max(3, 2 * ticks // 3)))] = False
    elif chance < 0.7:
        present_ticks[int(rng.integers(ticks // 3, ticks)) :] = False
    if rng.random() < (0.2 if party.hidden else 0.36):
        # Leaves and comes back.
        for _ in range(int(rng.integers(1, 3))):
            start = int(rng.integers(0, ticks))
            present_ticks[start : start + int(rng.integers(4, 13))] = False
    return present_ticks


def _member_poses(rng: Rng, move: Bools, shared: Ints, patient: bool) -> Ints:
    """Set poses: the party's gait while it moves, and single poses of three seconds or longer at rest.

    Patient people hold one pose for long, then another for a moment.
    """
    pose, last = shared.copy(), ""
    for tick, end in runs_of(~move):
        held = False
        while tick < end:
            held = patient and not held
            length = min(int(rng.integers(*(POSE_SECONDS if held else (3, 7) if patient else (3, 11)))), end - tick)
            if end - tick - length < 3 or (held and end - tick < POSE_SECONDS[1]):
                length = end - tick
            brief = patient and not held
            last = _pick(rng, {key: 1.0 if brief else share for key, share in STILL_POSES.items() if key != last})
            pose[tick : tick + length] = POSE[last]
            tick += length
    return pose


def _member_actions(rng: Rng, move: Bools) -> Ints:
    """Set one action at a time for three seconds or more, then a pause."""
    ticks = len(move)
    out = np.full(ticks, NONE, np.int64)
    tick = int(rng.integers(0, 5))
    while tick < ticks:
        stop = min(tick + int(rng.integers(3, 8)), ticks)
        action = ACTION[one_of(rng, _ON_THE_MOVE if move[tick] else _AT_REST)]
        # What people do at rest ends when they set off, and the other way round.
        changed = np.flatnonzero(move[tick:stop] != move[tick])
        stop = tick + int(changed[0]) if len(changed) else stop
        out[tick:stop] = action
        tick = stop + int(rng.integers(1, 5))
    return out


def _long_action(rng: Rng, move: Bools, first: Ints) -> Ints:
    """Let some people hold something or look somewhere for long, beside their other actions."""
    out = np.full(len(move), NONE, np.int64)
    if rng.random() < 0.35:
        start = int(rng.integers(0, len(move)))
        stop = start + int(rng.integers(6, 25))
        name = ACTION[one_of(rng, _FOR_LONG)]
        # A person would not do the same twice at once, nor stop for a moment because of the other slot.
        first[max(0, start - 4) : stop + 4][first[max(0, start - 4) : stop + 4] == name] = NONE
        out[start:stop] = name
    return out


def _conversations(rng: Rng, party: Party, move: Bools, actions: Ints) -> None:
    """Let the members of a resting party talk and listen in turns."""
    ticks = len(move)
    tick = int(rng.integers(0, 4))
    while tick < ticks:
        stop = min(tick + int(rng.integers(4, 8)), ticks)
        if not move[tick:stop].any() and rng.random() < 0.8:
            speaker = int(rng.choice(party.members))
            for member in party.members:
                part = "talking to someone" if member == speaker else "listening to someone"
                actions[tick:stop, member, 0] = ACTION[part]
        tick = stop + int(rng.integers(0, 3)) * 2


def _separations(rng: Rng, party: Party, ticks: int, apart: Bools) -> None:
    """Let some members join the party later, or leave it."""
    for member in party.members[1:]:
        chance = rng.random()
        if chance < 0.2:
            apart[int(rng.integers(ticks // 4, ticks)) :, member] = True
        elif chance < 0.4:
            apart[: int(rng.integers(1, 1 + 3 * ticks // 4)), member] = True
