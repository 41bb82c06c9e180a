"""Runs: the journal, resuming, what is opened, what is kept; over real sockets and in real processes."""

import dataclasses
import json
import os
import resource
import shutil
import signal
import sys
import threading
import time
import tracemalloc
from decimal import Decimal

import cv2
import duckdb
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from environment import ROOT
from fake_server import FakeServer, Status, sound
from hypothesis import given
from hypothesis import strategies as st
from painted import BLIND, FRAMES, POSES, QUESTIONS_ASKED, SEQUENCE, question, write_answers
from scored_runs import InMemory, journal_lines, opened

from jrdb_avr.engine.commands.evaluate import command
from jrdb_avr.engine.commands.report import score
from jrdb_avr.engine.run import answering
from jrdb_avr.engine.run import journal as journals
from jrdb_avr.engine.run.evaluate import default_run_id
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice, Evidence, Number
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.errors import AvrError, FilteredError, InputError, LockedError, RunStoppedError, StoreError
from jrdb_avr.schema.method import Prediction, SequenceInfo, Step
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.tables import QUESTIONS, RUNS


def evaluate(store, *options, ok=True):
    """The command in this process; `options` may replace the model."""
    base = ["--store", str(store.path), "--method", "react"]
    if "--model" not in options:
        base += ["--model", "simulated:perfect"]
    result = CliRunner().invoke(command, [*base, *options])
    if ok:
        assert result.exception is None, result.output
    return result


def predictions(store, run_id="react-simulated-perfect"):
    return pq.read_table(store.run_path(run_id) / "predictions.parquet")


def lasting(table):
    """What must be equal between two runs of the same questions."""
    return table.drop_columns(["run_id", "seconds"]).to_pylist()


# -- the command ------------------------------------------------------------------------------------------------------


def test_evaluate_with_the_simulated_model(store):
    result = evaluate(store, "--json")
    (row,) = json.loads(result.stdout)
    assert (row["run_id"], row["n"], row["answered"], row["error"]) == ("react-simulated-perfect", 12, 12, 0)
    assert "1 of 13 questions are left out: 1 sequences have no panoramas (unseen)" in result.stderr

    table = predictions(store)
    assert table.schema.equals(RUNS["predictions"])
    ids = table["question_id"].to_pylist()
    assert ids == sorted(q.question_id for q in QUESTIONS_ASKED)
    asked = {q.question_id: q for q in QUESTIONS_ASKED}
    for row in table.to_pylist():
        t1 = int(asked[row["question_id"]].question.rpartition("(frame ")[2].partition(")")[0])
        assert json.loads(row["answer"]) == {"choice": POSES.index("sitting" if t1 < 120 else "lying") + 1}
        assert abs((row["evidence_x"] - (3650 + row["evidence_frame"] * 0.5) + 1880) % 3760 - 1880) < 2
        assert row["n_model_calls"] == row["n_observations"] + 1

    steps = pq.read_table(store.run_path("react-simulated-perfect") / "steps.parquet")
    assert steps.schema.equals(RUNS["steps"])
    order = list(zip(steps["question_id"].to_pylist(), steps["step"].to_pylist(), strict=True))
    assert order == sorted(order)
    assert set(steps["kind"].to_pylist()) == {"model", "observe", "solve"}
    counted = duckdb.sql("select count(*) from steps where kind = 'model'").fetchall()[0][0]
    assert counted == sum(table["n_model_calls"].to_pylist())

    manifest = json.loads((store.run_path("react-simulated-perfect") / "run.json").read_bytes())
    assert manifest["synthetic"] is True
    assert manifest["question_ids"] == [q.question_id for q in QUESTIONS_ASKED]
    assert manifest["settings"]["method"]["budget"] == 24
    assert manifest["settings"]["endpoint"]["temperature"] == 0
    assert manifest["settings"]["served_model"] == "simulated:perfect"


def test_predictions_do_not_depend_on_concurrency(store):
    evaluate(store, "--run-id", "one", "--concurrency", "1")
    evaluate(store, "--run-id", "many", "--concurrency", "64")
    assert lasting(predictions(store, "one")) == lasting(predictions(store, "many"))


def test_the_sample_is_known_by_its_sequences():
    from jrdb_avr.loaders.synthetic.write import sequence_name

    assert all(is_of_sample(sequence_name(index)) for index in range(30))
    assert not is_of_sample("gates-ai-lab-2019-02-08_0")


def test_questions_by_id_by_file_and_by_number(store, tmp_path):
    ids = [q.question_id for q in QUESTIONS_ASKED[3:6]]
    evaluate(store, "--run-id", "a", "--questions", ",".join(ids))
    (tmp_path / "ids.txt").write_text("\n".join(ids) + "\n")
    evaluate(store, "--run-id", "b", "--questions", str(tmp_path / "ids.txt"), "--limit", "2")
    assert predictions(store, "a")["question_id"].to_pylist() == sorted(ids)
    evaluate(store, "--run-id", "c", "--questions", ",".join(q.question_id for q in QUESTIONS_ASKED * 20))
    assert len(predictions(store, "c")) == len(QUESTIONS_ASKED)
    assert predictions(store, "b")["question_id"].to_pylist() == sorted(ids[:2])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--questions", "0123456789abcdef"), "not in the store"),
        (("--questions", ","), "names no question"),
        (("--questions", "x" * 5000), "cannot read"),
        (("--questions", BLIND.question_id), "no selected question"),
        (("--run-id", "../evil"), "run id"),
        (("--run-id", ""), "'' cannot be a run id"),
        (("--run-id", "", "--epochs", "2"), "'' cannot be a run id"),
        (("--model", "qwen", "--base-url", "nowhere"), "no server address"),
    ],
)
def test_wrong_calls_are_one_line(store, options, message):
    result = evaluate(store, *options, ok=False)
    assert isinstance(result.exception, AvrError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)


def test_the_set_of_prompts_is_a_setting_of_the_run(store):
    evaluate(store, "--prompts", "paper", "--limit", "4")
    paper = json.loads((store.run_path("react-paper-simulated-perfect") / "run.json").read_bytes())
    assert paper["settings"]["method"]["prompts"] == "paper"
    # The simulated model reads both sets, and looks and answers the same.
    evaluate(store, "--run-id", "default", "--limit", "4")
    told = ["answer", "evidence_frame", "n_observations"]
    both = [predictions(store, run_id).select(told) for run_id in ("react-paper-simulated-perfect", "default")]
    assert both[0].equals(both[1])
    refused = evaluate(store, "--run-id", "default", "--limit", "4", "--prompts", "paper", "--resume", ok=False)
    assert "settings" in str(refused.exception)


def test_default_run_ids_are_names():
    assert default_run_id("react", "Qwen/Qwen3-VL-8B:latest") == "react-Qwen-Qwen3-VL-8B-latest"
    assert default_run_id("react", "../..") == "react"


# -- several runs -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_epochs_are_runs_of_their_own(store):
    options = ("--epochs", "3", "--limit", "4", "--simulate", "wrong=0.6", "--json")
    rows = json.loads(evaluate(store, *options).stdout)
    assert [row["run_id"] for row in rows] == [
        "react-simulated-perfect-1",
        "react-simulated-perfect-2",
        "react-simulated-perfect-3",
    ]
    answers = [predictions(store, row["run_id"])["answer"].to_pylist() for row in rows]
    assert len({tuple(own) for own in answers}) > 1, "the simulated model draws anew"
    manifests = [json.loads((store.run_path(row["run_id"]) / "run.json").read_bytes()) for row in rows]
    assert [manifest["settings"]["epoch"] for manifest in manifests] == [1, 2, 3]
    assert len(json.loads(evaluate(store, *options, "--resume").stdout)) == 3


@pytest.mark.slow
def test_a_matrix_is_several_runs(store, tmp_path):
    matrix = tmp_path / "runs.toml"
    matrix.write_text(
        """
        [[run]]
        method = ["react", "monolithic"]
        model = ["simulated:perfect", "simulated:independent"]
        [[run]]
        model = "fake"
        base-url = "URL"
        temperature = "none"
        header = ["X-Mine=HOME", "X-Other=HOME"]
        extra-body = {seed = 3, nested = {a = [1]}}
        limit = 1
        run-id = "mine"
        """
    )
    with FakeServer(sound(lambda request, n: "{}")) as server:
        matrix.write_text(matrix.read_text().replace("URL", server.url))
        shared = ("--store", str(store.path), "--matrix", str(matrix), "--method", "react", "--limit", "3", "--json")
        result = CliRunner().invoke(command, shared)
        assert result.exception is None, result.output
    rows = json.loads(result.stdout)
    assert [(row["run_id"], row["n"]) for row in rows] == [
        ("react-simulated-perfect", 3),
        ("react-simulated-independent", 3),
        ("monolithic-simulated-perfect", 3),
        ("monolithic-simulated-independent", 3),
        ("mine", 1),
    ]
    endpoint = json.loads((store.run_path("mine") / "run.json").read_bytes())["settings"]["endpoint"]
    assert endpoint["headers"] == {"X-Mine": "HOME", "X-Other": "HOME"} and endpoint["temperature"] is None
    assert server.requests[-1]["seed"] == 3 and "temperature" not in server.requests[-1]


def test_a_run_of_a_matrix_that_fails_leaves_the_others(store, tmp_path):
    matrix = tmp_path / "runs.toml"
    matrix.write_text(
        '[[run]]\nmodel = "x"\nbase-url = "http://127.0.0.1:9/v1"\n[[run]]\nmodel = "simulated:perfect"\n'
    )
    options = ("--store", str(store.path), "--matrix", str(matrix), "--method", "react", "--limit", "1", "--json")
    result = CliRunner().invoke(command, options)
    assert result.exit_code == 1
    assert [row["run_id"] for row in json.loads(result.stdout)] == ["react-simulated-perfect"]
    assert "react, x: " in result.stderr and "cannot reach the server" in result.stderr
    failed = CliRunner().invoke(command, (*options[:-1], "--model", "x"))
    assert (failed.exit_code, failed.stdout) == (1, "")  # No table without rows.


def test_the_papers_matrix_is_among_the_examples():
    assert (ROOT / "docs/examples/paper.toml").read_bytes() == (ROOT / "engine/run/paper.toml").read_bytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[", "cannot read"),
        ("", "holds no run"),
        ("run = 3", "holds no run"),
        ("[[run]]\nmodel = 'simulated:perfect'\nhistory = [4, 8]", "two runs are named react-simulated-perfect"),
        ("[[run]]\nmodell = 'marker'", "run 1: no option 'modell': did you mean model?"),
        ("[[run]]\nstore = 'other'", "run 1: no option 'store'"),
        ("[[run]]\n-s = 'other'", "run 1: no option '-s'"),
        ("[[run]]\nmodel = []", "run 1: the list of model is empty"),
        ("[[run]]\nmodel = 'simulated:perfect'\nlimit = true", "run 1: limit cannot be true or false"),
        ("[[run]]\nmodel = {a = 1}", "run 1: model cannot be a table"),
        ("[[run]]\nmodel = 'simulated:perfect'\n[[run]]\nlimit = 'many'", "run 2: Invalid value for '--limit'"),
        ("[[run]]\nmodel = 'x'", "needs --base-url"),
        ("[[run]]\nmethod = 'react'", "Missing option '--model'"),
        ("[[run]]\nmodel = 'simulated:perfect'\nmax-cost = 3", "--prices"),
        ("[[run]]\nmodel = 'simulated:perfect'\nextra-body = {n = 3}", "run 1: --extra-body must not hold 'n'"),
    ],
)
def test_a_matrix_that_cannot_be_run_starts_nothing(store, tmp_path, text, words):
    (tmp_path / "runs.toml").write_text(text)
    options = ("--store", str(store.path), "--matrix", str(tmp_path / "runs.toml"), "--method", "react")
    result = CliRunner().invoke(command, options)
    told = " ".join((result.output + str(result.exception)).split())
    assert result.exit_code in (1, 2) and words in told
    assert isinstance(result.exception, SystemExit | InputError)
    assert not (store.path / "runs").exists()


# -- resuming ---------------------------------------------------------------------------------------------------------


def test_errors_are_rows_and_are_asked_again(store):
    broken = True

    def script(request, n):
        if broken and n > 4:
            return Status(400, "context too long")
        return json.dumps({"action": "observe", "frame_id": "000000", "angle_deg": 10 * (n % 36)})

    with FakeServer(sound(script)) as server:
        options = ("--model", "fake", "--base-url", server.url, "--limit", "3", "--concurrency", "1", "--json")
        result = evaluate(store, *options, ok=False)
        (row,) = json.loads(result.stdout)
        assert (result.exit_code, row["error"]) == (1, 3)
        table = predictions(store, "react-fake").to_pylist()
        assert all("HTTP 400" in r["reason"] and r["answer"] is None for r in table)
        assert [r["n_model_calls"] for r in table].count(0) == 2
        assert max(r["n_observations"] for r in table) > 0
        broken = False
        kept = json.loads((store.run_path("react-fake") / "run.json").read_text())["settings"]
        assert (kept["unreadable_questions"], kept["method"]["identical_refusals"]) == (20, 3)
        resumed = evaluate(store, *options, "--resume", "--keep-going")
        (row,) = json.loads(resumed.stdout)
        assert (row["error"], row["invalid"]) == (0, 3)
        assert "3 of 3 questions ended as invalid, 3 of them because: no looks are left" in resumed.stderr


def test_the_beginning_of_an_unreadable_reply_is_said(store):
    with FakeServer(sound(lambda request, n: f"<unused94>{n}")) as server:
        arguments = ("--model", "fake", "--base-url", server.url, "--limit", "3")
        result = evaluate(store, *arguments, "--method", "monolithic")
    reason = "3 of them because: the reply is not one JSON object: Expecting value; a reply begins: '<unused94>"
    assert reason in result.stderr


@pytest.mark.parametrize(
    "gone",
    [Status(503, "loading model"), Status(429, "later"), Status(401, "the key has expired")],
    ids=["loading", "busy", "no key"],
)
def test_a_server_that_is_gone_ends_the_run_and_spends_no_question(store, gone):
    """Nothing is on record of the questions that it cannot answer; resumed, the run asks them for the first time."""
    away = True

    def script(request, n):
        if away and n > 30:
            return gone
        return json.dumps({"action": "observe", "frame_id": "000000", "angle_deg": 10 * (n % 36)})

    with FakeServer(sound(script)) as server:
        options = ("--model", "fake", "--base-url", server.url, "--limit", "4", "--concurrency", "1", "--json")
        result = evaluate(store, *options, "--retries", "0", ok=False)
        assert isinstance(result.exception, RunStoppedError)
        assert gone.message in str(result.exception)
        assert ("--resume" if gone.code != 401 else "OPENAI_API_KEY") in str(result.exception)
        folder = store.run_path("react-fake")
        kept = [json.loads(line) for line in journal_lines(folder)]
        assert len(kept) < 4 and not any(entry["prediction"]["status"] == "error" for entry in kept)
        assert "the same command with --resume" in result.stderr
        assert len(predictions(store, "react-fake")) == len(kept) if kept else "score" not in result.stderr
        away = False
        (row,) = json.loads(evaluate(store, *options, "--resume").stdout)
        assert (row["n"], row["error"]) == (4, 0)


def test_a_run_that_stops_in_its_preflight_has_asked_no_question(store):
    with FakeServer(lambda request, n: Status(401, "no key")) as server:
        result = evaluate(store, "--model", "fake", "--base-url", server.url, "--retries", "0", ok=False)
    assert isinstance(result.exception, RunStoppedError)
    assert "react-fake: no question was asked; go on" in result.stderr and "0 of 0" not in result.stderr


def test_a_run_that_is_interrupted_or_killed_is_scored_as_partial(store, monkeypatch):
    """Ctrl-C writes what is finished, here before the program knows that its first line is on disk.

    A killed run has its journal alone, and `score` writes its tables.
    """
    write_answers(store)
    signals, fsync = [signal.SIGINT], os.fsync

    def interrupt(file):
        fsync(file)
        if signals and journal_lines(store.run_path("react-fake")):
            os.kill(os.getpid(), signals.pop())

    monkeypatch.setattr(os, "fsync", interrupt)
    with FakeServer(sound(lambda request, n: '{"action": "observe", "frame_id": "000000", "angle_deg": 10}')) as server:
        options = ("--model", "fake", "--base-url", server.url, "--limit", "4", "--concurrency", "1")
        result = evaluate(store, *options, ok=False)
    kept = len(predictions(store, "react-fake"))
    assert 0 < kept < 4 and result.exit_code
    line = f"react-fake: {kept} of 4 questions are finished; go on: the same command with --resume; or score"
    assert line in result.stderr and f"jrdb-avr score --store {store.path} react-fake" in result.stderr
    for _ in range(2):
        scored = CliRunner().invoke(score, ["--store", str(store.path), "react-fake", "--json"])
        (row,) = json.loads(scored.stdout)
        assert (row["n"], row["label"]) == (kept, f"partial, {kept} of 4")
        (store.run_path("react-fake") / "predictions.parquet").unlink()


def test_a_run_that_reaches_its_cost_stops_and_goes_on_with_more(store, tmp_path, monkeypatch):
    """Ten tokens read and five written a call, at a dollar each: the checks alone cost 165."""
    monkeypatch.setenv("MINE", "a-secret-of-the-header")
    (tmp_path / "prices.toml").write_text("[fake]\ninput = 1000000\noutput = 1000000\n")
    turn = json.dumps({"action": "observe", "frame_id": "000000", "angle_deg": 10})
    with FakeServer(sound(lambda request, n: turn)) as server:
        options = ("--model", "fake", "--base-url", f"{server.url}?api-version=1", "--limit", "4", "--json")
        options += ("--temperature", "none", "--header", "X-Mine=MINE", "--extra-body", '{"seed": 3}')
        options += ("--prices", str(tmp_path / "prices.toml"), "--concurrency", "1")
        result = evaluate(store, *options, "--max-cost", "400", ok=False)
        assert isinstance(result.exception, RunStoppedError) and "--max-cost is 400" in str(result.exception)
        reached = len(server.requests)
        assert 400 <= 15 * reached < 400 + 15
        (row,) = json.loads(evaluate(store, *options, "--max-cost", "90000", "--resume").stdout)
        again = server.requests[reached:]
    assert (row["n"], row["error"]) == (4, 0)
    assert row["dollars"] == row["prompt_tokens"] + row["completion_tokens"] > 200
    assert all("temperature" not in request and request["seed"] == 3 for request in server.requests)
    assert again and all(header["x-mine"] == "a-secret-of-the-header" for header in server.headers)
    manifest = (store.run_path("react-fake") / "run.json").read_text()
    endpoint = json.loads(manifest)["settings"]["endpoint"]
    assert endpoint["headers"] == {"X-Mine": "MINE"} and "a-secret" not in manifest
    assert endpoint["price"] == {"input": 1e6, "output": 1e6} and endpoint["base_url"].endswith("/v1?api-version=1")
    assert (endpoint["temperature"], endpoint["extra_body"]) == (None, {"seed": 3})


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--model", "qwen"), "--base-url"),
        (("--max-cost", "3"), "--prices FILE"),
        (("--extra-body", "[1]"), "must be a JSON object"),
        (("--extra-body", "{"), "not JSON"),
        (("--extra-body", '{"model": "x"}'), "give its option"),
        (("--header", "novalue"), "NAME=ENV"),
        (("--header", "Host=MINE"), "no header of this name"),
        (("--temperature", "warm"), "nor 'none'"),
        (("--temperature", "nan"), "--temperature"),
    ],
)
def test_wrong_request_settings_are_usage_errors(store, option, words):
    result = evaluate(store, *option, ok=False)
    assert result.exit_code == 2
    assert words in " ".join(result.output.replace("│", " ").split())


def test_resume_refuses_another_run(store):
    evaluate(store, "--limit", "2")
    other = evaluate(store, "--resume", "--limit", "1", ok=False)
    assert "has 1 questions that this selection leaves out" in str(other.exception)
    evaluate(store, "--resume")
    assert len(predictions(store)) == 2
    rows = store.questions("questions").slice(1)
    store.write_questions("questions", rows, {})
    other = evaluate(store, "--resume", ok=False)
    assert "has other questions than the store has now" in str(other.exception)


def test_answers_without_a_manifest_are_nobodys(store):
    """Deleting run.json and asking another model must not give it the answers of the first."""
    evaluate(store, "--limit", "1", "--run-id", "r")
    (store.run_path("r") / "run.json").unlink()
    with FakeServer(sound(lambda request, n: "{}")) as server:
        options = ("--limit", "1", "--run-id", "r", "--model", "other", "--base-url", server.url)
        result = evaluate(store, *options, ok=False)
    assert isinstance(result.exception, StoreError)
    assert "no run.json" in str(result.exception)
    assert not (store.run_path("r") / "run.json").exists()


def test_a_copied_run_is_not_the_run(store):
    evaluate(store, "--limit", "1")
    shutil.copytree(store.run_path("react-simulated-perfect"), store.run_path("copy"))
    result = evaluate(store, "--run-id", "copy", "--resume", ok=False)
    assert isinstance(result.exception, StoreError)
    assert "'react-simulated-perfect'" in str(result.exception)


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.drop_columns(["choices"]),
        lambda table: table.set_column(6, "answer_mode", pa.array(["essay"] * len(table))),
        lambda table: pa.concat_tables([table, table]),
        lambda table: table.set_column(3, "choices", pa.nulls(len(table), pa.list_(pa.string()))),
        lambda table: table.set_column(0, "question_id", pa.nulls(len(table), pa.string())),
    ],
    ids=["a column less", "another mode", "ids twice", "no choices", "no ids"],
)
def test_questions_of_another_form_are_one_line(store, change):
    table = store.questions("questions").select(QUESTIONS["questions"].names)
    pq.write_table(change(table.replace_schema_metadata(None)), store.question_path("questions"))
    result = evaluate(store, ok=False)
    assert isinstance(result.exception, StoreError)
    assert "generate again" in str(result.exception)


def test_an_unreachable_server_is_one_line_and_leaves_no_run(store):
    result = evaluate(store, "--model", "x", "--base-url", "http://127.0.0.1:9/v1", ok=False)
    assert isinstance(result.exception, AvrError)
    assert "cannot reach" in str(result.exception)
    assert not (store.run_path("react-x") / "run.json").exists()


# -- the journal ------------------------------------------------------------------------------------------------------


def entry(name, status="answered", **other):
    row = {field.name: None if field.nullable else 0 for field in RUNS["predictions"] if field.name != "run_id"}
    row |= {"question_id": name, "status": status, "raw": "", "reason": ""}
    return journals.Finished(name, row | other, [])


def test_the_journal_keeps_what_was_appended(tmp_path):
    path = tmp_path / "run" / "journal.jsonl"
    with opened(path) as journal:
        journal.append(entry("a", "error"))
        journal.append(entry("b"))
        journal.append(entry("a"))
    with opened(path) as journal:
        assert journal.finished == {"a": entry("a"), "b": entry("b")}


@pytest.mark.slow
def test_twenty_times_the_questions_take_no_more_memory(tmp_path, monkeypatch):
    """Of transcripts; what is known of each question besides is small."""
    monkeypatch.setattr(journals, "_GROUP", 10)
    step = {"step": 0, "kind": "model", "request": "x" * 50_000, "response": "", "seconds": 0.0}
    peaks = []
    # The first time modules are imported.
    for n in (1, 20, 400):
        path = Store(tmp_path / str(n)).run_path("r") / "journal.jsonl"
        tracemalloc.start()
        with opened(path) as journal:
            for number in range(n):
                name = f"{number:04}"
                journal.append(msgspec.structs.replace(entry(name), steps=[step | {"question_id": name}]))
        with opened(path) as journal:
            assert len(journals.world_rows("r", journal.finished)) == 0
            journals.write_tables(Store(tmp_path / str(n)), "r", journal.finished)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        groups = pq.ParquetFile(path.with_name("steps.parquet")).metadata
        assert (groups.num_rows, groups.num_row_groups) == (n, max(n // 10, 1))
    # Each further question may take a kilobyte. Its transcript has 50.
    assert peaks[2] - peaks[1] < 380 * 1_000


def test_a_line_that_the_disk_took_in_part_is_none(tmp_path):
    path = tmp_path / "journal.jsonl"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with opened(path) as journal:
        journal.append(entry("a"))
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 10, hard))
        try:
            with pytest.raises(StoreError, match="File too large; mend it, then run again with --resume"):
                journal.append(entry("b"))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        journal.append(entry("c"))
        assert journal.finished.keys() == {"a", "c"}
    with opened(path) as journal:
        assert journal.finished == {"a": entry("a"), "c": entry("c")}


@given(st.integers(0, 1000))
def test_a_journal_cut_anywhere_keeps_its_whole_lines(tmp_path_factory, cut):
    path = tmp_path_factory.mktemp("journal") / "journal.jsonl"
    with opened(path) as journal:
        for name in "abc":
            journal.append(entry(name))
    data = path.read_bytes()[:cut]
    path.write_bytes(data)
    with opened(path) as journal:
        assert len(journal.finished) == data.count(b"\n")
        journal.append(entry("z"))
    with opened(path) as journal:
        assert len(journal.finished) == data.count(b"\n") + 1


@pytest.mark.parametrize(
    "line",
    [
        b"garbage",
        b"[]",
        b"\xff\xfe",
        b'{"question_id": "a", "prediction": {}, "steps": []}',
        b'{"question_id": "a", "prediction": {"status": "answered"}, "steps": []}',
        msgspec.json.encode(entry("a", evidence_x="left")),
        msgspec.json.encode(entry("a", n_model_calls=1 << 40)),
        msgspec.json.encode(entry("a", raw=None)),
        msgspec.json.encode(journals.Finished("a", entry("a").prediction, [{"step": 1}])),
    ],
)
def test_a_journal_line_of_another_form_is_refused(tmp_path, line):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(msgspec.json.encode(entry("b")) + b"\n" + line + b"\n")
    with pytest.raises(StoreError, match="line 2, is damaged"):
        opened(path)


def test_one_process_runs_a_run(tmp_path):
    with opened(tmp_path / "journal.jsonl"), pytest.raises(LockedError):
        opened(tmp_path / "journal.jsonl")


# -- asking -----------------------------------------------------------------------------------------------------------

INFO = SequenceInfo(SEQUENCE, 15.0, 301, FRAMES)


class Scripted:
    """A method that does what it is told with the question's number."""

    name = "scripted"

    def __init__(self, behave):
        self.behave = behave

    def answer(self, task):
        return self.behave(task)


def no_look(sequence, frame_index, angle_deg):
    raise AssertionError("not asked for")


@pytest.mark.parametrize(
    "error",
    [
        ValueError("bad\nthing"),
        AvrError("no way"),
        FilteredError("refused"),
        RecursionError(),
        MemoryError(),
        SystemExit(0),
        GeneratorExit(),
    ],
)
def test_whatever_a_method_raises_is_an_error_row(error):
    def behave(task):
        task.record(Step("model", "{}", "{}", 0.1))
        raise error

    finished = answering.answer_one(Scripted(behave), QUESTIONS_ASKED[0], INFO, no_look, no_look)
    assert finished.failed != isinstance(error, FilteredError)
    assert finished.prediction["status"] == ("error" if finished.failed else "invalid")
    assert "\n" not in finished.prediction["reason"]
    assert finished.prediction["n_model_calls"] == 1
    assert len(finished.steps) == 1


NAN = float("nan")


@pytest.mark.parametrize(
    "behave",
    [
        lambda task: Prediction("answered", Choice(1), Evidence(0, Box(NAN, 0.0, 1.0, 1.0))),
        lambda task: Prediction("answered", Choice(1), Evidence(0, Box(0.0, 0.0, float("inf"), 1.0))),
        lambda task: Prediction("answered", Number(NAN)),
        lambda task: Prediction("answered", Choice("b")),
        lambda task: Prediction("right", Choice(1)),
        lambda task: task.record(Step("model", "{}", "{}", NAN)) or Prediction("answered", Choice(1)),
        lambda task: task.record(Step("model", b"{}", "{}", 0.1)) or Prediction("answered", Choice(1)),
        lambda task: task.record(Step("model", "{}", "{}", Decimal("0.1"))) or Prediction("answered", Choice(1)),
        lambda task: task.record(Step(np.int64(1), "{}", "{}", 0.1)) or Prediction("answered", Choice(1)),
        lambda task: Prediction("answered", Choice(1), Evidence(0, Box(*map(Decimal, (0, 0, 1, 1))))),
        lambda task: Prediction("answered", Choice(1), Evidence(0, Box(2**53 + 1, 0.0, 1.0, 1.0))),
        lambda task: (_ for _ in ()).throw(ValueError("\ud800")),
        lambda task: task.record("a step") or Prediction("answered", Choice(1)),
        lambda task: task.record_write(7) or Prediction("answered", Choice(1)),
        lambda task: Prediction("answered", Choice(1), Evidence(0.9, Box(0.0, 0.0, 1.0, 1.0))),
        lambda task: Prediction("answered", Choice(1), Evidence(0, Box(0.0, 0.0, True, 1.0))),
        lambda task: Prediction("answered", Choice(1), n_observations=1.5),
        lambda task: Prediction("answered", Choice(1), prompt_tokens=1.5),
        lambda task: task.record(Step("model", "{}", "{}", True)) or Prediction("answered", Choice(1)),
        lambda task: task.record(Step("\ud800", "{}", "{}", 0.1)) or Prediction("answered", Choice(1)),
        lambda task: Prediction("answered", Choice(1), verdict="sure"),
        lambda task: None,
        lambda task: "answered",
        lambda task: Prediction("answered", n_model_calls=1 << 40),
        lambda task: Prediction("answered", prompt_tokens=10**30),
    ],
)
def test_what_a_method_leaves_that_cannot_be_kept_is_an_error_row(tmp_path, behave):
    """A run of a method of somebody's own goes on, and its journal can be read again, to the same."""
    path = tmp_path / "journal.jsonl"
    asked = {False: QUESTIONS_ASKED[0], True: QUESTIONS_ASKED[1]}

    def answer(task):
        return behave(task) if task.question == asked[False] else Prediction("invalid", reason="sound")

    with opened(path) as journal:
        answering.answer_all(Scripted(answer), [*asked.values()], {SEQUENCE: INFO}, no_look, no_look, journal, 1)
        finished = dict(journal.finished)
    assert {sound: finished[question.question_id].prediction["status"] for sound, question in asked.items()} == {
        False: "error",
        True: "invalid",
    }
    with opened(path) as journal:
        assert journal.finished == finished


@pytest.mark.parametrize(
    ("bad", "rest", "stops"),
    [
        (Prediction("invalid", reason="the reply is empty", raw="<x>"), None, True),
        (Prediction("invalid", reason="answer must be a number"), None, False),
        (Prediction("invalid", reason="the reply is empty"), Prediction("answered", Choice(1)), False),
        (None, None, True),
    ],
)
def test_a_run_without_a_readable_reply_stops(tmp_path, bad, rest, stops):
    """The second question may have a readable reply. Without patience, no run stops."""
    asked = [dataclasses.replace(QUESTIONS_ASKED[0], question_id=f"{n:016x}") for n in range(6)]

    def answer(task):
        # No question is answered before the journal has those before it, as with a server.
        while len(journal.finished) < asked.index(task.question):
            time.sleep(0.001)
        return rest if rest is not None and task.question == asked[1] else bad

    for patience in (3, None):
        with opened(tmp_path / f"journal{patience}") as journal:
            arguments = [Scripted(answer), asked, {SEQUENCE: INFO}, no_look, no_look, journal, 1]
            if stops and patience:
                with pytest.raises(RunStoppedError, match=r"no question so far has a readable reply .*--keep-going"):
                    answering.answer_all(*arguments, patience=patience)
                assert 3 <= len(journal.finished) < 6
            else:
                answering.answer_all(*arguments, patience=patience)
                assert len(journal.finished) == 6


def test_a_run_that_ends_early_leaves_no_question_at_work(tmp_path, monkeypatch):
    """What is in flight ends at its next look or step, and nothing new is begun."""
    # However slow the machine, all threads end, because none waits for a server.
    monkeypatch.setattr(answering, "_STOP_S", 60.0)
    ended, begun = [], threading.Semaphore(0)

    def behave(task):
        begun.release()
        try:
            while True:
                task.record(Step("model", "", "", 0.0))
                time.sleep(0.01)
        finally:
            ended.append(task.question.question_id)

    def once(task):
        return behave(task) if task.question != QUESTIONS_ASKED[0] else Prediction("invalid")

    def fail(steps):
        if steps:
            assert all(begun.acquire(timeout=60) for _ in range(3))
            raise KeyboardInterrupt

    with opened(tmp_path / "journal.jsonl") as journal, pytest.raises(KeyboardInterrupt):
        answering.answer_all(Scripted(once), QUESTIONS_ASKED, {SEQUENCE: INFO}, no_look, no_look, journal, 4, fail)
    assert 3 <= len(ended) <= 4


def test_what_utf8_cannot_hold_is_written_out(tmp_path):
    def behave(task):
        task.record(Step("model", "\ud800", "\udfff", 0.0))
        return Prediction("invalid", raw="\ud800", reason="\ud800")

    finished = answering.answer_one(Scripted(behave), QUESTIONS_ASKED[0], INFO, no_look, no_look)
    store = Store(tmp_path)
    journals.write_tables(store, "r", InMemory(finished))
    assert predictions(store, "r")["raw"].to_pylist() == ["\\ud800"]


def test_many_questions_in_flight(tmp_path):
    all_of_them = threading.Barrier(64)

    def behave(task):
        all_of_them.wait(timeout=60)
        return Prediction("answered", Choice(1), Evidence(0, (0.0, 0.0, 1.0, 1.0)))

    asked = [question(0, 15 * i) for i in range(3, 67)]
    with opened(tmp_path / "journal.jsonl") as journal:
        answering.answer_all(Scripted(behave), asked, {SEQUENCE: INFO}, no_look, no_look, journal, 64)
    assert [row.prediction["status"] for row in journal.finished.values()] == ["answered"] * 64


def test_threads_are_left_as_they_were():
    def state():
        return sys.getswitchinterval(), cv2.getNumThreads()

    cv2.setNumThreads(2)
    before = state()
    with pytest.raises(KeyboardInterrupt), answering.for_many_threads():
        assert state() == (pytest.approx(0.05), 1)
        raise KeyboardInterrupt
    assert state() == before == (pytest.approx(0.005), 2)
