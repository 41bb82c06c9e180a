"""`validate` finds each fault that a test puts into a benchmark, and no fault in a sound benchmark."""

import json
import shutil

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace
from processes import run
from question_files import keep_only, rewrite

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.twins import compare_twins
from jrdb_avr.engine.validate.checks import read_records, validate
from jrdb_avr.engine.validate.validation import CHECKS
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.plan import Time, canonical, parse_plan
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

RULES = Rules()


@pytest.fixture(scope="module")
def one_of_each(sample_benchmark, tmp_path_factory):
    """A store with one question of each template."""
    store = Store(shutil.copytree(sample_benchmark.path, tmp_path_factory.mktemp("few") / "store"))
    rows = store.questions("questions").sort_by([("sequence", "descending")]).to_pylist()
    chosen = {row["template"]: row["question_id"] for row in rows}
    kept = set(chosen.values())
    keep_only(store, kept)
    assert set(chosen) == {template.name for template in TEMPLATES.values()}
    assert not faulty(store)
    return store


@pytest.fixture(scope="module")
def known_annotations():
    """Annotations by sequence, read once, because tests change only questions."""
    return {}


@pytest.fixture
def few(one_of_each, tmp_path, known_annotations, monkeypatch):
    """A copy of the store with one question of each template, for changes."""
    read = Annotations.read

    def remembered(store, sequence, rules):
        if sequence not in known_annotations:
            known_annotations[sequence] = read(store, sequence, rules)
        return known_annotations[sequence]

    monkeypatch.setattr(Annotations, "read", remembered)
    return Store(shutil.copytree(one_of_each.path, tmp_path / "store"))


def faulty(store):
    return set(validate(store, RULES).faults)


def test_a_fresh_benchmark_is_sound(sample_benchmark):
    report = validate(sample_benchmark, RULES)
    assert report.sound, report.faults
    questions = sample_benchmark.questions("questions").num_rows
    assert report.checked["rederive"] == 9 * questions > 300
    assert [row["check"] for row in report.rows()] == list(CHECKS)
    assert set(report.checked) == set(CHECKS) - {"twins"}
    assert all(row["faults"] == 0 for row in report.rows())


def first(rows, template):
    return next(row for row in rows if row["template"] == template)


PUBLIC = {
    "another id": (lambda row: row.update(question_id="0" * 16), "ids"),
    "a word more": (lambda row: row.update(question=row["question"] + " Please."), "text"),
    "another frame": (lambda row: row.update(question=row["question"].replace("(frame ", "(frame 1")), "text"),
    "a choice twice": (lambda row: row["choices"].__setitem__(0, row["choices"][1]), "choices"),
    "choices in another order": (lambda row: row["choices"].reverse(), "choices"),
    "three choices": (lambda row: row["choices"].pop(), "choices"),
    "another family": (lambda row: row.update(family="long_range"), "plans"),
    "an unknown template": (lambda row: row.update(template="riddle"), "plans"),
    "another mode": (lambda row: row.update(answer_mode="frame"), "answers"),
}


@pytest.mark.parametrize(("change", "check"), PUBLIC.values(), ids=PUBLIC)
def test_a_spoiled_question_is_found(few, change, check):
    rewrite(few, "questions", lambda rows: change(first(rows, "change")))
    assert check in faulty(few)


def spoiled_plan(row, **changes):
    plan = json.loads(row["plan"])
    plan.update(changes)
    row["plan"] = msgspec.json.encode(plan, order="sorted").decode()


def needed(row, **changes):
    boxes = json.loads(row["needed"])
    boxes[0].update(changes)
    row["needed"] = json.dumps(boxes)


def proofs(row, change):
    found = json.loads(row["proofs"])
    change(found)
    row["proofs"] = json.dumps(found)


def shift(found):
    return next(proof for proof in found if proof["kind"] == "time.shift")


PRIVATE = {
    "another choice": (
        lambda row: row.update(answer=json.dumps({"choice": json.loads(row["answer"])["choice"] % 4 + 1})),
        "rederive",
    ),
    "a choice that is not there": (lambda row: row.update(answer='{"choice":5}'), "answers"),
    "no JSON": (lambda row: row.update(answer="{"), "answers"),
    "an answer of another kind": (lambda row: row.update(answer='{"frame":3}'), "answers"),
    "another person": (lambda row: row.update(target_track=row["target_track"] + 1), "rederive"),
    "no plan": (lambda row: row.update(plan="[]"), "plans"),
    "a plan with spaces": (lambda row: row.update(plan=json.dumps(json.loads(row["plan"]))), "plans"),
    "a plan of other nodes": (lambda row: spoiled_plan(row, root="b"), "plans"),
    "proofs that are no list": (lambda row: row.update(proofs="3"), "proofs"),
    "a proof with another field": (lambda row: proofs(row, lambda found: found[0].update(note="x")), "proofs"),
    "a proof left out": (lambda row: proofs(row, lambda found: found.remove(shift(found))), "rederive"),
    "proofs that fail": (lambda row: row.update(proofs=row["proofs"].replace("true", "false")), "proofs"),
    "other hops": (lambda row: row.update(hops=row["hops"] + 1), "rederive"),
    "another separation": (lambda row: row.update(separation_deg=row["separation_deg"] + 0.5), "rederive"),
    "fewer people": (lambda row: row.update(people_in_scene=row["people_in_scene"] - 1), "rederive"),
    "another wait": (lambda row: row.update(time_gap_s=row["time_gap_s"] + 1), "rederive"),
    "other bindings": (lambda row: row.update(bindings='{"a":1}'), "proofs"),
    "a needed box elsewhere": (lambda row: needed(row, x=1.25), "rederive"),
    "a box of the description decisive": (lambda row: needed(row, decisive=True), "rederive"),
    "needed that is no JSON": (lambda row: row.update(needed="x"), "proofs"),
    "other rules": (lambda row: row.update(rules="0" * 16), "rules"),
}


@pytest.mark.parametrize(("change", "check"), PRIVATE.values(), ids=PRIVATE)
def test_a_spoiled_answer_is_found(few, change, check):
    asked = few.questions("questions").to_pylist()
    of_change = {row["question_id"] for row in asked if row["template"] == "change"}
    rewrite(few, "answers", lambda rows: change(next(row for row in rows if row["question_id"] in of_change)))
    assert check in faulty(few)


def test_a_proof_stored_otherwise_than_found_again_is_named(few):
    """Without --replay: kind, variant and both outcomes; the question by its id."""
    changed = {}

    def spoil(rows):
        for row in rows:
            proofs = json.loads(row["proofs"])
            proof = proofs[len(changed) % len(proofs)]
            proof["outcome"] = "same" if proof["outcome"] == "empty" else "empty"
            changed[row["question_id"]] = f"{proof['kind']} {proof['variant']}: stored {proof['outcome']}"
            row["proofs"] = json.dumps(proofs)

    rewrite(few, "answers", spoil)
    found = validate(few).faults["rederive"]
    assert len(found) == len(changed)
    for fault in found:
        assert fault[fault.index(": ") + 2 :].startswith(changed[fault.partition(":")[0]]), fault
        assert ", now " in fault


def test_spoiled_evidence_is_found(few):
    def moved(rows):
        rows[0]["x"] += 1

    def foreign(rows):
        rows.append(rows[0] | {"track": 999_999})

    for change in (moved, foreign, lambda rows: rows.pop(), lambda rows: rows.append(dict(rows[0]))):
        rewrite(few, "evidence", change)
        assert "evidence" in faulty(few)


def test_missing_rows_are_found(few):
    rewrite(few, "answers", lambda rows: rows.pop())
    assert "ids" in faulty(few)


def test_a_missing_sequence_or_another_frame_rate_is_found(few):
    for change in (lambda rows: rows[0].update(fps=10.0), lambda rows: rows.clear()):
        rewrite(few, "sequences", change)
        assert "files" in faulty(few)


@pytest.mark.parametrize(
    ("template", "copies", "fault"),
    [
        ("start", [{"template": "span"}], "about one start"),
        ("action_search", [{"template": "start"}], "about one start"),
        ("presence", [{}], "read at nearly the same times"),
        ("gap", [{"template": name} for name in TEMPLATES] * 2, "questions of person"),
    ],
)
def test_too_much_about_a_person_is_found(few, template, copies, fault):
    rewrite(few, "questions", lambda rows: rows.extend(first(rows, template) | copy for copy in copies))
    assert any(fault in text for text in validate(few, RULES).faults["selection"])


def swap(pair, other, loose):
    pair[0]["twin_id"], other[0]["twin_id"] = other[0]["twin_id"], pair[0]["twin_id"]


TWINS = {
    "erased": (lambda pair, other, loose: pair[0].update(twin_id=None), "not on exactly two"),
    "on three": (lambda pair, other, loose: loose[0].update(twin_id=pair[0]["twin_id"]), "not on exactly two"),
    "swapped": (swap, " differ in "),
    "on two others": (lambda pair, other, loose: [row.update(twin_id="0" * 16) for row in loose[:2]], " differ in "),
    "another": (lambda pair, other, loose: [row.update(twin_id="0" * 16) for row in pair], "another twin_id"),
}


@pytest.mark.parametrize(("change", "fault"), TWINS.values(), ids=TWINS)
def test_a_changed_twin_id_is_found(twin_benchmark, tmp_path, change, fault):
    def spoil(rows):
        ids = sorted({row["twin_id"] for row in rows} - {None})[:2]
        change(*([row for row in rows if row["twin_id"] == twin] for twin in (*ids, None)))

    store = Store(shutil.copytree(twin_benchmark.path, tmp_path / "store"))
    rewrite(store, "answers", spoil)
    assert any(fault in text for text in validate(store).faults["twins"])


def test_time_twins_differ_in_one_time_and_in_their_answers_alone(twin_benchmark):
    report = validate(twin_benchmark)
    assert report.sound and report.checked["twins"] > 15, report.faults
    records = [record for record in read_records(twin_benchmark, report) if record.twin_id]
    first, second = sorted(records, key=lambda record: record.twin_id)[:2]
    assert compare_twins(first, second, RULES) is None
    plan = parse_plan(second.plan)
    described = canonical(replace(plan, times=plan.times | {"t0": Time(frame=0)}))
    for spoiled, reason in (
        ({"choices": first.choices[::-1]}, "differ in choices"),
        ({"plan": described}, "differ in more of the plan than the times asked"),
        ({"plan": first.plan}, "do not differ in exactly one time asked, by more than near-duplicates"),
        ({"answer": first.answer}, "have the same answer"),
    ):
        assert compare_twins(first, replace(second, **spoiled), RULES) == reason
    assert compare_twins(first, second, Rules(near_duplicate_s=99, near_presence_s=99)).startswith("do not differ")


def test_a_private_column_in_a_public_file_is_found(few):
    path = few.question_path("questions")
    table = pq.read_table(path)
    pq.write_table(table.append_column("target_track", pa.array([1] * table.num_rows, pa.int32())), path)
    assert "files" in faulty(few)


def test_metadata_is_looked_at(few):
    path = few.question_path("questions")
    table = pq.read_table(path)
    for metadata in (
        {},
        {**table.schema.metadata, b"target": b"7"},
        {**table.schema.metadata, b"generation": b"other"},
    ):
        pq.write_table(table.replace_schema_metadata(metadata), path)
        assert "files" in faulty(few)


def test_missing_and_broken_files_are_one_line(few, tmp_path):
    with pytest.raises(StoreError, match="is not a store: run 'jrdb-avr load"):
        Store(tmp_path / "nothing").questions("questions")
    path = few.question_path("evidence")
    path.write_bytes(b"PAR1 nothing")
    missing = run("validate", "--store", tmp_path / "nothing")
    broken = run("validate", "--store", few.path)
    path.unlink()
    gone = run("validate", "--store", few.path)
    (few.path / "store.json").unlink()
    unloaded = [run(*command, "--store", few.path) for command in (["validate"], ["cypher", "sequences"])]
    for code, out, err in (missing, broken, gone, *unloaded):
        assert code == 1 and len(err.splitlines()) == 1, err
        assert err.startswith("jrdb-avr: ") and not out
    assert all(" is not a store: run 'jrdb-avr load " in err for _, _, err in (missing, *unloaded))


def test_questions_of_other_rules_are_refused(sample_benchmark):
    with pytest.raises(StoreError, match="--rule"):
        validate(sample_benchmark, Rules(max_conditions=2))
