"""Stable segments of actions. A person visibly begins the action, continues it, and (in a closed segment) ends it.

At each frame of the action layer's grid, an action of a person is true, false or unknown. It is unknown at grid frames
that are not annotated. A run is a sequence of consecutive grid frames that cannot be extended. At each frame of a run,
the action is true and the person is in clear view, or the frame is in a closed gap. A run is a stable segment if three
conditions hold. The run is long enough. During the second before the run, the action is false and the person is in
clear view. During three seconds before and after the run, the action is false. Frames outside the grid do not count.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import People
from jrdb_avr.loaders.intervals.spans import Runs
from jrdb_avr.loaders.intervals.timeline import Grid, Timeline
from jrdb_avr.loaders.labelfiles.columns import Rows, ascending, begins, distinct_of, paired, ragged, texts, unpaired
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules, frames
from jrdb_avr.schema.tables import INTERVALS

HALF_STEP = KEYFRAME_STEP // 2
"""Half of the step between keyframes.

With one label per second, answers state that an action begins half a step before its first label, and that it ends
half a step after its last label.
"""

_BLOCK: Final = 500_000
"""Approximate maximum number of cells in a block. All actions of one person are in one block, even if it is larger."""


def segments_table(line: Timeline, people: People, runs: Runs, rules: LoadRules) -> pa.Table:
    """Derive the interval table `segments`, sorted by track, action and first frame.

    Args:
        line: Frames of the sequence.
        people: People of the sequence.
        runs: Intervals of actions.
        rules: Thresholds.
    """
    grid = line.grid("actions")
    if grid is None or not len(runs.track):
        return INTERVALS["segments"].empty_table()
    facts = _Facts(grid, people, runs)
    parts = (_find(_Cells(facts, *block), facts.keys, grid, rules) for block in facts.blocks())
    segments = next(parts).joined([*parts])
    half = 0 if grid.step == 1 else HALF_STEP
    columns = {name: getattr(segments, name) for name in ("track", "first", "last", "quiet_from", "closed")}
    columns |= {"start": segments.first - half, "end": segments.last + half}
    columns |= {"action": texts(people.actions.names, segments.action)}
    return line.table("segments", columns)


@dataclass(frozen=True)
class _Segments(Rows):
    track: Ints
    action: Ints
    first: Ints
    last: Ints
    quiet_from: Ints
    closed: Bools


class _Facts:
    """Facts (track, action) of a sequence, with the boxes and the labels of each fact."""

    def __init__(self, grid: Grid, people: People, runs: Runs) -> None:
        boxes, labels = people.boxes, people.actions
        self.grid, self.boxes, self.labels, self.runs, self.posed = grid, boxes, labels, runs, people.pose >= 0
        self.keys = distinct_of(paired(runs.track, runs.value))
        self.of_runs = np.searchsorted(self.keys, paired(runs.track, runs.value))
        on_grid = np.flatnonzero(grid.holds(boxes.frame))
        self.by_track = on_grid[ascending(boxes.track[on_grid])]
        ordered = boxes.track[self.by_track]
        track, _ = unpaired(self.keys)
        self.low = np.searchsorted(ordered, track, "left")
        self.count = np.searchsorted(ordered, track, "right") - self.low
        # A label needs a box, because the tables have no labels of refused boxes.
        has_box = np.flatnonzero(boxes.rows(labels.frame, labels.track) >= 0)
        of_labels = np.searchsorted(self.keys, paired(labels.track[has_box], labels.value[has_box]))
        order = ascending(of_labels)
        self.label_rows, self.of_labels = has_box[order], of_labels[order]

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Yield blocks of facts with about `_BLOCK` cells: the first fact, and the fact after the last one."""
        starts = np.flatnonzero(begins(np.cumsum(self.count) // _BLOCK)).tolist()
        yield from zip(starts, [*starts[1:], len(self.keys)], strict=True)


class _Cells:
    """Cells of a block of facts. A cell is a pair of a fact and a grid frame.

    A pair is a cell if the person has a box at the frame, or if the frame is in a closed gap. In all other pairs, the
    fact is unknown. The block has the facts from `begin` to `end - 1`. The cells are sorted by `key`, which is
    fact * span + index of the frame on the grid.
    """

    def __init__(self, facts: _Facts, begin: int, end: int) -> None:
        grid, boxes, labels, runs = facts.grid, facts.boxes, facts.labels, facts.runs
        self.span = grid.size + 1
        of_block = slice(*np.searchsorted(facts.of_runs, [begin, end]))
        first, last = runs.first[of_block], runs.last[of_block]
        gap_run, offset = ragged(np.where(runs.gap[of_block], (last - first) // grid.step + 1, 0))
        gap_keys = facts.of_runs[of_block][gap_run] * self.span + grid.index(first[gap_run]) + offset

        fact, offset = ragged(facts.count[begin:end])
        row = facts.by_track[facts.low[begin:end][fact] + offset]
        fact += begin
        box_keys = fact * self.span + grid.index(boxes.frame[row])

        # Both arrays are ascending, and a stable sort merges them in linear time.
        self.key = distinct_of(np.sort(np.concatenate([box_keys, gap_keys]), kind="stable"))
        pose = labels.is_pose[unpaired(facts.keys)[1]]
        of_block = slice(*np.searchsorted(facts.of_labels, [begin, end]))
        label = facts.label_rows[of_block]
        label_keys = facts.of_labels[of_block] * self.span + grid.index(labels.frame[label])

        listed, clear, pose_known, named, true, gap = np.zeros((6, len(self.key)), np.bool_)
        at = np.searchsorted(self.key, box_keys)
        listed[at], clear[at], pose_known[at] = boxes.listed[row], boxes.clear[row], ~pose[fact] | facts.posed[row]
        at = np.searchsorted(self.key, label_keys)
        named[at], true[at] = True, labels.certain[label]
        gap[np.searchsorted(self.key, gap_keys)] = True
        self.false = listed & pose_known & ~named & ~gap
        self.false_clear = self.false & clear
        self.inside = (true & clear) | gap


def _find(cells: _Cells, keys: Ints, grid: Grid, rules: LoadRules) -> _Segments:
    """Return the stable segments of a block of facts."""
    key, step = cells.key, grid.step
    next_to = np.append(False, key[1:] == key[:-1] + 1)
    starts = np.flatnonzero(cells.inside & ~(next_to & np.append(False, cells.inside[:-1])))
    ends = np.flatnonzero(cells.inside & ~np.append(next_to[1:] & cells.inside[1:], False))
    fact, first = np.divmod(key[starts], cells.span)
    last = key[ends] % cells.span
    # Lengths are in grid steps.
    least = -(-frames(rules.segment_min_s) // step)
    edge, quiet = frames(rules.segment_edge_s) // step, frames(rules.segment_quiet_s) // step

    def all_of(mask: Bools, low: Ints, high: Ints, must_exist: bool) -> Bools:
        """Return whether the mask is True at all grid frames in [low, high).

        Frames outside the grid do not count. If `must_exist` is true, the result is False for ranges with such frames.
        """
        total = np.append(0, np.cumsum(mask))
        inside_low, inside_high = np.maximum(low, 0), np.minimum(high, grid.size)
        left = np.searchsorted(key, fact * cells.span + inside_low)
        right = np.searchsorted(key, fact * cells.span + inside_high)
        good = total[right] - total[left] == inside_high - inside_low
        return np.asarray(good & ((low >= 0) & (high <= grid.size) if must_exist else True))

    stable = (
        (last - first >= least)
        & all_of(cells.false_clear, first - edge, first, True)
        & all_of(cells.false, first - quiet, first, False)
        & all_of(cells.false, last + 1, last + 1 + quiet, False)
    )
    closed = all_of(cells.false_clear, last + 1, last + 1 + edge, True)
    # The first cell of the stretch of consecutive false facts, for each cell with a false fact.
    chain = np.maximum.accumulate(
        np.where(cells.false & ~(next_to & np.append(False, cells.false[:-1])), np.arange(len(key)), 0)
    )
    before = np.maximum(starts - 1, 0)
    quiet_from = key[chain[before]] % cells.span
    track, action = unpaired(keys[fact[stable]])
    return _Segments(
        track,
        action,
        grid.first + first[stable] * step,
        grid.first + last[stable] * step,
        grid.first + quiet_from[stable] * step,
        closed[stable],
    )
