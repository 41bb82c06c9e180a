"""Stable segments of actions: stretches that visibly begin, last and (where closed) end.

Per action layer's grid frame an action of a person is true, false or unknown. A run is a maximal chain of consecutive
grid frames in which it is true and the person in clear view, or which lie in a closed gap. A run is a stable segment if
it lasts, the action is false and the person clear for a second before, and no frame is true or unknown for three
seconds before and after. A grid frame that is not annotated is unknown; frames beyond the grid do not exist.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules, frames
from jrdb_avr.schema.tables import INTERVALS

from .columns import constant, distinct_of, ragged, texts
from .runs import Runs
from .scene_people import Boxes, Labels
from .sightings import certain_pose
from .timeline import Grid, Timeline

Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

HALF_STEP = KEYFRAME_STEP // 2
"""At one frame per second the truth lies up to half a step outside [first, last]."""


def segments_table(line: Timeline, boxes: Boxes, labels: Labels, runs: Runs, rules: LoadRules) -> pa.Table:
    """The interval table `segments`, by track, action and first frame."""
    grid = line.grid("actions")
    found = _find(grid, boxes, labels, runs, rules) if grid and len(runs.track) else None
    if grid is None or found is None:
        return INTERVALS["segments"].empty_table()
    half = 0 if grid.step == 1 else HALF_STEP
    return pa.table(
        {
            "sequence": constant(line.sequence, len(found.first)),
            "track": found.track,
            "action": texts(labels.names, found.action),
            "first": found.first,
            "last": found.last,
            "start": found.first - half,
            "end": found.last + half,
            "quiet_from": found.quiet_from,
            "closed": found.closed,
        }
    ).cast(INTERVALS["segments"])


@dataclass(frozen=True)
class _Segments:
    track: Ints
    action: Ints
    first: Ints
    last: Ints
    quiet_from: Ints
    closed: Bools


class _Cells:
    """One cell per (fact, grid frame) at which the person has a box or the fact a closed gap; all others are unknown.

    A fact is a (track, action) that occurs. `key` is fact * span + grid number, ascending.
    """

    def __init__(self, grid: Grid, boxes: Boxes, labels: Labels, runs: Runs, rules: LoadRules) -> None:
        self.facts = np.unique(_fact(runs.track, runs.value))
        self.span = grid.size + 1
        fact_of_runs = np.searchsorted(self.facts, _fact(runs.track, runs.value))
        gap_run, place = ragged(np.where(runs.gap, (runs.last - runs.first) // grid.step + 1, 0))
        gap_keys = fact_of_runs[gap_run] * self.span + grid.index(runs.first[gap_run]) + place

        on_grid = np.flatnonzero(grid.holds(boxes.frame))
        by_track = on_grid[np.argsort(boxes.track[on_grid], kind="stable")]
        ordered = boxes.track[by_track]
        low = np.searchsorted(ordered, self.facts >> 31, "left")
        count = np.searchsorted(ordered, self.facts >> 31, "right") - low
        fact, place = ragged(count)
        row = by_track[low[fact] + place]
        box_keys = fact * self.span + grid.index(boxes.frame[row])

        # Both are ascending; a stable sort merges two runs in linear time.
        self.key = distinct_of(np.sort(np.concatenate([box_keys, gap_keys]), kind="stable"))
        action = self.facts & (2**31 - 1)
        pose = labels.is_pose[action]
        label_row = boxes.rows(labels.frame, labels.track)
        has_box = label_row >= 0
        label_fact = np.searchsorted(self.facts, _fact(labels.track, labels.action))
        label_keys = label_fact * self.span + grid.index(labels.frame)

        pose_code = certain_pose(boxes, labels)
        listed = np.zeros(len(self.key), np.bool_)
        clear, known = listed.copy(), listed.copy()
        at = np.searchsorted(self.key, box_keys)
        listed[at] = boxes.listed[row]
        clear[at] = boxes.clear[row]
        known[at] = ~pose[fact] | (pose_code[row] >= 0)
        named, true, gap = np.zeros((3, len(self.key)), np.bool_)
        # Labels without a box would be of refused boxes; there are none in the tables.
        at = np.searchsorted(self.key, label_keys[has_box])
        named[at] = True
        true[at] = labels.certain[has_box]
        gap[np.searchsorted(self.key, gap_keys)] = True
        self.false = listed & known & ~named & ~gap
        self.false_clear = self.false & clear
        self.inside = (true & clear) | gap


def _fact(track: Ints, action: Ints) -> Ints:
    return (track << 31) | action


def _find(grid: Grid, boxes: Boxes, labels: Labels, runs: Runs, rules: LoadRules) -> _Segments:
    cells = _Cells(grid, boxes, labels, runs, rules)
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
    pair = cells.facts[fact[stable]]
    return _Segments(
        pair >> 31,
        pair & (2**31 - 1),
        grid.first + first[stable] * step,
        grid.first + last[stable] * step,
        grid.first + quiet_from[stable] * step,
        closed[stable],
    )
