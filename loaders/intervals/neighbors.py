"""Interval table `beside`: positions of people relative to each other, at keyframes.

The *robot view* is derived from 2D boxes. Its facts name the first person to the left or right of a person, as the
robot sees them. The *person frame* is derived from 3D boxes with lidar points. Its facts name the sector and the
distance word of another person, relative to the direction that the person faces. Left is counter-clockwise. If one of
two people is not located, the relation is unknown, and there is no row.

If a view has more than `MAX_BESIDE` facts in the sequence, it has no rows, and all its relations are unknown. If the
column `robot_view_listed` or `person_view_listed` of the table `sightings` is true for a person, a missing row means
that the relation is false.
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
"""Maximum number of facts of a view in a sequence, before facts are joined to rows.

The number of facts grows with the square of the people at a keyframe. Each fact takes half a kilobyte of memory here,
and more in the graph.
"""

_PERSON_LABELS: Final = tuple(row.label for row in RELATIONS.values() if row.kind == "person")
_LABELS: Final = tuple(sorted((*_PERSON_LABELS, FIRST_LEFT, FIRST_RIGHT)))
_RANK: Final = np.array([_LABELS.index(label) for label in _PERSON_LABELS]).reshape(
    len(PERSON_SECTORS), len(DISTANCE_WORDS)
)


def beside_table(
    line: Timeline, boxes: Boxes, located: Located, rules: LoadRules
) -> tuple[pa.Table, tuple[bool, bool]]:
    """Derive the relations of a sequence.

    Args:
        line: Frames of the sequence.
        boxes: Boxes of the people.
        located: 3D boxes of the people.
        rules: Thresholds.

    Returns:
        The table, sorted by source, label, first frame, target and certainty. The second result is a pair: whether the
        table has the relations of the robot view, and those of the person frame. A view with more than `MAX_BESIDE`
        facts has no relations in the table.
    """
    # Facts of the robot view get one row per keyframe.
    (frame, source, target, certain, label), robot_listed = _joined(robot_view(line, boxes, rules))
    columns = {"source": source, "target": target, "label": label, "first": frame, "last": frame, "certain": certain}
    # The other facts are joined to intervals. The value of an interval encodes pair, label and certainty.
    (frame, source, target, certain, label), person_listed = _joined(person_frame(line, located, rules))
    pairs, pair = rank_values(paired(source, target))
    zeros = np.zeros(len(frame), np.int64)
    value = (pair * len(_LABELS) + label) * 2 + certain
    runs = find_runs(Facts(frame, zeros, value, certain.astype(np.bool_), zeros), KEYFRAME_STEP)
    source, target = unpaired(pairs[runs.value // (2 * len(_LABELS))])
    label = runs.value // 2 % len(_LABELS)
    more = (source, target, label, runs.first, runs.last, runs.certain)
    columns = {name: np.append(column, added) for (name, column), added in zip(columns.items(), more, strict=True)}
    order = ascending(*(columns[name] for name in ("source", "label", "first", "target", "certain")))
    columns = {name: column[order] for name, column in columns.items()}
    labels = {"label": texts(_LABELS, columns["label"]), "certain": columns["certain"].astype(np.bool_)}
    table = line.table("beside", columns | line.span(columns["first"], columns["last"]) | labels)
    return table, (robot_listed, person_listed)


def beside_warnings(sightings: pa.Table) -> list[str]:
    """Return one warning for each view that `beside_table` left out.

    Args:
        sightings: Interval table `sightings`.
    """
    tests = {
        "the first person to the left or right": len(sightings) and not pc.any(sightings["robot_view_listed"]).as_py(),
        "the place of a person as another one sees it": pc.any(sightings["located"]).as_py()
        and not pc.any(sightings["person_view_listed"]).as_py(),
    }
    end = "these facts are left out and unknown, so no question of the sequence uses them"
    return [f"more than {MAX_BESIDE:,} facts of {what}: {end}" for what, missing in tests.items() if missing]


_Facts = tuple[Ints, Ints, Ints, Bools, Ints]
"""Frame, source track, target track, certainty and code of the label of each fact."""


def _joined(blocks: Iterator[_Facts]) -> tuple[list[Ints], bool]:
    """Join the facts of all blocks to columns, and return the columns and True.

    If there are more than `MAX_BESIDE` facts, return empty columns and False. Facts are counted after each block, so
    the maximum limits the memory.
    """
    parts, count = [np.empty((5, 0), np.int64)], 0
    for block in blocks:
        count += len(block[0])
        if count > MAX_BESIDE:
            return list(parts[0]), False
        parts.append(np.stack(block))
    return list(np.hstack(parts)), True


def robot_view(line: Timeline, boxes: Boxes, rules: LoadRules) -> Iterator[_Facts]:
    """Find the first person to the left and right of each person at each keyframe. Covered people are left out.

    The search turns from a person to a side, up to `neighbor_max_deg`. The first person in clear view at least
    `neighbor_margin_deg` away may be the first person. All people before, or less than the margin behind, may be the
    first person too. The fact is certain if there are no such people. If no person in clear view is within reach, all
    people within reach may be the first person.

    Args:
        line: Frames of the sequence.
        boxes: Boxes of the people.
        rules: Thresholds.

    Yields:
        Blocks of facts.
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
    """Find the sector and the distance word of each located person near another located person, at each keyframe.

    Args:
        line: Frames of the sequence.
        located: 3D boxes of the people.
        rules: Thresholds.

    Yields:
        Blocks of facts.
    """
    reach = rules.pair_max_m + rules.pair_margin_m + SLACK
    # Relations exist only for distance words that begin below the maximum distance.
    words_within = 1 + sum(bound < rules.pair_max_m for bound in DISTANCE_BOUNDS_M)
    ahead = np.ascontiguousarray(located.center[:, 0])
    rows = np.flatnonzero(np.isin(located.frame, line.keyframes))
    for a, b in pairs_of_equal(located.frame, rows):
        # This cheap test comes first, because most pairs are far apart along one axis.
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
