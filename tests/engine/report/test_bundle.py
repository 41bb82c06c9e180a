"""Predictions leave a store and come back as they were; bundles score elsewhere, and hostile ones are refused."""

import hashlib
import json
import math
import os
import re
import subprocess

import msgspec
import pyarrow as pa
import pytest
from processes import run
from scored_runs import stored_failures

from jrdb_avr.engine.report.bundle import read_bundle, write_bundle
from jrdb_avr.engine.report.comparison import score
from jrdb_avr.engine.report.leaderboard import leaderboard, score_bundles
from jrdb_avr.engine.report.prediction_lines import parse_lines
from jrdb_avr.engine.run.imported import import_predictions
from jrdb_avr.queries.runs import read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError
from jrdb_avr.schema.tables import RUNS

ADDRESS = "http://10.1.2.3:8000/v1"
SETTINGS = {"endpoint": {"base_url": ADDRESS, "seed": 3}, "method": {"panoramas": 8}}


@pytest.fixture
def store(tmp_path):
    return stored_failures(tmp_path / "S", SETTINGS)[2]


def predictions_of(store, name):
    return read_table(store.run_path(name) / "predictions.parquet").drop(["run_id"]).sort_by("question_id")


# -- lines ------------------------------------------------------------------------------------------------------------


def test_predictions_come_back_as_they_left(store, tmp_path):
    assert run("export", "--store", store.path, "r", "--jsonl", tmp_path / "again.jsonl")[0] == 0
    code, out, err = run("score", "--store", store.path, "--jsonl", tmp_path / "again.jsonl", "--json")
    assert code == 0, err
    assert predictions_of(store, "again") == predictions_of(store, "r")
    (row,) = json.loads(out)
    (first,) = score(store, ["r"]).rows
    assert row | {"run": "r"} == first and row["n"] == 13
    # It is a run like any other.
    assert [row["run"] for row in json.loads(run("report", "--store", store.path, "--json")[1])] == ["again", "r"]


def test_a_line_needs_an_id_alone(store, tmp_path):
    (tmp_path / "mine.jsonl").write_text(
        '{"question_id": "scores"}\n\n{"question_id": "loose", "answer": {"choice": 1}}'
    )
    assert import_predictions(store, tmp_path / "mine.jsonl", "own") == "own"
    (row,) = score(store, ["own"]).rows
    assert (row["n"], row["answer"], row["evidence"], row["invalid"]) == (2, 50.0, 0.0, 0.0)


def test_whole_numbers_written_as_floats_are_read(store, tmp_path):
    line = b'{"question_id": "scores", "answer": {"choice": 1}, "evidence": {"frame": 7, "box": [1, 2, 3, 4]}, '
    line += b'"n_model_calls": 3, "prompt_tokens": 40}'
    floats = re.sub(rb"(\d)(?=[},])", rb"\1.0", line)
    assert floats.count(b".0") == 7
    assert parse_lines(floats, "r", tmp_path).equals(parse_lines(line, "r", tmp_path))
    for answer in ({"frame": 7}, {"start_frame": 7, "end_frame": 9}, {"frame": 7, "angle_deg": 7.5}):
        text = json.dumps({"question_id": "loose", "answer": {key: float(value) for key, value in answer.items()}})
        assert json.loads(parse_lines(text.encode(), "r", tmp_path)["answer"][0].as_py()) == answer


BROKEN = {
    "half a choice": (b'{"question_id": "loose", "answer": {"choice": 2.5}}', "line 1: choice must be a whole number"),
    "half a frame": (b'{"question_id": "loose", "evidence": {"frame": 1.5, "box": [1, 2, 3, 4]}}', "whole number"),
    "a failed answer": (b'{"question_id": "loose", "status": "error", "answer": {"choice": 2}}', "line 1: its status"),
    "an invalid answer": (
        b'{"question_id": "loose", "status": "invalid", "answer": {"choice": 2}}',
        "line 1: its status is invalid",
    ),
    "no JSON": (b"{", "line 1"),
    "another key": (b'{"question_id": "loose", "score": 1}', "unknown field `score`"),
    "a key of two lines": (b'{"question_id": "loose", "a\\nb": 1}', "unknown field `a b`"),
    "no id": (b'{"answer": {"choice": 1}}', "question_id"),
    "an unknown question": (b'{"question_id": "who"}', "not in the store"),
    "twice": (b'{"question_id": "loose"}\n{"question_id": "loose"}', "line 2: question 'loose' comes twice"),
    "half a character": (b'{"question_id": "loose", "raw": "\\ud800"}', "line 1"),
    "bytes": (b'{"question_id": "loose", "raw": "\xff"}', "line 1"),
    "a box of three": (b'{"question_id": "loose", "evidence": {"frame": 1, "box": [1, 2, 3]}}', "line 1"),
    "no number": (b'{"question_id": "loose", "evidence": {"frame": 1, "box": [NaN, 2, 3, 4]}}', "line 1"),
    "too large a number": (b'{"question_id": "loose", "n_model_calls": 3000000000}', "line 1"),
    "deep": (b'{"question_id": "loose", "answer": ' + b'{"a":' * 100_000 + b"}", "line 1"),
    "a long line": (b'{"question_id": "loose", "raw": "' + b"x" * (1 << 20) + b'"}', "longer than"),
    "nothing": (b"\n", "holds no prediction"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_lines_are_refused_in_one_line_and_leave_nothing(store, tmp_path, case):
    data, said = BROKEN[case]
    (tmp_path / "own.jsonl").write_bytes(data)
    code, out, err = run("score", "--store", store.path, "--jsonl", tmp_path / "own.jsonl")
    assert (code, out) == (1, "") and said in err and err.count("\n") == 1, err
    assert not store.run_path("own").exists()


def test_an_import_never_replaces_a_run(store, tmp_path):
    (tmp_path / "r.jsonl").write_text('{"question_id": "scores"}')
    before = predictions_of(store, "r")
    with pytest.raises(StoreError, match="'r' exists"):
        import_predictions(store, tmp_path / "r.jsonl")
    with pytest.raises(InputError, match="cannot be a run id"):
        import_predictions(store, tmp_path / "r.jsonl", "../r")
    assert predictions_of(store, "r") == before


# -- bundles ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def bundle(store, tmp_path):
    assert run("submit", "--store", store.path, "r", tmp_path / "B")[0] == 0
    return tmp_path / "B"


def test_a_bundle_scores_like_its_run(store, bundle):
    code, out, err = run("score", "--store", store.path, "--bundle", bundle, "--json")
    assert code == 0 and err == ""
    assert json.loads(out) == score(store, ["r"]).rows
    # Nothing of the run's own scores, and nothing of its server's address.
    assert sorted(path.name for path in bundle.iterdir()) == ["SHA256SUMS", "predictions.jsonl", "run.json"]
    assert not [path for path in bundle.iterdir() if ADDRESS in path.read_text()]
    assert read_bundle(bundle).run.settings == {"endpoint": {"seed": 3}, "method": {"panoramas": 8}}
    command = ["sha256sum", "--strict", "--check", "SHA256SUMS"]
    subprocess.run(command, cwd=bundle, check=True, stdout=subprocess.DEVNULL)


def test_a_bundle_needs_a_folder_of_its_own(store, bundle):
    code, _, err = run("submit", "--store", store.path, "r", bundle)
    assert code == 1 and "not empty" in err
    with pytest.raises(StoreError, match="no run 'x'"):
        write_bundle(store, "x", bundle.parent / "C")
    assert not (bundle.parent / "C").exists()


@pytest.mark.parametrize("name", ["run.json", "predictions.jsonl"])
def test_one_changed_character_is_refused(store, bundle, name):
    data = (bundle / name).read_bytes()
    for place in range(0, len(data), len(data) // 7):
        changed = bytearray(data)
        changed[place] ^= 1
        (bundle / name).write_bytes(changed)
        code, out, err = run("score", "--store", store.path, "--bundle", bundle)
        assert (code, out) == (1, "") and f"{name} does not match its hash" in err and err.count("\n") == 1


def resummed(bundle):
    """Sums that fit again: whoever alters a bundle can do that too."""
    names = ("run.json", "predictions.jsonl")
    lines = [f"{hashlib.sha256((bundle / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    (bundle / "SHA256SUMS").write_text("".join(lines))


MANIFESTS = {
    "a way out": {"run_id": "../../up"},
    "no question": {"question_ids": []},
    "a long name": {"model": "m" * 201},
    "no text": {"method": 3},
    "large settings": {"settings": {"a": "x" * 70_000}},
    "a question twice": {"question_ids": ["scores", "scores"]},
    "a question of nobody": {"question_ids": ["who"]},
    "other predictions": {"question_ids": ["scores"]},
    "other questions": {"questions_sha256": "0" * 64},
}


@pytest.mark.parametrize("case", MANIFESTS)
def test_hostile_manifests_are_refused_in_one_line(store, bundle, case):
    (bundle / "run.json").write_text(json.dumps(json.loads((bundle / "run.json").read_text()) | MANIFESTS[case]))
    resummed(bundle)
    code, out, err = run("score", "--store", store.path, "--bundle", bundle)
    assert (code, out) == (1, "") and err.count("\n") == 1 and (str(bundle) in err or "run r " in err), err


def test_a_manifest_that_is_too_deep_or_large_is_refused(bundle):
    whole = (bundle / "run.json").read_bytes()
    assert whole.count(b'"panoramas"') == 1
    nested = [b'"panoramas": ' + b"[" * deep + b"]" * deep + b', "n"' for deep in (33, 900, 985)]
    broken = [b'{"settings":' + b"[" * 200_000, b" " * ((1 << 24) + 1), b"\xff", b"[]"]
    for data in (*broken, *(whole.replace(b'"panoramas"', own) for own in nested)):
        (bundle / "run.json").write_bytes(data)
        resummed(bundle)
        with pytest.raises(InputError):
            read_bundle(bundle)


def test_no_link_or_pipe_of_a_bundle_is_followed(store, bundle, tmp_path):
    outside = tmp_path / "outside.jsonl"
    (bundle / "predictions.jsonl").rename(outside)
    with pytest.raises(InputError, match="cannot read"):
        read_bundle(bundle)
    (bundle / "predictions.jsonl").symlink_to(outside)
    with pytest.raises(InputError, match="is a link or a pipe"):
        read_bundle(bundle)
    (bundle / "predictions.jsonl").unlink()
    os.mkfifo(bundle / "predictions.jsonl")
    with pytest.raises(InputError, match="is a link or a pipe"):
        read_bundle(bundle)
    with pytest.raises(InputError):
        read_bundle(tmp_path / "none")


# -- the leaderboard --------------------------------------------------------------------------------------------------


def another(store, name, wrong=0, ids=None, **changes):
    """A run like r under another name, its first answers wrong, perhaps of some of the questions alone."""
    manifest = read_run_manifest(store, "r")
    ids = manifest.question_ids if ids is None else ids
    write_run_manifest(store, msgspec.structs.replace(manifest, run_id=name, question_ids=tuple(ids), **changes))
    predictions = read_table(store.run_path("r") / "predictions.parquet").to_pylist()
    rows = [row for row in predictions if row["question_id"] in ids]
    for row in rows:
        row |= {"run_id": name} | ({"answer": '{"choice":2}'} if row["question_id"] in ids[:wrong] else {})
    store.write_run(name, "predictions", pa.Table.from_pylist(rows, RUNS["predictions"]))
    return name


def test_bundles_are_ranked_among_those_of_the_same_questions(store, tmp_path):
    ids = read_run_manifest(store, "r").question_ids
    # Of few questions the best score of all, which is no reason to lead.
    names = ["r", another(store, "worse", wrong=1), another(store, "same"), another(store, "few", ids=ids[:1])]
    folders = [write_bundle(store, name, tmp_path / f"B-{name}").folder for name in names]
    # Two of them with one run id, as two people may send.
    board = leaderboard(store, [*folders, folders[0]])
    found = [[(row["rank"], row["run"], row["n"]) for _, row in entries] for entries in board.sets]
    assert found == [[(1, "r", 13), (1, "r", 13), (1, "same", 13), (4, "worse", 13)], [(1, "few", 1)]]
    assert len({row["questions"] for _, row in board.sets[0]}) == 1
    store.write_run("same", "predictions", read_table(store.run_path("same") / "predictions.parquet").slice(0, 2))
    partial = write_bundle(store, "same", tmp_path / "partial").folder
    rows = leaderboard(store, [partial, folders[1]]).rows
    assert [(row["rank"], row["run"], row["n"]) for row in rows] == [(1, "worse", 13), (None, "same", 2)]
    assert board.sets[0][0][1]["questions"] != board.sets[1][0][1]["questions"]
    for bundle, ranked in (entry for entries in board.sets for entry in entries):
        (row,) = score_bundles(store, [bundle.folder]).rows
        assert {name: ranked[name] for name in row} | {"label": row["label"]} == row


def test_what_cannot_be_scored_is_left_out_of_a_leaderboard(store, bundle, tmp_path):
    other = write_bundle(store, another(store, "other", questions_sha256="0" * 64), tmp_path / "other").folder
    with pytest.warns(AvrWarning, match=r"left out: .*other.* belongs to another questions file"):
        assert [entry["bundle"] for entry in leaderboard(store, [other, bundle]).rows] == ["B"]
    (bundle / "run.json").write_text("{}")
    with pytest.warns(AvrWarning, match="its hash"), pytest.raises(StoreError, match="none of the bundles"):
        leaderboard(Store(store.path), [bundle])


def test_the_score_of_a_bundle_follows_the_threshold(store, bundle):
    assert math.isclose(score_bundles(store, [bundle], 0.45).rows[0]["evidence"], 200 / 13, abs_tol=0.01)
    assert math.isclose(score_bundles(store, [bundle], 0.5).rows[0]["evidence"], 100 / 13, abs_tol=0.01)
