"""Intervals of facts: consecutive frames with a fact become one row, and short gaps are closed by rows of their own.

At one frame per step, up to `gap_frames` missing frames between two frames with the label are closed: inside, the fact
is unknown. At one per second consecutive keyframes join and nothing is closed.

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

from jrdb_avr.loaders.intervals.people import HARD, UNREADABLE, Boxes, Facts, rows_of
from jrdb_avr.loaders.intervals.persons import of_people
from jrdb_avr.loaders.intervals.timeline import Timeline
from jrdb_avr.loaders.labelfiles.columns import (
    Rows,
    ascending,
    begins,
    nullable,
    paired,
    places,
    ranked,
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
    """Highest difficulty inside; UNREADABLE for gaps."""


def find_runs(facts: Facts, step: int, gap_frames: int = 0) -> Runs:
    """Runs of facts, unique, in any order. `gap_frames`: missing frames that are closed, 0 for none."""
    facts = facts.at(ascending(facts.track, facts.value, facts.frame))
    frame, track, value, certain = facts.frame, facts.track, facts.value, facts.certain
    starts = np.flatnonzero(begins(track, value, certain.astype(np.int64), frame - step * np.arange(len(frame))))
    ends = np.append(starts, len(frame))[1:] - 1
    highest = np.maximum.reduceat(facts.difficulty, starts)
    solid = Runs(
        track[starts], value[starts], frame[starts], frame[ends], certain[starts], np.zeros_like(starts, bool), highest
    )
    # A gap follows row i when the next row of the same fact is a few frames off.
    off = np.diff(frame)
    holes = np.flatnonzero(~begins(track, value)[1:] & (off > step) & (off <= gap_frames + step))
    no, yes = np.zeros_like(holes, bool), np.ones_like(holes, bool)
    unreadable = np.full(len(holes), UNREADABLE)
    gaps = Runs(track[holes], value[holes], frame[holes] + step, frame[holes + 1] - step, no, yes, unreadable)
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


def interactions_table(line: Timeline, table: pa.Table, boxes: Boxes, rules: LoadRules) -> pa.Table:
    """The interval table `interactions`, from the annotation table of that name."""
    table = table.filter(pa.array(_both_boxed(table, boxes.keys)))
    names, label = ranked(table["label"])
    source, target = whole_numbers(table, "track"), whole_numbers(table, "partner")
    runs, (low, high, label) = _relation_runs(
        line, "interactions", table, rules, (np.minimum(source, target), np.maximum(source, target), label)
    )
    # One row for each direction.
    keys = {"source": np.append(low, high), "target": np.append(high, low), "label": np.tile(label, 2)}
    return runs_table(line, "interactions", runs.joined([runs]), keys, names)


def absent_partners(table: pa.Table, boxes: pa.Table) -> int:
    """Rows of the annotation table `interactions` that give no fact, as one of the two has no 2D box in the frame."""
    keys = paired(whole_numbers(boxes, "frame"), whole_numbers(boxes, "track"))
    return int((~_both_boxed(table, keys)).sum())


def handles_table(line: Timeline, table: pa.Table, categories: pa.Table, boxes: Boxes, rules: LoadRules) -> pa.Table:
    """The interval table `handles`, from the annotation tables `handles` and `categories`.

    What is done with people is not among them: they are no things.
    """
    boxed = boxes.rows(whole_numbers(table, "frame"), whole_numbers(table, "track")) >= 0
    table = table.filter(pa.array(boxed & ~of_people(whole_numbers(table, "category_id"), categories)))
    names, verb = ranked(table["verb"])
    columns = ("track", "object", "category_id")
    runs, facts = _relation_runs(line, "handles", table, rules, (*(whole_numbers(table, c) for c in columns), verb))
    return runs_table(line, "handles", runs, dict(zip((*columns, "verb"), facts, strict=True)), names)


def _both_boxed(table: pa.Table, keys: Ints) -> Bools:
    """Rows whose two people have a 2D box in the frame; `keys` are those of the boxes, ascending."""
    frame = whole_numbers(table, "frame")
    source, target = (rows_of(keys, paired(frame, whole_numbers(table, name))) for name in ("track", "partner"))
    return np.asarray((source >= 0) & (target >= 0))


def _relation_runs(
    line: Timeline, layer: str, table: pa.Table, rules: LoadRules, columns: tuple[Ints, ...]
) -> tuple[Runs, tuple[Ints, ...]]:
    """Runs of the relations that equal columns state, and the columns of each run.

    Statements of one fact in one frame are merged: the easier code counts.
    """
    fact, columns = _distinct(columns)
    none = np.zeros(len(fact), np.int64)
    certain = table["difficulty"].fill_null(UNREADABLE).to_numpy() < HARD
    facts = Facts(whole_numbers(table, "frame"), none, fact, certain, none)
    facts = facts.at(ascending(facts.value, facts.frame, ~facts.certain))
    runs = layer_runs(line, layer, facts.at(begins(facts.value, facts.frame)), rules)
    return runs, tuple(column[runs.value] for column in columns)


def _distinct(columns: tuple[Ints, ...]) -> tuple[Ints, tuple[Ints, ...]]:
    """Numbers the distinct rows of columns; per number, the values of each column."""
    code = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        values, place = places(column)
        _, code = places(code * max(len(values), 1) + place)
    row = np.empty(int(code.max(initial=-1)) + 1, np.int64)
    row[code] = np.arange(len(code))
    return code, tuple(column[row] for column in columns)
