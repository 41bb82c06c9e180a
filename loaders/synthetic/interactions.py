"""Derive interactions of people of the sample world from their script."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np

from jrdb_avr.loaders.synthetic.script import ACTION, POSE, Rng, Script, one_of, runs_of
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import INTERACTIONS

LABEL: Final = {name: i for i, name in enumerate(INTERACTIONS)}

_POSTURES: Final = (
    *("walking", "standing", "sitting", "going upstairs", "going downstairs"),
    *("running", "skating", "scootering", "cycling", "bending"),
)
_SHARED: Final = (
    *("looking at robot", "looking at sth", "looking into sth", "eating sth"),
    *("holding sth", "pointing at sth", "interaction with door"),
)
_JOINT_NAME: Final = {"running": "moving", "skating": "moving", "scootering": "moving", "eating sth": "eating"}
"""Names of joint actions that differ from the names of the single actions."""
_WELCOMES: Final = ("hugging", "shaking hand", "waving hand together")


class RelationRuns:
    """Runs of relations. Each attribute is an array of n values.

    Attributes:
        first: First tick.
        last: Last tick.
        person: Index of the person.
        target: Index of the other person, or of the thing.
        label: Index of the label or verb.
        hand: Hand that handles the thing.
        draw: Number in [0, 1), drawn once per run.
    """

    def __init__(self, rng: Rng, rows: Sequence[tuple[int, ...]]) -> None:
        """Make runs of rows (first, last, person, other, label, hand)."""
        columns: Ints = np.array(rows, np.int64).reshape(-1, 6).T
        self.first, self.last, self.person, self.target, self.label, self.hand = columns
        self.draw = rng.random(len(rows))

    def at(self, tick: int) -> list[tuple[int, int, int, int]]:
        """Return (person, other, label, hand) of the runs at a tick, by person and hand: what is held before seats."""
        now = np.flatnonzero((self.first <= tick) & (tick <= self.last))
        rows = zip(*(x[now].tolist() for x in (self.person, self.target, self.label, self.hand)), strict=True)
        return sorted(rows, key=lambda row: (row[0], row[3], row))


def interactions_of(rng: Rng, script: Script) -> RelationRuns:
    """Return all interactions of a script in a fixed order, each once. The person's index is the lower one."""
    rows: list[tuple[int, ...]] = []
    doing = {name: (script.actions == action).any(axis=2) for name, action in ACTION.items()}
    for party in script.parties:
        for a, b in combinations(party.members, 2):
            for label, where in _pair(rng, script, doing, a, b).items():
                rows += [(first, stop - 1, a, b, LABEL[label], 0) for first, stop in runs_of(where)]
    return RelationRuns(rng, rows)


def _pair(rng: Rng, script: Script, doing: dict[str, Bools], a: int, b: int) -> dict[str, Bools]:
    """Return the ticks of each label between two members of a party."""
    meeting = script.present[:, a] & script.present[:, b]
    together = meeting & ~script.apart[:, a] & ~script.apart[:, b]
    out: dict[str, Bools] = {}

    def mark(label: str, where: Bools, start: int = 0, stop: int | None = None) -> None:
        out.setdefault(label, np.zeros_like(where))[start:stop] |= where[start:stop]

    for pose in _POSTURES:
        same = (script.pose[:, [a, b]] == POSE[pose]).all(axis=1)
        mark(f"{_JOINT_NAME.get(pose, pose)} together", together & same)
    for action in _SHARED:
        mark(f"{_JOINT_NAME.get(action, action)} together", together & doing[action][:, a] & doing[action][:, b])
    talking, listening = doing["talking to someone"], doing["listening to someone"]
    mark("conversation", together & ((talking[:, a] & listening[:, b]) | (talking[:, b] & listening[:, a])))
    for tick in (np.flatnonzero(together[1:] & ~together[:-1]) + 1).tolist():
        if meeting[max(0, tick - 2) : tick].all() and POSE["walking"] in script.pose[tick - 1, [a, b]]:
            mark("walking toward each other", meeting, max(0, tick - 2), tick)
        if rng.random() < 0.5:
            mark(one_of(rng, _WELCOMES), together, tick, tick + int(rng.integers(1, 3)))
    # Now and then also without a meeting, between standing people.
    upright = together & (script.pose[:, [a, b]] == POSE["standing"]).all(axis=1)
    for tick in np.flatnonzero(upright & (rng.random(len(upright)) < 0.02)).tolist():
        mark(one_of(rng, _WELCOMES), upright, tick, tick + 2)
    return out
