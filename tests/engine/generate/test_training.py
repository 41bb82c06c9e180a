"""Training sets: everything that is proven, away from the held-out questions, and never taken for the benchmark."""

import itertools
import json
import random
import shutil

import pyarrow.parquet as pq
import pytest
from processes import run
from question_files import question_files
from random_worlds import lively_world
from worlds import load_world

from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.integrations.huggingface import export_folders
from jrdb_avr.engine.validate.checks import validate
from jrdb_avr.engine.validate.statistics import statistics
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError
from jrdb_avr.schema.rules import Rules

pytestmark = pytest.mark.slow

NAMES = ("hall-2020-01-01_0", "yard-2020-01-01_0")
FEW = 6
CAPS = Rules(max_per_person=1, max_per_person_in_all=2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """(store, generation) of all training questions of two worlds; the caps given are not those of training."""
    world = {}
    for name, seed in zip(NAMES, (34, 8), strict=True):
        world |= lively_world(random.Random(seed), name)
    store = load_world(tmp_path_factory.mktemp("whole"), world)
    return store, generate(store, CAPS, profile="train", workers=1)


@pytest.fixture(scope="module")
def copy(whole, tmp_path_factory):
    """A function that copies the store, without its questions."""
    folder, numbers, left_out = (
        tmp_path_factory.mktemp("copies"),
        itertools.count(),
        shutil.ignore_patterns("questions"),
    )
    return lambda: Store(shutil.copytree(whole[0].path, folder / str(next(numbers)), ignore=left_out))


@pytest.fixture(scope="module")
def held_out(copy):
    """A store with few questions: to keep away from a whole benchmark, such small worlds have too few people."""
    store = copy()
    generate(store, profile="train", n=FEW, workers=1)
    return store


@pytest.fixture(scope="module")
def trained(copy, held_out):
    """(store, generation) of the training questions that are disjoint from `held_out`, by two workers."""
    store = copy()
    return store, generate(store, profile="train", disjoint_from=held_out.path, workers=2)


def files(store):
    return {name: path.read_bytes() for name, path in question_files(store).items()}


def extents(store):
    """Per question its plan, its sequence, the tracks it needs, and all frames of its time."""
    sequences = {row["question_id"]: row["sequence"] for row in store.questions("questions").to_pylist()}
    for row in store.questions("answers").to_pylist():
        bindings, needed, plan, answer = (json.loads(row[name]) for name in ("bindings", "needed", "plan", "answer"))
        nodes = {node["id"] for node in plan["nodes"]}
        tracks = {track for name, track in bindings.items() if name in nodes} | {box["track"] for box in needed}
        frames = [frame for name, frame in bindings.items() if name not in nodes] + [box["frame"] for box in needed]
        frames += [value for name, value in answer.items() if name in ("frame", "start_frame", "end_frame")]
        yield row["plan"], sequences[row["question_id"]], tracks, set(range(min(frames), max(frames) + 1))


def touches(one, others):
    return any(one[1] == other[1] and one[2] & other[2] and one[3] & other[3] for other in others)


def test_no_training_question_touches_a_held_out_one(trained, held_out):
    others = list(extents(held_out))
    assert len(others) == FEW
    own = list(extents(trained[0]))
    assert len(own) > FEW and not [one for one in own if touches(one, others)]


def test_what_touches_a_held_out_question_is_refused(trained, whole, held_out):
    others = list(extents(held_out))
    assert {touches(one, others) for one in extents(whole[0])} == {True, False}
    assert (
        sum(row["held_out"] for row in trained[1].templates) > sum(row["held_out"] for row in whole[1].templates) == 0
    )


def test_a_training_set_of_which_nothing_is_left_says_so(copy, whole):
    # Every candidate touches a held-out question that it is itself.
    code, out, err = run("generate", "--store", copy().path, "--profile", "train", "--disjoint-from", whole[0].path)
    assert code == 1 and "Candidates" in out
    assert err.splitlines()[-1].startswith("jrdb-avr: no question is left that is disjoint from ")


def test_the_files_are_the_same_for_any_number_of_workers(trained, held_out, copy):
    again = copy()
    generate(again, profile="train", disjoint_from=held_out.path, workers=1)
    assert files(again) == files(trained[0])


def test_the_files_say_that_they_are_a_training_set(trained, held_out, whole):
    generation = pq.read_schema(held_out.question_path("questions")).metadata[b"generation"]
    for path in question_files(trained[0]).values():
        metadata = pq.read_schema(path).metadata
        assert (metadata[b"profile"], metadata[b"disjoint_from"]) == (b"train", generation)
        assert b"canary" not in metadata
    assert whole[0].training_set() == {"profile": "train", "disjoint_from": ""}


def test_no_command_takes_it_for_a_benchmark(trained, tmp_path):
    store = trained[0]
    with pytest.warns(AvrWarning, match="a training set .profile train, disjoint from generation"):
        statistics(store)
    with pytest.raises(StoreError, match="not a benchmark"):
        export_folders(store, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_files_without_their_marks_are_noticed(trained, copy):
    store = Store(shutil.copytree(trained[0].path, copy().path, dirs_exist_ok=True))
    path = store.question_path("evidence")
    table = pq.read_table(path)
    kept = {key: value for key, value in table.schema.metadata.items() if key != b"profile"}
    pq.write_table(table.replace_schema_metadata(kept), path)
    assert validate(store).faults["files"]


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"profile": "train", "n": 0}, "0 is no number of questions: give 1 or more"),
        ({"profile": "all", "n": 5}, "go with the profile 'train'"),
        ({"profile": "paper", "disjoint_from": "elsewhere"}, "go with the profile 'train'"),
    ],
)
def test_options_of_another_profile_are_refused(held_out, options, line):
    with pytest.raises(InputError, match=line):
        generate(held_out, **options)


def test_held_out_questions_are_not_overwritten(held_out, tmp_path):
    before = files(held_out)
    with pytest.raises(InputError, match="into another store"):
        generate(held_out, profile="train", disjoint_from=held_out.path / "questions" / "..", workers=1)
    with pytest.raises(StoreError, match="is not a store"):
        generate(held_out, profile="train", disjoint_from=tmp_path, workers=1)
    assert files(held_out) == before
