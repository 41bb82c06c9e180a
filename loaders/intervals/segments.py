"""Stable segments of actions: stretches that visibly begin, last and (where closed) end.

At each frame of the action layer's grid, an action of a person is true, false or unknown. A run is a maximal chain of
consecutive grid frames in which it is true and the person in clear view, or which lie in a closed gap. A run is a
stable segment if it lasts, the action is false and the person clear for a second before, and no frame is true or
unknown for three seconds before and after. A grid frame that is not annotated is unknown; frames beyond the grid do
not exist.
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
from jrdb_avr.loaders.labelfiles.columns import Rows, ascending, distinct_of, paired, ragged, texts, unpaired
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules, frames
from jrdb_avr.schema.tables import INTERVALS

HALF_STEP = KEYFRAME_STEP // 2
"""At one frame per second the truth lies up to half a step outside [first, last]."""

_BLOCK: Final = 500_000
"""Cells worked on at once; the many actions of one person may make more."""


def segments_table(line: Timeline, people: People, runs: Runs, rules: LoadRules) -> pa.Table:
    """The interval table `segments`, by track, action and first frame."""
    grid = line.grid("actions")
    if grid is None or not len(runs.track):
        return INTERVALS["segments"].empty_table()
    known = _Known(grid, people, runs)
    parts = (_find(_Cells(known, *block), known.facts, grid, rules) for block in known.blocks())
    found = next(parts).joined([*parts])
    half = 0 if grid.step == 1 else HALF_STEP
    columns = {name: getattr(found, name) for name in ("track", "first", "last", "quiet_from", "closed")}
    columns |= {"start": found.first - half, "end": found.last + half}
    columns |= {"action": texts(people.actions.names, found.action)}
    return line.table("segments", columns)


@dataclass(frozen=True)
class _Segments(Rows):
    track: Ints
    action: Ints
    first: Ints
    last: Ints
    quiet_from: Ints
    closed: Bools


class _Known:
    """The facts of a sequence, (track, action) that occur, and what is true of them at which frames of the grid."""

    def __init__(self, grid: Grid, people: People, runs: Runs) -> None:
        boxes, labels = people.boxes, people.actions
        self.grid, self.boxes, self.labels, self.runs, self.posed = grid, boxes, labels, runs, people.pose >= 0
        self.facts = distinct_of(paired(runs.track, runs.value))
        self.of_runs = np.searchsorted(self.facts, paired(runs.track, runs.value))
        on_grid = np.flatnonzero(grid.holds(boxes.frame))
        self.by_track = on_grid[ascending(boxes.track[on_grid])]
        ordered = boxes.track[self.by_track]
        track, _ = unpaired(self.facts)
        self.low = np.searchsorted(ordered, track, "left")
        self.count = np.searchsorted(ordered, track, "right") - self.low
        # Labels without a box would be of refused boxes; there are none in the tables.
        has_box = np.flatnonzero(boxes.rows(labels.frame, labels.track) >= 0)
        of_labels = np.searchsorted(self.facts, paired(labels.track[has_box], labels.value[has_box]))
        order = ascending(of_labels)
        self.label_rows, self.of_labels = has_box[order], of_labels[order]

    def blocks(self) -> Iterator[tuple[int, int]]:
        """First fact, and the one after the last, of blocks of about as many cells as are looked at in one go."""
        number = np.cumsum(self.count) // _BLOCK
        starts = np.flatnonzero(np.append(True, number[1:] != number[:-1])).tolist()
        yield from zip(starts, [*starts[1:], len(self.facts)], strict=True)


class _Cells:
    """One cell per (fact, grid frame) at which the person has a box or the fact a closed gap; all others are unknown.

    Only the facts from `begin` to before `end` are looked at. `key` is fact * span + grid number, ascending.
    """

    def __init__(self, known: _Known, begin: int, end: int) -> None:
        grid, boxes, labels, runs = known.grid, known.boxes, known.labels, known.runs
        self.span = grid.size + 1
        here = slice(*np.searchsorted(known.of_runs, [begin, end]))
        first, last = runs.first[here], runs.last[here]
        gap_run, place = ragged(np.where(runs.gap[here], (last - first) // grid.step + 1, 0))
        gap_keys = known.of_runs[here][gap_run] * self.span + grid.index(first[gap_run]) + place

        fact, place = ragged(known.count[begin:end])
        row = known.by_track[known.low[begin:end][fact] + place]
        fact += begin
        box_keys = fact * self.span + grid.index(boxes.frame[row])

        # Both are ascending; a stable sort merges two runs in linear time.
        self.key = distinct_of(np.sort(np.concatenate([box_keys, gap_keys]), kind="stable"))
        pose = labels.is_pose[unpaired(known.facts)[1]]
        here = slice(*np.searchsorted(known.of_labels, [begin, end]))
        label = known.label_rows[here]
        label_keys = known.of_labels[here] * self.span + grid.index(labels.frame[label])

        listed, clear, pose_known, named, true, gap = np.zeros((6, len(self.key)), np.bool_)
        at = np.searchsorted(self.key, box_keys)
        listed[at], clear[at], pose_known[at] = boxes.listed[row], boxes.clear[row], ~pose[fact] | known.posed[row]
        at = np.searchsorted(self.key, label_keys)
        named[at], true[at] = True, labels.certain[label]
        gap[np.searchsorted(self.key, gap_keys)] = True
        self.false = listed & pose_known & ~named & ~gap
        self.false_clear = self.false & clear
        self.inside = (true & clear) | gap


def _find(cells: _Cells, facts: Ints, grid: Grid, rules: LoadRules) -> _Segments:
    key, step = cells.key, grid.step
    next_to = np.append(False, key[1:] == key[:-1] + 1)
    begins = np.flatnonzero(cells.inside & ~(next_to & np.append(False, cells.inside[:-1])))
    ends = np.flatnonzero(cells.inside & ~np.append(next_to[1:] & cells.inside[1:], False))
    fact, first = np.divmod(key[begins], cells.span)
    last = key[ends] % cells.span
    # Spans of the rules in grid steps.
    least = -(-frames(rules.segment_min_s) // step)
    edge, quiet = frames(rules.segment_edge_s) // step, frames(rules.segment_quiet_s) // step

    def all_of(mask: Bools, low: Ints, high: Ints, must_exist: bool) -> Bools:
        """Whether the mask holds at all grid frames in [low, high); those beyond the grid fail or do not count."""
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
    # Where the chain of false frames that ends just before the run begins.
    chain = np.maximum.accumulate(
        np.where(cells.false & ~(next_to & np.append(False, cells.false[:-1])), np.arange(len(key)), 0)
    )
    before = np.maximum(begins - 1, 0)
    quiet_from = key[chain[before]] % cells.span
    track, action = unpaired(facts[fact[stable]])
    return _Segments(
        track,
        action,
        grid.first + first[stable] * step,
        grid.first + last[stable] * step,
        grid.first + quiet_from[stable] * step,
        closed[stable],
    )
