"""Where people stand relative to each other, at keyframes: the interval table `beside`.

*Robot view*, from 2D boxes: the first person met when turning left or right from X. *Person frame*, from 3D boxes with
lidar points: sector and distance word of another person in X's own heading frame, left being counter-clockwise. A pair
of which one is not located has no person-frame row: that relation is unknown.

A view with more than `MAX_BESIDE` facts in the sequence has no rows either, and all its relations are unknown. The
columns `robot_view_listed` and `person_view_listed` of the table `sightings` tell of whom a missing row means false.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.intervals.people import Boxes, Facts, Located, wrap
from jrdb_avr.loaders.intervals.sightings import distance_word, in_person_sector
from jrdb_avr.loaders.intervals.spans import find_runs
from jrdb_avr.loaders.intervals.timeline import Timeline
from jrdb_avr.loaders.labelfiles.columns import ascending, paired, pairs_of_equal, rank_values, texts, unpaired
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, PERSON_SECTORS
from jrdb_avr.schema.panorama import clockwise
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, RELATIONS
from jrdb_avr.schema.rules import KEYFRAME_STEP, SLACK, LoadRules

MAX_BESIDE: Final = 1_000_000
"""Maximum number of facts of a view in a sequence, before they are joined to rows. Facts grow with the square of the
people at a keyframe, and each takes half a kilobyte here and more in the graph."""

_PERSON_LABELS: Final = tuple(row.label for row in RELATIONS.values() if row.kind == "person")
_LABELS: Final = tuple(sorted((*_PERSON_LABELS, FIRST_LEFT, FIRST_RIGHT)))
_RANK: Final = np.array([_LABELS.index(label) for label in _PERSON_LABELS]).reshape(
    len(PERSON_SECTORS), len(DISTANCE_WORDS)
)


def beside_table(
    line: Timeline, boxes: Boxes, located: Located, rules: LoadRules
) -> tuple[pa.Table, tuple[bool, bool]]:
    """Return the relations of a sequence, and whether those of the robot view and of the person frame are listed.

    Rows are sorted by source, label, first frame, target and certainty. A view with more than `MAX_BESIDE` facts has no
    rows.
    """
    # Those seen by the robot are one row per keyframe.
    (frame, source, target, certain, label), robot_listed = _joined(robot_view(line, boxes, rules))
    columns = {"source": source, "target": target, "label": label, "first": frame, "last": frame, "certain": certain}
    # Of the others, one row per fact and certainty: the pair and the label are the value of a run.
    (frame, source, target, certain, label), person_listed = _joined(person_frame(line, located, rules))
    pairs, pair = rank_values(paired(source, target))
    none = np.zeros(len(frame), np.int64)
    value = (pair * len(_LABELS) + label) * 2 + certain
    runs = find_runs(Facts(frame, none, value, certain.astype(np.bool_), none), KEYFRAME_STEP)
    source, target = unpaired(pairs[runs.value // (2 * len(_LABELS))])
    label = runs.value // 2 % len(_LABELS)
    more = (source, target, label, runs.first, runs.last, runs.certain)
    columns = {name: np.append(column, other) for (name, column), other in zip(columns.items(), more, strict=True)}
    order = ascending(*(columns[name] for name in ("source", "label", "first", "target", "certain")))
    columns = {name: column[order] for name, column in columns.items()}
    labels = {"label": texts(_LABELS, columns["label"]), "certain": columns["certain"].astype(np.bool_)}
    table = line.table("beside", columns | line.span(columns["first"], columns["last"]) | labels)
    return table, (robot_listed, person_listed)


def beside_warnings(sightings: pa.Table) -> list[str]:
    """Return a warning for each view that `beside_table` left out, by the interval table `sightings`."""
    tests = {
        "the first person to the left or right": len(sightings) and not pc.any(sightings["robot_view_listed"]).as_py(),
        "the place of a person as another one sees it": pc.any(sightings["located"]).as_py()
        and not pc.any(sightings["person_view_listed"]).as_py(),
    }
    end = "these facts are left out and unknown, so no question of the sequence uses them"
    return [f"more than {MAX_BESIDE:,} facts of {what}: {end}" for what, missing in tests.items() if missing]


_Facts = tuple[Ints, Ints, Ints, Bools, Ints]
"""Columns frame, source track, target track, certain, label code."""


def _joined(blocks: Iterator[_Facts]) -> tuple[list[Ints], bool]:
    """Return the columns of all blocks and True. If there are more than `MAX_BESIDE` facts, return none and False.

    Facts are counted block by block, so that memory is bounded by the maximum.
    """
    parts, count = [np.empty((5, 0), np.int64)], 0
    for block in blocks:
        count += len(block[0])
        if count > MAX_BESIDE:
            return list(parts[0]), False
        parts.append(np.stack(block))
    return list(np.hstack(parts)), True


def robot_view(line: Timeline, boxes: Boxes, rules: LoadRules) -> Iterator[_Facts]:
    """First to the left and right of everybody at every keyframe, block by block.

    Covered people are left out. Turning from X, the first person at least a degree away and clearly seen settles the
    matter. Those met before, and those met less than a degree later, could be it as well; the fact is certain where
    there is no such other. Where nobody settles it within reach, everybody within reach could be it.
    """
    clear, angle = boxes.clear, boxes.angle
    rows = np.flatnonzero(np.isin(boxes.frame, line.keyframes) & ~boxes.covered)
    reach = rules.neighbor_max_deg + rules.neighbor_margin_deg
    for all_a, all_b in pairs_of_equal(boxes.frame, rows):
        right = clockwise(angle[all_a], angle[all_b])
        for label, turned in ((FIRST_LEFT, np.where(right > 0, 360.0 - right, 0.0)), (FIRST_RIGHT, right)):
            near = np.flatnonzero(turned <= reach)
            if not len(near):
                continue
            a, b, turn = all_a[near], all_b[near], turned[near]
            settles = clear[b] & (turn >= rules.neighbor_margin_deg) & (turn <= rules.neighbor_max_deg)
            starts = np.flatnonzero(np.append(True, a[1:] != a[:-1]))
            counts = np.diff(np.append(starts, len(a)))
            settled = np.minimum.reduceat(np.where(settles, turn, np.inf), starts)
            limit = np.repeat(settled, counts)
            before = turn < limit + rules.neighbor_margin_deg
            could = np.where(np.isfinite(limit), before, turn <= rules.neighbor_max_deg)
            alone = np.repeat(np.add.reduceat(could.astype(np.int64), starts) == 1, counts) & np.isfinite(limit)
            code = np.full(int(could.sum()), _LABELS.index(label))
            yield boxes.frame[a][could], boxes.track[a][could], boxes.track[b][could], alone[could], code


def person_frame(line: Timeline, located: Located, rules: LoadRules) -> Iterator[_Facts]:
    """Sector and distance word of every located person for every other one near, block by block."""
    reach = rules.pair_max_m + rules.pair_margin_m + SLACK
    # Words that begin where the relation's reach ends are not of this relation.
    words_within = 1 + sum(bound < rules.pair_max_m for bound in DISTANCE_BOUNDS_M)
    ahead = np.ascontiguousarray(located.center[:, 0])
    rows = np.flatnonzero(np.isin(located.frame, line.keyframes))
    for a, b in pairs_of_equal(located.frame, rows):
        # Most pairs are far apart already along one axis.
        close = np.flatnonzero(np.abs(ahead[b] - ahead[a]) <= reach)
        a, b = a[close], b[close]
        offset = located.center[b] - located.center[a]
        metres = np.sqrt((offset**2).sum(axis=1))
        near = metres <= reach
        a, b, offset, metres = a[near], b[near], offset[near], metres[near]
        bearing = np.degrees(wrap(np.arctan2(offset[:, 1], offset[:, 0]) - located.heading[a]))
        word, word_other = distance_word(metres, rules)
        word_other = np.where(word_other < words_within, word_other, -1)
        beyond = word >= words_within
        word, word_other = np.where(beyond, word_other, word), np.where(beyond, -1, word_other)
        edge = metres >= rules.pair_max_m - rules.pair_margin_m - SLACK
        apart = np.abs(offset[:, 2]) > rules.pair_vertical_m
        certain = (word_other < 0) & ~edge & ~apart
        for rank, sector in zip(_RANK, PERSON_SECTORS.values(), strict=True):
            true, possible = in_person_sector(bearing, sector)
            for d in (word, word_other):
                could = possible & (d >= 0)
                x, y = a[could], b[could]
                yield located.frame[x], located.track[x], located.track[y], (certain & true)[could], rank[d[could]]
