"""Stretches without a box between two boxes of a person, in which the person is certainly absent."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules

from . import views
from .scene import NOBODY, Ints, Scene


def absence_tables(scene: Scene, rules: Rules) -> dict[str, pa.Table]:
    """The graph's tables `Absence` and `Leaves`.

    leaves: the last frame before, with a box; returns: the first one after. Between them no frame is unannotated, and
    at one keyframe or more the person is absent. present_from: the first keyframe from which on the person is present
    at every keyframe before `leaves`; null where it is not present at the last of them. clear and image hold of both
    frames; ahead: both boxes are seen straight ahead.
    """
    person, leaves, returns, rows = _absences(scene)
    keyframes, count = scene.keyframes, len(scene.keyframes)
    since = np.full(len(person), NOBODY)
    if len(person):
        last = np.searchsorted(keyframes, leaves) - 1
        since = np.where(last < 0, NOBODY, _present_since(scene)[person, np.maximum(last, 0)])
    x, w = scene.geometry["x"], scene.geometry["w"]
    ahead = views.ahead(x, w, rules.visible_share)
    number = np.arange(len(person))
    return {
        "Absence": pa.table(
            {
                "id": number,
                "leaves": leaves,
                "returns": returns,
                "present_from": pa.array(keyframes[np.maximum(since, 0)] if count else since, mask=since == NOBODY),
                "clear": scene.clear[rows] & scene.clear[rows + 1],
                "image": scene.has_image(leaves) & scene.has_image(returns),
                "ahead": ahead[rows] & ahead[rows + 1],
            }
        ),
        "Leaves": pa.table({"from": person, "to": number}),
    }


def _absences(scene: Scene) -> tuple[Ints, Ints, Ints, Ints]:
    """Person, last frame before, first frame after, and the row in `boxes` of the last frame before."""
    track, frame = (scene.boxes[name].to_numpy().astype(np.int64) for name in ("track", "frame"))
    rows = np.flatnonzero((track[1:] == track[:-1]) & (frame[1:] > frame[:-1] + 1))
    person, leaves, returns = scene.person_of(track[rows]), frame[rows], frame[rows + 1]
    # How many keyframes before each the person is absent at.
    gone = scene.absent.reshape(len(scene.tracks), len(scene.keyframes))
    before = np.pad(np.cumsum(gone, axis=1), ((0, 0), (1, 0)))
    low, high = np.searchsorted(scene.keyframes, leaves, side="right"), np.searchsorted(scene.keyframes, returns)
    absent = before[person, high] > before[person, low]
    kept = absent & _annotated_between(scene.annotated, leaves, returns)
    return person[kept], leaves[kept], returns[kept], rows[kept]


def _annotated_between(annotated: Ints, first: Ints, last: Ints) -> Bools:
    """Whether every frame of the 2D layer's grid strictly between two of its frames is annotated."""
    steps = np.diff(annotated)
    step = KEYFRAME_STEP if np.all(steps % KEYFRAME_STEP == 0) else 1
    known = np.searchsorted(annotated, last) - np.searchsorted(annotated, first, side="right")
    return np.asarray(known == -((first - last) // step) - 1)


def _present_since(scene: Scene) -> Ints:
    """(persons, keyframes): the first keyframe from which on the person is present until this one, or NOBODY."""
    place = np.arange(len(scene.keyframes))
    missed = np.maximum.accumulate(np.where(scene.present, NOBODY, place), axis=1)
    return np.where(scene.present, missed + 1, NOBODY)
