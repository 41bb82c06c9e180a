"""Intervals of facts: consecutive frames with a fact become one row, and short gaps are closed by rows of their own.

At one frame per step, up to `gap_frames` missing frames between two frames with the label are closed: inside, the fact
is unknown. At one per second consecutive keyframes join and nothing is closed.

A table of labels, such as `actions`, holds written labels only. Closed gaps, and facts that follow from the words of
other labels (`ALSO`), are rows of the table beside it, such as `possible_actions`.

A relation is true where a file states it with difficulty 1 or 2 and unknown where it does so with another code only. An
interaction stated in one direction holds in both. Only people with a 2D box in the frame, of any quality, have
relations.
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
    """Highest difficulty inside; UNWRITTEN for gaps and for what follows from other labels."""


def find_runs(facts: Facts, step: int, gap_frames: int = 0) -> Runs:
    """Runs of facts, unique, in any order. `gap_frames`: missing frames that are closed, 0 for none."""
    facts = facts.at(ascending(facts.track, facts.value, facts.frame))
    frame, track, value, certain = facts.frame, facts.track, facts.value, facts.certain
    # Certain, doubtful, not written: frames of one kind make one run.
    kind = certain.astype(np.int64) + 2 * (facts.difficulty == UNWRITTEN)
    starts = np.flatnonzero(begins(track, value, kind, frame - step * np.arange(len(frame))))
    ends = np.append(starts, len(frame))[1:] - 1
    highest = np.maximum.reduceat(facts.difficulty, starts)
    solid = Runs(
        track[starts], value[starts], frame[starts], frame[ends], certain[starts], np.zeros_like(starts, bool), highest
    )
    # A gap follows row i when the next row of the same fact is a few frames off.
    off = np.diff(frame)
    holes = np.flatnonzero(~begins(track, value)[1:] & (off > step) & (off <= gap_frames + step))
    no, yes = np.zeros_like(holes, bool), np.ones_like(holes, bool)
    unwritten = np.full(len(holes), UNWRITTEN)
    gaps = Runs(track[holes], value[holes], frame[holes] + step, frame[holes + 1] - step, no, yes, unwritten)
    runs = solid.joined([gaps])
    return runs.at(ascending(runs.track, runs.value, runs.first))


def layer_runs(line: Timeline, layer: str, facts: Facts, rules: LoadRules) -> Runs:
    """Runs at the step of a layer; gaps are closed where the layer has every frame."""
    grid = line.grid(layer)
    step = grid.step if grid else 1
    return find_runs(facts, step, rules.gap_frames if step == 1 else 0)


def runs_table(
    line: Timeline, kind: str, runs: Runs, keys: Mapping[str, Ints], names: Sequence[str] | None = None
) -> pa.Table:
    """The interval table of runs, sorted by the key columns and the first frame. `names`: texts of the last key."""
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
    """The interval tables `<kind>`, of written labels, and `possible_<kind>`, of facts that were not written."""
    written = runs.difficulty < UNWRITTEN
    return {
        half: runs_table(line, half, runs.at(rows), {name: key[rows] for name, key in keys.items()}, names)
        for half, rows in ((kind, np.flatnonzero(written)), (f"possible_{kind}", np.flatnonzero(~written)))
    }


def interactions_tables(line: Timeline, table: pa.Table, boxes: Boxes, rules: LoadRules) -> dict[str, pa.Table]:
    """The interval tables of interactions, from the annotation table `interactions`."""
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
    """Rows of the annotation table `interactions` that give no fact, as one of the two has no 2D box in the frame."""
    keys = paired(whole_numbers(boxes, "frame"), whole_numbers(boxes, "track"))
    return int((~_both_boxed(table, keys)).sum())


def handles_tables(
    line: Timeline, table: pa.Table, categories: pa.Table, boxes: Boxes, rules: LoadRules
) -> dict[str, pa.Table]:
    """The interval tables of handling, from the annotation tables `handles` and `categories`.

    What is done with people is not among them: they are no things.
    """
    boxed = boxes.rows(whole_numbers(table, "frame"), whole_numbers(table, "track")) >= 0
    table = table.filter(pa.array(boxed & ~of_people(whole_numbers(table, "category_id"), categories)))
    names, verb = ranked(table["verb"])
    columns = ("track", "object", "category_id")
    runs, facts = _relation_runs(line, "handles", table, rules, (*(whole_numbers(table, c) for c in columns), verb))
    return label_tables(line, "handles", runs, dict(zip((*columns, "verb"), facts, strict=True)), names)


def _both_boxed(table: pa.Table, keys: Ints) -> Bools:
    """Rows whose two people have a 2D box in the frame; `keys` are those of the boxes, ascending."""
    frame = whole_numbers(table, "frame")
    boxed = (rows_of(keys, paired(frame, whole_numbers(table, name))) >= 0 for name in ("track", "partner"))
    return np.logical_and(*boxed)


def _relation_runs(
    line: Timeline, layer: str, table: pa.Table, rules: LoadRules, columns: tuple[Ints, ...]
) -> tuple[Runs, tuple[Ints, ...]]:
    """Runs of the relations that equal columns state, and the columns of each run.

    Statements of one fact in one frame are merged: the easier code counts.
    """
    fact, row = group_rows(*columns)
    none = np.zeros(len(fact), np.int64)
    difficulty = table["difficulty"].fill_null(UNREADABLE).to_numpy().astype(np.int64)
    facts = Facts(whole_numbers(table, "frame"), none, fact, difficulty < HARD, difficulty)
    facts = facts.at(ascending(facts.value, facts.frame, facts.difficulty))
    runs = layer_runs(line, layer, facts.at(begins(facts.value, facts.frame)), rules)
    return runs, tuple(column[row][runs.value] for column in columns)
