"""Replay of stored proofs: a sound store has no difference, and the messages name each changed proof and fact."""

import json
import shutil

import msgspec
import pytest
from processes import run as run_command
from question_files import keep_only, rewrite

from jrdb_avr.engine.validate.checks import check_replay, read_records
from jrdb_avr.engine.validate.replay import compare_record
from jrdb_avr.engine.validate.validation import CHECKS, REPLAY_CHECKS, Validation
from jrdb_avr.queries.graph.file import check_fingerprint, compute_fingerprint, fingerprint_path
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.questions import Proof, QuestionRecord
from jrdb_avr.schema.rules import Rules

RULES = Rules()


@pytest.fixture(scope="module")
def few(sample_benchmark, tmp_path_factory):
    """A store with up to three questions of each template, from one sequence if it has as many."""
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
    check_replay(report, store, read_records(store, report), RULES)
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


def moved_plan(row):
    """Move the time of the description by a second. The people and the times differ then."""
    plan = json.loads(row["plan"])
    plan["times"]["t0"]["frame"] += 15
    row["plan"] = json.dumps(plan, sort_keys=True, separators=(",", ":"))


def described_at_the_event(row):
    row["plan"] = row["plan"].replace('"at":"t0"', '"at":"t1"')


def other_condition(row):
    plan = json.loads(row["plan"])
    plan["nodes"][0]["conditions"] = [{"action": "skating", "at": "t0"}]
    row["plan"] = json.dumps(plan, sort_keys=True, separators=(",", ":"))


# Template, change of the private row, and the part of the record that the message must name.
TAMPERED = {
    "an outcome": ("change", proofs(lambda f: proof_of(f, "time.shift").update(outcome="unknown")), "time.shift -3 s"),
    "holding": ("presence", proofs(lambda f: proof_of(f, "time.drop").update(holds=False)), "time.drop all keyframes"),
    "a proof's answer": ("two_hop", proofs(lambda f: proof_of(f, "hop.stop").update(answer="lying")), "hop.stop 0"),
    "a proof left out": ("three_hop", proofs(lambda f: f.remove(proof_of(f, "hop.skip"))), "hop.skip 1"),
    "a proof twice": ("later_action", proofs(lambda f: f.append(f[0])), "proofs"),
    "a proof of another kind": ("start", proofs(lambda f: f.append({**f[0], "kind": "hunch"})), "hunch match"),
    "a dropped condition": ("distance", proofs(lambda f: f[1].update(holds=False)), "anchor without"),
    "the second path": ("gap", proofs(lambda f: proof_of(f, "rederive").update(outcome="unknown")), "rederive"),
    "a hidden person": ("start", proofs(lambda f: proof_of(f, "evidence").update(outcome="unknown")), "evidence clear"),
    "the forward view": ("gap", proofs(lambda f: proof_of(f, "view.ahead").update(outcome="same")), "view.ahead 180"),
    "one view": ("two_hop", proofs(lambda f: proof_of(f, "view.single").update(holds=None)), "view.single any angle"),
}
NOTICED_BY_BOTH = {
    "another person": ("change", put("target_track", lambda track: track + 1), "target_track"),
    "another answer": (
        "presence",
        put("answer", lambda text: f'{{"choice":{json.loads(text)["choice"] % 4 + 1}}}'),
        "a",
    ),
    "another span": ("span", put("answer", lambda text: text.replace('frame":', 'frame":1', 1)), "anchor match"),
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
CASES = TAMPERED | NOTICED_BY_BOTH


def test_every_record_that_is_tampered_with_is_named(few, tmp_path):
    """Each change is in a question of its own, and all other questions stay sound."""
    store, free = copied(few, tmp_path), {}
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
        assert any(fault.startswith(f"{of_case[name]}: {where}") for fault in faults["replay"]), (name, faults)
        noticed = any(fault.startswith(f"{of_case[name]}: ") for fault in faults["compiled"])
        assert noticed == (name in NOTICED_BY_BOTH), (name, faults["compiled"])
    tampered = set(of_case.values())
    assert {fault.partition(":")[0] for found in faults.values() for fault in found} == tampered


# -- tampered facts -----------------------------------------------------------------------------------------------


@pytest.fixture
def one(few, tmp_path):
    """A store with one question about a posture at a stated time: the store, and the id, sequence and target."""
    store = copied(few, tmp_path)
    [asked, *_] = [row for row in store.questions("questions").to_pylist() if row["template"] == "change"]
    name = asked["question_id"]
    keep_only(store, {name})
    [row] = [row for row in store.questions("answers").to_pylist() if row["question_id"] == name]
    return store, name, asked["sequence"], row["target_track"]


def test_the_command_names_every_difference_and_fails(one):
    store, name, *_ = one
    rewrite(store, "answers", lambda rows: [TAMPERED["an outcome"][1](row) for row in rows])
    code, out, err = run_command("validate", "--store", store.path, "--replay", "--json")
    rows = {row["check"]: row for row in json.loads(out)}
    assert code == 1 and [*rows] == [*CHECKS, *REPLAY_CHECKS]
    (fault,) = [line.removeprefix("replay: ") for line in err.splitlines() if line.startswith("replay: ")]
    assert rows["replay"]["faults"] == 1 and rows["replay"]["first fault"] == fault
    assert fault.startswith(f"{name}: time.shift -3 s: stored unknown")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edge", "change", "noticed"),
    [
        (
            "-[r:Performs]->(:Action)",
            "r.difficulty = 3",
            {"compiled": "answer: ", "replay": "time.drop all keyframes: "},
        ),
        ("-[s:SeenIn]->(:Frame)", "s.clear = false", {"replay": "evidence clear views: "}),
    ],
    ids=["actions", "clear views"],
)
def test_a_fact_changed_in_the_scene_is_noticed(one, edge, change, noticed):
    store, name, sequence, track = one
    with Graph.open(store.graph_path) as graph:
        graph.execute(
            f"MATCH (p:Person){edge} WHERE p.sequence = $sequence AND p.track = $track SET {change}",
            {"sequence": sequence, "track": track},
        )
    # As if it had been built so: else the file is taken for damaged.
    rows = check_fingerprint(store.graph_path).rows
    fingerprint_path(store.graph_path).write_bytes(msgspec.json.encode(compute_fingerprint(store.graph_path, rows)))
    faults = run(store).faults
    assert faults.keys() == noticed.keys()
    assert all(any(fault.startswith(f"{name}: {noticed[check]}") for fault in faults[check]) for check in faults)


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
        ({"separation_deg": float("nan")}, ["separation_deg"]),
        ({"bindings": {"a": 1, "t0": 30}, "hops": 0}, ["bindings"]),
        ({"proofs": (SHIFT,)}, ["time.drop by construction"]),
        ({"proofs": (SHIFT, DROP, Proof("hop.stop", "0", True, "empty"))}, ["hop.stop 0"]),
        ({"proofs": (SHIFT, DROP, DROP)}, ["proofs"]),
        ({"proofs": (Proof("time.shift", "-3 s", True, "different", "lying"), DROP)}, ["time.shift -3 s"]),
    ],
)
def test_differences_from_the_stored_record_are_named(again, where):
    assert [line.split(": ")[1] for line in compare_record(RECORD, again)] == where
