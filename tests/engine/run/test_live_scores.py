"""Scores of a run at work: what comes back from the process that reads the answers, and that nothing else does."""

import itertools
import json
import os
import queue
import subprocess
import sys
import threading

import pyarrow as pa
import pytest
import warm
from asked_world import FRAMES, POSES, QUESTIONS_ASKED
from click.testing import CliRunner
from fake_server import FakeServer, images, sound, texts
from painted_world import SEQUENCE

from jrdb_avr.engine.commands import evaluate
from jrdb_avr.engine.report.scoring import read_truth, score_run
from jrdb_avr.engine.run import answering
from jrdb_avr.engine.run import journal as journals
from jrdb_avr.engine.run.live_scores import LiveScore, live_scores, report_scores
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.schema.answers import Choice, Evidence
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.method import Prediction, SequenceInfo
from jrdb_avr.schema.tables import QUESTIONS

PROGRAM = [sys.executable, "-m", "jrdb_avr.engine.run.live_scores"]


def asked_frame(question):
    return int(question.question.rpartition("(frame ")[2].partition(")")[0])


def shown_at(frame):
    return POSES.index("sitting" if frame < 120 else "lying") + 1


def box_at(frame):
    return (3650 + frame * 0.5, 120.0, 70.0, 220.0)


def write_answers(store):
    """Answers under which every second question's mark is right, and evidence where the person stands."""
    answers, evidence = [], []
    for i, q in enumerate(QUESTIONS_ASKED):
        frame = asked_frame(q)
        answer = json.dumps({"choice": shown_at(frame) if i % 2 else shown_at(frame) % 4 + 1})
        texts = dict.fromkeys(("plan", "distractors", "rules", "bindings", "needed", "proofs"), "{}")
        numbers = {"target_track": 1, "hops": 1, "time_gap_s": 1.0, "separation_deg": 1.0, "people_in_scene": 2}
        answers.append({"question_id": q.question_id, "answer": answer, **texts, **numbers})
        box = dict(zip("xywh", box_at(frame), strict=True))
        evidence.append({"question_id": q.question_id, "frame": frame, **box})
    for name, rows in (("answers", answers), ("evidence", evidence)):
        store.write_questions(name, pa.Table.from_pylist(rows, QUESTIONS[name]), {})
    rows = store.questions("questions").filter(pa.compute.field("sequence") != "unseen")
    store.write_questions("questions", rows, {})


class Reader:
    """A method that reads the questions' marks without looking."""

    name = "reader"

    def answer(self, task):
        t1 = asked_frame(task.question)
        return Prediction("answered", Choice(shown_at(t1)), Evidence(t1, box_at(t1)))


@pytest.fixture
def judged(store):
    """A store with answers, and the run `r`, finished."""
    write_answers(store)
    info = SequenceInfo(SEQUENCE, 15.0, 301, FRAMES)
    ids = tuple(q.question_id for q in QUESTIONS_ASKED)
    write_run_manifest(store, RunManifest("r", "reader", "m", questions_hash(store), ids, True, {}, "2026-01-01"))
    with journals.Journal(store.run_path("r") / "journal.jsonl") as journal:
        answering.answer_all(Reader(), QUESTIONS_ASKED, {SEQUENCE: info}, None, None, journal, 4)
        journals.write_tables(store, "r", journal.finished.values())
    return store


def final(store, run_id="r"):
    scores = score_run(store, read_truth(store), run_id)[2].to_pydict()
    return LiveScore(len(scores["invalid"]), *(sum(scores[f"{n}_score"]) for n in ("answer", "evidence", "combined")))


def test_a_run_stands_in_the_end_where_score_sees_it(judged):
    assert final(judged) == LiveScore(12, 6, 12, 6)
    assert list(live_scores(judged, "r", lambda: False)) == [final(judged)]
    assert str(final(judged)) == "answer 50.0 %, evidence 100.0 %, combined 50.0 % of 12"


def test_lines_count_as_they_come_and_the_last_of_a_question_counts(judged):
    """Also cut anywhere, as a reader sees a line that is being written."""
    path = judged.run_path("r") / "journal.jsonl"
    data = path.read_bytes()
    first = data.splitlines(keepends=True)[0]
    failed = json.loads(first)
    failed["prediction"] |= {"status": "error", "answer": None, "evidence_frame": None}
    data = json.dumps(failed).encode() + b"\n" + data
    cuts = [0, 100, data.index(b"\n") + 1, len(data) // 2, len(data) - 1, len(data)]
    path.write_bytes(b"")
    turn = itertools.pairwise(cuts)

    def go_on():
        start, end = next(turn, (0, 0))
        with path.open("ab") as file:
            file.write(data[start:end])
        return end > 0

    seen = list(live_scores(judged, "r", go_on))
    lines = [data[:cut].count(b"\n") for cut in cuts[1:]]
    assert [s.judged for s in seen] == [n if n < 2 else n - 1 for n in (*lines, lines[-1])]
    assert seen[1] == LiveScore(1, 0, 0, 0)
    assert seen[-1] == final(judged)


def test_four_numbers_come_back_and_the_process_goes(judged):
    reported = queue.SimpleQueue()
    with report_scores(judged, "r", reported.put):
        assert reported.get(timeout=120) == final(judged)
    assert reported.empty()
    children = subprocess.run(["ps", "-o", "args=", "--ppid", str(os.getpid())], capture_output=True, text=True)
    assert "running" not in children.stdout


def test_what_the_process_prints_is_numbers_alone_and_its_end_is_its_parents(judged):
    """It ends when its input closes, as it does when the parent is killed."""
    with subprocess.Popen(
        [*PROGRAM, str(judged.path), "r"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "12 6 12 6\n"
        process.stdin.close()
        assert process.wait(10) == 0
        assert process.stdout.read() == ""


@pytest.mark.parametrize("lost", ["answers.parquet", "evidence.parquet", "run.json"])
def test_without_answers_nothing_is_said(judged, lost):
    folder = judged.run_path("r") if lost == "run.json" else judged.path / "questions"
    (folder / lost).unlink()
    with pytest.raises(StoreError):
        next(live_scores(judged, "r", lambda: False))


def test_without_answers_the_process_ends_in_silence(store):
    program = "from jrdb_avr.engine.run.live_scores import print_scores; print_scores()"
    done = warm.run(warm.script, program, store.path, "r")
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_a_run_tells_its_scores_when_asked(store, monkeypatch):
    """Without a terminal only if asked, and the model is told nothing of them."""
    write_answers(store)
    first, second = QUESTIONS_ASKED[1], QUESTIONS_ASKED[3]
    noted, scored = [], threading.Event()

    def note(text):
        noted.append(text)
        if text == "so far: answer 100.0 %, evidence 0.0 %, combined 0.0 % of 1":
            scored.set()

    monkeypatch.setattr(evaluate, "note", note)
    monkeypatch.setattr(evaluate, "LOG_EVERY_S", 0.0)

    def script(request, n):
        if second.question in texts(request):
            # The second question is not answered before the score of the first is printed.
            assert scored.wait(120)
        if not images(request):
            return json.dumps({"action": "observe", "frame_id": f"{asked_frame(first):06d}", "angle_deg": 350})
        box = [{"frame_id": f"{asked_frame(first):06d}", "bbox": [1, 2, 3, 4]}]
        return json.dumps({"action": "answer", "answer": shown_at(asked_frame(first)), "evidence_bboxes": box})

    base = ["--store", str(store.path), "--method", "react", "--model", "m", "--concurrency", "2", "--questions"]
    for picked, options in (
        ([first], ("--run-id", "a")),
        ([first, second], ("--run-id", "b", "--scores")),
    ):
        ids = ",".join(question.question_id for question in picked)
        with FakeServer(sound(script)) as server:
            result = CliRunner().invoke(evaluate.command, [*base, ids, "--base-url", server.url, *options])
            assert result.exception is None, result.output
            assert not any("combined" in texts(request) for request in server.requests)
        assert any(text.startswith("so far: ") for text in noted) == scored.is_set() == ("--scores" in options)
