"""Interval tables `presences` and `absences`: intervals with boxes of a person, and intervals between them.

A person is present at a frame with a box of the person. The presence is certain if the box is a clear view. A person is
absent at an annotated frame without a box, if the person has boxes before and after the frame. The absence is certain
if the frames one second before and after are annotated too, and have no box of the person. Presences and absences end
at frames that are not annotated.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import Boxes, Facts
from jrdb_avr.loaders.intervals.spans import find_runs, runs_table
from jrdb_avr.loaders.intervals.timeline import Timeline, step_of
from jrdb_avr.loaders.labelfiles.columns import ascending, ragged
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import KEYFRAME_STEP


def presences_table(line: Timeline, boxes: Boxes) -> pa.Table:
    """Derive the presences of a sequence.

    Args:
        line: Frames of the sequence.
        boxes: Boxes of the people.

    Returns:
        The interval table, sorted by track and first frame.
    """
    return _table(line, "presences", boxes.frame, boxes.track, boxes.clear)


def absences_table(line: Timeline, boxes: Boxes) -> pa.Table:
    """Derive the absences of a sequence.

    Args:
        line: Frames of the sequence.
        boxes: Boxes of the people.

    Returns:
        The interval table, sorted by track and first frame.
    """
    annotated = line.frames_of("2d")
    order = ascending(boxes.track)
    frame, track = boxes.frame[order], boxes.track[order]
    low, high = np.searchsorted(annotated, frame[:-1], "right"), np.searchsorted(annotated, frame[1:])
    row, offset = ragged(np.where(track[1:] == track[:-1], high - low, 0))
    frame, track = annotated[low[row] + offset], track[row]
    certain = np.ones(len(row), np.bool_)
    for near in (frame - KEYFRAME_STEP, frame + KEYFRAME_STEP):
        certain &= np.isin(near, annotated) & (boxes.rows(near, track) < 0)
    return _table(line, "absences", frame, track, certain)


def _table(line: Timeline, kind: str, frame: Ints, track: Ints, certain: Bools) -> pa.Table:
    none = np.zeros_like(frame)
    runs = find_runs(Facts(frame, track, none, certain, none), step_of(line.frames_of("2d")))
    return runs_table(line, kind, runs, {"track": runs.track})
