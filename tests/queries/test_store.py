"""The store's files: whole or not at all, one writer, no name that leaves the folder."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import run
from worlds import person, write_root

from jrdb_avr.engine.run.journal import journal_lock
from jrdb_avr.queries.files import write_atomic
from jrdb_avr.queries.graph.file import lock_graph
from jrdb_avr.queries.store import Store, read_table, safe_sequence, write_table
from jrdb_avr.schema.errors import InputError, StoreError

SCHEMA = pa.schema([pa.field("a", pa.int32(), nullable=False), pa.field("b", pa.string())])
TABLE = pa.table({"a": [2, 1], "b": ["x", None]})


def test_written_tables_come_back_and_equal_tables_give_equal_bytes(tmp_path):
    first = write_table(tmp_path / "one.parquet", TABLE, SCHEMA, {"canary": "c"})
    second = write_table(tmp_path / "two.parquet", TABLE.slice(0), SCHEMA, {"canary": "c"})
    assert first == second
    back = read_table(tmp_path / "one.parquet")
    assert back.to_pydict() == TABLE.to_pydict()
    assert back.schema.metadata[b"canary"] == b"c"


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "file"
    write_atomic(path, lambda p: p.write_text("old"))

    def broken(p):
        p.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(StoreError, match="free some space"):
        write_atomic(path, broken)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@given(st.text(max_size=20))
def test_a_sequence_name_never_leaves_its_folder(name):
    try:
        path = Store("/store").interval_path("frames", safe_sequence(name))
    except InputError:
        return
    assert path.resolve().parent == Path("/store/intervals/frames")


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "../x", "a\\b\n", "a\x00", ".hidden", "x" * 101, "a..b"])
def test_hostile_sequence_names_are_refused(name):
    with pytest.raises(InputError):
        safe_sequence(name)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"version": 1}', "null"])
def test_a_broken_manifest_is_one_error(tmp_path, text):
    (tmp_path / "store.json").write_text(text)
    with pytest.raises(StoreError, match="load"):
        Store(tmp_path).manifest()


def test_a_file_system_without_locks_is_named_and_no_process(tmp_path, monkeypatch):
    graph, folder = tmp_path / "graph.kuzu", tmp_path / "journal"
    folder.mkdir()
    for lock in (graph.with_name("graph.kuzu.lock"), tmp_path / ".writing"):
        lock.write_text("process 1")

    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    for use in (
        lambda: lock_graph(graph, shared=True),
        lambda: lock_graph(graph, shared=False),
        lambda: Store(tmp_path).writing("load").__enter__(),
        lambda: journal_lock(folder, "").__enter__(),
    ):
        with pytest.raises(StoreError, match="its file system has no locks") as error:
            use()
        assert "process" not in str(error.value) and "local disk" in str(error.value)


@pytest.mark.parametrize("command", ["load {root}", "load --rebuild", "generate", "score", "runs remove r"])
def test_a_store_of_a_newer_version_is_refused_in_one_line_and_stays(tmp_path, command):
    root = write_root(tmp_path / "root", {"yard-2020-01-01_0": {"2d": {0: [person(1, (100, 100, 50, 90))]}}})
    (tmp_path / "store").mkdir()
    (tmp_path / "store/store.json").write_text(text := '{"version": 3, "sequences": ["of another form"]}')
    code, out, err = run(*command.format(root=root).split(), "--store", tmp_path / "store")
    assert (code, out, err.count("\n")) == (1, "", 1) and "by a newer jrdb-avr" in err
    assert (tmp_path / "store/store.json").read_text() == text


def test_questions_of_no_store_at_all_are_not_called_missing(tmp_path):
    with pytest.raises(StoreError, match="is not a store: run 'jrdb-avr load"):
        Store(tmp_path / "nowhere").questions("questions")


def test_a_broken_parquet_file_is_one_error(tmp_path):
    path = tmp_path / "t.parquet"
    write_table(path, TABLE, SCHEMA)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(StoreError, match=r"t\.parquet"):
        read_table(path)


def test_a_column_that_a_table_lacks_is_one_error(tmp_path):
    path = tmp_path / "t.parquet"
    write_table(path, TABLE, SCHEMA)
    assert read_table(path, TABLE.column_names[:1]).column_names == TABLE.column_names[:1]
    with pytest.raises(StoreError, match=r"t\.parquet: it lacks the column weight"):
        read_table(path, ["weight"])


def test_what_is_no_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StoreError, match="not a file"):
        write_atomic(tmp_path / "pipe", lambda path: path.write_bytes(b"x"))
    assert (tmp_path / "pipe").is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]
