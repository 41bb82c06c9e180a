"""Choose labelled people of a store, and take the crops that show how the errors of a model repeat."""

from __future__ import annotations

from typing import Any, Final

from jrdb_avr.agent.model.labelled_people import LabelledPerson, PersonView
from jrdb_avr.agent.model.messages import picture_of
from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import Box, to_crop
from jrdb_avr.schema.rules import KEYFRAME_STEP

PEOPLE: Final = 50
_APART_DEG: Final = 6.0
"""Angle between the two crops of one frame."""

_CHOSEN: Final = """
SELECT a.sequence, a.frame, a.x, a.y, a.w, a.h, a.angle, a.pose, p.gender, p.age,
       b.x AS x2, b.y AS y2, b.w AS w2, b.h AS h2, b.angle AS angle2, b.pose AS pose2
FROM intervals_sightings a
JOIN intervals_sightings b ON b.sequence = a.sequence AND b.track = a.track AND b.frame = a.frame + $step
JOIN intervals_persons p ON p.sequence = a.sequence AND p.track = a.track
WHERE a.clear AND b.clear AND a.pose IS NOT NULL AND b.pose IS NOT NULL
ORDER BY row_number() OVER (PARTITION BY a.sequence, a.track ORDER BY md5(concat_ws('/', a.track, a.frame))),
         md5(concat_ws('/', a.sequence, a.track)), a.frame
"""
"""Moments of people with a known pose, in an order that takes each person once before any person twice."""


def labelled_people(store: Store, n: int = PEOPLE) -> list[LabelledPerson]:
    """Choose people in clear view whose pose is labelled at a frame and a second later.

    Args:
        store: The store, with annotations and panoramas.
        n: The maximum number of people. A person may be chosen again at another frame if the store has fewer people.

    Returns:
        The people. Equal stores give equal people. Moments without panoramas are left out.
    """
    observer = Observer.of(store)
    people: list[LabelledPerson] = []
    for row in store.sql(_CHOSEN, step=KEYFRAME_STEP).to_pylist():
        if len(people) == n:
            break
        timeless = {topic: row[topic] for topic in ("gender", "age") if row[topic] is not None}
        labels, labels2 = timeless | {"pose": row["pose"]}, timeless | {"pose": row["pose2"]}
        box, box2 = (Box(*(row[f"{key}{end}"] for key in "xywh")) for end in ("", "2"))
        try:
            people.append(
                LabelledPerson(
                    _view(observer, row, row["frame"], row["angle"] - _APART_DEG / 2, box, labels),
                    _view(observer, row, row["frame"], row["angle"] + _APART_DEG / 2, box, labels),
                    _view(observer, row, row["frame"] + KEYFRAME_STEP, row["angle2"], box2, labels2),
                )
            )
        except ObserveError:
            continue
    return people


def _view(
    observer: Observer, row: dict[str, Any], frame: int, angle: float, box: Box, labels: dict[str, str]
) -> PersonView:
    seen = observer(row["sequence"], frame, angle % 360.0)
    return PersonView(picture_of(seen), to_crop(box, seen.left), labels)
