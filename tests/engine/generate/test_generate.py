"""Generation as a whole: what is published, that it is reproducible, and what it refuses to start on."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from keyframe_layers import layers_in_memory
from loaded_stores import graphless_store
from processes import run_program
from question_files import question_files
from random_worlds import lively_world
from stored_layers import layer_rows
from worlds import load_world

from jrdb_avr.engine.commands.generate import generate as generate_command
from jrdb_avr.engine.generate.diagnostics import REASONS
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import LockedError, StoreError
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.rules import Rules, override

NAMES = ("hall-2020-01-01_0", "yard-2020-01-01_0")
SEEDS = (34, 8)
HOW = {"profile": "all", "workers": 1}


def two_worlds():
    world = {}
    for name, seed in zip(NAMES, SEEDS, strict=True):
        world |= lively_world(random.Random(seed), name)
    return world


def files(store):
    return {name: path.read_bytes() for name, path in question_files(store).items()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """(store, report) of a generation over two worlds, by two workers."""
    store = load_world(tmp_path_factory.mktemp("made"), two_worlds())
    return store, generate(store, Rules(), **HOW | {"workers": 2})


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """The same as `made`, over one world with much to ask: for tests that generate again. Not to be written to."""
    store = load_world(tmp_path_factory.mktemp("one"), lively_world(random.Random(8), NAMES[0]))
    return store, generate(store, Rules(), **HOW)


@pytest.fixture
def another(one, tmp_path):
    """A copy of the store of one world, without its questions."""
    shutil.copytree(one[0].path, tmp_path / "store", ignore=shutil.ignore_patterns("questions"))
    return Store(tmp_path / "store")


@pytest.fixture
def in_memory():
    """No graph is stored: for tests of what the layer does not change."""
    with layers_in_memory():
        yield


@pytest.fixture(scope="module")
def rows(made):
    """Questions joined with their answers."""
    store = made[0]
    answers = {row["question_id"]: row for row in store.questions("answers").to_pylist()}
    return [answers[row["question_id"]] | row | {"stored": answers[row["question_id"]]["answer"]}
            for row in store.questions("questions").to_pylist()]  # fmt: skip


# -- what is published ----------------------------------------------------------------------------------------


def test_true_choices_stand_at_every_place(rows):
    answers = [json.loads(row["stored"]) for row in rows]
    assert {answer["choice"] for answer in answers if "choice" in answer} == {1, 2, 3, 4}


def test_refusals_add_up(made):
    store, report = made
    for row in report.templates:
        assert row["candidates"] == sum(row[rule] for rule in REASONS) + row["questions"]
    rejected = store.questions("rejected").to_pylist()
    assert len({(row["sequence"], row["template"], row["rule"]) for row in rejected}) == len(rejected)


# -- reproducible ---------------------------------------------------------------------------------------------


def shuffled(world, seed):
    """The same labels with frames and records in another order."""
    rng = random.Random(seed)
    result = {}
    for name in rng.sample(sorted(world), len(world)):
        result[name] = {}
        for layer, content in world[name].items():
            if layer == "images":
                result[name][layer] = content
                continue
            frames = rng.sample(sorted(content), len(content))
            result[name][layer] = {frame: rng.sample(content[frame], len(content[frame])) for frame in frames}
    return result


@pytest.mark.slow
def test_files_do_not_depend_on_workers_input_order_or_hash_seed(made, tmp_path):
    load_world(tmp_path, shuffled(two_worlds(), 1))
    environment = os.environ | {"PYTHONHASHSEED": "77"}
    call = [Path(sys.executable).parent / "jrdb-avr", "generate", "--store", tmp_path / "store", "--workers", "1"]
    subprocess.run(call, check=True, env=environment, capture_output=True, timeout=300)
    store = Store(tmp_path / "store")
    assert files(store) == files(made[0])
    assert layer_rows(store) == layer_rows(made[0])


@pytest.mark.slow
def test_a_kill_between_the_files_is_repaired_by_another_run(one, tmp_path):
    store = Store(shutil.copytree(one[0].path, tmp_path / "store"))
    script = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from jrdb_avr.engine.generate.run import generate\n"
        "from jrdb_avr.queries.store import Store\n"
        "from jrdb_avr.schema.rules import Rules\n"
        "moves, move = [], Path.replace\n"
        "def replace(self, target):\n"
        "    if Path(target).parent.name == 'questions':\n"
        "        moves.append(target)\n"
        "        if len(moves) == 3:\n"
        "            os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return move(self, target)\n"
        "Path.replace = replace\n"
        "generate(Store(sys.argv[1]), Rules(), profile='train', workers=1)\n"
    )
    killed = run_program(script, store.path)
    assert killed.returncode == -signal.SIGKILL
    assert files(store) != files(one[0])
    generate(store, Rules(), **HOW)
    assert files(store) == files(one[0])
    left = {path for path in store.question_path("questions").parent.rglob("*") if path.is_file()}
    assert left == set(question_files(store).values())


# -- refusals -------------------------------------------------------------------------------------------------


def test_a_store_of_other_load_rules_is_refused(made):
    with pytest.raises(StoreError, match="other load rules"):
        generate(made[0], override(Rules(), {"load.gap_frames": "3"}), **HOW)


def test_intervals_that_are_not_as_they_were_loaded_are_refused(another):
    (sequence,) = another.manifest().sequences
    path = another.interval_path("sightings", sequence)
    pq.write_table(pq.read_table(path).slice(1), path)
    with pytest.raises(StoreError, match=f"{path.name} is not as it was loaded: run 'jrdb-avr load --verify"):
        generate(another, Rules(), **HOW)


def test_nothing_loaded_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(StoreError, match="run 'jrdb-avr load"):
        generate(Store(tmp_path / "none"), Rules(), **HOW)
    assert not (tmp_path / "none").exists()


def test_a_second_writer_is_refused(made):
    with made[0].writing("load"), pytest.raises(LockedError, match="load"):
        generate(made[0], Rules(), **HOW)


def test_missing_layers_are_named(tmp_path, in_memory):
    world = {NAMES[0]: {"2d": lively_world(random.Random(3), NAMES[0])[NAMES[0]]["2d"]}}
    store = graphless_store(tmp_path, world)
    result = CliRunner().invoke(generate_command, ["--store", str(store.path), "--workers", "1"])
    assert result.exit_code == 0, result.output
    assert "distance: skipped, the layer 3d is missing" in result.output
    found = CliRunner().invoke(generate_command, ["--store", str(store.path), "--workers", "1", "--json"])
    told = {row["template"]: row for row in json.loads(found.stdout)}
    assert told["distance"]["why"] == "skipped, the layer 3d is missing"
    assert not (told["start"]["why"] or "").startswith("skipped")


def test_a_world_without_anything_gives_empty_tables(tmp_path, in_memory):
    store = graphless_store(tmp_path, {NAMES[0]: {"2d": {0: [], 15: []}}})
    report = generate(store, Rules(), **HOW)
    assert all(row["questions"] == 0 for row in report.templates)
    assert store.questions("questions").num_rows == 0


def test_rules_reach_the_search(one, another, in_memory):
    report = generate(another, override(Rules(), {"max_conditions": "1", "max_per_person": "1"}), **HOW)
    answers = another.questions("answers").to_pylist()
    assert answers
    assert all(len(parse_plan(row["plan"]).nodes[0].conditions) == 1 for row in answers)
    assert sum(row["questions"] for row in report.templates) < sum(row["questions"] for row in one[1].templates)
