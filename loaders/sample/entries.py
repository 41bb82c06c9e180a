"""What a run of ticks says, as one entry per person and frame, for the lists that label files repeat on every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jrdb_avr.schema.arrays import Bools, Floats, Ints

from .labels import HARD, annotated, occlusion
from .script import Rng
from .world import World


@dataclass(frozen=True)
class Entries:
    """Entries sorted by frame and person, arrays of n: the person who has the entry, its run, its other end (a person
    or a thing) and its difficulty; `start` (frames + 1) tells where each frame's begin."""

    person: Ints
    run: Ints
    other: Ints
    level: Ints
    start: Ints

    def at(self, frame: int) -> list[tuple[int, int, int, int]]:
        """(person, run, other, level) of a frame."""
        part = slice(int(self.start[frame]), int(self.start[frame + 1]))
        columns = (self.person, self.run, self.other, self.level)
        return list(zip(*(column[part].tolist() for column in columns), strict=True))


def _frames_of(world: World, first: Ints, last: Ints) -> tuple[Ints, Ints]:
    """The runs' places repeated once per frame, and those frames."""
    begin = world.starts[first]
    length = world.starts[last + 1] - begin
    run = np.repeat(np.arange(len(first)), length)
    before = np.cumsum(length) - length
    return run, np.arange(length.sum()) - before[run] + begin[run]


def _sorted(world: World, frame: Ints, person: Ints, run: Ints, other: Ints, level: Ints) -> Entries:
    order = np.lexsort((run, other, person, frame))
    start = np.searchsorted(frame[order], np.arange(world.frames + 1))
    return Entries(person[order], run[order], other[order], level[order], start)


def _levels(draw: Floats, hidden: Bools) -> Ints:
    """Hard labels are mostly those of people who are covered; one draw per run, as for actions."""
    return np.where(draw < np.where(hidden, 0.5, 0.04), HARD, 1 + (draw * 64).astype(np.int64) % 2)


def of_bonds(world: World, one_way: Ints) -> Entries:
    """Entries of interactions, both directions; `one_way` per run: 0 both, 1 or 2 only that of the first or second."""
    bonds = world.bonds
    here, hidden = annotated(world), occlusion(world) >= 2
    run, frame = _frames_of(world, bonds.first, bonds.last)
    run, frame = np.tile(run, 2), np.tile(frame, 2)
    back = np.arange(len(run)) >= len(run) // 2
    person = np.where(back, bonds.b[run], bonds.a[run])
    other = np.where(back, bonds.a[run], bonds.b[run])
    # A partner may have no box: annotators name also whom another box hides.
    keep = here[frame, person] & world.present[frame, other]
    keep &= np.where(back, one_way[run] != 1, one_way[run] != 2)
    run, frame, person, other = run[keep], frame[keep], person[keep], other[keep]
    level = _levels(bonds.draw[run], hidden[frame, person] | hidden[frame, other])
    return _sorted(world, frame, person, run, other, level)


def of_handling(world: World) -> Entries:
    """Entries of things handled."""
    handling = world.things.handling
    here, hidden = annotated(world), occlusion(world) >= 2
    run, frame = _frames_of(world, handling.first, handling.last)
    person, thing = handling.person[run], handling.thing[run]
    keep = here[frame, person]
    run, frame, person, thing = run[keep], frame[keep], person[keep], thing[keep]
    return _sorted(world, frame, person, run, thing, _levels(handling.draw[run], hidden[frame, person]))


def some(rng: Rng, count: int, share: float) -> Bools:
    """Which of `count` runs are chosen, a share of them but always one where there are any."""
    chosen = rng.random(count) < share
    if count and not chosen.any():
        chosen[int(rng.integers(count))] = True
    return chosen
