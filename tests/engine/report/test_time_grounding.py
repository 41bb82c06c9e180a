"""Time-grounded accuracy on pairs made by hand."""

import pytest

from jrdb_avr.engine.report.time_grounding import TwinScore, time_grounded_row


def pair(number, answers, combined, template="change"):
    return [
        TwinScore(f"t{number}", template, f"s{number % 3}", answer, both)
        for answer, both in zip(answers, combined, strict=True)
    ]


def test_a_pair_counts_only_if_both_answers_are_right():
    scores = [*pair(0, (1, 1), (1, 0)), *pair(1, (1, 1), (1, 1)), *pair(2, (1, 0), (1, 0)), *pair(3, (0, 0), (0, 0))]
    row = time_grounded_row(scores)
    assert (row["n"], row["sequences"]) == (4, 3)
    assert (row["both_answers"].value, row["both_combined"].value) == (0.5, 0.25)
    assert row["single"] == 5 / 8
    assert row["both_answers"].low <= 0.5 <= row["both_answers"].high
    assert time_grounded_row(scores[::-1]) == row


def test_a_reader_that_ignores_the_time_gets_no_pair():
    row = time_grounded_row([one for number in range(9) for one in pair(number, (1, 0), (1, 0))])
    assert (row["single"], row["both_answers"].value, row["both_combined"].value) == (0.5, 0, 0)


def test_chance_depends_on_the_template_and_a_lonely_twin_is_ignored():
    row = time_grounded_row(
        [*pair(0, (1, 1), (1, 1)), *pair(1, (1, 1), (1, 1), "presence"), *pair(2, (1, 1), (1, 1))[:1]]
    )
    assert row["n"] == 2
    assert row["chance"] == pytest.approx(1 / 16)
    assert row["chance_twins"] == pytest.approx((1 / 12 + 1 / 4) / 2)
    assert time_grounded_row([]) is None
