"""`load --verify` finds a changed file and says how to repair the store."""

import random
import shutil
import subprocess
import sys

import pytest
from processes import run
from random_worlds import sociable_world
from worlds import load_world

from jrdb_avr.engine.generate.stored_layer import ensure_layer
from jrdb_avr.loaders.verify import VERIFY_STEPS, checks_of
from jrdb_avr.queries.beliefs.graph import make_world_tables
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import Rules


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return load_world(tmp_path_factory.mktemp("verify"), sociable_world(random.Random(7), "yard-1_0"))


@pytest.fixture
def copy(store, tmp_path):
    return Store(shutil.copytree(store.path, tmp_path / "store"))


def faults(store):
    return {check.what: check.fault for check in checks_of(store) if check.fault}


def flip(path, position):
    """Change one bit of a file."""
    data = bytearray(path.read_bytes())
    data[position] ^= 1
    path.write_bytes(data)


def write_episode(store):
    """Write into the graph as a run does."""
    with Graph.open(store.graph_path) as graph:
        make_world_tables(graph)
        graph.execute("CREATE (:Episode {id: 'r/q', run: 'r', question: 'q', sequence: 's'})")


def test_a_loaded_store_has_no_fault(store):
    steps = []
    checks = checks_of(store, steps.append)
    assert [check.what for check in checks] == ["annotations", "intervals", "graph"]
    assert all(check.checked and not check.fault for check in checks)
    assert sum(steps) == VERIFY_STEPS


@pytest.mark.parametrize("position", [9, 100, 0.5, -1])
@pytest.mark.parametrize(
    ("file", "remedy"),
    [
        ("annotations/boxes_2d/yard-1_0.parquet", "ROOT"),
        ("intervals/sightings/yard-1_0.parquet", "--rebuild"),
        ("graph.kuzu", "--rebuild"),
    ],
)
def test_one_changed_byte_is_found_in_its_file(copy, file, remedy, position):
    path = copy.path / file
    flip(path, int(position * path.stat().st_size) if isinstance(position, float) else position)
    code, out, err = run("load", "--verify", "--store", copy.path, "--csv")
    (fault,) = [line for line in out.splitlines() if " is not the file that was " in line]
    assert code == 1 and file in fault
    assert (
        err.splitlines()[-1] == f"{copy.path} changed after the load: run 'jrdb-avr load {remedy} --store {copy.path}'"
    )


def test_a_missing_and_an_added_file_are_named(copy):
    path = copy.interval_path("actions", "yard-1_0")
    path.rename(path.with_name("other-1_0.parquet"))
    assert faults(copy) == {"intervals": "intervals/actions/yard-1_0.parquet is missing (and 1 more)"}


def test_a_graph_that_a_run_has_written_into_is_compared_by_its_rows(copy):
    write_episode(copy)
    assert faults(copy) == {}
    with Graph.open(copy.graph_path) as graph:
        graph.execute("MATCH ()-[r:Beside]->() WITH r LIMIT 1 DELETE r")
        left = graph.count_rows()["Beside"]
    assert faults(copy) == {"graph": f"graph.kuzu has {left} rows of Beside instead of {left + 1}"}


@pytest.mark.parametrize("runs", [0, 1])
@pytest.mark.parametrize("extra", [1, 4096])
def test_a_graph_that_has_grown_without_a_run_is_not_what_was_built(copy, runs, extra):
    if runs:
        write_episode(copy)
    with copy.graph_path.open("ab") as file:
        file.write(b"\0" * extra)
    assert list(faults(copy)) == ([] if runs and extra == 4096 else ["graph"])


@pytest.mark.slow
def test_a_graph_that_crashes_the_engine_is_a_line(copy):
    data = bytearray(copy.graph_path.read_bytes())
    data[4096:] = random.Random(3).randbytes(len(data) - 4096)
    copy.graph_path.write_bytes(data)
    command = [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()", "load", "--verify", "--csv"]
    done = subprocess.run([*command, "--store", copy.path], check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert "graph.kuzu is not the file that was built" in done.stdout.splitlines()[-1]
    assert len(done.stderr.splitlines()) == 1


def test_generate_does_not_search_a_damaged_graph(copy):
    copy.graph_path.write_bytes(copy.graph_path.read_bytes().replace(b"walking", b"wolking"))
    with pytest.raises(StoreError, match="is damaged: run 'jrdb-avr load --verify"):
        ensure_layer(copy, Rules(), 1)


def test_a_damaged_graph_is_rebuilt_by_the_command_that_is_named(copy):
    before = copy.manifest().graph
    copy.graph_path.write_bytes(copy.graph_path.read_bytes()[:-4096])
    code, _, err = run("load", "--verify", "--store", copy.path)
    assert code == 1
    again = err.partition("jrdb-avr ")[2].strip().strip("'").split()
    assert run(*again)[0] == 0
    assert not faults(copy) and copy.manifest().graph == before
