"""The interval table `objects`: things with a track, shown by the panoptic layer or named by the reasoning layer.

A thing is known by its track and its category together. People are left out: the box layers count them.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.tables import INTERVALS
from jrdb_avr.schema.things import PERSON_CATEGORIES

from .columns import constant, distinct_of, nullable, paired, unpaired, whole_numbers


def objects_table(sequence: str, panoptic: pa.Table, categories: pa.Table, handles: pa.Table) -> pa.Table:
    """From the annotation tables: one row per (category, thing), in this order."""
    seen = panoptic.filter(pc.is_valid(panoptic["object"]))
    keys, frame = _keys(seen), whole_numbers(seen, "frame")
    order = np.lexsort((frame, keys))
    keys, frame = keys[order], frame[order]
    things = distinct_of(np.sort(np.concatenate([keys, _keys(handles)])))
    names = dict(zip(*(categories[name].to_pylist() for name in ("category_id", "category")), strict=True))
    people = [number for number, name in names.items() if name in PERSON_CATEGORIES]
    things = things[~np.isin(unpaired(things)[0], people)]
    category, track = unpaired(things)
    begin, end = np.searchsorted(keys, things), np.searchsorted(keys, things, "right")
    unseen: Bools = begin == end
    return pa.table(
        {
            "sequence": constant(sequence, len(things)),
            "object": track,
            "category_id": category,
            "category": pa.array([names.get(number) for number in category.tolist()], pa.string()),
            "first_frame": nullable(_at(frame, begin), unseen, pa.int32()),
            "last_frame": nullable(_at(frame, end - 1), unseen, pa.int32()),
        }
    ).cast(INTERVALS["objects"])


def _keys(table: pa.Table) -> Ints:
    """One number per (category, thing)."""
    return paired(whole_numbers(table, "category_id"), whole_numbers(table, "object"))


def _at(values: Ints, place: Ints) -> Ints:
    """Values at places, of which some may lie outside."""
    return values[np.clip(place, 0, len(values) - 1)] if len(values) else np.zeros(len(place), np.int64)
