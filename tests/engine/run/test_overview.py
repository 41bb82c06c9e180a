"""The runs of a store: listed with their state, shown, compared question by question, and removed."""

import json
import shutil

import msgspec
import numpy as np
import pytest
from processes import run
from scored_runs import BOX, ELSEWHERE, Benchmark, opened, segment_of

from jrdb_avr.engine.report.comparison import diff
from jrdb_avr.engine.run.journal import Finished
from jrdb_avr.engine.run.overview import list_runs, remove_run, show_run
from jrdb_avr.queries.runs import questions_hash, run_ids, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, LockedError, StoreError

RIGHT, ANSWER, NOTHING = (1, BOX, 7), (1, ELSEWHERE, 7), (2, None, 0)


@pytest.fixture
def store(tmp_path):
    """Two runs of twelve questions, one of twelve sequences each."""
    place = Store(tmp_path / "S")
    benchmark = Benchmark([(f"q{n:02}", f"s{n:02}", "long_range") for n in range(12)])
    benchmark.write(place)
    for name, given in (
        ("one", [RIGHT] * 6 + [ANSWER] * 3 + [NOTHING] * 3),
        ("two", [RIGHT] * 2 + [NOTHING] * 6 + [RIGHT] * 4),
    ):
        made = benchmark.run(given, name, "react")
        place.write_run(name, "predictions", benchmark.written["predictions"])
        manifest = msgspec.structs.replace(made.manifest, questions_sha256=questions_hash(place))
        write_run_manifest(place, manifest)
    return place


def state(store, name):
    return {row["run"]: row["state"] for row in list_runs(store)}[name]


def test_runs_are_listed_by_how_far_they_are(store):
    rows = {row["run"]: row for row in list_runs(store)}
    assert rows["one"]["state"] == "complete"
    assert (rows["one"]["n"], rows["one"]["answered"], rows["one"]["invalid"], rows["one"]["error"]) == (12, 9, 3, 0)
    (store.run_path("one") / "predictions.parquet").unlink()
    with opened(segment_of(store.run_path("one"))) as journal:
        for n, reason in enumerate(("slow", "slow", "lost"), len(journal.finished)):
            blank = {"status": "error", "reason": reason}
            lines = [Finished(f"q0{n}", blank, [])]
            segment_of(store.run_path("one")).open("ab").write(msgspec.json.encode(lines[0]) + b"\n")
        assert state(store, "one") == "unfinished"
        found = show_run(store, "one")
        assert (found["error"], found["commonest error"]) == (3, ["2 x slow", "1 x lost"])
        with pytest.raises(LockedError, match="is being run"):
            remove_run(store, "one")
    (store.run_path("two") / "run.json").write_text("{")
    assert state(store, "two") == "damaged"
    store.write_questions("questions", store.questions("questions").slice(1), {})
    assert state(store, "one") == "other questions"


def test_a_run_is_shown_with_its_settings(store):
    code, out, err = run("runs", "show", "one", "-s", store.path, "--json")
    (row,) = json.loads(out)
    assert (code, err, row["run"], row["n"], row["folder"]) == (0, "", "one", 12, str(store.run_path("one")))
    assert run("runs", "show", "noe", "-s", store.path)[2].endswith("has no run 'noe': did you mean one?\n")


@pytest.mark.parametrize("depth", [900, 100_000])
@pytest.mark.parametrize("pair", ['{"a":}', "[]"])
def test_names_and_settings_of_any_size_are_read(store, depth, pair):
    path = store.run_path("one") / "run.json"
    manifest = json.loads(path.read_text()) | {"method": "m" * 300_000, "settings": {"method": "DEEP", "kept": '[\\"{'}}
    path.write_text(
        json.dumps(manifest).replace('"DEEP"', pair[:-1] * depth + "1" * (len(pair) > 2) + pair[-1] * depth)
    )
    assert state(store, "one") == "complete"
    for command in (["runs", "list"], ["runs", "show", "one"], ["report"], ["score"], ["sql", "FROM runs"]):
        code, out, err = run(*command, "-s", store.path)
        assert code == 0 and len(out) < 2_000_000, (command, err)
    assert show_run(store, "one")["settings"]["kept"] == '[\\"{'


def test_removing_takes_one_run_and_nothing_else(store):
    others = {path: path.read_bytes() for path in store.path.rglob("*") if path.is_file() and "one" not in path.parts}
    assert run("runs", "remove", "one", "-s", store.path)[0] == 2, "nobody was asked"
    assert run_ids(store) == ["one", "two"]
    assert run("runs", "remove", "one", "-s", store.path, "--yes")[0] == 0
    assert {path: path.read_bytes() for path in store.path.rglob("*") if path.is_file()} == others
    for name in ("one", "../two", ".."):
        with pytest.raises((StoreError, InputError)):
            remove_run(store, name)
    assert run_ids(store) == ["two"]


def test_a_run_that_cannot_be_moved_away_stays(store, monkeypatch):
    def full(**options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.mkdtemp", full)
    with pytest.raises(StoreError, match="cannot remove"):
        remove_run(store, "one")
    assert run_ids(store) == ["one", "two"]


def test_a_link_is_not_followed(store, tmp_path):
    shutil.move(store.run_path("one"), tmp_path / "elsewhere")
    store.run_path("one").symlink_to(tmp_path / "elsewhere")
    remove_run(store, "one")
    assert run_ids(store) == ["two"] and (tmp_path / "elsewhere" / "run.json").exists()


def test_who_scores_which_question(store):
    found = diff(store, "one", "two")
    combined = next(row for row in found.rows if row["score"] == "combined")
    assert (combined["n"], combined["only_first"], combined["only_second"]) == (12, 4, 4)
    assert combined["difference"] == 0 and combined["difference_low"] < 0 < combined["difference_high"]
    scores = {row["score"]: row for row in found.scores()}
    assert (scores["answer"]["first"], scores["answer"]["second"]) == (75, 50)
    assert (scores["combined"]["first"], scores["combined"]["second"]) == (50, 50)
    assert (scores["combined"]["only first"], scores["combined"]["only second"]) == (4, 4)
    rows = {row["question_id"]: row for row in found.questions()}
    assert {name: row["only"] for name, row in rows.items()} == {
        **{f"q{n:02}": "one" for n in range(2, 6)},
        **{f"q{n:02}": "two" for n in range(8, 12)},
    }
    assert (rows["q08"]["first right"], rows["q08"]["second right"]) == ("answer", "both")
    assert len(found.questions("answer")) == 4 + 2 + 3
    # The other way round everything changes sides.
    back = diff(store, "two", "one")
    assert {row["question_id"]: row["only"] for row in back.questions()} == {k: v["only"] for k, v in rows.items()}
    answers = [next(row for row in own.rows if row["score"] == "answer") for own in (found, back)]
    assert answers[0]["difference"] == -answers[1]["difference"] == pytest.approx(np.round(100 * (6 - 9) / 12, 2))
    with pytest.raises(InputError, match="did you mean combined"):
        found.questions("combine")


def test_the_command_tells_both_tables(store):
    code, out, _ = run("runs", "diff", "one", "two", "-s", store.path)
    assert code == 0 and "first: one, second: two" in out and "[" in out
    code, out, _ = run("runs", "diff", "one", "two", "-s", store.path, "--score", "answer", "--csv")
    assert code == 0 and len(out.splitlines()) == 10 and out.startswith("question_id,only,template")
