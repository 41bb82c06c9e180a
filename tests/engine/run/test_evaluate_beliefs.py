"""World models of runs: what a live run wrote, write by write, is what its record gives back, row by row."""

import json
import random
import signal
import subprocess
import sys

import pyarrow as pa
import pytest
from belief_runs import ASKED, Believer, run, world_dump
from click.testing import CliRunner
from painted import write_public
from processes import run_program
from random_worlds import lively_world
from scored_runs import InMemory, segment_of
from worlds import load_world

from jrdb_avr.engine.cli import group
from jrdb_avr.engine.run import journal as journals
from jrdb_avr.engine.run.methods import open_world
from jrdb_avr.engine.run.run import add_world_counts
from jrdb_avr.queries.beliefs.graph import WorldGraph, make_world_tables
from jrdb_avr.queries.beliefs.record import merge_world, read_record, replayed, restore_world
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.runs import RunManifest, read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, LockedError, StoreError


def dump(path):
    with Graph.open(path, read_only=True) as graph:
        return world_dump(graph)


def of_run(found, run_id):
    return {name: [row for row in rows if f"'{run_id}/" in row] for name, rows in found.items()}


def jrdb_avr(*arguments):
    result = CliRunner().invoke(group, [str(a) for a in arguments])
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
    import shutil

    shutil.copytree(template.path, tmp_path / "store")
    return Store(tmp_path / "store")


@pytest.fixture(scope="module")
def live(template):
    """What the two runs themselves wrote."""
    found = dump(template.graph_path)
    # Nothing here can hold of an empty table.
    assert all(len(rows) > 5 for rows in found.values()), {name: len(rows) for name, rows in found.items()}
    return found


@pytest.mark.slow
def test_an_episode_that_was_interrupted_before_its_lines_is_taken_away(template):
    """Facts come before the lines of the record: a killed run may leave an episode without any."""
    with Graph.memory() as graph:
        make_world_tables(graph)
        restore_world(graph, "one", read_record(template, "one"))
        before = world_dump(graph)
        graph.execute(
            "CREATE (:Episode {id: 'one/x', run: 'one', question: 'x', sequence: 's', plan: ''})-[:Made]->"
            "(:Observation {id: 'one/x/o1', episode: 'one/x', number: 1, step: 1, frame: 0, angle: 0.0, left: 0, "
            "width: 480})"
        )
        assert world_dump(graph) != before
        assert restore_world(graph, "one", read_record(template, "one")) == 0
        assert world_dump(graph) == before


def test_the_record_gives_back_every_row_of_a_live_run(template, live):
    with Graph.memory() as graph, WorldGraph.memory() as empty:
        assert not any(world_dump(empty).values())
        make_world_tables(graph)
        for name in ("one", "two"):
            merge_world(graph, name, read_record(template, name))
        assert world_dump(graph) == live


def test_every_line_of_the_record_is_a_node_and_refused_ones_changed_nothing(template, live):
    rows = read_record(template, "one").to_pylist()
    assert len(rows) == len(of_run(live, "one")["Write"])
    assert {row["accepted"] for row in rows} == {True, False}
    assert not any(row["fact"] for row in rows if not row["accepted"])
    edges = sum(len(of_run(live, "one")[name]) for name in ("Sighted", "Has", "Related"))
    assert edges == sum(any(f'"{name}":' in row["fact"] for name in ("sighted", "has", "related")) for row in rows)


def test_a_rebuild_of_a_torn_graph_brings_every_run_back(store, live):
    store.graph_path.write_bytes(store.graph_path.read_bytes()[:4096])
    assert jrdb_avr("load", "--rebuild", "--store", store.path).exit_code == 0
    assert dump(store.graph_path) == live
    assert jrdb_avr("load", "--verify", "--store", store.path).exit_code == 0


@pytest.mark.slow
def test_a_run_with_a_graph_of_its_own_is_merged(store, live, tmp_path):
    run(store, "three", path=tmp_path / "own.kuzu")
    assert dump(store.graph_path) == live
    (row,) = json.loads(jrdb_avr("world", "merge", "three", "--store", store.path, "--json").stdout)
    found = dump(store.graph_path)
    assert of_run(found, "three") == dump(tmp_path / "own.kuzu")
    assert {name: [r for r in rows if "'three/" not in r] for name, rows in found.items()} == live
    assert (row["run"], row["episodes"], row["writes"]) == ("three", len(ASKED), len(of_run(found, "three")["Write"]))
    jrdb_avr("world", "merge", "three", "one", "--store", store.path)
    assert dump(store.graph_path) == found


def test_a_dropped_run_leaves_the_graph_and_keeps_its_record(store, live):
    jrdb_avr("world", "drop", "one", "--store", store.path)
    assert dump(store.graph_path) == of_run(live, "two")
    with pytest.raises(StoreError, match="holds nothing of run 'one'"):
        jrdb_avr("world", "drop", "two", "one", "--store", store.path)
    assert dump(store.graph_path) == of_run(live, "two")
    jrdb_avr("world", "merge", "one", "--store", store.path)
    assert dump(store.graph_path) == live


KILLED_AT = """
import os, signal, sys
from jrdb_avr.engine.cli import main
from jrdb_avr.queries.graph import handle
steps, last, run = 0, int(sys.argv[1]), handle.Graph._run
def counted(self, text, *more):
    global steps
    found = run(self, text, *more)
    steps += not text.startswith("EXPLAIN") and any(word in text for word in ("DELETE", "COPY", "COMMIT"))
    if steps == last:
        os.kill(os.getpid(), signal.SIGKILL)
    return found
handle.Graph._run = counted
sys.argv = ["jrdb-avr", *sys.argv[2:]]
main()
"""


@pytest.mark.parametrize(
    ("what", "step"),
    [("drop", 3), pytest.param("drop", 7, marks=pytest.mark.slow), pytest.param("merge", 9, marks=pytest.mark.slow)],
)
def test_a_kill_leaves_a_run_whole_or_gone_and_the_command_again_ends_it(store, live, what, step):
    """Six statements take a run away, the seventh is the COMMIT, or the first of those that copy."""
    done = run_program(KILLED_AT, step, "world", what, "one", "--store", store.path)
    assert done.returncode == -signal.SIGKILL, done.stderr
    kept, dropped = of_run(live, "one"), of_run(live, "nobody")
    assert of_run(dump(store.graph_path), "one") == (dropped if step == 7 else kept)
    if step == 7:
        with pytest.raises(StoreError, match="holds nothing of run 'one'"):
            jrdb_avr("world", what, "one", "--store", store.path)
    else:
        jrdb_avr("world", what, "one", "--store", store.path)
    assert of_run(dump(store.graph_path), "one") == (kept if what == "merge" else dropped)
    assert of_run(dump(store.graph_path), "two") == of_run(live, "two")


def test_a_runs_manifest_counts_reads_and_writes_of_its_world_model(store):
    with WorldGraph.memory() as graph:
        graph.write([("CREATE (:Episode {id: 'r/q'})", {}), ("CREATE (:Episode {id: 'r/p'})", {})])
        graph.query("MATCH (e:Episode) RETURN count(*) AS n")
        assert graph.counts == {"reads": 1, "writes": 2}
        for resumed in (1, 2):
            add_world_counts(store, "one", graph.counts)
            assert read_run_manifest(store, "one").world == {"reads": resumed, "writes": 2 * resumed}


def test_merging_what_is_not_there_is_one_line(store, live, tmp_path):
    run(store, "half", ASKED[:1], tmp_path / "half.kuzu", finish=False)
    for run_id, method in (("half", "agent"), ("base", "react"), ("silent", "agent")):
        manifest = RunManifest(run_id, method, "m", "0" * 64, (), True, {}, "")
        write_run_manifest(store, manifest)
    for run_id in ("base", "silent"):
        journals.write_tables(store, run_id, InMemory())
    for run_id, words in (
        ("none", r"has no run 'none': did you mean one"),
        ("half", r"'half' is not finished: repeat its 'jrdb-avr evaluate' with --resume"),
        ("base", r"'base' has no world model: only the methods agent and agent-passive"),
        ("../one", r"cannot be a run id"),
    ):
        with pytest.raises(AvrError, match=words) as caught:
            jrdb_avr("world", "merge", "one", run_id, "--store", store.path)
        assert "\n" not in str(caught.value) and "Errno" not in str(caught.value)
        assert dump(store.graph_path) == live, "nothing is merged where one of the runs cannot be"
        with pytest.raises(StoreError, match="holds nothing of run"):
            jrdb_avr("world", "drop", run_id, "--store", store.path)
    (row,) = json.loads(jrdb_avr("world", "merge", "silent", "--store", store.path, "--json").stdout)
    assert (row["episodes"], row["writes"]) == (0, 0)
    with pytest.raises(StoreError, match="is not a store"):
        jrdb_avr("world", "merge", "one", "--store", tmp_path / "typo")
    store.graph_path.unlink()
    with pytest.raises(StoreError, match="has no graph"):
        jrdb_avr("world", "merge", "one", "--store", store.path)


@pytest.mark.slow
def test_a_resumed_run_brings_back_what_a_new_graph_lacks(store, live):
    """As after a load while the run was stopped; and what an interrupted question left does not stay."""
    journal = segment_of(store.run_path("one"))
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:3]))
    (store.run_path("one") / "world.parquet").unlink()
    assert jrdb_avr("load", "--rebuild", "--store", store.path).exit_code == 0
    assert dump(store.graph_path) == of_run(live, "two")
    with open_world(store.graph_path, "one", journals.world_rows("one", {})) as world:
        Believer(world, 20).answer(Task(ASKED[5]))
    run(store, "one")
    assert dump(store.graph_path) == live


class Task:
    """What the believer needs of a task."""

    def __init__(self, question):
        self.question, self.record_write = question, lambda write: None


def test_what_another_process_writes_is_refused_by_name(store):
    code = (
        "import sys; from jrdb_avr.queries.beliefs.graph import WorldGraph\n"
        "with WorldGraph.open(sys.argv[1]): print('open', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, str(store.graph_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "open\n"
        write_public(store, ASKED, {"yard-1_0": (0, 15)})
        (store.path / "images" / "yard-1_0").mkdir(parents=True)
        (store.path / "images" / "yard-1_0" / "000000.jpg").write_bytes(b"")
        evaluate = ["evaluate", "--method", "agent", "--model", "simulated:perfect"]
        evaluate += ["--store", store.path, "--images", store.path / "images"]
        for arguments, told in (
            (["cypher", "MATCH (e:Episode) RETURN count(*)", "--store", store.path], "wait for it"),
            (["world", "merge", "one", "--store", store.path], "wait for it"),
            (["load", "--rebuild", "--store", store.path], "wait for it"),
            (evaluate, "--world-db FILE"),
        ):
            with pytest.raises(LockedError) as refused:
                jrdb_avr(*arguments)
            assert f"process {holder.pid}" in str(refused.value)
            assert told in str(refused.value)
        holder.stdin.close()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda rows: rows[1:], "has no write 0"),
        (lambda rows: [*rows, rows[-1]], "has it twice"),
        (lambda rows: [{**rows[0], "fact": "{]"}, *rows[1:]], "no fact"),
        (lambda rows: [{**rows[0], "fact": "null,null"}, *rows[1:]], "two facts"),
        (lambda rows: [{**rows[0], "fact": ""}, *rows[1:]], "does not begin"),
        (
            lambda rows: [r if r["tool"] == "observe" else {**r, "fact": r["fact"].replace("/o", "/q")} for r in rows],
            "not hold",
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
        replayed(read_record(copy, "two"))


def test_a_broken_record_is_left_out_and_told(store, live):
    (store.run_path("two") / "world.parquet").write_bytes(b"no table")
    result = jrdb_avr("load", "--rebuild", "--store", store.path)
    assert "the world model of run two was left out: " in result.stderr
    assert dump(store.graph_path) == of_run(live, "one")
