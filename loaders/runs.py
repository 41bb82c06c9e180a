"""Runs: consecutive frames with a fact become one interval, and short gaps are closed by rows of their own.

`Performs` and `MemberOf` intervals. At one frame per step, up to `gap_frames` missing frames between two frames with
the label are closed: inside, the fact is unknown. At one per second consecutive keyframes join and nothing is closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import INTERVALS

from .columns import constant, nullable, texts
from .scene_people import UNREADABLE, Groups, Labels
from .timeline import Timeline


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
