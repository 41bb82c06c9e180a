"""The judge scores one prediction at a time, as `score` does, and says nothing else of the answers."""

import subprocess
import sys
import threading
from dataclasses import replace

import msgspec
import pytest
from painted import BLIND, QUESTIONS_ASKED, Reader, write_answers

from jrdb_avr.engine.run.answering import answer_one
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.journal import finished_entry
from jrdb_avr.engine.run.judge import Judge, QuestionScore
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.method import Prediction


@pytest.fixture
def judged(store):
    write_answers(store)
    return store


def read(question):
    return answer_one(Reader(), question, None, None, None)


@pytest.mark.slow
def test_predictions_are_scored_from_many_threads_at_once(judged):
    """Of the reader every second answer is right, and every box."""
    found = {}
    with Judge.open(judged) as judge:

        def score(i, question):
            found[i] = judge.score_row(read(question).prediction)

        threads = [threading.Thread(target=score, args=pair) for pair in enumerate(QUESTIONS_ASKED)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(120)
        question = QUESTIONS_ASKED[0]
        assert judge.score(question, Prediction("invalid")) == QuestionScore(0, 0, 0, True)
        assert judge.score(question, Prediction("error")) == QuestionScore(0, 0, 0, False)
        with pytest.raises(InputError, match="has no answer of question"):
            judge.score(BLIND, Prediction("answered", Choice(1)))
        # After a question that it does not know it goes on.
        assert judge.score_row(read(QUESTIONS_ASKED[1]).prediction).combined == 1
    assert found == {i: QuestionScore(i % 2, 1, i % 2, False) for i in range(len(QUESTIONS_ASKED))}
    with pytest.raises(StoreError, match="has ended"):
        judge.score(question, Prediction("answered"))


def test_a_folder_without_answers_has_no_judge(store):
    with pytest.raises(StoreError, match="answers"):
        Judge.open(store)


def test_four_digits_come_back_and_its_end_is_its_parents(judged):
    command = [sys.executable, "-m", "jrdb_avr.engine.run.judge", str(judged.path)]
    line = finished_entry(QUESTIONS_ASKED[1], Prediction("answered"), (), (), 0.0)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        out, _ = process.communicate(msgspec.json.encode(line.prediction).decode() + "\n", timeout=120)
    assert (process.returncode, out) == (0, "ready\n0000\n")


def test_a_bench_reads_the_public_files_alone(judged):
    for path in (judged.question_path("answers"), judged.question_path("evidence")):
        path.write_bytes(b"nothing to read")
    bench = Bench.open(judged)
    assert [question.question_id for question in bench.questions] == [q.question_id for q in QUESTIONS_ASKED]
    episode = bench.episode(QUESTIONS_ASKED[0].question_id, budget=1)
    assert episode.observe(15, 180.0).image.shape == (480, 480, 3)
    with pytest.raises(InputError, match="no question"):
        bench.episode("nope")


def test_a_question_of_an_unknown_sequence_is_refused_in_a_line(judged):
    stray = replace(QUESTIONS_ASKED[0], sequence="nowhere")
    with pytest.raises(StoreError, match=r"'nowhere', which sequences.parquet lacks: generate again"):
        Bench(judged, [stray], None, opaque=False)


def test_an_opaque_bench_never_says_the_name_of_a_sequence(judged):
    ids = [QUESTIONS_ASKED[0].question_id]
    bench = Bench.open(judged, questions=ids, opaque=True)
    steps = []
    (question,) = bench.questions
    assert question.question_id not in ids
    with Judge.open(judged) as judge:
        assert judge.score(question, Prediction("answered")) == (0, 0, 0, False)
    episode = bench.episode(question.question_id, record=steps.append)
    seen = episode.observe(15, 180.0)
    said = f"{bench.questions} {bench.sequences} {episode.prompt} {seen} {steps}"
    assert "painted" not in said and "sequence-" in said
