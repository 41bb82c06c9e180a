"""The interval table `objects`: things with a track, shown by the panoptic layer or named by the reasoning layer.

A thing is known by its track and its category together. People are left out: the box layers count them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.tables import INTERVALS
from jrdb_avr.schema.things import PERSON_CATEGORIES

from .columns import TRACK_BITS, constant, distinct_of, nullable


def objects_table(sequence: str, panoptic: pa.Table, categories: pa.Table, handles: pa.Table) -> pa.Table:
    """From the annotation tables: one row per (category, thing), in this order."""
    seen = panoptic.filter(pc.is_valid(panoptic["object"]))
    keys, frame = _keys(seen), _numbers(seen, "frame")
    order = np.lexsort((frame, keys))
    keys, frame = keys[order], frame[order]
    things = distinct_of(np.sort(np.concatenate([keys, _keys(handles)])))
    names = dict(zip(*(categories[name].to_pylist() for name in ("category_id", "category")), strict=True))
    people = [number for number, name in names.items() if name in PERSON_CATEGORIES]
    things = things[~np.isin(things >> TRACK_BITS, people)]
    category = things >> TRACK_BITS
    begin, end = np.searchsorted(keys, things), np.searchsorted(keys, things, "right")
    unseen: Bools = begin == end
    return pa.table(
        {
            "sequence": constant(sequence, len(things)),
            "object": things & ((1 << TRACK_BITS) - 1),
            "category_id": category,
            "category": pa.array([names.get(number) for number in category.tolist()], pa.string()),
            "first_frame": nullable(_at(frame, begin), unseen, pa.int32()),
            "last_frame": nullable(_at(frame, end - 1), unseen, pa.int32()),
        }
    ).cast(INTERVALS["objects"])


def _keys(table: pa.Table) -> Ints:
    """One number per (category, thing)."""
    return (_numbers(table, "category_id") << TRACK_BITS) | _numbers(table, "object")


def _numbers(table: pa.Table, name: str) -> Ints:
    return np.asarray(table[name].to_numpy(), np.int64)


def _at(values: npt.NDArray[np.int64], place: Ints) -> Ints:
    """Values at places, of which some may lie outside."""
    return values[np.clip(place, 0, len(values) - 1)] if len(values) else np.zeros(len(place), np.int64)
