"""Runs made by hand for the page that traces them: every kind of step, refused ones too, and texts of any kind."""

import json

import msgspec
from question_files import all_evidence
from scored_runs import table

from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.schema.beliefs import AttributeRow, EntityRow, Fact, RelationRow, SightingRow, SlotRow
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.tables import RUNS

HOSTILE = (
    '</script><script>document.title="hit"</script><img src=x onerror=\'document.title="hit"\'>\x1b[31m\u202e\u05d0'
)
PERSON = HOSTILE.replace("/", "|")
"""A hostile name of an entity. Names of entities have no slash."""

LONG = "x" * 10_000


def entity(name, number, step):
    return EntityRow(f"e/{name}", "e", number, name, step)


def sighted(name, write, step, frame, x):
    row = (f"e/{name}", "e/o1", "e", write, step, frame)
    return SightingRow(*row, Box(x, 200.0, 40.0, 90.0), x / 3760 * 360, whole=True, number=1, metres=-1.0)


def has(name, write, step, value, frame):
    row = (f"e/{name}", "e/o1", "e", write, step, frame)
    values = {"topic": "pose", "name": "action", "value": value, "weight": 2.2, "exclusive": True, "origin": "model"}
    return AttributeRow(*row, **values, log_odds=2.2)


def related(source, target, write, step, frame):
    row = (f"e/{source}", f"e/{target}", "e", write, step, frame)
    return RelationRow(*row, name="conversation", weight=-1.5, look="e/o1", origin="model", log_odds=2.2)


def world_rows(frame):
    """p1 is written down at step 2, its action at step 2 and anew at step 5; p2 and what ties them at step 5."""
    facts = [
        (2, "add_entity", "", Fact(entities=(entity("p1", 1, 2),), sighted=(sighted("p1", 0, 2, frame, 900.0),))),
        (2, "add_attribute", "", Fact(has=(has("p1", 1, 2, "walking", frame),))),
        (2, "add_relation", f"no observation o9 {HOSTILE}", Fact()),
        (5, "add_attribute", "", Fact(has=(has("p1", 3, 5, "sitting", frame),))),
        (5, "add_people", "", Fact(entities=(entity(PERSON, 2, 5),), sighted=(sighted(PERSON, 4, 5, frame, 3750.0),))),
        (5, "add_relation", "", Fact(related=(related("p1", PERSON, 5, 5, frame),))),
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


PLAN = {
    "root": "a",
    "target": "a",
    "times": {"t0": {"frame": 0}},
    "nodes": [{"id": "a", "conditions": [{"attribute": "gender", "value": "male"}]}, {"id": "b", "conditions": []}],
    "edges": [{"source": "a", "relation": "conversation", "target": "b", "at": "t0"}],
    "answer": {"mode": "multiple_choice", "read": "action", "of": "a", "at": "t0"},
}

DECISION = {
    "conclusion": {"entity": "p1", "frame": 0, "verdict": "supported", "support": "sitting has log-odds 2.2."},
    "bindings": [
        {"nodes": {"a": "p1", "b": PERSON}, "log_odds": 3.5, "margin": 1.5},
        {"nodes": {"a": PERSON, "b": "p1"}, "log_odds": 2.0, "margin": -1.5},
    ],
    "parts": [{"part": f"a gender male {HOSTILE}", "support": [[2.2, "certain"], [0.0, "open"]]}],
    "statements": [{"name": "slots", "parameters": {"hash": "e"}, "rows": [{"slot": 0, "entity": HOSTILE}]}],
}


def decided_run(store, frame):
    """Write a run of an agent with a world model: a plan, a prompt with the state of the graph, and a decision."""
    world = {"likely": [{"nodes": {"a": "p1", "b": PERSON}, "log_odds": 3.5}], "open": [f"b: {HOSTILE}"]}
    looks = [{"frame_id": f"{frame:06}", "angle_deg": 212.0, "reason": f"p1 may be there {HOSTILE}"}]
    prompt = f"World: {json.dumps(world)}\nLooks: {json.dumps(looks)}\n{HOSTILE}"
    steps = [
        ("model", json.dumps([{"role": "user", "content": prompt}]), json.dumps({"content": "{}"})),
        ("tool", json.dumps({"tool": "final_answer", "entity": HOSTILE}), json.dumps(f"refused: {HOSTILE}")),
        ("solve", '{"accepted":false}', json.dumps(DECISION)),
    ]
    slot = SlotRow("e/0", "e", 0, 0, "condition", "a", "", "gender", HOSTILE, "gender", "model", "", 0, 0.4)
    plan = Fact(slots=(slot,))
    own = {"number": 6, "step": 0, "tool": "plan", "arguments": json.dumps(PLAN), "accepted": True, "reason": ""}
    rows = [*world_rows(frame), own | {"fact": msgspec.json.encode(plan).decode()}]
    stored_run(store, "decided", steps=steps, world=rows, prediction={"proposed": '{"choice":1}'})


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


def trace_runs(store):
    """Write runs: all kinds of steps, a world model that decided, no steps, and a box that cannot be drawn."""
    question = store.questions("questions").to_pylist()[0]
    evidence = all_evidence(store).to_pylist()
    box = next(row for row in evidence if row["question_id"] == question["question_id"])
    frame = box["frame"]
    given = {"evidence_frame": frame} | {f"evidence_{key}": box[key] + 1.0 for key in "xywh"}
    steps, world = step_rows(question["sequence"], frame), world_rows(frame)
    stored_run(store, "full", steps=steps, world=world, prediction=given | {"answer": f'{{"choice": "{LONG}"'})
    decided_run(store, frame)
    stored_run(store, "empty", steps=[], prediction={"status": "error", "reason": LONG})
    broken = {"evidence_frame": frame, "evidence_x": float("inf"), "evidence_y": 1.0, "evidence_w": None}
    stored_run(store, "broken", steps=[], prediction=broken)
    return question["question_id"]
