"""`trace` on runs made by hand: what it refuses, how it stays small, and which looks it takes for looks.

The page in a browser is in `test_pages.py`.
"""

import json
from types import SimpleNamespace

import msgspec
import pyarrow as pa
import pytest
from processes import run
from traced_runs import PERSON, entity, related, stored_run, trace_runs

from jrdb_avr.engine.pages import trace as trace_page
from jrdb_avr.engine.pages.turns import turns_of
from jrdb_avr.engine.report.traces import Trace, Written, look_of
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.beliefs import Fact
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


def test_turns_are_titled_by_what_they_did(traced):
    store, name = traced
    turns = turns_of(Trace(store, "full", name))
    titles = [turn.title.replace(PERSON, "p2") for turn in turns]
    frame = turns[0].looks[0].frame
    assert titles == [
        f"Turn 1: looked at frame {frame}, 0\N{DEGREE SIGN}",
        "Turn 2: wrote 1 person (p1 new), 1 refused",
        "Turn 3: wrote 2 people (p2 new)",
    ]
    assert [person.facts for person in turns[1].people] == [["action walking +2.2"]]
    assert turns[1].refused[0]["reason"].startswith("no observation o9")


def model_step(step, *lines):
    """Return a model call whose prompt has the given lines."""
    request = json.dumps([{"role": "user", "content": "\n".join(lines)}])
    return {"step": step, "kind": "model", "request": request, "response": "{}", "seconds": 0.5}


def transcript(*steps):
    """Return a transcript that holds only steps."""
    looks = [look for step in steps if (look := look_of(step))]
    return SimpleNamespace(steps=steps, looks=looks, writes=[], prediction={"status": "answered"})


def test_a_turn_has_what_the_prompt_stated_about_the_graph():
    world = {"likely": [{"nodes": {"a": "p1"}, "log_odds": 2.5}], "open": ["a gender female: open"]}
    looks = [{"frame_id": "000150", "angle_deg": 212.0, "reason": "b may be there"}]
    step = model_step(0, "Which?", f"World: {json.dumps(world)}", f"Looks: {json.dumps(looks)}")
    (turn,) = turns_of(transcript(step))
    assert turn.graph.likely[0].nodes == {"a": "p1"} and turn.graph.open == ["a gender female: open"]
    assert [look.words for look in turn.advised] == ["frame 150, 212\N{DEGREE SIGN}"]


@pytest.mark.parametrize("line", ["World: {", 'World: {"likely": 3}', "World: []", "World:", "Looks: {}", "Looks: [3]"])
def test_lines_of_another_form_are_no_state_of_a_graph(line):
    (turn,) = turns_of(transcript(model_step(0, line)))
    assert (turn.graph, turn.advised, turn.title) == (None, [], "Turn 1: answered")


def test_calls_are_told_in_words_with_their_results():
    call = {"tool": "add_people", "observation": "o1", "people": [{}, {}]}
    steps = [
        ("tool", json.dumps(call), '"o1: p1 written"'),
        ("tool", '{"tool":"final_answer","entity":"p1"}', '"refused: p2 is likelier"'),
        ("tool", "no JSON", "nor this"),
    ]
    rows = [
        {"step": number, "kind": kind, "request": request, "response": response, "seconds": 0.0}
        for number, (kind, request, response) in enumerate(steps, 1)
    ]
    (turn,) = turns_of(transcript(model_step(0), *rows))
    assert turn.title == "Turn 1: final answer refused"
    assert [tuple(call) for call in turn.calls] == [
        ("add_people observation o1, 2 people", "o1: p1 written", False),
        ("final_answer entity p1", "refused: p2 is likelier", True),
        ("no JSON", "nor this", False),
    ]


@pytest.mark.parametrize(("angle", "reason"), [(211.0, " (b may be there)"), (195.0, "")])
def test_a_look_that_was_due_has_its_reason_in_the_title(angle, reason):
    due = json.dumps([{"frame_id": "000150", "angle_deg": 212.0, "reason": "b may be there"}])
    seen = json.dumps({"frame_id": "000150", "angle_deg": angle, "left": 5})
    rows = [{"kind": "solve", "response": due}, {"kind": "observe", "response": seen}]
    rows = [{"step": n, "request": "{}", "seconds": 0.0} | row for n, row in enumerate(rows, 1)]
    (turn,) = turns_of(transcript(model_step(0), *rows))
    assert turn.title == f"Turn 1: looked at frame 150, {angle:.0f}\N{DEGREE SIGN}{reason}"


def test_relations_from_boxes_are_shown_if_they_hold_for_a_person_of_the_turn():
    def edge(source, weight):
        row = related(source, "p2", 0, 0, 0)
        return msgspec.structs.replace(row, name="first to the left of", weight=weight, origin="derived")

    fact = Fact(entities=(entity("p1", 1, 0),), related=(edge("p1", 2.0), edge("p1", -2.0), edge("p3", 2.0)))
    row = {"tool": "add_people", "accepted": True, "reason": ""}
    record = transcript(model_step(0))
    record.writes = [Written(row, 0, fact)]
    (turn,) = turns_of(record)
    arrow = "\N{RIGHTWARDS ARROW}"
    assert [tuple(line) for line in turn.people] == [
        ("p1", True, [f"first to the left of {arrow} p2 +2.0 (from boxes)"])
    ]
    assert turn.title == "Turn 1: wrote 1 person (p1 new)"
