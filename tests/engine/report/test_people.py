"""How far people agree, counted by hand."""

from scored_runs import BOX, ELSEWHERE, Benchmark

from jrdb_avr.engine.report.people import HUMAN, agreement_rows
from jrdb_avr.schema.tables import QUESTIONS


def test_people_agree_where_their_answers_are_the_same():
    benchmark = Benchmark([(f"q{number}", "s", "long_range") for number in range(4)])
    right, wrong, other, nothing = (1, BOX, 7), (2, ELSEWHERE, 7), (3, BOX, 7), (None, None, 0)
    runs = [
        benchmark.run([right, wrong, wrong, nothing], "human-b", HUMAN),
        benchmark.run([right, wrong, other, nothing], "human-a", HUMAN),
        benchmark.run([right] * 4, "react", "react"),
    ]
    # No answer agrees with nothing; q2's answers differ, both are wrong, and one has the box.
    expected = {"n": 4, "same_answer": 50.0, "answer": 100.0, "evidence": 75.0, "combined": 100.0}
    assert agreement_rows(benchmark.index, runs) == [{"first": "human-a", "second": "human-b"} | expected]
    assert agreement_rows(benchmark.index, runs[1:]) == []
    runs[0].rows, runs[0].scores, runs[0].answers = runs[0].rows[2:], runs[0].scores[2:], runs[0].answers[2:]
    (row,) = agreement_rows(benchmark.index, runs)
    assert (row["n"], row["same_answer"], row["evidence"]) == (2, 0.0, 50.0), "of the questions that both have"


def test_numbers_and_frames_agree_within_the_tolerance_that_scores():
    benchmark = Benchmark([(f"q{number}", "s", "long_range") for number in range(4)])
    modes = ["frame", "frame", "number", "number"]
    questions = benchmark.tables["questions"]
    place = QUESTIONS["questions"].names.index("answer_mode")
    index = type(benchmark.index)(questions.set_column(place, "answer_mode", [modes]), benchmark.tables["answers"])
    runs = [benchmark.run([(1, BOX, 7)] * 4, f"human-{name}", HUMAN) for name in "ab"]
    runs[0].answers = ['{"frame":100}', '{"frame":100}', '{"value":2.0}', '{"value":2.0}']
    runs[1].answers = ['{"frame":115}', '{"frame":116}', '{"value":4.0}', '{"value":4.1}']
    assert agreement_rows(index, runs)[0]["same_answer"] == 50.0
