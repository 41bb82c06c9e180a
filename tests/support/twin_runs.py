"""Stores with time twins made by hand, and a run over them."""

import msgspec
from scored_runs import BOX, ELSEWHERE, Benchmark, table

from jrdb_avr.queries.runs import questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.tables import QUESTIONS, RUNS
from jrdb_avr.schema.templates import TEMPLATES, Slots
from jrdb_avr.schema.wording.text import render

RIGHT, WRONG_BOX, WRONG = (1, BOX, 7), (1, ELSEWHERE, 7), (2, BOX, 7)

QUESTIONS_ASKED = (
    # question, sequence, template, twin, what the run gave
    ("a1", "s1", "change", "a", RIGHT),
    ("a2", "s1", "change", "a", RIGHT),
    ("b1", "s1", "change", "b", RIGHT),
    ("b2", "s1", "change", "b", WRONG_BOX),
    ("c1", "s2", "change", "c", RIGHT),
    ("c2", "s2", "change", "c", WRONG),
    ("d1", "s3", "presence", "d", WRONG),
    ("d2", "s3", "presence", "d", WRONG),
    ("e", "s3", "two_hop", None, RIGHT),
)


def plan_of(t1):
    """The plan of a question about frame t1."""
    return TEMPLATES["change"].build(Slots((Condition(action="reading", at="t0"),), {"t0": 15, "t1": t1}))


def twin_store(path, asked=QUESTIONS_ASKED, ids=None):
    """A store with these questions, and a run "r" with what it gave to them or to the questions `ids`."""
    benchmark = Benchmark([(name, sequence, "unique_anchor") for name, sequence, *_ in asked])
    rows = {name: own.to_pylist() for name, own in benchmark.tables.items()}
    for number, (_, _, template, twin, _) in enumerate(asked):
        plan = plan_of(90 + 15 * number)
        rows["questions"][number] |= {"template": template, "question": render("change", plan, "0" * 64)}
        rows["questions"][number]["choices"] = ["walking", "standing", "sitting", "cycling"]
        rows["answers"][number] |= {"twin_id": twin, "plan": msgspec.json.encode(plan).decode()}
    benchmark.tables = {name: table(own, QUESTIONS[name]) for name, own in rows.items()}
    store = Store(path)
    benchmark.write(store)
    run = benchmark.run([given for *_, given in asked])
    kept = ids or benchmark.ids
    predictions = benchmark.written["predictions"]
    names = predictions["question_id"].to_pylist()
    predictions = predictions.take([number for number, name in enumerate(names) if name in kept])
    store.write_run("r", "predictions", predictions)
    store.write_run("r", "steps", table([], RUNS["steps"]))
    changed = {"questions_sha256": questions_hash(store), "question_ids": tuple(kept)}
    write_run_manifest(store, msgspec.structs.replace(run.manifest, **changed))
    return store
