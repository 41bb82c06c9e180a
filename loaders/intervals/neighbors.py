"""Where people stand relative to each other, at keyframes: the interval table `beside`.

*Robot view*, from 2D boxes: the first person met when turning left or right from X. *Person frame*, from 3D boxes with
lidar points: sector and distance word of another person in X's own heading frame, left being counter-clockwise. A pair
of which one is not located has no person-frame row: that relation is unknown, which `sightings.located` tells.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import Boxes, Located, wrap
from jrdb_avr.loaders.intervals.sightings import SLACK, distance_word, person_sector
from jrdb_avr.loaders.intervals.spans import find_runs, span_columns
from jrdb_avr.loaders.intervals.timeline import Timeline
from jrdb_avr.loaders.labelfiles.columns import constant, paired, ragged, texts, unpaired
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, PERSON_SECTORS
from jrdb_avr.schema.panorama import clockwise
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, RELATIONS
from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules
from jrdb_avr.schema.tables import INTERVALS

BLOCK: Final = 1_000_000
"""Pairs of people looked at in one go."""

_PERSON_LABELS: Final = tuple(row.label for row in RELATIONS.values() if row.kind == "person")
_LABELS: Final = tuple(sorted((*_PERSON_LABELS, FIRST_LEFT, FIRST_RIGHT)))
_RANK: Final = np.array([_LABELS.index(label) for label in _PERSON_LABELS]).reshape(
    len(PERSON_SECTORS), len(DISTANCE_WORDS)
)


def beside_table(line: Timeline, boxes: Boxes, located: Located, rules: LoadRules) -> pa.Table:
    """All relations of a sequence, by source, label, first frame, target and certainty."""
    frame, source, target, certain, label = (
        np.concatenate(parts) for parts in zip(*robot_view(line, boxes, rules), strict=True)
    )
    near = [np.concatenate(parts) for parts in zip(*person_frame(line, located, rules), strict=True)]
    # One row per fact and certainty: the pair and the label are the value of a run.
    frame3, source3, target3, certain3, label3 = near
    pairs, pair = np.unique(paired(source3, target3), return_inverse=True)
    value = (pair * len(_LABELS) + label3) * 2 + certain3
    zero = np.zeros(len(frame3), np.int64)
    runs = find_runs(frame3, zero, value, certain3, zero, KEYFRAME_STEP, 0)
    run_source, run_target = unpaired(pairs[runs.value // (2 * len(_LABELS))])
    columns = {
        "source": np.concatenate([source, run_source]),
        "target": np.concatenate([target, run_target]),
        "label": np.concatenate([label, runs.value // 2 % len(_LABELS)]),
        "first": np.concatenate([frame, runs.first]),
        "last": np.concatenate([frame, runs.last]),
        "certain": np.concatenate([certain, runs.certain]),
    }
    order = np.lexsort(tuple(columns[name] for name in ("certain", "target", "first", "label", "source")))
    columns = {name: column[order] for name, column in columns.items()}
    return pa.table(
        {
            "sequence": constant(line.sequence, len(order)),
            "source": columns["source"],
            "target": columns["target"],
            "label": texts(_LABELS, columns["label"]),
            **span_columns(line, columns["first"], columns["last"]),
            "certain": columns["certain"],
        }
    ).cast(INTERVALS["beside"])


_Facts = tuple[Ints, Ints, Ints, Bools, Ints]
"""Columns frame, source track, target track, certain, label code."""


def robot_view(line: Timeline, boxes: Boxes, rules: LoadRules) -> Iterator[_Facts]:
    """First to the left and right of everybody at every keyframe, block by block.

    Turning from X, the first person at least a degree away and clearly seen settles the matter. Those met before, and
    those met less than a degree later, could be it as well; the fact is certain where there is no such other. Where
    nobody settles it within reach, everybody within reach could be it.
    """
    clear, angle = boxes.clear, boxes.angle
    yield _no_facts()
    rows = np.flatnonzero(np.isin(boxes.frame, line.keyframes))
    reach = rules.neighbor_max_deg + rules.neighbor_margin_deg
    for all_a, all_b in _pairs(boxes.frame, rows):
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
            could = np.where(
                np.isfinite(limit), turn < limit + rules.neighbor_margin_deg, turn <= rules.neighbor_max_deg
            )
            alone = np.repeat(np.add.reduceat(could.astype(np.int64), starts) == 1, counts) & np.isfinite(limit)
            code = np.full(int(could.sum()), _LABELS.index(label))
            yield boxes.frame[a][could], boxes.track[a][could], boxes.track[b][could], alone[could], code


def person_frame(line: Timeline, located: Located, rules: LoadRules) -> Iterator[_Facts]:
    """Sector and distance word of every located person for every other one near, block by block."""
    reach = rules.pair_max_m + rules.pair_margin_m + SLACK
    # Words that begin where the relation's reach ends are not of this relation.
    words_within = 1 + sum(bound < rules.pair_max_m for bound in DISTANCE_BOUNDS_M)
    yield _no_facts()
    ahead = np.ascontiguousarray(located.center[:, 0])
    rows = np.flatnonzero(np.isin(located.frame, line.keyframes))
    for a, b in _pairs(located.frame, rows):
        # Most pairs are far apart already along one axis.
        close = np.flatnonzero(np.abs(ahead[b] - ahead[a]) <= reach)
        a, b = a[close], b[close]
        offset = located.center[b] - located.center[a]
        metres = np.sqrt((offset**2).sum(axis=1))
        near = metres <= reach
        a, b, offset, metres = a[near], b[near], offset[near], metres[near]
        bearing = np.degrees(wrap(np.arctan2(offset[:, 1], offset[:, 0]) - located.heading[a]))
        sector, sector_other = person_sector(bearing, rules)
        word, word_other = distance_word(metres, rules)
        word_other = np.where(word_other < words_within, word_other, -1)
        word, word_other = (
            np.where(word < words_within, word, word_other),
            np.where(word < words_within, word_other, -1),
        )
        edge = metres >= rules.pair_max_m - rules.pair_margin_m - SLACK
        apart = np.abs(offset[:, 2]) > rules.pair_vertical_m
        certain = (sector_other < 0) & (word_other < 0) & ~edge & ~apart
        for s in (sector, sector_other):
            for d in (word, word_other):
                said = (s >= 0) & (d >= 0)
                yield (
                    located.frame[a][said],
                    located.track[a][said],
                    located.track[b][said],
                    certain[said],
                    _RANK[s[said], d[said]],
                )


def _pairs(frame: Ints, rows: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Ordered pairs of different rows of equal frames, among `rows` (ascending, grouped by frame), in blocks.

    All pairs of one first row come together, in one block.
    """
    _, first, counts = np.unique(frame[rows], return_index=True, return_counts=True)
    size = np.repeat(counts, counts)  # per row: people in its frame
    start = np.repeat(first, counts)
    block = (np.cumsum(size) - size) // BLOCK
    for number in np.unique(block):
        of = np.flatnonzero(block == number)
        of = of[size[of] > 1]
        group, place = ragged(size[of])
        a, b = rows[of[group]], rows[start[of][group] + place]
        other = a != b
        if other.any():
            yield a[other], b[other]


def _no_facts() -> _Facts:
    none = np.empty(0, np.int64)
    return none, none, none, none.astype(np.bool_), none
