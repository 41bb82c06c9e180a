"""Runs: consecutive frames with a fact become one interval, and short gaps are closed by rows of their own.

`Performs` and `MemberOf` intervals. At one frame per step, up to `gap_frames` missing frames between two frames with
the label are closed: inside, the fact is unknown. At one per second consecutive keyframes join and nothing is closed.

Intervals of relations: `Interacts` between two people, `Handles` between a person and a thing.

A relation is true where a file says it with difficulty 1 or 2 and unknown where it says it with another code only. An
interaction said in one direction holds in both. Only people with a 2D box in the frame, of any quality, have relations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.intervals.people import HARD, UNREADABLE, Boxes, Groups, Labels, rows_of
from jrdb_avr.loaders.intervals.timeline import Timeline
from jrdb_avr.loaders.labelfiles.columns import begins, constant, nullable, person_keys, ranked, texts, whole_numbers
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import INTERVALS
from jrdb_avr.schema.things import PERSON_CATEGORIES


@dataclass(frozen=True)
class Runs:
    """Intervals of facts (track, value), sorted by track, value and first frame."""

    track: Ints
    value: Ints
    first: Ints
    last: Ints
    certain: Bools
    gap: Bools
    difficulty: Ints
    """Highest difficulty inside; UNREADABLE for gaps."""


def find_runs(frame: Ints, track: Ints, value: Ints, certain: Bools, difficulty: Ints, step: int, gap: int) -> Runs:
    """Runs of rows (frame, track, value), unique, in any order. `gap`: missing frames that are closed, 0 for none."""
    order = np.lexsort((frame, value, track))
    frame, track, value = frame[order], track[order], value[order]
    certain, difficulty = certain[order], difficulty[order]
    same = (track[1:] == track[:-1]) & (value[1:] == value[:-1])
    delta = frame[1:] - frame[:-1]
    joined = same & (delta == step)
    starts = np.flatnonzero(np.append(True, ~(joined & (certain[1:] == certain[:-1])))) if len(frame) else frame
    ends = np.append(starts[1:], len(frame)) - 1 if len(frame) else frame
    # A gap follows row i when the next row of the same fact is a few frames off.
    holes = np.flatnonzero(same & (delta > step) & (delta <= gap + step)) if gap else np.empty(0, np.int64)
    highest = np.maximum.reduceat(difficulty, starts) if len(frame) else difficulty
    runs = Runs(
        np.concatenate([track[starts], track[holes]]),
        np.concatenate([value[starts], value[holes]]),
        np.concatenate([frame[starts], frame[holes] + step]),
        np.concatenate([frame[ends], frame[holes + 1] - step]),
        np.concatenate([certain[starts], np.zeros(len(holes), np.bool_)]),
        np.concatenate([np.zeros(len(starts), np.bool_), np.ones(len(holes), np.bool_)]),
        np.concatenate([highest, np.full(len(holes), UNREADABLE)]),
    )
    order = np.lexsort((runs.first, runs.value, runs.track))
    return Runs(*(getattr(runs, name)[order] for name in Runs.__dataclass_fields__))


def layer_runs(
    line: Timeline,
    layer: str,
    frame: Ints,
    track: Ints,
    value: Ints,
    certain: Bools,
    difficulty: Ints,
    rules: LoadRules,
) -> Runs:
    """As `find_runs`, at the step of a layer; gaps are closed where the layer has every frame."""
    grid = line.grid(layer)
    step = grid.step if grid else 1
    return find_runs(frame, track, value, certain, difficulty, step, rules.gap_frames if step == 1 else 0)


def action_runs(line: Timeline, labels: Labels, rules: LoadRules) -> Runs:
    """Runs of every action; `value` is the action's code."""
    columns = (labels.frame, labels.track, labels.action, labels.certain, labels.difficulty)
    return layer_runs(line, "actions", *columns, rules)


def actions_table(line: Timeline, labels: Labels, runs: Runs) -> pa.Table:
    """The interval table `actions`."""
    return pa.table(
        {
            "sequence": constant(line.sequence, len(runs.track)),
            "track": runs.track,
            "action": texts(labels.names, runs.value),
            **span_columns(line, runs.first, runs.last),
            "difficulty": nullable(runs.difficulty, runs.difficulty == UNREADABLE, pa.int8()),
            "certain": runs.certain,
            "gap": runs.gap,
        }
    ).cast(INTERVALS["actions"])


def memberships_table(line: Timeline, groups: Groups, rules: LoadRules) -> pa.Table:
    """The interval table `memberships`."""
    none = np.zeros(len(groups.frame), np.int64)
    runs = layer_runs(line, "groups", groups.frame, groups.track, groups.cluster, groups.certain, none, rules)
    return pa.table(
        {
            "sequence": constant(line.sequence, len(runs.track)),
            "track": runs.track,
            "cluster": runs.value,
            **span_columns(line, runs.first, runs.last),
            "certain": runs.certain,
            "gap": runs.gap,
        }
    ).cast(INTERVALS["memberships"])


def span_columns(line: Timeline, first: Ints, last: Ints) -> dict[str, npt.NDArray[np.generic]]:
    """The four columns of an interval: inclusive frames and their seconds."""
    return {"first": first, "last": last, "first_s": line.seconds(first), "last_s": line.seconds(last)}


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
