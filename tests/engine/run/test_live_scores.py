"""Scores of a run at work: what comes back from the process that reads the answers, and that nothing else does."""

import dataclasses
import json
import os
import queue
import re
import subprocess
import threading

import msgspec
import pytest
from click.testing import CliRunner
from fake_server import FakeServer, images, sound, texts
from painted import FRAMES, QUESTIONS_ASKED, SEQUENCE, Reader, asked_frame, shown_at, write_answers
from scored_runs import opened, segment_of

from jrdb_avr.engine import console
from jrdb_avr.engine.commands import evaluate
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.run import answering
from jrdb_avr.engine.run import journal as journals
from jrdb_avr.engine.run.live_scores import LiveScore, report_scores
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.schema.method import SequenceInfo


@pytest.fixture
def judged(store):
    """A store with answers, and the run `r`, finished."""
    write_answers(store)
    info = SequenceInfo(SEQUENCE, 15.0, 301, FRAMES)
    ids = tuple(q.question_id for q in QUESTIONS_ASKED)
    write_run_manifest(store, RunManifest("r", "reader", "m", questions_hash(store), ids, True, {}, "2026-01-01"))
    with opened(segment_of(store.run_path("r"), SEQUENCE)) as journal:
        answering.answer_all(Reader(), QUESTIONS_ASKED, {SEQUENCE: info}, None, None, journal, 4)
        journals.write_tables(store, "r", journal.finished)
    return store


def final(store, run_id="r"):
    scores = report(store, [run_id]).scores.to_pydict()
    return LiveScore(len(scores["invalid"]), *(sum(scores[f"{n}_score"]) for n in ("answer", "evidence", "combined")))


def reported(store, entries, more=()):
    """What is reported of a run with these entries, and of more that finish."""
    scores = queue.SimpleQueue()
    with report_scores(store, entries, scores.put) as append:
        found = [scores.get(timeout=120)]
        for entry in more:
            append(entry)
            found.append(scores.get(timeout=120))
    assert scores.empty()
    return found


def test_a_run_stands_in_the_end_where_score_sees_it(judged):
    with opened(segment_of(judged.run_path("r"), SEQUENCE)) as journal:
        entries = [*journal.finished.values()]
    assert final(judged) == LiveScore(12, 6, 12, 6)
    assert str(final(judged)) == "answer 50.0 %, evidence 100.0 %, combined 50.0 % of 12"
    failed = msgspec.structs.replace(
        entries[0], prediction=entries[0].prediction | {"status": "error", "answer": None, "evidence_frame": None}
    )
    # An error scores nothing, and the last entry of a question counts.
    before = judges()
    seen = reported(judged, entries[1:], [failed, entries[0]])
    assert [score.judged for score in seen] == [11, 12, 12]
    assert seen[1] == dataclasses.replace(seen[0], judged=12)
    assert seen[2] == final(judged)
    # Other tests of this process may have one of their own.
    assert judges() <= before


def judges():
    """The process ids of the judges that this process has started and that run."""
    listed = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(os.getpid())], capture_output=True, text=True)
    return {line.split()[0] for line in listed.stdout.splitlines() if "engine.run.judge" in line}


def test_without_answers_nothing_is_said(store):
    with report_scores(store, [], lambda score: pytest.fail("a score")) as append:
        append(answering.answer_one(Reader(), QUESTIONS_ASKED[0], None, None, None))
        for thread in threading.enumerate():
            if thread.name == "live scores":
                thread.join(120)


def test_a_run_tells_its_scores_when_asked(store, monkeypatch, tmp_path):
    """Without a terminal only if asked, and the model is told nothing of them. The cost so far stands beside them."""
    write_answers(store)
    first, second = QUESTIONS_ASKED[1], QUESTIONS_ASKED[3]
    noted, scored = [], threading.Event()

    def note(text):
        noted.append(text)
        # An earlier line may have the score of the first question while its progress is still due.
        spent = r"[0-9]+ tokens, [0-9.]+ dollars, 0 retries; answer 100.0 %, evidence 0.0 %, combined 0.0 % of 1$"
        if re.match(rf"react, m: 1 of 2, [-0-9:]+ left; {spent}", str(text)):
            scored.set()

    monkeypatch.setattr(console, "note", note)
    monkeypatch.setattr(console, "_LOG_EVERY_S", 0.02)

    def script(request, n):
        if second.question in texts(request):
            # The second question is not answered before the score of the first is printed.
            assert scored.wait(120)
        if not images(request):
            return json.dumps({"action": "observe", "frame_id": f"{asked_frame(first):06d}", "angle_deg": 350})
        box = [{"frame_id": f"{asked_frame(first):06d}", "bbox": [1, 2, 3, 4]}]
        return json.dumps({"action": "answer", "answer": shown_at(asked_frame(first)), "evidence_bboxes": box})

    (tmp_path / "prices.toml").write_text("[m]\ninput = 1000000\noutput = 0\n")
    base = ["--store", str(store.path), "--method", "react", "--model", "m", "--prices", str(tmp_path / "prices.toml")]
    base += ["--concurrency", "2", "--questions"]
    for picked, options in (
        ([first], ("--run-id", "a")),
        ([first, second], ("--run-id", "b", "--scores")),
    ):
        ids = ",".join(question.question_id for question in picked)
        with FakeServer(sound(script)) as server:
            result = CliRunner().invoke(evaluate.command, [*base, ids, "--base-url", server.url, *options])
            assert result.exception is None, result.output
            assert not any("combined" in texts(request) for request in server.requests)
        assert any("combined" in str(text) for text in noted) == scored.is_set() == ("--scores" in options)
