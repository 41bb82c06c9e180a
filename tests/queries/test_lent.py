"""A mirror on a machine of a cluster that does not see the cache of the machine that runs the command."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from jrdb_avr.queries import mirror
from jrdb_avr.queries.lent import away, lend, take_back, write_back
from jrdb_avr.queries.manifest import Manifest, SequenceEntry
from jrdb_avr.queries.store import Store, file_hash
from jrdb_avr.schema.rules import LoadRules

TABLES = [f"annotations/boxes_2d/{name}.parquet" for name in ("hall_0", "yard_0")]


@pytest.fixture
def store(tmp_path, monkeypatch):
    """A store at a URL with a table of two sequences, a graph and a folder for what workers write."""
    monkeypatch.setattr(mirror, "OPENED", {})
    monkeypatch.setattr("jrdb_avr.queries.lent.OPENED", mirror.OPENED)
    monkeypatch.setenv("JRDB_AVR_CACHE", str(tmp_path / "cache"))
    (tmp_path / "there").mkdir()
    store = Store((tmp_path / "there").as_uri())
    with store.writing("load"):
        for table in TABLES:
            (store.path / table).parent.mkdir(parents=True, exist_ok=True)
            (store.path / table).write_text(table)
        entries = {"both": SequenceEntry((), {table: file_hash(store.path / table) for table in TABLES})}
        store.write_manifest(Manifest(None, LoadRules(), "", entries, {}))
    (store.path / "graph.kuzu").write_text("graph")
    (store.path / "graph.kuzu.lock").write_text("held here")
    (store.path / ".found").mkdir()
    return store


def search(store, seen):
    """What a worker does: read its table and the graph, and write into the hidden folder."""

    def function(item):
        seen.update({p.relative_to(store.path).as_posix() for p in store.path.rglob("*") if p.is_file()})
        (store.path / ".found" / f"{item.sequence}.parquet").write_text("found")
        return (store.path / TABLES[1]).read_text(), (store.path / "graph.kuzu").read_text()

    return function


def test_a_worker_fetches_its_sequence_and_hands_back_what_it_wrote(store):
    seen, place = set(), store.path.parent
    lent = lend(lambda value: value)
    place.rename(place.with_name("of the driver"))  # As on a machine that sees nothing of it.
    result, files = away(lent, search(store, seen), SimpleNamespace(sequence="yard_0"), lambda value: value)
    assert result == (TABLES[1], "graph")
    assert seen == {TABLES[1], "store.json", "graph.kuzu"}
    found = store.path / ".found" / "yard_0.parquet"
    assert files == {found: b"found"} and not found.exists()
    place.rename(place.with_name("of the worker"))
    place.with_name("of the driver").rename(place)
    write_back(files)
    assert found.read_text() == "found"
    take_back(lent)
    assert sorted(path.name for path in place.iterdir()) == ["files", "lock", "state.json"]


def test_a_worker_that_sees_the_cache_hands_nothing_back(store):
    lent = lend(lambda value: value)
    result, files = away(lent, search(store, set()), SimpleNamespace(sequence="yard_0"), lambda value: value)
    assert result == (TABLES[1], "graph") and files == {}
    assert (store.path / ".found" / "yard_0.parquet").read_text() == "found"
