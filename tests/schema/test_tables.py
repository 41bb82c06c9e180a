"""The tables' columns are a public interface: a change here is a change for everybody who reads the files."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from environment import DOCS

from jrdb_avr.engine.commands.page import tables_page
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.graph import SCENE_NODES, SCENE_RELS, scene_ddl
from jrdb_avr.schema.tables import (
    ABOUT,
    ANNOTATIONS,
    COLUMNS,
    INTERVALS,
    PRIVATE,
    QUESTIONS,
    RUNS,
    SPECIAL,
    views,
)

ALL = {**ANNOTATIONS, **{f"i_{k}": v for k, v in INTERVALS.items()}, **QUESTIONS, **RUNS}

# Word for word from the column contracts of the specification.
CONTRACTS = {
    "questions": "question_id sequence family template question choices answer_mode",
    "sequences": "sequence fps frame_count frames",
    "answers": "question_id answer target_track plan proofs rules hops time_gap_s separation_deg "
    "people_in_scene bindings needed twin_id",
    "evidence": "sequence track frame x y w h",
    "predictions": "run_id question_id status answer evidence_frame evidence_x evidence_y evidence_w evidence_h raw "
    "reason verdict proposed n_observations n_model_calls prompt_tokens completion_tokens seconds",
    "steps": "run_id question_id step kind request response seconds",
    "world": "run_id question_id number step tool arguments accepted reason fact",
    "scores": "run_id question_id answer_score evidence_score combined_score invalid",
}


@pytest.mark.parametrize("name", CONTRACTS)
def test_columns_are_the_contract(name):
    assert ALL[name].names == CONTRACTS[name].split()


def test_public_tables_hold_no_secret():
    public = {column for name in QUESTIONS if name not in PRIVATE for column in QUESTIONS[name].names}
    secret = {"answer", "target_track", "plan", "proofs", "bindings", "needed", "twin_id", "x", "y"}
    assert not public & secret


@pytest.mark.parametrize("name", ALL)
def test_tables_survive_parquet_under_their_schema(name, tmp_path):
    schema = ALL[name]
    assert len(set(schema.names)) == len(schema.names)
    pq.write_table(schema.empty_table(), tmp_path / "t.parquet")
    back = pq.read_table(tmp_path / "t.parquet").schema
    assert back.names == schema.names
    assert [field.nullable for field in back] == [field.nullable for field in schema]


def test_every_per_sequence_table_begins_with_its_sequence():
    for schema in (*ANNOTATIONS.values(), *INTERVALS.values()):
        assert schema.names[0] == "sequence"


def test_equal_tables_give_equal_bytes_whatever_their_metadata(tmp_path):
    store = Store(tmp_path)
    row = {"run_id": "r", "question_id": "q", "answer_score": 1, "evidence_score": 0, "combined_score": 0}
    table = pa.Table.from_pylist([row | {"invalid": False}])
    first = store.write_run("r", "scores", table)
    assert first == store.write_run("s", "scores", table.replace_schema_metadata({"made": "elsewhere"}))


def test_the_scene_names_its_ends():
    for name, (source, target, columns) in SCENE_RELS.items():
        assert {*source.split(":"), target} <= SCENE_NODES.keys(), name
        assert "sequence STRING" in columns, name
        known = "gap BOOLEAN" if name.startswith("May") else "certain BOOLEAN"
        assert (known in columns) == (name != "SeenIn"), name
    statements = scene_ddl()
    assert len(statements) == len(SCENE_NODES) + len(SCENE_RELS)
    assert all(s.startswith("CREATE NODE TABLE") for s in statements[: len(SCENE_NODES)])


def test_the_reference_page_is_current():
    assert (DOCS / "tables.md").read_text("utf-8") == tables_page()
    known = {(name, field) for name, schema, _ in views() for field in schema.names}
    assert set(SPECIAL) <= known
    assert set(COLUMNS) <= {field for _, field in known}
    assert set(ABOUT) == {name for name, _ in known}
