"""World models of runs: what a live run wrote, write by write, is what its record gives back, row by row."""

import random
import shutil
import signal
import subprocess
import sys
from types import SimpleNamespace

import pyarrow as pa
import pytest
from belief_runs import ASKED, run
from click.testing import CliRunner
from processes import run_program
from random_worlds import lively_world
from world_calls import begin, tables_of
from worlds import load_world

from jrdb_avr.engine.cli import group
from jrdb_avr.engine.run import evaluate as evaluation
from jrdb_avr.engine.run.methods import open_world
from jrdb_avr.engine.run.overview import remove_run
from jrdb_avr.queries.beliefs.graph import make_world_tables
from jrdb_avr.queries.beliefs.record import merge_world, read_record, replay
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrWarning, LockedError, StoreError


def dump(path):
    with Graph.open(path, read_only=True) as graph:
        return tables_of(graph)


def of_run(tables, run_id):
    return {name: [row for row in rows if f"'{run_id}/" in repr(row)] for name, rows in tables.items()}


def jrdb_avr(*arguments):
    result = CliRunner().invoke(group, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A store with a scene of one sequence, and two runs in its graph."""
    store = load_world(tmp_path_factory.mktemp("world"), lively_world(random.Random(0), "yard-1_0"))
    run(store, "one")
    run(store, "two", ASKED[3:4])
    return store


@pytest.fixture
def store(template, tmp_path):
    shutil.copytree(template.path, tmp_path / "store")
    return Store(tmp_path / "store")


@pytest.fixture(scope="module")
def merged(template):
    """The world models of both runs in the store's graph."""
    tables = dump(template.graph_path)
    assert all(len(rows) > 1 for rows in tables.values()), {name: len(rows) for name, rows in tables.items()}
    return tables


def test_a_merge_of_the_record_gives_the_same_rows_again(template, merged):
    with Graph.memory() as graph:
        make_world_tables(graph)
        for name in ("one", "two", "one"):
            merge_world(graph, name, read_record(template, name))
        assert tables_of(graph) == merged


def test_every_line_of_the_record_is_a_node_and_refused_calls_changed_nothing(template, merged):
    rows = read_record(template, "one").to_pylist()
    assert len(rows) == len(of_run(merged, "one")["Write"])
    assert {row["accepted"] for row in rows} == {True, False}
    assert not any(row["fact"] for row in rows if not row["accepted"])


def test_the_graph_of_a_run_is_in_its_folder_until_the_run_ends(store, merged):
    folder = store.run_path("one")
    with open_world(folder, "one") as world:
        begin(world.graph)
        assert (folder / "world.kuzu").exists()
        assert dump(store.graph_path) == merged
    assert {path.name for path in folder.glob("world.kuzu*")} <= {"world.kuzu.lock"}


def test_a_rebuild_of_a_torn_graph_brings_every_run_back(store, merged):
    store.graph_path.write_bytes(store.graph_path.read_bytes()[:4096])
    assert jrdb_avr("load", "--rebuild", "--store", store.path).exit_code == 0
    assert dump(store.graph_path) == merged
    assert jrdb_avr("load", "--verify", "--store", store.path).exit_code == 0


def test_removing_a_run_drops_its_world_model(store, merged):
    remove_run(store, "one")
    assert not store.run_path("one").exists()
    assert dump(store.graph_path) == of_run(merged, "two")


KILLED_AT = """
import os, signal, sys
from jrdb_avr.queries.beliefs.graph import open_graph
from jrdb_avr.queries.beliefs.record import merge_world, read_record
from jrdb_avr.queries.graph import handle
from jrdb_avr.queries.store import Store
steps, last, run = 0, int(sys.argv[1]), handle.Graph._run
def counted(self, text, *more):
    global steps
    result = run(self, text, *more)
    steps += not text.startswith("EXPLAIN") and any(word in text for word in ("DELETE", "COPY", "COMMIT"))
    if steps == last:
        os.kill(os.getpid(), signal.SIGKILL)
    return result
handle.Graph._run = counted
store = Store(sys.argv[2])
with open_graph(store.graph_path) as graph:
    merge_world(graph, "one", read_record(store, "one"))
"""


@pytest.mark.parametrize("step", [3, pytest.param(9, marks=pytest.mark.slow)])
def test_a_killed_merge_leaves_the_run_whole(store, merged, step):
    done = run_program(KILLED_AT, step, store.path)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert dump(store.graph_path) == merged


def test_a_graph_that_cannot_take_the_world_models_costs_no_answers(store):
    store.graph_path.write_bytes(b"no graph")
    ended = SimpleNamespace(store=store, run_id="one", finished={})
    with pytest.warns(AvrWarning, match="lacks the world models of one.*--resume"):
        evaluation._merge_world(ended)


def test_a_graph_in_use_is_refused_by_name(store):
    code = (
        "import sys; from jrdb_avr.queries.beliefs.graph import WorldGraph\n"
        "with WorldGraph.open(sys.argv[1]): print('open', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, str(store.graph_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "open\n"
        for arguments in (["cypher", "MATCH (e:Episode) RETURN count(*)"], ["load", "--rebuild"]):
            with pytest.raises(LockedError, match="wait for it") as refused:
                jrdb_avr(*arguments, "--store", store.path)
            assert f"process {holder.pid}" in str(refused.value)
        holder.stdin.close()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda rows: rows[1:], "has no write 0"),
        (lambda rows: [*rows, rows[-1]], "has it twice"),
        (lambda rows: [{**rows[0], "fact": "{]"}, *rows[1:]], "unreadable fact"),
        (lambda rows: [{**rows[0], "fact": "null,null"}, *rows[1:]], "two facts"),
        (lambda rows: [{**rows[0], "fact": ""}, *rows[1:]], "does not begin"),
        (
            lambda rows: [r if r["tool"] == "observe" else {**r, "fact": r["fact"].replace("/o", "/q")} for r in rows],
            "does not have",
        ),
        (lambda rows: [{**r, "fact": r["fact"].replace(r["question_id"], "x")} for r in rows], "does not begin"),
        (lambda rows: [{**r, "run_id": "other"} for r in rows], "another run"),
    ],
    ids=["a write less", "twice", "broken", "two in one", "no beginning", "to nothing", "another", "of another run"],
)
def test_a_record_that_no_run_wrote_is_refused(template, tmp_path, change, why):
    copy = Store(tmp_path)
    table = read_record(template, "two")
    copy.write_run("two", "world", pa.Table.from_pylist(change(table.to_pylist()), table.schema))
    with pytest.raises(StoreError, match=why):
        replay(read_record(copy, "two"))


def test_a_broken_record_is_left_out_with_a_warning(store, merged):
    (store.run_path("two") / "world.parquet").write_bytes(b"no table")
    result = jrdb_avr("load", "--rebuild", "--store", store.path)
    assert "the world model of run two was left out: " in result.stderr
    assert dump(store.graph_path) == of_run(merged, "one")
