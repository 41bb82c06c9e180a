"""The keyframe layer of the stored graph: made once, reused, made anew, and whole whatever happens to its maker."""

import contextlib
import random
import shutil
import signal
from collections import defaultdict

import msgspec
import pytest
from processes import run, run_program, started
from random_worlds import lively_world, sociable_world
from stored_layers import layer_rows
from world_calls import believe, tables_of
from worlds import load_world

from jrdb_avr.engine.generate import stored_layer
from jrdb_avr.engine.generate.describe import describe
from jrdb_avr.engine.generate.layer import Layer
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.generate.stored_layer import STAGE, ensure_layer, layer_jobs
from jrdb_avr.engine.validate.checks import validate
from jrdb_avr.loaders.load import rebuild
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.graph.database import engine
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.keyframes import layer_stamp
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules, Rules

NAMES = ["hall-2020-01-01_0", "yard-2020-01-01_0"]
RULES = Rules()
OTHER = Rules(max_conditions=1)


def stamp(store):
    with Graph.open(store.graph_path, read_only=True) as graph:
        return layer_stamp(graph)


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """A store without a layer. Not to be written to."""
    worlds = sociable_world(random.Random(7), NAMES[0]) | lively_world(random.Random(8), NAMES[1])
    return load_world(tmp_path_factory.mktemp("loaded"), worlds)


@pytest.fixture(scope="module")
def made(loaded, tmp_path_factory):
    """The same with the layer. Not to be written to."""
    store = Store(shutil.copytree(loaded.path, tmp_path_factory.mktemp("made") / "store"))
    ensure_layer(store, RULES, 1)
    return store


@pytest.fixture(scope="module")
def made_rows(made):
    """Every row of its layer."""
    return layer_rows(made)


def copied(store, tmp_path):
    return Store(shutil.copytree(store.path, tmp_path / "store"))


def test_the_graph_holds_the_layers_of_all_sequences(made, made_rows):
    expected = defaultdict(list)
    with Graph.open(made.graph_path, read_only=True) as graph:
        for job in layer_jobs(made, RULES):
            for name, rows in Layer(made, graph, job.sequence, RULES, job.low).tables():
                expected[name] += [repr(tuple(row.values())) for row in rows.to_pylist()]
    assert len(expected.pop("Keyframes")) == len(NAMES)
    assert made_rows == {name: sorted(rows) for name, rows in expected.items()}
    assert all(made_rows.values()) and stamp(made) == (NAMES, RULES)


def test_names_are_read_back_as_people_are_described(made):
    with Graph.open(made.graph_path, read_only=True) as graph:
        for job in layer_jobs(made, RULES):
            layer = job.layer(graph)
            facts = layer.facts
            seen = [(who, frame) for who, frame in sorted(layer.boxes) if who in facts.uncovered[frame]]
            described = [some for one in seen for some in describe(facts, job.sequence, *one, RULES)]
            assert described and [*layer.names.values()] == described


@pytest.mark.slow
def test_generation_and_replay_make_no_graph_in_memory(loaded, tmp_path, monkeypatch):
    opened = []

    class Recorded(engine().Database):
        def __init__(self, path, *arguments, **more):
            opened.append(path)
            super().__init__(path, *arguments, **more)

    store = copied(loaded, tmp_path)
    monkeypatch.setattr(engine(), "Database", Recorded)
    monkeypatch.setattr(Graph, "memory", None)
    generate(store, workers=1)
    assert set(opened) == {str(store.graph_path), str(store.path / ".graph.kuzu.building")}
    opened.clear()
    assert validate(store, replay_proofs=True).checked["replay"] > 0
    assert set(opened) == {str(store.graph_path)}


# -- reused and made anew -----------------------------------------------------------------------------------------


def test_a_layer_that_fits_is_reused(made, tmp_path):
    store = copied(made, tmp_path)
    before = store.graph_path.read_bytes()
    # What a kill left once the layer was made.
    (store.path / STAGE).mkdir()
    assert ensure_layer(store, RULES, 1) == layer_jobs(store, RULES)
    assert store.graph_path.read_bytes() == before and not (store.path / STAGE).exists()


def test_a_layer_of_other_rules_is_the_one_of_a_fresh_store(loaded, made, made_rows, tmp_path):
    store, fresh = copied(made, tmp_path), copied(loaded, tmp_path / "fresh")
    for one in (store, fresh):
        ensure_layer(one, OTHER, 1)
        assert stamp(one) == (NAMES, OTHER)
    assert layer_rows(store) == layer_rows(fresh) != made_rows


class NewLayerError(Exception):
    """A layer is about to be made."""


@pytest.fixture
def no_new_layer(monkeypatch):
    def refuse(*_):
        raise NewLayerError

    monkeypatch.setattr(stored_layer, "map_in_order", refuse)


def test_a_layer_of_any_other_rule_is_not_reused(made, no_new_layer):
    others = {"condition_order": RULES.condition_order[::-1], "time_shift": "both"}
    with Graph.open(made.graph_path, read_only=True):
        for name, value in msgspec.structs.asdict(RULES).items():
            if name != "load":
                with pytest.raises(NewLayerError):
                    ensure_layer(made, Rules(**{name: others.get(name) or 2 * value}), 1)
        assert [job.sequence for job in ensure_layer(made, RULES, 1)] == NAMES


@pytest.mark.parametrize("sequences", [NAMES[:1], [*NAMES, "zoo-2020-01-01_0"]])
def test_a_layer_of_other_sequences_is_not_reused(made, no_new_layer, monkeypatch, sequences):
    whole = made.manifest()
    entries = dict.fromkeys(sequences, whole.sequences[NAMES[0]])
    monkeypatch.setattr(Store, "manifest", lambda store: msgspec.structs.replace(whole, sequences=entries))
    with pytest.raises(NewLayerError):
        ensure_layer(made, RULES, 1)


def test_a_rebuild_leaves_no_layer(made, made_rows, tmp_path):
    store = copied(made, tmp_path)
    rebuild(store, LoadRules(), 1)
    assert stamp(store) == ([], None)
    ensure_layer(store, RULES, 1)
    assert layer_rows(store) == made_rows


# -- who has the graph --------------------------------------------------------------------------------------------

HOLDER = """
import sys, time
from jrdb_avr.queries.graph.handle import Graph, build_graph
with Graph.open(sys.argv[1], read_only=sys.argv[2] == "reads"):
    print("open", flush=True)
    time.sleep(3600)  # The test ends it.
"""


@contextlib.contextmanager
def holder(store, how):
    """Another process that has the graph open."""
    with started(HOLDER, store.graph_path, how, until=lambda process: process.stdout.readline()) as process:
        yield process


def refused(store, *options):
    """The one line with which `generate` refuses."""
    code, out, err = run("generate", "--store", store.path, "--workers", "1", *options)
    assert (code, out) == (1, "")
    [line] = err.splitlines()
    return line


def test_without_a_graph_generate_says_what_to_do(loaded, tmp_path):
    store = copied(loaded, tmp_path)
    store.graph_path.unlink()
    hint = f"run 'jrdb-avr load --rebuild --store {store.path}'"
    assert refused(store) == f"jrdb-avr: {store.graph_path} does not exist: {hint}"
    assert not (store.path / "questions").exists()


@pytest.mark.parametrize("how", ["reads", "writes"])
def test_a_graph_in_use_is_not_written_and_its_holder_named(made, tmp_path, how):
    store = copied(made, tmp_path)
    before = store.graph_path.read_bytes()
    with holder(store, how) as process:
        line = refused(store, "--rule", "max_conditions=1")
        assert line.startswith(f"jrdb-avr: {store.graph_path} is in use by process {process.pid} (")
        if how == "reads":
            # Under the rules of the layer nothing is written to the graph.
            ensure_layer(store, RULES, 1)
        assert store.graph_path.read_bytes() == before
    assert not (store.path / STAGE).exists()


# -- beside a world model -----------------------------------------------------------------------------------------

BELIEVER = """
import os, signal, sys
from world_calls import believe
from jrdb_avr.queries.beliefs.graph import WorldGraph
world = WorldGraph.open(sys.argv[1])
believe(world)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
def test_the_world_model_of_a_run_stays(loaded, made_rows, tmp_path):
    store = copied(loaded, tmp_path)
    # What a killed run wrote last lies in the log beside the graph.
    assert run_program(BELIEVER, store.graph_path).returncode == -signal.SIGKILL
    log = store.graph_path.with_name("graph.kuzu.wal")
    assert log.stat().st_size
    ensure_layer(store, RULES, 1)
    assert layer_rows(store) == made_rows
    with WorldGraph.open(store.graph_path) as world:
        written = tables_of(world.graph)
        assert written["Entity"] and written["Related"]
        believe(world, 1)
        written = tables_of(world.graph)
    ensure_layer(store, OTHER, 1)
    assert stamp(store)[1] == OTHER
    with WorldGraph.open(store.graph_path) as world:
        assert tables_of(world.graph) == written
    # Opening the graph for a run rewrites its first page. The rows of the run explain the change.
    assert run("load", "--verify", "--store", store.path)[0] == 0


# -- killed -------------------------------------------------------------------------------------------------------

KILLED = """
import os, signal, sys, tempfile
from pathlib import Path
from jrdb_avr.engine.generate.stored_layer import ensure_layer
from jrdb_avr.queries import workers
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import Rules
steps, replace = 0, Path.replace
def counted(self, target):
    global steps
    steps += 1
    if steps == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    return replace(self, target)
Path.replace = counted
workers.run_alone = lambda function: function()
tempfile.tempdir = os.path.dirname(sys.argv[1])
ensure_layer(Store(sys.argv[1]), Rules(), 1)
"""


@pytest.mark.parametrize("step", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_kill_while_the_graph_is_published_leaves_a_sound_one(loaded, made, made_rows, tmp_path, step):
    store = copied(loaded, tmp_path)
    assert run_program(KILLED, store.path, step).returncode == -signal.SIGKILL
    code, _, err = run("load", "--verify", "--store", store.path)
    assert code == 0, err
    ensure_layer(store, RULES, 1)
    assert layer_rows(store) == made_rows
    assert sorted(path.name for path in store.path.iterdir()) == sorted(path.name for path in made.path.iterdir())
