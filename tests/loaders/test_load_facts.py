"""Every derived fact, in the tables and in the graph, equals a brute-force computation from the raw files."""

from __future__ import annotations

import random
import tempfile
from pathlib import Path

import pytest
from environment import REAL, examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from loaded_stores import NAME, compare_tables, reported_store, rows_of
from oracle_facts import Oracle, facts
from oracle_files import read_root
from random_worlds import in_other_words, random_world

from jrdb_avr.loaders.load import load_shard
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import ANNOTATIONS


def compare_annotations(store, found, sequence):
    """What was kept of the files is what brute force sees in them, row by row; codes of masks are not looked at."""
    for table, schema in ANNOTATIONS.items():
        if table in ("frames", "calibration"):
            continue
        names = [name for name in schema.names if name not in ("sequence", "segmentation")]
        # As sets: a word said twice over is one fact.
        assert set(rows_of(store.annotation(table, sequence).to_pylist(), names)) == set(
            rows_of(found.rows(table), names)
        ), table
    known = {}
    for row in store.annotation("frames", sequence).to_pylist():
        known.setdefault(row["layer"], set()).add(row["frame"])
    assert known == {layer: set(frames) for layer, frames in found.frames.items() if frames}


def check_tables(world):
    """Derive the tables of a world of one sequence, compare them; returns the oracle's facts."""
    with tempfile.TemporaryDirectory() as folder:
        (sequence,) = world
        store, _ = reported_store(folder, world[sequence])
        found = read_root(Path(folder) / "root", sequence)
        expected = Oracle(found, sequence).tables()
        compare_annotations(store, found, sequence)
        compare_tables(store, expected, sequence)
        return expected


@settings(max_examples=examples(3), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32))
def test_random_worlds_have_the_facts_of_the_oracle(seed):
    check_tables(in_other_words(random_world)(random.Random(seed), NAME))


@pytest.mark.slow
def test_many_random_worlds_have_the_facts_of_the_oracle():
    for seed in range(400):
        check_tables((in_other_words(random_world) if seed % 2 else random_world)(random.Random(seed), NAME))


@pytest.mark.skipif(not REAL.exists(), reason="the slice of real data is not here")
@pytest.mark.parametrize(
    "sequence",
    [
        "gates-ai-lab-2019-02-08_0",
        pytest.param("bytes-cafe-2019-02-07_0", marks=pytest.mark.slow),
        pytest.param("huang-basement-2019-01-25_0", marks=pytest.mark.slow),
    ],
)
def test_real_annotations_have_the_facts_of_the_oracle(tmp_path, sequence):
    (files,) = (files for files in find_root(REAL).sequences if files.sequence == sequence)
    load_shard(files, str(tmp_path), LoadRules())
    compare_tables(Store(tmp_path), facts(REAL, sequence), sequence)
