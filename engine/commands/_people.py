"""Choose labelled people of a store, and take the crops that show how the errors of a model repeat."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any, Final

from jrdb_avr.agent.model.labelled_people import LabelledPerson, PersonView
from jrdb_avr.agent.model.messages import picture_of
from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import Box, to_crop
from jrdb_avr.schema.rules import KEYFRAME_STEP

PEOPLE: Final = 50
_TURN_DEG: Final = 3.0
"""Angle between the person and the middle of each of the two crops of one frame."""

_SIGHTINGS: Final = """
SELECT sequence, track, frame, x, y, w, h, angle, pose, gender, age
FROM intervals_sightings JOIN intervals_persons USING (sequence, track) WHERE clear AND pose IS NOT NULL
ORDER BY row_number() OVER (PARTITION BY sequence, track ORDER BY md5(concat_ws('/', track, frame))),
         md5(concat_ws('/', sequence, track)), frame
"""
"""Sightings of people with a known pose, in an order that has each person once before any person twice."""


def labelled_people(store: Store, n: int = PEOPLE) -> list[LabelledPerson]:
    """Choose people in clear view whose pose is labelled at a frame and a second later.

    Args:
        store: The store, with annotations and panoramas.
        n: The maximum number of people. A person may be chosen again at another frame if the store has fewer people.

    Returns:
        The people. Equal stores give equal people. Moments without panoramas are left out.
    """
    observer = Observer(store)
    people: list[LabelledPerson] = []
    rows = {(row["sequence"], row["track"], row["frame"]): row for row in store.sql(_SIGHTINGS).to_pylist()}
    for (sequence, track, frame), row in rows.items():
        later = rows.get((sequence, track, frame + KEYFRAME_STEP))
        if later is not None and len(people) < n:
            with contextlib.suppress(ObserveError):
                first, beside = (_view(observer, row, turn) for turn in (-_TURN_DEG, _TURN_DEG))
                people.append((first, beside, _view(observer, later)))
    return people


def _view(observer: Observer, row: Mapping[str, Any], turn: float = 0.0) -> PersonView:
    seen = observer(row["sequence"], row["frame"], (row["angle"] + turn) % 360.0)
    labels = {topic: row[topic] for topic in ("gender", "age", "pose") if row[topic] is not None}
    return PersonView(picture_of(seen), to_crop(Box(*(row[key] for key in "xywh")), seen.left), labels)
