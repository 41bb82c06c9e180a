"""The statements of the generators, run by name over a stored graph: their rows are the candidates of the sequence with
their judgement."""

import contextlib
import re
from functools import cache
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from keyframe_layers import LAX_RULES, lax_sample
from made_tables import table_store

import jrdb_avr
from jrdb_avr.engine.generate.candidates import OUTCOMES, RULES, VALUES
from jrdb_avr.engine.generate.context import LayerJob
from jrdb_avr.engine.generate.keyframe_graph import stored_layer
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.queries.graph.parameters import strip_literals
from jrdb_avr.queries.named import named_queries
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import KEYFRAME_NODES
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.templates import TEMPLATES

CYPHER = Path(jrdb_avr.__file__).parent / "queries"
TEXTS = {
    path.stem: path.read_text()
    for folder in ("generators", "necessity", "search")
    for path in sorted((CYPHER / folder).glob("*.cypher"))
}
LISTED = sorted({template.query for template in TEMPLATES.values()} - {"presence"})
FLAGS = {
    "anchor": "anchor",
    "evidence": "evidence",
    "image": "image",
    "ahead": "view.ahead",
    "hop_stop": "hop.stop",
    "hop_skip": "hop.skip",
}
"""Columns that judge a candidate, and the rule that each decides."""
RANGED = KEYFRAME_NODES.keys() - {"Keyframes"}


class Sequence:
    """A sequence of a store: `rows` by a statement's name, `found` by the search for a template's candidates, and these
    as `columns` of a statement."""

    def __init__(self, store, context):
        self.store, self.context = store, context
        self.rows, self.found, self.columns = cache(self.rows), cache(self.found), cache(self.columns)

    def rows(self, name, **values):
        return self.store.cypher(name, sequence=self.context.scene.sequence, **values)

    def found(self, name):
        return find_candidates(self.context, TEMPLATES[name])

    def columns(self, name):
        scene, found = self.context.scene, self.found(name)
        columns = (
            dict(found.frames)
            | {node: scene.tracks[scene.people(moments)] for node, moments in found.people.items()}
            | {name: np.array(RELATIONS, object)[codes] for name, codes in found.relations.items()}
            | {"name": found.name, "segment": found.segments[0], "segment2": found.segments[1]}
            | {"encounter": found.window, "answer": np.array(VALUES, object)[found.answer], "value": found.value}
            | {"description": self.context.descriptions.texts[1][found.name]}
        )
        return {name: column.tolist() for name, column in columns.items()}

    def keys(self, name, columns):
        """Per candidate of a template its values in these columns."""
        return list(zip(*(self.columns(name)[column] for column in columns), strict=True))


@pytest.fixture(scope="module")
def sequences(once, sample_benchmark):
    """One sequence of the sample under the rules, of which it has questions, the other under the laxer ones."""
    first, second = sorted(sample_benchmark.manifest().sequences)
    wanted = [(sample_benchmark, first, Rules()), (lax_sample(once, sample_benchmark), second, LAX_RULES)]
    with contextlib.ExitStack() as stack:
        found = []
        for store, name, rules in wanted:
            job = LayerJob(store.path, name, stored_layer(store, rules)[name], rules)
            found.append(Sequence(store, stack.enter_context(job.searching())))
        yield found


def outcome(text, answer):
    """How what a perturbed program reads compares with the answer."""
    return "unknown" if text is None else text if text in OUTCOMES else "same" if text == answer else "different"


def outcomes(found, kind, variant):
    """What the proof of every candidate says of a perturbed program."""
    results = [one for one in found.perturbed if (one.kind, one.variant) == (kind, variant)]
    return [OUTCOMES[code] for one in results for code in one.outcome]


def reached(found, rule):
    """The candidates that no rule before this one refuses."""
    return np.flatnonzero(found.rule >= RULES.index(rule)).tolist()


# -- candidates -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", LISTED)
def test_the_rows_of_a_generator_are_the_candidates_of_its_sequence_with_their_judgement(sequences, name):
    rows = 0
    for sequence in sequences:
        found, table, listed = sequence.found(name), sequence.rows(name), sequence.columns(name)
        assert {"name", found.template.described, *found.people, *found.relations} <= set(table.column_names)
        for column in table.column_names:
            if column in listed:
                assert table[column].to_pylist() == listed[column], column
            else:
                assert column in FLAGS or re.fullmatch(r"(stop|skip)_\d(_person)?", column)
        check_judgement(sequence, name, table, range(len(found)))
        rows += len(found)
    assert rows >= 10


@pytest.mark.slow
def test_the_hops_of_later_pose_are_judged_by_a_statement_of_their_own(sequences):
    judged = 0
    for sequence in sequences:
        table, columns = sequence.rows("later_pose_hops"), ("name", "t1", "r1", "r2")
        place = {key: i for i, key in enumerate(zip(*(table[key].to_pylist() for key in columns), strict=True))}
        keys = sequence.keys("later_pose", columns)
        rows = reached(sequence.found("later_pose"), "hop.stop")
        check_judgement(sequence, "later_pose", table.take(pa.array([place[keys[i]] for i in rows], pa.int64())), rows)
        judged += len(rows)
    assert judged >= 100


def check_judgement(sequence, name, table, rows):
    """The rows of a statement on these candidates against the first rule that refuses each, whose flag is false while
    those before it are true; and where none before hop.stop does, the texts of perturbed paths against the proofs."""
    found, answers = sequence.found(name), sequence.columns(name)["answer"]
    refusing = found.rule[list(rows)]
    for column in set(FLAGS) & set(table.column_names):
        holds = np.array(table[column].to_pylist(), bool) != (column == "ahead")
        number = RULES.index(FLAGS[column])
        assert holds[refusing > number].all() and not holds[refusing == number].any(), column
    for column in [column for column in table.column_names if re.fullmatch(r"(stop|skip)_\d", column)]:
        proofs, texts = outcomes(found, f"hop.{column[:4]}", column[-1]), table[column].to_pylist()
        nobody = table["skip_1_person"].is_null().to_pylist() if name == "action_search" else None
        for place, row in enumerate(rows):
            if found.rule[row] >= RULES.index("hop.stop") and (nobody is None or nobody[place]):
                assert outcome(texts[place], answers[row]) == proofs[row], column


@pytest.mark.slow
def test_presence_is_the_product_of_who_is_described_and_when_somebody_is_present(sequences):
    for sequence in sequences:
        found, wait = sequence.found("presence"), frames(sequence.context.rules.min_wait_s)
        columns = {key: sequence.columns("presence")[key] for key in ("name", "t0", "a", "t1", "t2", "answer")}
        with duckdb.connect() as database:
            database.register("pairs", sequence.rows("presence"))
            database.register("described", sequence.rows("described"))
            database.register("candidates", pa.table(columns | {"rule": np.array([*RULES, None], object)[found.rule]}))
            database.execute(f"""
                CREATE TABLE listed AS
                SELECT name, t0, a, t1, t2, answer,
                    CASE WHEN NOT anchor THEN 'anchor' WHEN NOT evidence THEN 'evidence'
                         WHEN NOT (d.image AND p.image) THEN 'image' WHEN coalesce(p.ahead, d.ahead) THEN 'view.ahead'
                         END AS rule
                FROM described d JOIN pairs p USING (a) WHERE t1 >= t0 + {wait};
                CREATE TABLE searched AS
                SELECT * REPLACE (CASE WHEN rule NOT LIKE 'time.%' THEN rule END AS rule) FROM candidates""")
            for one, other in (("listed", "searched"), ("searched", "listed")):
                assert database.execute(f"FROM {one} EXCEPT ALL FROM {other}").fetchall() == []
            assert database.execute("SELECT count(*) FROM listed").fetchone()[0] == len(found) > 1000


@pytest.mark.slow
def test_people_counted_are_those_whom_an_encounter_meets(sequences):
    for sequence in sequences:
        assert sequence.rows("gap_count_people").equals(sequence.context.people_met)
    assert len(sequence.context.people_met)


# -- doors ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", TEXTS)
def test_a_pasted_statement_gives_the_rows_of_its_name_with_numbers_sorted_before_texts(sequences, name):
    """The engine misplaces rows where a text is sorted by before a number."""
    sequence = sequences[1]
    by_name, defaults = sequence.rows(name), named_queries("cypher")[name].defaults
    assert len(by_name) and by_name.equals(sequence.rows(TEXTS[name], **defaults))
    keys = TEXTS[name].rpartition("ORDER BY ")[2].strip().split(", ")
    texts = [by_name.schema.field(key).type == pa.string() for key in keys]
    assert texts == sorted(texts)


@pytest.mark.slow
def test_a_statement_runs_in_a_process_of_its_own(sequences, own_processes):
    rows = sequences[1].store.cypher("two_hop", sequence=sequences[1].context.scene.sequence)
    assert rows.equals(sequences[1].rows("two_hop"))


@pytest.mark.parametrize("name", [*TEXTS, "descriptions"])
def test_every_node_of_the_layer_lies_in_the_range_of_the_sequence(name):
    """Without a range on every node a query takes longer with every sequence of the store."""
    text = strip_literals(named_queries("cypher")[name].text)
    labelled = re.findall(r"\((\w*):(\w+)", text)
    nodes = {variable for variable, label in labelled if label in RANGED}
    assert nodes and "" not in nodes and not re.search(r"\(\s*\)\s*<?-|-\s*\(\s*\)", text)
    for node in nodes:
        assert f"{node}.id >= $low AND {node}.id < $high" in text, node


def test_without_a_layer_one_line_says_what_to_run(tmp_path):
    store = table_store(tmp_path, sequences=("yard-1_0",), frames=31, people=3)
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
            f"run 'jrdb-avr validate --replay --store {store.path}'"
        )
