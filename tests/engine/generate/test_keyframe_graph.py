"""The keyframe layer of the stored graph: made once, reused, made anew, and whole whatever happens to its maker."""

import contextlib
import os
import random
import shutil
import signal

import msgspec
import pytest
from keyframe_layers import layer_rows
from processes import run, run_program, started
from question_files import question_files
from random_worlds import lively_world
from world_calls import believe, tables_of
from worlds import load_world

from jrdb_avr.engine.generate import keyframe_graph, sequence
from jrdb_avr.engine.generate.keyframe_graph import STAGE, ensure_layer
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.validate.checks import validate
from jrdb_avr.loaders.load import rebuild
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.record import drop_world
from jrdb_avr.queries.graph.database import engine
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.keyframes import layer_stamp
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.rules import LoadRules, Rules
from jrdb_avr.schema.tables import RUNS
from jrdb_avr.schema.templates import FORMS

NAME = "yard-2020-01-01_0"
OTHER = Rules(max_conditions=1)


def files(store):
    return {name: path.read_bytes() for name, path in question_files(store).items()}


def stamp(store):
    with Graph.open(store.graph_path, read_only=True) as graph:
        return layer_stamp(graph)


@pytest.fixture(scope="module", autouse=True)
def few_templates():
    """Three templates are searched: most of these tests are about the layer alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sequence, "FORMS", {name: FORMS[name] for name in ("start", "change", "two_hop")})
        yield


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """A store without a layer. Not to be written to."""
    return load_world(tmp_path_factory.mktemp("loaded"), lively_world(random.Random(8), NAME))


@pytest.fixture(scope="module")
def made(loaded, tmp_path_factory):
    """The same with questions, and so with the layer. Not to be written to."""
    store = Store(shutil.copytree(loaded.path, tmp_path_factory.mktemp("made") / "store"))
    generate(store, workers=1)
    return store


@pytest.fixture(scope="module")
def made_rows(made):
    """Every row of its layer."""
    return layer_rows(made)


def copied(store, tmp_path):
    return Store(shutil.copytree(store.path, tmp_path / "store"))


# -- one graph ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_generation_and_replay_make_no_graph_in_memory(loaded, tmp_path, monkeypatch):
    opened = []

    class Recorded(engine().Database):
        def __init__(self, path, *arguments, **more):
            opened.append(path)
            super().__init__(path, *arguments, **more)

    store = copied(loaded, tmp_path)
    monkeypatch.setattr(sequence, "FORMS", FORMS)
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
    shutil.rmtree(store.path / "questions")
    # What a kill left once the layer was made.
    (store.path / STAGE).mkdir()
    generate(store, workers=1)
    assert files(store) == files(made) and not (store.path / STAGE).exists()
    assert store.graph_path.read_bytes() == before


@pytest.mark.slow
def test_other_rules_give_the_questions_of_a_fresh_store(loaded, made, made_rows, tmp_path):
    store, fresh = copied(made, tmp_path), copied(loaded, tmp_path / "fresh")
    for one in (store, fresh):
        generate(one, OTHER, workers=1)
        assert stamp(one)[1] == OTHER
    assert files(store) == files(fresh) != files(made)
    assert layer_rows(store) == layer_rows(fresh) != made_rows


class NewLayerError(Exception):
    """A layer is about to be made."""


@pytest.fixture
def no_new_layer(monkeypatch):
    def refuse(*_):
        raise NewLayerError

    monkeypatch.setattr(keyframe_graph, "map_sequences", refuse)


def test_a_layer_of_any_other_rule_is_not_reused(made, no_new_layer):
    others = {"condition_order": Rules().condition_order[::-1], "time_shift": "both"}
    with Graph.open(made.graph_path, read_only=True):
        for name, value in msgspec.structs.asdict(Rules()).items():
            if name != "load":
                with pytest.raises(NewLayerError):
                    ensure_layer(made, Rules(**{name: others.get(name) or 2 * value}), 1)
        assert ensure_layer(made, Rules(), 1) == stamp(made)[0] == {NAME: 0}


def test_a_layer_of_other_sequences_is_not_reused(made, no_new_layer, monkeypatch):
    whole = made.manifest()
    entries = dict.fromkeys((NAME, "zoo-2020-01-01_0"), whole.sequences[NAME])
    monkeypatch.setattr(Store, "manifest", lambda store: msgspec.structs.replace(whole, sequences=entries))
    with pytest.raises(NewLayerError):
        ensure_layer(made, Rules(), 1)


def test_a_rebuild_leaves_no_layer_and_what_searches_makes_it_again(made, made_rows, tmp_path):
    store = copied(made, tmp_path)
    rebuild(store, LoadRules(), 1)
    assert stamp(store) == ({}, None)
    code, _, err = run("generate", "--store", store.path, "--workers", "1")
    assert code == 0, err
    assert files(store) == files(made)
    assert layer_rows(store) == made_rows


# -- who has the graph --------------------------------------------------------------------------------------------

HOLDER = """
import sys, time
from jrdb_avr.queries.graph.handle import Graph, build_graph
with Graph.open(sys.argv[1], read_only=sys.argv[2] == "reads"):
    print("open", flush=True)
    time.sleep(60)
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
    before = files(store), store.graph_path.read_bytes()
    with holder(store, how) as process:
        line = refused(store, "--rule", "max_conditions=1")
        assert line.startswith(f"jrdb-avr: {store.graph_path} is in use by process {process.pid} (")
        if how == "reads":
            # Under the rules of the layer nothing is written to the graph.
            generate(store, workers=1)
        assert (files(store), store.graph_path.read_bytes()) == before
    assert not (store.path / keyframe_graph.STAGE).exists()


def test_a_folder_that_cannot_be_written_is_one_line(made, tmp_path):
    if os.geteuid() == 0:
        pytest.skip("the superuser may write everywhere")
    store = copied(made, tmp_path)
    store.path.chmod(0o500)
    try:
        assert "cannot" in refused(store, "--rule", "max_conditions=1")
    finally:
        store.path.chmod(0o700)


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
def test_the_world_model_of_a_run_stays(loaded, made, made_rows, tmp_path):
    store = copied(loaded, tmp_path)
    # What a killed run wrote last lies in the log beside the graph.
    assert run_program(BELIEVER, store.graph_path).returncode == -signal.SIGKILL
    log = store.graph_path.with_name("graph.kuzu.wal")
    assert log.stat().st_size
    generate(store, workers=1)
    assert files(store) == files(made)
    assert layer_rows(store) == made_rows
    with WorldGraph.open(store.graph_path) as world:
        written = tables_of(world)
        assert [row["name"] for row in written["Entity"]] == ["p1", "p2"] and written["Related"]
        # A second episode, and no look at the layer, which holds the answers.
        believe(world, 1)
        written = tables_of(world)
        for text in ("MATCH (m:Moment) RETURN m.pose ORDER BY m.id", "MATCH (n) RETURN n.pose, n.kind ORDER BY n.id"):
            with pytest.raises(QueryError):
                world.query(text)
    # All that another `generate` would write to the graph.
    ensure_layer(store, OTHER, 1)
    assert stamp(store)[1] == OTHER
    with WorldGraph.open(store.graph_path) as world:
        assert tables_of(world) == written
    # Opening the graph for a run rewrites its first page. The rows of the run explain the change.
    assert run("load", "--verify", "--store", store.path)[0] == 0


@pytest.mark.slow
def test_a_world_model_that_was_dropped_is_no_damage(made, tmp_path):
    store = copied(made, tmp_path)
    with WorldGraph.open(store.graph_path) as world:
        believe(world)
        drop_world(world.graph, "run")
    # The record of the run says that the graph has been written into.
    store.write_run("run", "world", RUNS["world"].empty_table())
    assert ensure_layer(store, Rules(), 1) == {NAME: 0}


# -- killed -------------------------------------------------------------------------------------------------------

KILLED = """
import os, signal, sys, tempfile
from pathlib import Path
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.queries import workers
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
generate(sys.argv[1], workers=1)
"""


def check_survived(store, made, made_rows):
    code, _, err = run("load", "--verify", "--store", store.path)
    assert code == 0, err
    generate(store, workers=1)
    assert files(store) == files(made)
    assert layer_rows(store) == made_rows
    assert sorted(path.name for path in store.path.iterdir()) == sorted(path.name for path in made.path.iterdir())


@pytest.mark.parametrize(
    "step",
    [1, *(pytest.param(step, marks=pytest.mark.slow) for step in (2, 3, 4))],
)
def test_a_kill_while_the_graph_is_published_leaves_a_sound_one(loaded, made, made_rows, tmp_path, step):
    store = copied(loaded, tmp_path)
    assert run_program(KILLED, store.path, step).returncode == -signal.SIGKILL
    check_survived(store, made, made_rows)
