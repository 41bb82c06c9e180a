"""Statements of the generators, run by name over a stored graph: their ranges, and refusals without a layer."""

import random
import re
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from random_worlds import lively_world
from worlds import load_world

import jrdb_avr
from jrdb_avr.queries.graph.parameters import strip_literals
from jrdb_avr.queries.named import named_queries
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import KEYFRAME_NODES

CYPHER = Path(jrdb_avr.__file__).parent / "queries"
TEXTS = {
    path.stem: path.read_text()
    for folder in ("generators", "necessity", "search")
    for path in sorted((CYPHER / folder).glob("*.cypher"))
}
RANGED = KEYFRAME_NODES.keys() - {"Keyframes"}
OF_LAYER = [name for name, text in TEXTS.items() if any(f":{label})" in text for label in RANGED)]


@pytest.mark.parametrize("name", [*OF_LAYER, "descriptions"])
def test_every_node_of_the_layer_lies_in_the_range_of_the_sequence(name):
    """Without a range on every node a query takes longer with every sequence of the store."""
    text = strip_literals(named_queries("cypher")[name].text)
    labelled = re.findall(r"\((\w*):(\w+)", text)
    nodes = {variable for variable, label in labelled if label in RANGED}
    assert nodes and "" not in nodes and not re.search(r"\(\s*\)\s*<?-|-\s*\(\s*\)", text)
    for node in nodes:
        assert f"{node}.id >= $low AND {node}.id < $high" in text, node


def test_without_a_layer_one_line_says_what_to_run(tmp_path):
    store = load_world(tmp_path, lively_world(random.Random(0), "yard-1_0"))
    for query in ("two_hop", TEXTS["two_hop"]):
        with pytest.raises(StoreError) as refused:
            store.cypher(query, sequence="yard-1_0")
        assert str(refused.value) == (
            f"{store.graph_path} has no keyframe layer: run 'jrdb-avr generate --store {store.path}'"
        )


def test_with_a_layer_of_other_rules_than_the_questions_one_line_says_what_to_run(benchmark_copy):
    store, path = benchmark_copy, benchmark_copy.question_path("answers")
    answers = pq.read_table(path)
    other = pa.array(["0" * 64] * len(answers))
    pq.write_table(answers.set_column(answers.column_names.index("rules"), "rules", other), path)
    for query in ("two_hop", TEXTS["two_hop"]):
        with pytest.raises(StoreError) as refused:
            store.cypher(query, sequence=min(store.manifest().sequences))
        assert str(refused.value) == (
            f"{store.graph_path} has a keyframe layer of other rules than the questions: "
            f"run 'jrdb-avr generate --store {store.path}'"
        )
