"""Intervals of facts. Consecutive frames with a fact become one row, and each closed gap becomes another row.

If a layer has labels at every frame, a gap of up to `gap_frames` frames between two frames with a label is closed. In a
closed gap, the fact is unknown. If a layer has one frame per second, consecutive keyframes are joined, and no gap is
closed.

A table of labels, such as `actions`, has only facts with a label. A second table, such as `possible_actions`, has the
closed gaps, and the facts that may be true because of other labels (`ALSO`).

A relation is true if a file states it with difficulty 1 or 2. It is unknown if a file states it only with other codes.
An interaction holds in both directions. Only people with a 2D box in the frame have relations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import HARD, UNREADABLE, UNWRITTEN, Boxes, Facts
from jrdb_avr.loaders.intervals.persons import of_people
from jrdb_avr.loaders.intervals.timeline import Timeline
from jrdb_avr.loaders.labelfiles.columns import (
    Rows,
    ascending,
    begins,
    group_rows,
    nullable,
    paired,
    ranked,
    rows_of,
    texts,
    whole_numbers,
)
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import LoadRules


@dataclass(frozen=True)
class Runs(Rows):
    """Intervals of facts (track, value), sorted by track, value and first frame."""

    track: Ints
    value: Ints
    first: Ints
    last: Ints
    certain: Bools
    gap: Bools
    difficulty: Ints
    """Highest difficulty inside each interval. `UNWRITTEN` for gaps and for facts that follow from other labels."""


def find_runs(facts: Facts, step: int, gap_frames: int = 0) -> Runs:
    """Join the frames of each fact to intervals.

    Args:
        facts: Facts in any order, without duplicates.
        step: Distance between consecutive frames.
        gap_frames: Maximum number of missing frames in a gap that is closed. 0 closes no gap.

    Returns:
        The intervals. Each closed gap is an interval too.
    """
    facts = facts.at(ascending(facts.track, facts.value, facts.frame))
    frame, track, value, certain = facts.frame, facts.track, facts.value, facts.certain
    # Frames of one kind make one run. The kinds are: certain, easy but not certain, hard, and not written.
    kind = certain.astype(np.int64) + 2 * (facts.difficulty >= HARD) + 4 * (facts.difficulty == UNWRITTEN)
    starts = np.flatnonzero(begins(track, value, kind, frame - step * np.arange(len(frame))))
    ends = np.append(starts, len(frame))[1:] - 1
    highest = np.maximum.reduceat(facts.difficulty, starts)
    solid = Runs(
        track[starts], value[starts], frame[starts], frame[ends], certain[starts], np.zeros_like(starts, bool), highest
    )
    # A gap follows row i if the next row of the same fact begins a few frames later.
    off = np.diff(frame)
    holes = np.flatnonzero(~begins(track, value)[1:] & (off > step) & (off <= gap_frames + step))
    no, yes = np.zeros_like(holes, bool), np.ones_like(holes, bool)
    unwritten = np.full(len(holes), UNWRITTEN)
    gaps = Runs(track[holes], value[holes], frame[holes] + step, frame[holes + 1] - step, no, yes, unwritten)
    runs = solid.joined([gaps])
    return runs.at(ascending(runs.track, runs.value, runs.first))


def layer_runs(line: Timeline, layer: str, facts: Facts, rules: LoadRules) -> Runs:
    """Join the facts of a layer to intervals at the step of the layer.

    Args:
        line: Frames of the sequence.
        layer: Name of the layer.
        facts: Facts of the layer.
        rules: Thresholds. Gaps are closed only if the layer has every frame.

    Returns:
        The intervals.
    """
    grid = line.grid(layer)
    step = grid.step if grid else 1
    return find_runs(facts, step, rules.gap_frames if step == 1 else 0)


def runs_table(
    line: Timeline, kind: str, runs: Runs, keys: Mapping[str, Ints], names: Sequence[str] | None = None
) -> pa.Table:
    """Return a table of intervals.

    Args:
        line: Frames of the sequence.
        kind: Name of the table.
        runs: Intervals.
        keys: Key columns by name, with one element per interval.
        names: Strings for the codes in the last key column. None keeps the numbers.

    Returns:
        The table, sorted by its key columns and the first frame.
    """
    order = ascending(*keys.values(), runs.first)
    runs = runs.at(order)
    columns: dict[str, Any] = {name: key[order] for name, key in keys.items()}
    if names is not None:
        last = [*keys][-1]
        columns[last] = texts(names, columns[last])
    difficulty = nullable(runs.difficulty, runs.difficulty == UNREADABLE, pa.int8())
    columns |= {"difficulty": difficulty, "certain": runs.certain, "gap": runs.gap}
    return line.table(kind, columns | line.span(runs.first, runs.last))


def label_tables(
    line: Timeline, kind: str, runs: Runs, keys: Mapping[str, Ints], names: Sequence[str] | None = None
) -> dict[str, pa.Table]:
    """Return the tables of facts with a label and of facts without one.

    Args:
        line: Frames of the sequence.
        kind: Name of the table of facts with a label.
        runs: Intervals.
        keys: Key columns by name, with one element per interval.
        names: Strings for the codes in the last key column. None keeps the numbers.

    Returns:
        The interval tables `<kind>` and `possible_<kind>`, by name.
    """
    written = runs.difficulty < UNWRITTEN
    return {
        half: runs_table(line, half, runs.at(rows), {name: key[rows] for name, key in keys.items()}, names)
        for half, rows in ((kind, np.flatnonzero(written)), (f"possible_{kind}", np.flatnonzero(~written)))
    }


def interactions_tables(line: Timeline, table: pa.Table, boxes: Boxes, rules: LoadRules) -> dict[str, pa.Table]:
    """Derive the interval tables of interactions.

    Args:
        line: Frames of the sequence.
        table: Annotation table `interactions`.
        boxes: Boxes of the people.
        rules: Thresholds.

    Returns:
        The tables by name.
    """
    table = table.filter(pa.array(_both_boxed(table, boxes.keys)))
    names, label = ranked(table["label"])
    source, target = whole_numbers(table, "track"), whole_numbers(table, "partner")
    runs, (low, high, label) = _relation_runs(
        line, "interactions", table, rules, (np.minimum(source, target), np.maximum(source, target), label)
    )
    # One row for each direction.
    keys = {"source": np.append(low, high), "target": np.append(high, low), "label": np.tile(label, 2)}
    return label_tables(line, "interactions", runs.joined([runs]), keys, names)


def absent_partners(table: pa.Table, boxes: pa.Table) -> int:
    """Count the interactions that give no fact, because one of the two people has no 2D box in the frame.

    Args:
        table: Annotation table `interactions`.
        boxes: Annotation table `boxes_2d`.
    """
    keys = paired(whole_numbers(boxes, "frame"), whole_numbers(boxes, "track"))
    return int((~_both_boxed(table, keys)).sum())


def handles_tables(
    line: Timeline, table: pa.Table, categories: pa.Table, boxes: Boxes, rules: LoadRules
) -> dict[str, pa.Table]:
    """Derive the interval tables of handled things. Handled people are left out, because people are not things.

    Args:
        line: Frames of the sequence.
        table: Annotation table `handles`.
        categories: Annotation table `categories`.
        boxes: Boxes of the people.
        rules: Thresholds.

    Returns:
        The tables by name.
    """
    boxed = boxes.rows(whole_numbers(table, "frame"), whole_numbers(table, "track")) >= 0
    table = table.filter(pa.array(boxed & ~of_people(whole_numbers(table, "category_id"), categories)))
    names, verb = ranked(table["verb"])
    columns = ("track", "object", "category_id")
    runs, facts = _relation_runs(line, "handles", table, rules, (*(whole_numbers(table, c) for c in columns), verb))
    return label_tables(line, "handles", runs, dict(zip((*columns, "verb"), facts, strict=True)), names)


def _both_boxed(table: pa.Table, keys: Ints) -> Bools:
    """Return the mask of the rows with a 2D box of both people. `keys` has the ascending keys of all boxes."""
    frame = whole_numbers(table, "frame")
    boxed = (rows_of(keys, paired(frame, whole_numbers(table, name))) >= 0 for name in ("track", "partner"))
    return np.logical_and(*boxed)


def _relation_runs(
    line: Timeline, layer: str, table: pa.Table, rules: LoadRules, columns: tuple[Ints, ...]
) -> tuple[Runs, tuple[Ints, ...]]:
    """Join relations to intervals. Rows with equal `columns` state the same relation.

    If several rows state a relation in one frame, the easiest code counts. Return the intervals, and the columns of
    each interval.
    """
    fact, row = group_rows(*columns)
    none = np.zeros(len(fact), np.int64)
    difficulty = table["difficulty"].fill_null(UNREADABLE).to_numpy().astype(np.int64)
    facts = Facts(whole_numbers(table, "frame"), none, fact, difficulty < HARD, difficulty)
    facts = facts.at(ascending(facts.value, facts.frame, facts.difficulty))
    runs = layer_runs(line, layer, facts.at(begins(facts.value, facts.frame)), rules)
    return runs, tuple(column[row][runs.value] for column in columns)
