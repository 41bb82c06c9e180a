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
from worlds import load_world

from jrdb_avr.loaders.load import Shard, load_shard
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS

RELATIONS = (
    ("Person", "SeenIn", "sightings", "track", "frame", "b.frame"),
    ("Object", "SeenIn", "object_sightings", "object", "frame", "b.frame"),
    ("Person", "Present", "presences", "track", "sequence", "b.sequence"),
    ("Person", "Absent", "absences", "track", "sequence", "b.sequence"),
    ("Person", "Performs", "actions", "track", "action", "b.name"),
    ("Person", "MayPerform", "possible_actions", "track", "action", "b.name"),
    ("Person", "MemberOf", "memberships", "track", "cluster", "b.cluster"),
    ("Person", "MayBelong", "possible_memberships", "track", "cluster", "b.cluster"),
    ("Person", "Interacts", "interactions", "source", "target", "b.track"),
    ("Person", "MayInteract", "possible_interactions", "source", "target", "b.track"),
    ("Person", "Handles", "handles", "track", "object", "b.track"),
    ("Person", "MayHandle", "possible_handles", "track", "object", "b.track"),
    ("Person", "Beside", "beside", "source", "target", "b.track"),
)
"""Where a relationship starts, its name and interval table, the columns that name its ends, and what the end says."""
GROUP_LISTS = ("aim", "bpc", "ssc", "location", "inter")


def nodes(graph, table, names, sequence):
    columns = ", ".join(f"n.{name} AS {name}" for name in names)
    query = f"MATCH (n:{table}) WHERE n.sequence = $s RETURN {columns}"
    return rows_of(graph.query(query, {"s": sequence}, ordered=False).to_pylist(), names)


def clusters_of(expected):
    return {row["cluster"] for row in expected["memberships"]}


def group_of(expected, sequence, cluster):
    """What a group's node says: the chosen values; null for an attribute of which none is chosen."""
    chosen = {}
    for row in expected["group_info"]:
        if row["cluster"] == cluster and row["chosen"]:
            chosen.setdefault(row["attribute"], []).append(row["value"])
    lists = {name: sorted(chosen[name]) if name in chosen else None for name in GROUP_LISTS}
    (venue,) = chosen.get("venue", [None])
    return {"id": f"{sequence}/{cluster}", "cluster": cluster, "venue": venue, **lists}


def compare_graph(graph, expected, sequence):
    names = ("id", "track", "gender", "age", "ethnicity", "first_frame", "last_frame")
    persons = nodes(graph, "Person", names, sequence)
    assert persons == rows_of([{"id": f"{sequence}/{row['track']}", **row} for row in expected["persons"]], names)
    names = ("id", "track", "category_id", "category", "first_frame", "last_frame")
    objects = nodes(graph, "Object", names, sequence)
    keyed = [{"id": f"{sequence}/{row['category_id']}:{row['object']}", **row} for row in expected["objects"]]
    assert objects == rows_of([{"track": row["object"], **row} for row in keyed], names)
    names = ("id", "cluster", "venue", *GROUP_LISTS)
    groups = nodes(graph, "SocialGroup", names, sequence)
    assert groups == rows_of([group_of(expected, sequence, cluster) for cluster in clusters_of(expected)], names)
    frames = graph.query(
        "MATCH (f:Frame) WHERE f.sequence = $s RETURN f.id, f.frame, f.keyframe, f.annotated, f.image ORDER BY f.frame",
        {"s": sequence},
    ).to_pylist()
    assert [tuple(row.values()) for row in frames] == [
        (f"{sequence}/{row['frame']:06d}", row["frame"], row["keyframe"], row["annotated"], row["image"])
        for row in expected["frames"]
    ]
    for start, relation, kind, source, target, end in RELATIONS:
        names = [n for n in INTERVALS[kind].names if n not in ("sequence", source, target, "action", "cluster")]
        stored = {name: f"r.box.{name}" if name in "xywh" else f"r.{name}" for name in names}
        stored["category_id"] = "a.category_id" if start == "Object" else "b.category_id"
        columns = "".join(f", {stored[name]} AS {name}" for name in names if name != "frame")
        query = (
            f"MATCH (a:{start})-[r:{relation}]->(b) WHERE r.sequence = $s "
            f"RETURN a.track AS {source}, {end} AS {target}{columns}"
        )
        found = graph.query(query, {"s": sequence}, ordered=False).to_pylist()
        keys = [source, target, *(name for name in names if name != "frame")]
        assert rows_of(found, keys) == rows_of(expected[kind], keys), relation


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


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
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
        for relation in dict.fromkeys(row[1] for row in RELATIONS):
            kinds = [row[2] for row in RELATIONS if row[1] == relation]
            total = sum(store.interval(kind, sequence).num_rows for kind in kinds for sequence in world)
            found = graph.query(f"MATCH ()-[r:{relation}]->() RETURN count(*) AS n")["n"][0].as_py()
            assert found == total == store.manifest().graph[relation]


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
    load_shard(Shard(files, str(tmp_path), LoadRules()))
    compare_tables(Store(tmp_path), facts(REAL, sequence), sequence)
