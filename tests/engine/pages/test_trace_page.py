"""`trace` on runs made by hand: what it refuses, how it stays small, and which looks it takes for looks.

The page in a browser is in `test_pages.py`.
"""

import json

import pyarrow as pa
import pytest
from processes import run
from traced_runs import stored_run, trace_runs

from jrdb_avr.engine.pages import trace as trace_page
from jrdb_avr.engine.report.traces import Trace, look_of
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.tables import RUNS


@pytest.fixture
def traced(benchmark_copy):
    return benchmark_copy, trace_runs(benchmark_copy)


@pytest.mark.slow
def test_a_page_of_thousands_of_steps_stays_small(benchmark_copy, tmp_path, monkeypatch):
    """Pictures are shown of the first looks alone; the rest is told."""
    question = benchmark_copy.questions("questions").to_pylist()[0]
    asked = json.dumps({"sequence": question["sequence"], "frame_index": 0, "angle_deg": 1.0})
    stored_run(
        benchmark_copy, "long", steps=[("observe", asked, '{"frame_id":"000000","angle_deg":1.0,"left":5}')] * 3000
    )
    monkeypatch.setattr(trace_page, "_PICTURES", 2)
    code, _, err = run(
        "trace", "long", question["question_id"], "--store", benchmark_copy.path, "--out", tmp_path / "t"
    )
    assert code == 0, err
    text = (tmp_path / "t").read_text()
    assert text.count("only the first 2 looks have pictures") == 2998
    assert len(text) < 3_000_000


def test_what_cannot_be_traced_is_refused_in_a_line(traced, tmp_path):
    store, name = traced
    for asked in (("none", name), ("full", "0" * 16), ("full", "\u202e../x"), ("../full", name)):
        code, out, err = run("trace", *asked, "--store", store.path, "--out", tmp_path / "t.html")
        assert (code, out) == (1, "") and err.startswith("jrdb-avr: ") and err.count("\n") == 1
    world = store.run_path("full") / "world.parquet"
    rows = Store(store.path).sql("SELECT * FROM world").to_pylist()
    store.write_run("full", "world", pa.Table.from_pylist([rows[0] | {"fact": "{"}], RUNS["world"]))
    code, _, err = run("trace", "full", name, "--store", store.path, "--out", tmp_path / "t.html")
    assert code == 1 and err.startswith(f"jrdb-avr: {world} holds a fact that cannot be read") and err.count("\n") == 1


def test_looks_are_those_that_were_shown(traced):
    store, name = traced
    trace = Trace(store, "full", name)
    assert [(look.step, look.left, look.angle) for look in trace.looks] == [(1, 3520, 0.0)]
    assert look_of({"kind": "tool", "request": "{}", "response": "{}", "step": 0}) is None


def test_a_statement_that_is_read_again_stands_once_and_one_that_was_replaced_twice():
    statements = []
    for step, until, text in [(1, 4, "sits"), (2, 2, "stands"), (4, 7, "sits"), (9, 12, "sits")]:
        trace_page.add_statement(statements, trace_page.Statement(step, until, text))
    assert [*map(tuple, statements)] == [(1, 7, "sits"), (2, 2, "stands"), (9, 12, "sits")]
