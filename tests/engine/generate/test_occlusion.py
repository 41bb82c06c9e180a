"""Sequences without occlusion attributes: said at load and generation, listed in statistics, skipped on demand."""

import warnings

import pytest
from click.testing import CliRunner
from keyframe_layers import layers_in_memory
from loaded_stores import without_graph
from worlds import load_world, person, write_root

from jrdb_avr.engine.cli import group
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.validate.statistics import statistics
from jrdb_avr.schema.errors import AvrWarning, StoreError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import LoadRules

BOX, OTHER = (1800, 100, 60, 200), (400, 100, 60, 200)
EVIDENCE = "geometry" if LoadRules().visibility == "clear" else "nothing"
SEEN, UNSEEN = "yard-2020-01-01_0", "yard-2020-01-02_0"


def sequence(attributes):
    """Somebody who stands and then walks, and somebody else who sits."""
    frames = {}
    for frame in range(0, 300, 15):
        pose = POSES[1] if frame < 120 else POSES[0]
        told = {} if attributes else {"attributes": None}
        frames[frame] = [person(1, BOX, {pose: "1", "reading": "1"}, **told), person(2, OTHER, {POSES[2]: "1"}, **told)]
    return {"2d": frames}


@pytest.fixture(autouse=True)
def in_memory():
    with layers_in_memory():
        yield


@pytest.fixture
def store(tmp_path):
    with without_graph(), pytest.warns(AvrWarning, match="1 of 2 sequences have no occlusion attributes"):
        return load_world(tmp_path, {SEEN: sequence(True), UNSEEN: sequence(False)})


def test_load_counts_them_in_one_line(store, tmp_path):
    assert store.without_occlusion() == [UNSEEN]
    root = write_root(tmp_path / "again", {SEEN: sequence(True), UNSEEN: sequence(False)})
    with without_graph():
        result = CliRunner().invoke(group, ["load", str(root), "--store", str(tmp_path / "s"), "--workers", "1"])
    assert result.exit_code == 0, result.output
    assert len([line for line in result.stderr.splitlines() if "no occlusion attributes" in line]) == 1
    with without_graph(), warnings.catch_warnings():
        warnings.simplefilter("error", AvrWarning)
        load_world(tmp_path / "all", {SEEN: sequence(True)})


def test_generate_says_so_and_skips_them_on_demand(store):
    with pytest.warns(AvrWarning, match="boxes decide who is in clear view.*--require-occlusion skips them"):
        generate(store, workers=1)
    assert store.questions("sequences")["sequence"].to_pylist() == [SEEN, UNSEEN]
    with pytest.warns(AvrWarning, match="1 of 2 sequences have no occlusion attributes and are skipped"):
        generate(store, workers=1, require_occlusion=True)
    assert store.questions("sequences")["sequence"].to_pylist() == [SEEN]
    assert set(store.questions("questions")["sequence"].to_pylist()) <= {SEEN}


def test_the_statistics_name_them(store):
    with pytest.warns(AvrWarning):
        generate(store, workers=1)
    tables = statistics(store)
    assert {row["sequence"]: row["visibility"] for row in tables["sequence"]} == {SEEN: "attributes", UNSEEN: EVIDENCE}
    result = CliRunner().invoke(group, ["stats", "--store", str(store.path)])
    assert result.exit_code == 0, result.output


def test_a_store_without_any_is_refused_on_demand(tmp_path):
    with without_graph(), pytest.warns(AvrWarning, match="1 of 1 sequences"):
        store = load_world(tmp_path, {UNSEEN: sequence(False)})
    with pytest.warns(AvrWarning), pytest.raises(StoreError, match="without --require-occlusion"):
        generate(store, workers=1, require_occlusion=True)
