"""When people are in the picture and when they are away: the interval tables `presences` and `absences`.

A person is present at a frame with a box, for certain where it is a clear view. Between the first and the last box, a
person is absent at an annotated frame without one, for certain where the frames one second before and after are
annotated without one too: what questions go by at keyframes. Frames that are not annotated end both; nothing is closed.
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
    """All presences of a sequence, by track and first frame."""
    return _table(line, "presences", boxes.frame, boxes.track, boxes.clear)


def absences_table(line: Timeline, boxes: Boxes) -> pa.Table:
    """All absences of a sequence, by track and first frame."""
    annotated = line.frames_of("2d")
    order = ascending(boxes.track)
    frame, track = boxes.frame[order], boxes.track[order]
    low, high = np.searchsorted(annotated, frame[:-1], "right"), np.searchsorted(annotated, frame[1:])
    row, place = ragged(np.where(track[1:] == track[:-1], high - low, 0))
    frame, track = annotated[low[row] + place], track[row]
    certain = np.ones(len(row), np.bool_)
    for near in (frame - KEYFRAME_STEP, frame + KEYFRAME_STEP):
        certain &= np.isin(near, annotated) & (boxes.rows(near, track) < 0)
    return _table(line, "absences", frame, track, certain)


def _table(line: Timeline, kind: str, frame: Ints, track: Ints, certain: Bools) -> pa.Table:
    none = np.zeros_like(frame)
    runs = find_runs(Facts(frame, track, none, certain, none), step_of(line.frames_of("2d")))
    return runs_table(line, kind, runs, {"track": runs.track})
