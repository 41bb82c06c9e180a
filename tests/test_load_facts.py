"""Every derived fact, in the tables and in the graph, equals a brute-force computation from the raw files."""

from __future__ import annotations

import os
import random
import tempfile
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracle_facts import facts
from random_worlds import random_world
from worlds import load_world, write_root

from jrdb_avr.loaders.layers import find_root
from jrdb_avr.loaders.load import Shard, load, load_shard
from jrdb_avr.queries.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import INTERVALS

REAL = Path(os.environ.get("JRDB_REAL", Path(__file__).parents[2] / "shared" / "jrdb-real"))

RELATIONS = {
    "SeenIn": ("sightings", "track", "frame"),
    "Performs": ("actions", "track", "action"),
    "MemberOf": ("memberships", "track", "cluster"),
    "Beside": ("beside", "source", "target"),
}


def plain(value):
    """A value that compares: floats to nine digits, so that another order of summing does not show."""
    if isinstance(value, float):
        return round(value, 9) + 0.0
    return tuple(value) if isinstance(value, list) else value


def rows_of(rows, names):
    return sorted((tuple(plain(row[name]) for name in names) for row in rows), key=repr)


def compare_tables(store, expected, sequence):
    for kind, schema in INTERVALS.items():
        found = rows_of(store.interval(kind, sequence).to_pylist(), schema.names)
        wanted = rows_of(expected[kind], schema.names)
        assert set(found) - set(wanted) == set(), kind
        assert set(wanted) - set(found) == set(), kind
        assert found == wanted, kind


def compare_graph(graph, expected, sequence):
    persons = graph.query(
        "MATCH (p:Person) WHERE p.sequence = $s RETURN p.id, p.track, p.first_frame, p.last_frame ORDER BY p.track",
        {"s": sequence},
    ).to_pylist()
    assert [tuple(row.values()) for row in persons] == [
        (f"{sequence}/{row['track']}", row["track"], row["first_frame"], row["last_frame"])
        for row in expected["persons"]
    ]
    frames = graph.query(
        "MATCH (f:Frame) WHERE f.sequence = $s RETURN f.id, f.frame, f.keyframe, f.annotated, f.image ORDER BY f.frame",
        {"s": sequence},
    ).to_pylist()
    assert [tuple(row.values()) for row in frames] == [
        (f"{sequence}/{row['frame']:06d}", row["frame"], row["keyframe"], row["annotated"], row["image"])
        for row in expected["frames"]
    ]
    ends = {"SeenIn": "b.frame", "Performs": "b.name", "MemberOf": "b.cluster", "Beside": "b.track"}
    for relation, (kind, source, target) in RELATIONS.items():
        names = [n for n in INTERVALS[kind].names if n not in ("sequence", source, target, "action", "cluster")]
        stored = {name: f"box.{name}" if name in "xywh" else name for name in names}
        columns = "".join(f", r.{stored[name]} AS {name}" for name in names if name != "frame")
        query = (
            f"MATCH (a:Person)-[r:{relation}]->(b) WHERE r.sequence = $s "
            f"RETURN a.track AS {source}, {ends[relation]} AS {target}{columns}"
        )
        found = graph.query(query, {"s": sequence}, ordered=False).to_pylist()
        keys = [source, target, *(name for name in names if name != "frame")]
        assert rows_of(found, keys) == rows_of(expected[kind], keys), relation


def check_tables(world):
    """Derive the tables of a world of one sequence, compare them; returns the oracle's facts."""
    with tempfile.TemporaryDirectory() as folder:
        root = write_root(Path(folder) / "root", world)
        (files,) = find_root(root).sequences
        assert load_shard(Shard(files, folder, LoadRules())).entry is not None
        expected = facts(root, files.sequence)
        compare_tables(Store(folder), expected, files.sequence)
        return expected


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32))
def test_random_worlds_have_the_facts_of_the_oracle(seed):
    check_tables(random_world(random.Random(seed)))


@pytest.mark.slow
def test_many_random_worlds_have_the_facts_of_the_oracle():
    for seed in range(400):
        check_tables(random_world(random.Random(seed)))


def test_random_worlds_are_not_empty_of_facts():
    """The comparison is worth something only if every kind of fact occurs in it."""
    seen = Counter()
    for seed in range(30):
        expected = check_tables(random_world(random.Random(seed)))
        seen.update(("gap", row["gap"], row["certain"]) for row in expected["actions"])
        seen.update(("member", row["gap"], row["certain"]) for row in expected["memberships"])
        seen.update((row["label"].endswith("(robot view)"), row["certain"]) for row in expected["beside"])
        seen.update(("closed", row["closed"]) for row in expected["segments"])
        seen.update(("size", row["group_size"] is None) for row in expected["sightings"])
        seen.update(("sector", row["sector_other"] is None) for row in expected["sightings"])
    assert len(seen) == 3 + 3 + 4 + 2 + 2 + 2, seen
    assert min(seen.values()) >= 5, seen


@pytest.mark.parametrize("seed", range(3))
def test_the_graph_has_the_facts_of_the_oracle(seed, tmp_path):
    """Three sequences in one graph: each has its own rows and no other's."""
    worlds = [random_world(random.Random(1000 * seed + i), f"yard-2020-01-0{i}_0") for i in range(1, 4)]
    world = {name: layers for one in worlds for name, layers in one.items()}
    store = load_world(tmp_path, world)
    with Graph.open(store.graph_path, read_only=True) as graph:
        for sequence in world:
            expected = facts(tmp_path / "root", sequence)
            compare_tables(store, expected, sequence)
            compare_graph(graph, expected, sequence)
        for relation, (kind, _, _) in RELATIONS.items():
            total = sum(store.interval(kind, sequence).num_rows for sequence in world)
            found = graph.query(f"MATCH ()-[r:{relation}]->() RETURN count(*) AS n")["n"][0].as_py()
            assert found == total == store.manifest().graph[relation]


def test_a_synthetic_sample_has_the_facts_of_the_oracle(tmp_path):
    from jrdb_avr.loaders.sample.writer import plan, write

    root = tmp_path / "root"
    for _ in write(plan(root, [(200, 12)], 3, images="none"), 1):
        pass
    store = Store(tmp_path / "store")
    load(find_root(root), store, LoadRules(), 1)
    with Graph.open(store.graph_path, read_only=True) as graph:
        for sequence in store.manifest().sequences:
            expected = facts(root, sequence)
            compare_tables(store, expected, sequence)
            compare_graph(graph, expected, sequence)


@pytest.mark.skipif(not REAL.exists(), reason="the slice of real data is not here")
def test_real_annotations_have_the_facts_of_the_oracle(tmp_path):
    root = find_root(REAL)
    chosen = ("gates-ai-lab-2019-02-08_0", "bytes-cafe-2019-02-07_0", "huang-basement-2019-01-25_0")
    for files in root.sequences:
        if files.sequence in chosen:
            load_shard(Shard(files, str(tmp_path), LoadRules()))
            compare_tables(Store(tmp_path), facts(REAL, files.sequence), files.sequence)
