"""Small worlds loaded without what a test does not look at: the graph, the manifest, or the files of the tables.

store = memory_store(tmp_path, world)   # all that searching a sequence reads, the tables in memory
store, report = reported_store(tmp_path, layers)    # the same of one sequence, and what the load reports
store, found = read_store(tmp_path, layers) # the same, and what its files gave; intervals are derived if looked at
store = graphless_store(tmp_path, world)    # all that generation reads but the graph
"""

from __future__ import annotations

import contextlib
from collections import Counter
from pathlib import Path

import pytest
from worlds import load_world, write_root

from jrdb_avr.loaders import load
from jrdb_avr.loaders.intervals.derive import derive
from jrdb_avr.loaders.load import load_shard
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.sequence import annotate
from jrdb_avr.queries.manifest import SequenceEntry
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS

NAME = "yard-2020-01-01_0"


def memory_store(folder, world, **rules):
    """Write a world, load its sequences one by one, and return the store. Raises InputError for unusable worlds."""
    store = MemoryStore(Path(folder) / "store")
    with kept_in(store):
        for files in find_root(write_root(Path(folder) / "root", world)).sequences:
            load_shard(files, str(store.path), LoadRules(**rules))
    return store


def reported_store(folder, layers, **rules):
    """The MemoryStore and the load's report of a world of one sequence, `NAME`."""
    return load_root(folder, write_root(Path(folder) / "root", {NAME: layers}), **rules)


def read_store(folder, layers):
    """A store with the annotations of a world of one sequence, `NAME`, and all that reading its files gave."""
    (files,) = find_root(write_root(Path(folder) / "root", {NAME: layers})).sequences
    found = annotate(files)
    return ReadStore(Path(folder) / "store", found.tables), found


def load_root(folder, root, **rules):
    """As `reported_store`, from a root that is written already."""
    store = MemoryStore(Path(folder) / "store")
    (files,) = find_root(root).sequences
    with kept_in(store):
        return store, load_shard(files, str(store.path), LoadRules(**rules)).report


def graphless_store(folder, world):
    """A world loaded as the command does, manifest and all, without its graph."""
    with without_graph():
        return load_world(folder, world)


def without_graph():
    """A context in which loads make everything but the graph."""

    def build(store, staging, manifest):
        staging.write_manifest(manifest)
        return []

    return _instead(stage_scene=_nothing, _build=build)


def kept_in(store):
    """A context in which a sequence's tables stay in a MemoryStore."""
    return _instead(_write=store.keep)


class MemoryStore(Store):
    """A store with tables in memory. An annotation table's file is written when somebody asks where it is."""

    def __init__(self, path):
        super().__init__(path)
        self._annotations, self._intervals = {}, {}

    @property
    def sequences(self):
        """Those with anything to read, by name."""
        return sorted({name for _, name in self._intervals})

    def keep(self, staging, sequence, annotations, intervals):
        """In place of writing what a sequence's files gave."""
        self._annotations |= {(name, sequence): table for name, table in annotations.items()}
        self._intervals |= {(name, sequence): table for name, table in intervals.items()}
        return SequenceEntry(tuple(intervals["sequence"]["layers"][0].as_py()), {})

    def annotation(self, layer, sequence, columns=None):
        table = _as_read(self._annotations, (layer, sequence), ANNOTATIONS[layer])
        return table if columns is None else table.select(columns)

    def interval(self, kind, sequence, columns=None):
        table = _as_read(self._intervals, (kind, sequence), INTERVALS[kind])
        return table if columns is None else table.select(columns)

    def annotation_path(self, layer, sequence):
        path = super().annotation_path(layer, sequence)
        if (layer, sequence) in self._annotations and not path.exists():
            write_table(path, self._annotations[layer, sequence], ANNOTATIONS[layer])
        return path

    def written(self):
        """The same store with all of its files."""
        for layer, sequence in self._annotations:
            self.annotation_path(layer, sequence)
        for (kind, sequence), table in self._intervals.items():
            self.write_interval(kind, sequence, table)
        return Store(self.path)


class ReadStore(MemoryStore):
    """A store of one sequence in memory, whose intervals are derived when somebody looks at them."""

    def __init__(self, path, annotations):
        super().__init__(path)
        self._annotations = {(name, NAME): table for name, table in annotations.items()}

    def interval(self, kind, sequence, columns=None):
        if not self._intervals:
            annotations = {name: table for (name, _), table in self._annotations.items()}
            self.keep(None, NAME, {}, derive(NAME, annotations, LoadRules()))
        return super().interval(kind, sequence, columns)


def _as_read(tables, key, schema):
    """A table as its file would give it."""
    table = tables[key]
    if table.schema != schema or table.schema.metadata:
        table = tables[key] = table.select(schema.names).cast(schema).replace_schema_metadata(None)
    return table


@contextlib.contextmanager
def _instead(**parts):
    """Something else in place of parts of the load."""
    with pytest.MonkeyPatch.context() as patch:
        for name, part in parts.items():
            patch.setattr(load, name, part)
        yield


def _nothing(*arguments):
    """In place of writing down what a graph is built from."""


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
