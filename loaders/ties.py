"""Intervals of relations: `Interacts` between two people, `Handles` between a person and a thing.

A relation is true where a file says it with difficulty 1 or 2 and unknown where it says it with another code only. An
interaction said in one direction holds in both. Only people with a 2D box in the frame, of any quality, have relations.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import INTERVALS
from jrdb_avr.schema.things import PERSON_CATEGORIES

from .columns import begins, constant, person_keys, ranked, texts, whole_numbers
from .runs import Runs, layer_runs, span_columns
from .scene_people import HARD, UNREADABLE, Boxes, rows_of
from .timeline import Timeline


def interactions_table(line: Timeline, table: pa.Table, boxes: Boxes, rules: LoadRules) -> pa.Table:
    """The interval table `interactions`, from the annotation table of that name."""
    table = table.filter(pa.array(_both_there(table, boxes.keys)))
    names, label = ranked(table["label"])
    frame, source, target = (whole_numbers(table, name) for name in ("frame", "track", "partner"))
    low, high = np.minimum(source, target), np.maximum(source, target)
    fact, (low, high, label) = _distinct(low, high, label)
    runs = _runs(line, "interactions", frame, fact, table, rules)
    # One row for each direction.
    source, target = np.append(low[runs.value], high[runs.value]), np.append(high[runs.value], low[runs.value])
    first, last, label = np.tile(runs.first, 2), np.tile(runs.last, 2), np.tile(label[runs.value], 2)
    order = np.lexsort((first, label, target, source))
    columns = {
        "sequence": constant(line.sequence, len(order)),
        "source": source[order],
        "target": target[order],
        "label": texts(names, label[order]),
        **span_columns(line, first[order], last[order]),
        "certain": np.tile(runs.certain, 2)[order],
        "gap": np.tile(runs.gap, 2)[order],
    }
    return pa.table(columns).cast(INTERVALS["interactions"])


def absent_partners(table: pa.Table, boxes: pa.Table) -> int:
    """Rows of the annotation table `interactions` that give no fact, as one of the two has no 2D box in the frame."""
    keys = person_keys(whole_numbers(boxes, "frame"), whole_numbers(boxes, "track"))
    return int((~_both_there(table, keys)).sum())


def handles_table(line: Timeline, table: pa.Table, categories: pa.Table, boxes: Boxes, rules: LoadRules) -> pa.Table:
    """The interval table `handles`, from the annotation tables `handles` and `categories`.

    What is done with people is not among them: they are no things.
    """
    frame, track, category = (whole_numbers(table, name) for name in ("frame", "track", "category_id"))
    people = pc.is_in(categories["category"], pa.array(sorted(PERSON_CATEGORIES)))
    person_ids = categories["category_id"].filter(people).to_numpy()
    table = table.filter(pa.array((boxes.rows(frame, track) >= 0) & ~np.isin(category, person_ids)))
    names, verb = ranked(table["verb"])
    frame, track, thing, category = (whole_numbers(table, name) for name in ("frame", "track", "object", "category_id"))
    fact, (track, thing, category, verb) = _distinct(track, thing, category, verb)
    runs = _runs(line, "handles", frame, fact, table, rules)
    order = np.lexsort((runs.first, verb[runs.value], category[runs.value], thing[runs.value], track[runs.value]))
    value = runs.value[order]
    columns = {
        "sequence": constant(line.sequence, len(order)),
        "track": track[value],
        "object": thing[value],
        "category_id": category[value],
        "verb": texts(names, verb[value]),
        **span_columns(line, runs.first[order], runs.last[order]),
        "certain": runs.certain[order],
        "gap": runs.gap[order],
    }
    return pa.table(columns).cast(INTERVALS["handles"])


def _both_there(table: pa.Table, keys: Ints) -> Bools:
    """Rows whose two people have a 2D box in the frame; `keys` are those of the boxes, ascending."""
    frame, source, target = (whole_numbers(table, name) for name in ("frame", "track", "partner"))
    there = [rows_of(keys, person_keys(frame, track)) >= 0 for track in (source, target)]
    return np.asarray(there[0] & there[1])


def _runs(line: Timeline, layer: str, frame: Ints, fact: Ints, table: pa.Table, rules: LoadRules) -> Runs:
    """Runs of facts, sayings of one fact in one frame merged: the easier code counts. `value` is the fact."""
    hard = table["difficulty"].fill_null(UNREADABLE).to_numpy() >= HARD
    order = np.lexsort((hard, frame, fact))
    frame, fact, hard = frame[order], fact[order], hard[order]
    first = begins(fact, frame)
    frame, fact, hard = frame[first], fact[first], hard[first]
    none = np.zeros(len(frame), np.int64)
    return layer_runs(line, layer, frame, none, fact, ~hard, none, rules)


def _distinct(*columns: Ints) -> tuple[Ints, tuple[Ints, ...]]:
    """Numbers the distinct rows of columns; per number, the values of each column."""
    code = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        values, place = np.unique(column, return_inverse=True)
        _, code = np.unique(code * max(len(values), 1) + place, return_inverse=True)
    _, first = np.unique(code, return_index=True)
    return code, tuple(column[first] for column in columns)
