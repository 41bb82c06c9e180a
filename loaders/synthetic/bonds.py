"""What people of the sample world do with one another: interactions that follow from their script."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.script import ACTION, POSE, Party, Rng, Script
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import INTERACTIONS, POSES

LABEL: Final = {name: i for i, name in enumerate(INTERACTIONS)}

_POSTURE: Final = {
    "walking": "walking together",
    "standing": "standing together",
    "sitting": "sitting together",
    "going upstairs": "going upstairs together",
    "going downstairs": "going downstairs together",
    "running": "moving together",
    "skating": "moving together",
    "scootering": "moving together",
    "cycling": "cycling together",
    "bending": "bending together",
}
_SHARED: Final = {
    "looking at robot": "looking at robot together",
    "looking at sth": "looking at sth together",
    "looking into sth": "looking into sth together",
    "eating sth": "eating together",
    "holding sth": "holding sth together",
    "pointing at sth": "pointing at sth together",
    "interaction with door": "interaction with door together",
}
_WELCOMES: Final = ("hugging", "shaking hand", "waving hand together")


@dataclass(frozen=True)
class Bonds:
    """Runs of interactions, each an array of n: ticks [first, last], places of the two people (a < b) and of the
    label, and a number in [0, 1) drawn once per run."""

    first: Ints
    last: Ints
    a: Ints
    b: Ints
    label: Ints
    draw: npt.NDArray[np.float64]


def runs_of(where: Bools) -> list[tuple[int, int]]:
    """First and last place of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))


def bonds_of(rng: Rng, script: Script) -> Bonds:
    """All interactions of a script, in a fixed order."""
    rows: list[tuple[int, int, int, int, int]] = []
    for party in script.parties:
        for a, b in combinations(party.members, 2):
            for label, where in _pair(rng, script, party, a, b).items():
                rows += [(first, last, a, b, label) for first, last in runs_of(where)]
    table = np.array(rows, np.int64).reshape(-1, 5)
    draw = rng.random(len(table))
    return Bonds(table[:, 0], table[:, 1], table[:, 2], table[:, 3], table[:, 4], draw)


def _pair(rng: Rng, script: Script, party: Party, a: int, b: int) -> dict[int, Bools]:
    """Per label the ticks at which two members of a party are bound by it."""
    here = script.present[:, a] & script.present[:, b]
    together = here & ~script.apart[:, a] & ~script.apart[:, b]
    out: dict[int, Bools] = {}
    for pose, label in _POSTURE.items():
        where = together & (script.pose[:, a] == POSE[pose]) & (script.pose[:, b] == POSE[pose])
        out[LABEL[label]] = out.get(LABEL[label], np.zeros_like(where)) | where
    doing = {name: (script.actions == ACTION[name]).any(axis=2) for name in ("talking to someone", *_SHARED)}
    for action, label in _SHARED.items():
        out[LABEL[label]] = together & doing[action][:, a] & doing[action][:, b]
    listening = (script.actions == ACTION["listening to someone"]).any(axis=2)
    talking = doing["talking to someone"]
    said = (talking[:, a] & listening[:, b]) | (talking[:, b] & listening[:, a])
    out[LABEL["conversation"]] = together & said
    met = together[1:] & ~together[:-1]
    for tick in (np.flatnonzero(met) + 1).tolist():
        if here[max(0, tick - 2) : tick].all() and _walks(script, tick - 1, a, b):
            _mark(out, "walking toward each other", here, tick - 2, tick)
        if rng.random() < 0.5:
            _mark(out, _WELCOMES[int(rng.integers(3))], together, tick, tick + int(rng.integers(1, 3)))
    # Now and then also without a meeting, between those who stand.
    upright = together & (script.pose[:, a] == POSE["standing"]) & (script.pose[:, b] == POSE["standing"])
    for tick in np.flatnonzero(upright & (rng.random(len(upright)) < 0.02)).tolist():
        _mark(out, _WELCOMES[int(rng.integers(3))], upright, tick, tick + 2)
    return out


def _walks(script: Script, tick: int, a: int, b: int) -> bool:
    return POSES.index("walking") in (script.pose[tick, a], script.pose[tick, b])


def _mark(out: dict[int, Bools], name: str, allowed: Bools, start: int, stop: int) -> None:
    where = out.setdefault(LABEL[name], np.zeros_like(allowed))
    start = max(0, start)
    where[start:stop] |= allowed[start:stop]


def shown(bonds: Bonds, tick: int, who: Ints) -> dict[int, tuple[int, int]]:
    """Person -> (partner, label) that the marks show at a tick, among the people `who`.

    A mark has room for one. Each relation shall be seen on one of its two people: those that bind a person to one
    partner alone come first, rare labels before common ones; then free marks repeat what they take part in.
    """
    there = np.zeros(int(max(bonds.a.max(initial=-1), bonds.b.max(initial=-1), who.max(initial=-1))) + 1, bool)
    there[who] = True
    now = (bonds.first <= tick) & (tick <= bonds.last)
    now &= there[bonds.a] & there[bonds.b]
    pairs = list(zip(bonds.a[now].tolist(), bonds.b[now].tolist(), bonds.label[now].tolist(), strict=True))
    partners: dict[tuple[int, int], int] = {}
    for a, b, label in pairs:
        partners[a, label] = partners.get((a, label), 0) + 1
        partners[b, label] = partners.get((b, label), 0) + 1
    pairs.sort(key=lambda p: (min(partners[p[0], p[2]], partners[p[1], p[2]]), _RANK[p[2]], p))
    out: dict[int, tuple[int, int]] = {}
    for a, b, label in pairs:
        one, other = (a, b) if partners[a, label] <= partners[b, label] else (b, a)
        if one not in out:
            out[one] = other, label
        elif other not in out:
            out[other] = one, label
    for a, b, label in pairs:
        out.setdefault(a, (b, label))
        out.setdefault(b, (a, label))
    return out


_RANK: Final = [
    1 if name in ("conversation", "sitting together") else 2 if name in ("walking together", "standing together") else 0
    for name in INTERACTIONS
]
