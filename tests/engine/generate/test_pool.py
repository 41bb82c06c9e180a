"""The pools of proven proposals are those of the set-wise search, row by row; of presence, a part of what it proves."""

import random
from collections import Counter

import numpy as np
import pyarrow as pa
import pytest
from keyframe_layers import layers_in_memory, searched
from random_worlds import lively_world, random_world, sociable_world
from worlds import load_world

from jrdb_avr.engine.generate.candidates import PASSED, frame_lists, to_table
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.held_out import Extent, refuse_held_out
from jrdb_avr.engine.generate.layer import LAYER_NODES, LAYER_RELS, make_layer
from jrdb_avr.engine.generate.near_duplicates import KEPT, thin_out
from jrdb_avr.engine.generate.pool import Prover, fill_pool
from jrdb_avr.engine.generate.propose import Search
from jrdb_avr.engine.generate.question import rows_of
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.engine.generate.selection import POOL
from jrdb_avr.engine.generate.sequence import SequenceJob, search_sequence
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.graph import SCENE_NODES, table_ddl
from jrdb_avr.schema.plan import canonical
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FORMS

RULES = Rules()


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    rng, layers = random.Random(31), {}
    for number in range(9):
        make = (random_world, lively_world, sociable_world)[number % 3]
        layers |= make(rng, f"yard-2020-01-01_{number}")
    return load_world(tmp_path_factory.mktemp("pool"), layers)


def layer_graph(layer, sequence):
    """A graph in memory with the layer of a sequence."""
    graph = Graph.memory()
    for statement in table_ddl({"Person": SCENE_NODES["Person"]} | LAYER_NODES, LAYER_RELS):
        graph.execute(statement)
    people = {row["from"] for name in ("At", "Acts", "Leaves") for row in layer.rows[name]}
    for person in sorted(people):
        graph.execute("CREATE (:Person {id: $id})", {"id": person})
    for name, rows in layer.tables():
        graph.copy(name, rows)
    return graph


def search_of(scene_graph, store, sequence, with_faces):
    facts = Facts(scene_graph, sequence, RULES.load, with_faces=with_faces)
    tables = {name: store.interval(name, sequence) for name in ("sequence", "frames", "sightings", "segments")}
    tables["actions"] = store.facts("actions", sequence)
    layer = make_layer(facts, sequence, tables, RULES)
    return Search(layer_graph(layer, sequence), sequence, layer, RULES)


def old_pool(context, forms, held_out=()):
    """(plan, answer, target) of what the set-wise search proves, and of what of it stays."""
    tables, reads = [], []
    for form in forms:
        candidates = refuse_held_out(context, find_candidates(context, form), held_out)
        rows = np.flatnonzero(candidates.rule == PASSED)
        tables.append(to_table(context, candidates, rows))
        reads.append(frame_lists(candidates, form.read, rows))
    proven, kept = set(), set()
    whole = pa.concat_tables(tables)
    read = pa.concat_arrays(
        [array.combine_chunks() if isinstance(array, pa.ChunkedArray) else array for array in reads]
    )
    verdicts = thin_out(whole.append_column("read_frames", read).combine_chunks(), RULES)
    for line, verdict in zip(whole.to_pylist(), verdicts, strict=True):
        row = line["plan"], line["answer"], line["target_track"]
        proven.add(row)
        if verdict == KEPT:
            kept.add(row)
    return proven, kept


def check_pools(store, sequence, graph, only=None):
    """The pool of each template is the same; return the number of questions by template."""
    compared = Counter()
    with layers_in_memory():
        result = search_sequence(SequenceJob(store.path, sequence, 0, RULES))
    with searched(store, sequence, RULES) as context:
        search = search_of(graph, store, sequence, "pose" in context.scene.layers)
        prover = Prover(search, CypherFacts(graph, RULES.load))
        for name, forms in FORMS.items():
            allowed = [form for form in forms if context.scene.layers.issuperset(form.layers)]
            if not allowed or (only and name not in only):
                continue
            proven, kept = old_pool(context, allowed)
            pool = fill_pool(search, allowed, prover)
            found = {(canonical(one.plan), one.answer, one.target) for one, _ in pool}
            if name == "presence":
                assert found <= proven
                assert bool(found) == bool(kept)
            else:
                assert found == kept, (sequence, name, len(found - kept), len(kept - found))
                rows = {row["key"]: row for row in result.pool.to_pylist() if row["template"] == name}
                made = pa.Table.from_pylist(list(rows_of(search, pool)), schema=POOL).to_pylist()
                assert {row["key"]: row for row in made} == rows
            compared[name] += len(found)
    return compared


def test_pools_of_random_worlds_are_those_of_the_set_wise_search(worlds):
    compared = Counter()
    with Graph.open(worlds.graph_path, read_only=True) as graph:
        for sequence in sorted(worlds.manifest().sequences):
            compared += check_pools(worlds, sequence, graph)
    assert compared.total() > 50


def test_pools_of_the_sample_are_those_of_the_set_wise_search(sample_benchmark):
    compared = Counter()
    with Graph.open(sample_benchmark.graph_path, read_only=True) as graph:
        for sequence in sorted(sample_benchmark.manifest().sequences):
            compared += check_pools(sample_benchmark, sequence, graph)
    assert compared.keys() == FORMS.keys()


def test_no_question_touches_a_held_out_one(sample_benchmark):
    store = sample_benchmark
    sequence = min(store.manifest().sequences)
    with Graph.open(store.graph_path, read_only=True) as graph, searched(store, sequence, RULES) as context:
        search = search_of(graph, store, sequence, "pose" in context.scene.layers)
        tracks = context.scene.tracks.tolist()
        held_out = (Extent(tuple(tracks[::3]), 100, 250), Extent(tuple(tracks[1::3]), 300, 330))
        prover, changed = Prover(search, CypherFacts(graph, RULES.load), held_out), 0
        for name, forms in FORMS.items():
            if name == "presence":
                continue
            _, kept = old_pool(context, forms, held_out)
            found = {(canonical(one.plan), one.answer, one.target) for one, _ in fill_pool(search, forms, prover)}
            assert found == kept
            changed += kept != old_pool(context, forms)[1]
        assert changed > 3
