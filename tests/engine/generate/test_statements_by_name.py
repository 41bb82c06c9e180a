"""Statements of the generators, run by name over a stored graph: their comments, and refusals without a layer."""

import random
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from random_worlds import lively_world
from worlds import load_world

import jrdb_avr
from jrdb_avr.engine.generate.stored_layer import ensure_layer
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.keyframes import keyframe_values, queries_layer
from jrdb_avr.queries.named import named_queries
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FORMS

QUERIES = Path(jrdb_avr.__file__).parent / "queries"
GENERATORS = {path.stem: path.read_text() for path in sorted((QUERIES / "generators").glob("*.cypher"))}
RULES = Rules()
NAME = "yard-1_0"


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store with the layer."""
    store = load_world(tmp_path_factory.mktemp("named"), lively_world(random.Random(0), NAME))
    ensure_layer(store, RULES, 1)
    return store


def test_every_form_has_a_generator():
    counted = {"gap_count"}  # From `described`, in `propose.py`.
    assert {form.query for forms in FORMS.values() for form in forms} - counted == GENERATORS.keys() - {"described"}


@pytest.mark.parametrize("name", GENERATORS)
def test_a_generator_runs_by_its_name(store, name):
    """At most 15 lines, one sentence that says what it finds, and the values of rules from the layer."""
    query, text = named_queries("cypher")[name], GENERATORS[name]
    assert len(text.splitlines()) <= 15 and queries_layer(text)
    assert query.answers.endswith(".") and query.takes == "sequence (text)"
    values = keyframe_values(RULES) | {"sequence": NAME}
    by_hand = store.cypher(text, **{key: values[key] for key in parameters(text)})
    assert store.cypher(name, sequence=NAME).equals(by_hand)


def test_without_a_layer_one_line_says_what_to_run(tmp_path):
    store = load_world(tmp_path, lively_world(random.Random(0), NAME))
    for query in ("two_hop", GENERATORS["two_hop"]):
        with pytest.raises(StoreError) as refused:
            store.cypher(query, sequence=NAME)
        assert str(refused.value) == (
            f"{store.graph_path} has no keyframe layer: run 'jrdb-avr generate --store {store.path}'"
        )


def test_with_a_layer_of_other_rules_than_the_questions_one_line_says_what_to_run(benchmark_copy):
    store, path = benchmark_copy, benchmark_copy.question_path("answers")
    answers = pq.read_table(path)
    other = pa.array(["0" * 64] * len(answers))
    pq.write_table(answers.set_column(answers.column_names.index("rules"), "rules", other), path)
    for query in ("two_hop", GENERATORS["two_hop"]):
        with pytest.raises(StoreError) as refused:
            store.cypher(query, sequence=min(store.manifest().sequences))
        assert str(refused.value) == (
            f"{store.graph_path} has a keyframe layer of other rules than the questions: "
            f"run 'jrdb-avr generate --store {store.path}' with the options that made the questions"
        )
