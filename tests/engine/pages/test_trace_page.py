"""`trace` on runs made by hand: each step, the world model as it grew, what was refused, and what any text may hold."""

import json

import msgspec
import pyarrow as pa
import pytest
from browser import browser, complaints
from entry import run
from known_runs import table

from jrdb_avr.engine.pages import trace as trace_page
from jrdb_avr.engine.report.traces import look_of, read_trace
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.beliefs import AttributeRow, EntityRow, Fact, RelationRow, SightingRow
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.tables import RUNS

HOSTILE = (
    '</script><script>document.title="hit"</script><img src=x onerror=\'document.title="hit"\'>\x1b[31m\u202e\u05d0'
)
LONG = "x" * 10_000


def entity(name, number, step, node=""):
    return EntityRow(f"e/{name}", "e", name, number, "person", node, step)


def sighted(name, write, step, frame, x):
    return SightingRow(f"e/{name}", "e/o1", "e", write, step, frame, Box(x, 200.0, 40.0, 90.0), x / 3760 * 360)


def has(name, write, step, value, frame):
    return AttributeRow(f"e/{name}", "e/o1", "e", write, step, "action", value, 0.0, frame, frame)


def world_rows(frame):
    """p1 is written down at step 2, its action at step 2 and anew at step 5; p2 and what ties them at step 5."""
    facts = [
        (2, "add_entity", "", Fact(entity=entity("p1", 0, 2, "a"), sighted=sighted("p1", 0, 2, frame, 900.0))),
        (2, "add_attribute", "", Fact(has=has("p1", 1, 2, "walking", frame))),
        (2, "add_relation", f"no observation o9 {HOSTILE}", Fact()),
        (5, "add_attribute", "", Fact(has=has("p1", 3, 5, "sitting", frame), replaced=(1,))),
        (5, "add_entity", "", Fact(entity=entity(HOSTILE, 1, 5), sighted=sighted(HOSTILE, 4, 5, frame, 3750.0))),
        (
            5,
            "add_relation",
            "",
            Fact(related=RelationRow("e/p1", f"e/{HOSTILE}", "e", 5, 5, "conversation", "o1", frame, frame)),
        ),
    ]
    return [
        {
            "number": number,
            "step": step,
            "tool": tool,
            "arguments": json.dumps({"text": HOSTILE}),
            "accepted": not reason,
            "reason": reason,
            "fact": msgspec.json.encode(fact).decode(),
        }
        for number, (step, tool, reason, fact) in enumerate(facts)
    ]


def step_rows(sequence, frame):
    asked = {"sequence": sequence, "frame_index": frame}
    reply = {"content": f"I look {HOSTILE}", "reasoning": LONG * 3, "finish_reason": "length"}
    return [
        ("model", json.dumps([{"role": "user", "content": f"{HOSTILE} [image panorama]"}]), json.dumps(reply)),
        (
            "observe",
            json.dumps(asked | {"angle_deg": 0.0}),
            json.dumps({"frame_id": f"{frame:06}", "angle_deg": 0.0, "left": 3520}),
        ),
        ("model", "no JSON " + LONG, HOSTILE),
        ("observe", json.dumps(asked | {"angle_deg": 0.4}), json.dumps({"refused": "a duplicate"})),
        # A method of somebody's own: no form that is known.
        ("observe", "looked round", "\x00\x07 saw 3 people"),
        ("model", json.dumps([3, {"role": 1}]), json.dumps({"content": None})),
        ("my own kind", '{"a": 1}', LONG),
    ]


def stored_run(store, name, *, steps, world=None, prediction=None, manifest=None):
    question = store.questions("questions").to_pylist()[0]
    own = {"run_id": name, "question_id": question["question_id"]}
    about = {"method": f"mine {HOSTILE}", "model": HOSTILE} | (manifest or {})
    write_run_manifest(
        store,
        RunManifest(
            run_id=name,
            questions_sha256=questions_hash(store),
            question_ids=(question["question_id"],),
            synthetic=True,
            settings={"note": HOSTILE},
            created="2020-01-01T00:00:00Z",
            **about,
        ),
    )
    given = {"status": "invalid", "reason": HOSTILE, "answer": None} | (prediction or {})
    store.write_run(name, "predictions", table([own | given], RUNS["predictions"]))
    rows = [
        own | {"step": number, "kind": kind, "request": asked, "response": said, "seconds": 0.5}
        for number, (kind, asked, said) in enumerate(steps)
    ]
    store.write_run(name, "steps", table(rows, RUNS["steps"]))
    if world is not None:
        store.write_run(name, "world", table([own | row for row in world], RUNS["world"]))
    return question


@pytest.fixture
def traced(benchmark_copy):
    """A store with a run that has everything, one that has nothing, and one whose box cannot be drawn."""
    question = benchmark_copy.questions("questions").to_pylist()[0]
    evidence = benchmark_copy.questions("evidence").to_pylist()
    box = next(row for row in evidence if row["question_id"] == question["question_id"])
    frame = box["frame"]
    given = {"evidence_frame": frame} | {f"evidence_{key}": box[key] + 1.0 for key in "xywh"}
    steps, world = step_rows(question["sequence"], frame), world_rows(frame)
    stored_run(benchmark_copy, "full", steps=steps, world=world, prediction=given | {"answer": f'{{"choice": "{LONG}"'})
    stored_run(benchmark_copy, "empty", steps=[], prediction={"status": "error", "reason": LONG})
    broken = {"evidence_frame": frame, "evidence_x": float("inf"), "evidence_y": 1.0, "evidence_w": None}
    stored_run(benchmark_copy, "broken", steps=[], prediction=broken)
    return benchmark_copy, question["question_id"]


def test_the_world_model_grows_with_the_slider(traced, tmp_path):
    store, name = traced
    code, _, err = run("trace", "full", name, "--store", store.path, "--out", tmp_path / "t.html")
    assert (code, err) == (0, f"wrote {tmp_path / 't.html'}: 7 steps\n")
    with browser(tmp_path) as driver:
        driver.get((tmp_path / "t.html").as_uri())
        assert complaints(driver) == []
        assert "hit" not in driver.title and not driver.find_elements("css selector", "img")

        def visible(selector):
            return [e.text for e in driver.find_elements("css selector", selector) if e.is_displayed()]

        def at(step):
            driver.execute_script(
                "const s = document.getElementById('until'); s.value = arguments[0];"
                "s.dispatchEvent(new Event('input'))",
                step,
            )

        assert visible(".verdict b") == ["answer \N{BALLOT X}", "evidence \N{CHECK MARK}", "combined \N{BALLOT X}"]
        assert len(driver.find_elements("css selector", "section.step")) == 7
        # Two looks have a known form, and one of them was refused.
        assert len(driver.find_elements("css selector", ".map rect.look")) == 2, "a crop over the seam is two parts"
        assert len(visible(".entity")) == 2 and len(visible("circle.given")) == 1
        assert visible(".entity .gone") == [t for t in visible(".entity .belief") if "walking" in t] != []
        at(1)
        assert visible(".entity") == visible("circle.seen") == visible("td.refused") == []
        at(2)
        assert [text.split()[0] for text in visible(".entity")] == ["p1"]
        assert any("walking" in t for t in visible(".entity .belief")) and not visible(".gone")
        assert len(visible("td.refused")) == 1 and not visible(".map path.tie")
        assert driver.find_element("id", "at").text == "2 of 6: model"
        at(5)
        assert len(visible(".map path.tie")) == len(visible(".web path.tie")) == len(visible(".entity .gone")) == 1
        # A text of ten thousand letters does not make the page wide.
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 1250
        for other in ("empty", "broken"):
            assert run("trace", other, name, "--store", store.path, "--out", tmp_path / "o.html")[0] == 0
            driver.get((tmp_path / "o.html").as_uri())
            assert complaints(driver) == []
            assert "recorded no steps" in driver.find_element("tag name", "main").text


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
    trace = read_trace(store, "full", name)
    assert [(look.step, look.left, look.angle) for look in trace.looks] == [(1, 3520, 0.0)]
    assert look_of({"kind": "tool", "request": "{}", "response": "{}", "step": 0}) is None
