"""Comparison of annotation tables with rows from another reading."""

from __future__ import annotations

from collections import Counter

from jrdb_avr.schema.tables import INTERVALS


def plain(value):
    """A value that compares: floats to nine digits, so that another order of summing does not show."""
    if isinstance(value, float):
        return round(value, 9) + 0.0
    return tuple(value) if isinstance(value, list) else value


def rows_of(rows, names):
    """How often each row is there."""
    return Counter(tuple(plain(row[name]) for name in names) for row in rows)


def compare_tables(store, expected, sequence):
    for kind, schema in INTERVALS.items():
        found = rows_of(store.interval(kind, sequence).to_pylist(), schema.names)
        wanted = rows_of(expected[kind], schema.names)
        assert found - wanted == Counter(), kind
        assert wanted - found == Counter(), kind
