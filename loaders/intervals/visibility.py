"""The class of each 2D box: in clear view, covered, or uncertain.

If a sequence has a readable degree of occlusion, these degrees decide. In other sequences the class depends on the
share of the box that nearer boxes cover, and on the group label of the person. All lengths of this module are
whole numbers of 1/256 pixel, so that no rounding decides. `docs/definitions.md` states the rules.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.labelfiles.columns import ascending, distinct_of, paired, pairs_of_equal, whole_numbers
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import CLEAR_OCCLUSIONS, COVERED_OCCLUSIONS
from jrdb_avr.schema.panorama import HEIGHT, WIDTH
from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules

UNIT: Final = 256
"""Number of length units in a pixel."""
_TURN: Final = WIDTH * UNIT
_LOWEST: Final = (HEIGHT - 2) * UNIT
"""Minimum bottom edge of a box that the image cuts off. Two such boxes are compared by their top edges."""

Source = Literal["attributes", "geometry", "nothing"]
"""Evidence for the classes of a sequence. "geometry" means nearer boxes and group labels."""


def classify_boxes(boxes: pa.Table, groups: pa.Table, rules: LoadRules) -> tuple[Source, Bools, Bools]:
    """Judge the boxes of one sequence.

    Args:
        boxes: Annotation table `boxes_2d`, sorted by frame and track.
        groups: Annotation table `groups`.
        rules: Thresholds.

    Returns:
        The evidence, the mask of the boxes in clear view, and the mask of the covered boxes. The other boxes are
        uncertain.
    """
    frame, track = whole_numbers(boxes, "frame"), whole_numbers(boxes, "track")
    box = np.stack([boxes[name].to_numpy() for name in "xywh"], axis=1)
    usable = _has_legal_size(box, rules) & ~boxes["no_eval"].fill_null(False).to_numpy()
    visible, hidden = (
        np.asarray(pc.is_in(boxes["occlusion"], pa.array(sorted(values), pa.string())).to_numpy())
        for values in (CLEAR_OCCLUSIONS, COVERED_OCCLUSIONS)
    )
    nobody = np.zeros(len(frame), np.bool_)
    if rules.visibility == "any":
        attributes = bool(boxes["has_attributes"].to_numpy().any())
        return ("attributes", usable & visible, nobody) if attributes else ("nothing", usable, nobody)
    if boxes["occlusion"].null_count < len(frame):
        return "attributes", usable & visible, hidden
    if not len(frame):
        return "nothing", nobody, nobody
    least, most = rules.covered_thousandths()
    covered, area = covered_areas(frame, box)
    drawn = area > 0
    uncovered = drawn & (1000 * covered < least * area)
    clear = usable & uncovered & _has_group(frame, track, groups)
    return "geometry", clear, drawn & (1000 * covered >= most * area)


def covered_areas(frame: Ints, box: Floats) -> tuple[Ints, Ints]:
    """Measure how much of each box is covered by the nearer boxes of its frame.

    Args:
        frame: Frame of each box, ascending.
        box: Left, top, width and height of each box in stitched pixels, shape (n, 4).

    Returns:
        The area of each box inside the union of the nearer boxes, and the area of each box. The unit is
        1/65536 square pixel. Boxes are cut to the rows of the panorama and to one turn.
    """
    edges = np.rint(UNIT * np.stack([box[:, 0], box[:, 0] + box[:, 2], box[:, 1], box[:, 1] + box[:, 3]]))
    left, right, top, bottom = edges.astype(np.int64)
    width, left = np.minimum(right - left, _TURN), left % _TURN
    top, bottom = np.clip(top, 0, HEIGHT * UNIT), np.clip(bottom, 0, HEIGHT * UNIT)
    covered = np.zeros(len(frame), np.int64)
    for a, b in pairs_of_equal(frame, np.arange(len(frame))):
        nearer = (bottom[b] > bottom[a] + 2 * UNIT) | (
            (bottom[a] >= _LOWEST) & (bottom[b] >= _LOWEST) & (top[b] < top[a] - 4 * UNIT)
        )
        high, low = np.maximum(top[a], top[b]), np.minimum(bottom[a], bottom[b])
        near = np.flatnonzero(nearer & (high < low))
        a, b, high, low = a[near], b[near], high[near], low[near]
        # Because the panorama repeats every turn, a box can reach another one from either side.
        begin = left[b] + np.array([[-_TURN], [0], [_TURN]])
        start, end = np.maximum(left[a], begin), np.minimum(left[a] + width[a], begin + width[b])
        parts = np.stack([np.broadcast_to(part, start.shape) for part in (a, start, end, high, low)])
        _add_unions(covered, parts[:, start < end])
    return covered, width * (bottom - top)


def _add_unions(covered: Ints, parts: Ints) -> None:
    """Set the area of the union of the parts of each box. The rows of `parts` are box, left, right, top, bottom."""
    parts = parts[:, ascending(parts[0], parts[3])]
    boxes, starts, counts = np.unique(parts[0], return_index=True, return_counts=True)
    # Boxes with equally many parts form arrays without gaps.
    for count in np.unique(counts):
        of = np.flatnonzero(counts == count)
        left, right, top, bottom = parts[1:, starts[of][:, None] + np.arange(count)]
        edges = np.sort(np.concatenate([left, right], axis=1), axis=1)
        strip = edges[:, :-1]
        filled, reached = np.zeros((2, *strip.shape), np.int64)
        for part in range(count):
            inside = (left[:, part, None] <= strip) & (strip < right[:, part, None])
            # Parts come by their tops, so a strip is filled downwards.
            ending = np.where(inside, np.maximum(reached, bottom[:, part, None]), reached)
            filled += np.maximum(ending - np.maximum(reached, top[:, part, None]), 0)
            reached = ending
        covered[boxes[of]] = (filled * np.diff(edges, axis=1)).sum(axis=1)


def _has_legal_size(box: Floats, rules: LoadRules) -> Bools:
    """Return whether each box is inside the rows of the panorama and of a size within the rules."""
    _, y, w, h = box.T
    sized = (w >= rules.clear_min_width) & (w <= rules.clear_max_width) & (h >= rules.clear_min_height)
    return np.asarray(sized & (y >= 0) & (y + h <= HEIGHT))


def _has_group(frame: Ints, track: Ints, groups: pa.Table) -> Bools:
    """Return whether each person has a certain group label in the nearest frame with any group label.

    The frame is at most a second away. Of two frames that are equally near, the earlier one counts. If the sequence has
    no group labels, the result is True for all.
    """
    labelled = distinct_of(np.sort(whole_numbers(groups, "frame")))
    if not len(labelled):
        return np.ones(len(frame), np.bool_)
    row = np.searchsorted(labelled, frame)
    before, after = labelled[np.maximum(row - 1, 0)], labelled[np.minimum(row, len(labelled) - 1)]
    nearest = np.where(np.abs(frame - before) <= np.abs(after - frame), before, after)
    easy = groups.filter(pc.less(groups["difficulty"], 3))
    certain = np.isin(paired(nearest, track), paired(whole_numbers(easy, "frame"), whole_numbers(easy, "track")))
    return np.asarray(certain & (np.abs(nearest - frame) <= KEYFRAME_STEP))
