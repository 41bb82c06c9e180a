"""Comparison of annotation tables with rows from another reading."""

from __future__ import annotations

from jrdb_avr.schema.tables import INTERVALS


def plain(value):
    """A value that compares: floats to nine digits, so that another order of summing does not show."""
    if isinstance(value, float):
        return round(value, 9) + 0.0
    return tuple(value) if isinstance(value, list) else value


def rows_of(rows, names):
    return sorted((tuple(plain(row[name]) for name in names) for row in rows), key=repr)


def compare_tables(store, expected, sequence):
    for kind, schema in INTERVALS.items():
        found = rows_of(store.interval(kind, sequence).to_pylist(), schema.names)
        wanted = rows_of(expected[kind], schema.names)
        assert set(found) - set(wanted) == set(), kind
        assert set(wanted) - set(found) == set(), kind
        assert found == wanted, kind
