"""The process that keeps the tables of a graph file: what it is asked, what becomes of it, and of the file's lock."""

import datetime
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.errors import QueryError, StoreError

NESTED = []
for _ in range(90):
    NESTED = [NESTED]


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    with WorldGraph.open(tmp_path_factory.mktemp("process") / "graph.kuzu") as graph:
        yield graph


@pytest.mark.parametrize(
    ("value", "why"),
    [
        (1 << 70, "a parameter cannot be bound"),
        (1 << 63, "does not fit 64 bits"),
        ("\ud800", "surrogates not allowed"),
        (np.arange(3), "a ndarray is no value"),
        (object(), "a object is no value"),
        (NESTED, "Recursion"),
        (b"bytes", "cannot be bound"),
        ({1: 2}, "cannot be a field's name"),
    ],
)
def test_what_cannot_be_asked_is_one_error_and_no_end(graph, value, why, capfd):
    with pytest.raises(QueryError, match=why) as caught:
        graph.query("RETURN $value AS value", {"value": value}, ordered=False)
    assert "\n" not in str(caught.value)
    assert graph.query("RETURN $value AS value", {"value": np.int16(4)}, ordered=False)["value"].to_pylist() == [4]
    assert capfd.readouterr().err == ""


def test_megabytes_go_both_ways(graph):
    text = "x" * (3 << 20)
    assert graph.query("RETURN $text AS text", {"text": text}, ordered=False)["text"].to_pylist() == [text]
    odd = ["", "a\0b", "\N{LINE SEPARATOR}", str(datetime.date(2020, 1, 2)), float("inf")]
    rows = [graph.query("RETURN $value AS v", {"value": value}, ordered=False) for value in odd]
    assert [row["v"][0].as_py() for row in rows] == odd


def test_a_killed_process_is_one_error_and_nothing_is_left_of_it(tmp_path):
    graph = WorldGraph.open(tmp_path / "graph.kuzu")
    os.kill(graph._tables._process.pid, signal.SIGKILL)
    for _ in range(2):
        with pytest.raises(StoreError, match=r"has ended: run again \(evaluate with --resume\)$"):
            graph.query("RETURN 1 AS one", ordered=False)
    graph.close()
    assert graph._tables._process.returncode == -signal.SIGKILL
    WorldGraph.open(tmp_path / "graph.kuzu").close()


def test_its_modules_are_the_parents_and_not_the_folders(tmp_path, monkeypatch):
    (tmp_path / "msgspec.py").write_text("raise SystemExit('not this one')")
    monkeypatch.chdir(tmp_path)
    WorldGraph.open("graph.kuzu").close()


def test_a_process_that_cannot_be_started_is_one_error(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with pytest.raises(StoreError, match="cannot start the process"):
        WorldGraph.open(tmp_path / "graph.kuzu")


LONG = """
import sys
from jrdb_avr.queries.beliefs.graph import WorldGraph
graph = WorldGraph.open(sys.argv[1])
print(graph._tables._process.pid, flush=True)
while True:
    graph.query("UNWIND range(1, 4000000) AS a WITH CAST(a AS STRING) AS s WHERE s CONTAINS '999999' RETURN count(*)")
"""


def test_it_ends_with_its_parent_in_the_middle_of_a_statement_and_the_file_opens_at_once(tmp_path):
    path = tmp_path / "graph.kuzu"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", LONG, str(path)], stdout=pipe, stderr=pipe) as run:
        child = Path("/proc", run.stdout.readline().decode().strip())
        time.sleep(0.2)
        assert child.exists()
        run.kill()
        WorldGraph.open(path).close()
        # It may be nobody's to reap here.
        assert not child.exists() or (child / "stat").read_text().rpartition(")")[2].split()[0] in "ZX"
        assert run.stderr.read() == b""
