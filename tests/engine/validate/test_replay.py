"""Proofs run again: a sound store replays without a difference, and whatever is tampered with is named."""

import json
import shutil
from collections import Counter

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from processes import run as run_command
from question_files import keep_only, rewrite

from jrdb_avr.engine.rederive import Annotations
from jrdb_avr.engine.validate.checks import CHECKS, REPLAY_CHECKS, Validation, check_replay, read_records
from jrdb_avr.engine.validate.replay import differences
from jrdb_avr.queries.graph.file import check_fingerprint, compute_fingerprint, fingerprint_path
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import Proof, QuestionRecord
from jrdb_avr.schema.rules import Rules

RULES = Rules()


@pytest.fixture(scope="module", autouse=True)
def known_annotations():
    """What was read of a sequence, so that it is read once: no test changes the annotation tables."""
    known, read = {}, Annotations.read

    def remembered(store, sequence, rules):
        if sequence not in known:
            known[sequence] = read(store, sequence, rules)
        return known[sequence]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Annotations, "read", remembered)
        yield


@pytest.fixture(scope="module")
def few(sample_benchmark, tmp_path_factory):
    """Up to three questions of each template, of one sequence where it has as many."""
    store = Store(shutil.copytree(sample_benchmark.path, tmp_path_factory.mktemp("few") / "store"))
    rows = store.questions("questions").sort_by([("sequence", "ascending"), ("question_id", "ascending")]).to_pylist()
    most = max({row["sequence"] for row in rows}, key=lambda name: sum(row["sequence"] == name for row in rows))
    rows.sort(key=lambda row: row["sequence"] != most)
    kept = {}
    for row in rows:
        kept.setdefault(row["template"], []).append(row["question_id"])
    ids = {name for names in kept.values() for name in names[:3]}
    keep_only(store, ids)
    return store


def run(store):
    report = Validation()
    check_replay(report, store, read_records(store, report), RULES, 1)
    return report


def copied(store, tmp_path):
    return Store(shutil.copytree(store.path, tmp_path / "store"))


def test_a_sound_store_replays_without_a_difference(few):
    report = run(few)
    assert report.sound, report.faults
    questions = few.questions("questions").num_rows
    assert report.checked == {"replay": questions, "compiled": questions}
    assert {row["check"] for row in report.rows()} == {*CHECKS, *REPLAY_CHECKS}
    assert not REPLAY_CHECKS.keys() & {row["check"] for row in Validation().rows()}


# -- tampered records ---------------------------------------------------------------------------------------------


def proofs(change):
    def tamper(row):
        found = json.loads(row["proofs"])
        change(found)
        row["proofs"] = json.dumps(found)

    return tamper


def proof_of(found, kind):
    return next(proof for proof in found if proof["kind"] == kind)


def put(name, value):
    return lambda row: row.update({name: value(row[name])})


def needed(row):
    boxes = json.loads(row["needed"])
    boxes[-1]["frame"] += 1
    row["needed"] = json.dumps(boxes)


def moved_plan(row):
    """The description's time moved by a second: other people, other times."""
    plan = json.loads(row["plan"])
    plan["times"]["t0"]["frame"] += 15
    row["plan"] = json.dumps(plan, sort_keys=True, separators=(",", ":"))


def described_at_the_event(row):
    row["plan"] = row["plan"].replace('"at":"t0"', '"at":"t1"')


def other_condition(row):
    plan = json.loads(row["plan"])
    plan["nodes"][0]["conditions"] = [{"action": "skating", "at": "t0"}]
    row["plan"] = json.dumps(plan, sort_keys=True, separators=(",", ":"))


# template, how it is tampered with, and where a difference must be named in each check that notices it
TAMPERED = {
    "an outcome": ("change", proofs(lambda f: proof_of(f, "time.shift").update(outcome="unknown")), "time.shift -3 s"),
    "holding": ("presence", proofs(lambda f: proof_of(f, "time.drop").update(holds=False)), "time.drop all keyframes"),
    "a proof's answer": ("two_hop", proofs(lambda f: proof_of(f, "hop.stop").update(answer="lying")), "hop.stop 0"),
    "a proof left out": ("three_hop", proofs(lambda f: f.remove(proof_of(f, "hop.skip"))), "hop.skip 1"),
    "a proof twice": ("later_action", proofs(lambda f: f.append(f[0])), "proofs"),
    "a proof of another kind": ("start", proofs(lambda f: f.append({**f[0], "kind": "hunch"})), "hunch match"),
    "a dropped condition": ("distance", proofs(lambda f: f[1].update(holds=False)), "anchor without"),
    "the second path": ("gap", proofs(lambda f: proof_of(f, "rederive").update(outcome="unknown")), "rederive"),
    "needed boxes": ("start", needed, "needed"),
    "hops": ("two_hop", put("hops", lambda number: number + 1), "hops"),
    "separation": ("three_hop", put("separation_deg", lambda degrees: degrees + 0.5), "separation_deg"),
    "people": ("later_action", put("people_in_scene", lambda number: number - 1), "people_in_scene"),
    "the time": ("gap", put("time_gap_s", lambda seconds: seconds + 1), "time_gap_s"),
    "distractors": ("fork_join", put("distractors", lambda text: text.replace("null", '"a guess"', 1)), "distractors"),
}
NOTICED_BY_BOTH = {
    "another person": ("change", put("target_track", lambda track: track + 1), "target_track"),
    "another answer": (
        "presence",
        put("answer", lambda text: f'{{"choice":{json.loads(text)["choice"] % 4 + 1}}}'),
        "a",
    ),
    "another span": ("span", put("answer", lambda text: text.replace('"start_frame":', '"start_frame":1')), "answer"),
    "another binding": ("distance", put("bindings", lambda text: text.replace('"t1":', '"t1":1')), "bindings"),
    "another plan": ("action_search", moved_plan, ""),
    "nobody's condition": ("change", other_condition, "anchor match"),
    "a plan of another template": (
        "distance",
        put("plan", lambda text: text.replace("distance_change", "presence")),
        "",
    ),
    "a description at the event": ("start", described_at_the_event, "plan"),
    "no plan": ("action_search", put("plan", lambda text: "[]"), "plan"),
}
UNREADABLE = {
    "a word more": ("span", proofs(lambda f: f[0].update(note="x")), "Object contains unknown field `note`"),
    "a strange proof": ("span", proofs(lambda f: f.append({"kind": [1], "variant": {}})), "Expected `str`"),
    "no proofs": ("fork_join", put("proofs", lambda text: "3"), "Expected `array`"),
}
CASES = TAMPERED | NOTICED_BY_BOTH | UNREADABLE


def test_every_record_that_is_tampered_with_is_named(few, tmp_path):
    """Each by itself, in a question of its own, so that the others stay sound; of one sequence."""
    store = copied(few, tmp_path)
    asked = store.questions("questions").to_pylist()
    most, _ = Counter(row["sequence"] for row in asked).most_common(1)[0]
    keep_only(store, {row["question_id"] for row in asked if row["sequence"] == most})
    free = {}
    for row in store.questions("questions").sort_by("question_id").to_pylist():
        free.setdefault(row["template"], []).append(row["question_id"])
    of_case = {}
    for name, (template, *_) in CASES.items():
        of_case[name] = free[template].pop()

    def change(rows):
        by_id = {row["question_id"]: row for row in rows}
        for name, (_, tamper, _) in CASES.items():
            before = dict(by_id[of_case[name]])
            tamper(by_id[of_case[name]])
            assert by_id[of_case[name]] != before, name

    rewrite(store, "answers", change)
    faults = run(store).faults
    for name, (_, _, where) in CASES.items():
        check = "proofs" if name in UNREADABLE else "replay"
        assert any(fault.startswith(f"{of_case[name]}: {where}") for fault in faults[check]), (name, faults)
        noticed = any(fault.startswith(f"{of_case[name]}: ") for fault in faults["compiled"])
        assert noticed == (name in NOTICED_BY_BOTH), (name, faults["compiled"])
    tampered = set(of_case.values())
    assert {fault.partition(":")[0] for found in faults.values() for fault in found} == tampered


# -- tampered facts -----------------------------------------------------------------------------------------------


@pytest.fixture
def one(few, tmp_path):
    """A store with one question, whose answer is a pose read at a stated time: store, question's id, sequence, and the
    person and frame of the reading."""
    store = copied(few, tmp_path)
    [asked, *_] = [row for row in store.questions("questions").to_pylist() if row["template"] == "change"]
    name = asked["question_id"]
    keep_only(store, {name})
    [row] = [row for row in store.questions("answers").to_pylist() if row["question_id"] == name]
    plan = parse_plan(row["plan"])
    return store, name, asked["sequence"], row["target_track"], plan.times[plan.answer.at].frame


def test_a_fact_changed_in_the_interval_tables_is_noticed(one):
    store, _, sequence, track, frame = one
    path = store.interval_path("sightings", sequence)
    rows, schema = pq.read_table(path).to_pylist(), pq.read_schema(path)
    for row in rows:
        if (row["track"], row["frame"]) == (track, frame):
            row["pose"] = "lying"
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), path)
    with pytest.raises(StoreError, match=r"sightings/.* is not as it was loaded: run 'jrdb-avr load --verify"):
        run(store)


@pytest.mark.slow
def test_a_fact_changed_in_the_keyframe_layer_is_noticed(one):
    store, name, sequence, track, frame = one
    with Graph.open(store.graph_path) as graph:
        graph.execute(
            "MATCH (m:Moment) WHERE m.sequence = $sequence AND m.track = $track AND m.frame = $frame "
            "SET m.pose = 'lying'",
            {"sequence": sequence, "track": track, "frame": frame},
        )
    # As if it had been built so: else the file is taken for damaged.
    rows = check_fingerprint(store.graph_path).rows
    fingerprint_path(store.graph_path).write_bytes(msgspec.json.encode(compute_fingerprint(store.graph_path, rows)))
    faults = run(store).faults
    assert any(fault.startswith(name) for fault in faults["replay"])
    assert "compiled" not in faults


def test_the_command_names_every_difference_and_fails(one):
    store, name, *_ = one
    rewrite(store, "answers", lambda rows: [row.update(hops=7) for row in rows])
    code, out, err = run_command("validate", "--store", store.path, "--replay", "--workers", "1", "--json")
    rows = {row["check"]: row for row in json.loads(out)}
    assert code == 1 and [*rows] == [*CHECKS, *REPLAY_CHECKS]
    assert rows["replay"]["faults"] == 1 and rows["replay"]["first fault"] == f"{name}: hops: stored 7, now 0"
    assert f"replay: {name}: hops: stored 7, now 0" in err.splitlines()


@pytest.mark.slow
def test_a_fact_changed_in_the_scene_is_noticed(one):
    store, name, sequence, track, frame = one
    with Graph.open(store.graph_path) as graph:
        graph.execute(
            "MATCH (p:Person)-[s:SeenIn]->(:Frame) WHERE p.sequence = $sequence AND p.track = $track "
            "AND s.frame = $frame SET s.pose = 'lying'",
            {"sequence": sequence, "track": track, "frame": frame},
        )
    # As if it had been built so: else the file is taken for damaged.
    rows = check_fingerprint(store.graph_path).rows
    fingerprint_path(store.graph_path).write_bytes(msgspec.json.encode(compute_fingerprint(store.graph_path, rows)))
    faults = run(store).faults
    assert any(fault.startswith(f"{name}: answer: ") and fault.endswith("now lying") for fault in faults["compiled"])
    assert "replay" not in faults


# -- the comparison by itself -----------------------------------------------------------------------------------------

SHIFT, DROP = (
    Proof("time.shift", "-3 s", True, "different", "sitting"),
    Proof("time.drop", "by construction", True, "empty"),
)
RECORD = QuestionRecord(
    question_id="q",
    sequence="s",
    family="f",
    template="t",
    question="?",
    choices=("walking", "sitting"),
    answer_mode="multiple_choice",
    answer='{"choice":1}',
    target_track=1,
    plan="",
    proofs=(SHIFT, DROP),
    distractors=(None, None),
    rules="",
    hops=0,
    time_gap_s=3.0,
    separation_deg=0.5,
    people_in_scene=2,
    bindings={"a": 1, "t0": 15},
    needed=(),
)


@pytest.mark.parametrize(
    ("again", "where"),
    [
        ({"answer": "walking", "proofs": (DROP, SHIFT), "separation_deg": 0.5 + 1e-12, "needed": frozenset()}, []),
        ({"answer": "sitting"}, ["answer"]),
        ({"separation_deg": 0.5001, "time_gap_s": 3.0}, ["separation_deg"]),
        ({"bindings": {"a": 1, "t0": 30}, "hops": 0}, ["bindings"]),
        ({"proofs": (SHIFT,)}, ["time.drop by construction"]),
        ({"proofs": (SHIFT, DROP, Proof("hop.stop", "0", True, "empty"))}, ["hop.stop 0"]),
        ({"proofs": (SHIFT, DROP, DROP)}, ["proofs"]),
        ({"proofs": (Proof("time.shift", "-3 s", True, "different", "lying"), DROP)}, ["time.shift -3 s"]),
        ({"proofs": (Proof("time.shift", "-3 s", True, "empty", "sitting"), DROP)}, ["time.shift -3 s"]),
        ({"proofs": (Proof("time.shift", "-3 s", False, "different", "sitting"), DROP)}, ["time.shift -3 s"]),
    ],
)
def test_what_differs_from_the_stored_record_is_named(again, where):
    assert [one.where for one in differences(RECORD, again)] == where
