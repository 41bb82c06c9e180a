"""Intervals and comparisons against scipy and statsmodels, and against counting by hand.

Their import takes seconds, so that only the worker that runs a test pays for it.
"""

import numpy as np
import pytest

from jrdb_avr.engine.report.bootstrap import Interval, compare, draws, intervals, mcnemar, mean_ratio, numbered_sums
from jrdb_avr.engine.report.paper import ABLATION, GROUPS, MAIN
from jrdb_avr.schema.templates import FAMILIES


def interval(sums, statistic):
    return intervals(sums, [statistic])[0]


@pytest.mark.parametrize(("first", "second"), [(0, 0), (3, 9), (12, 12), (40, 7), (0, 5)])
def test_mcnemar_as_statsmodels_has_it(first, second):
    from statsmodels.stats import contingency_tables

    table = [[50, first], [second, 30]]
    assert mcnemar(first, second) == pytest.approx(contingency_tables.mcnemar(table, exact=True).pvalue)


def test_mcnemar_of_a_whole_benchmark_is_no_overflow():
    assert 0 < mcnemar(1000, 1098) < 0.05
    assert mcnemar(0, 2098) == pytest.approx(2.0**-2097)


def test_one_question_per_cluster_is_the_plain_bootstrap():
    from scipy import stats

    scores = np.random.default_rng(5).integers(0, 2, 120).astype(float)
    sums = numbered_sums(np.arange(120), 120, np.stack([scores, np.ones(120)], axis=1))
    ours = interval(sums, mean_ratio((0, 1)))
    theirs = stats.bootstrap(
        (scores,), np.mean, method="percentile", n_resamples=10_000, rng=np.random.default_rng(1)
    ).confidence_interval
    assert ours.value == pytest.approx(scores.mean())
    assert ours.low == pytest.approx(theirs.low, abs=0.012)
    assert ours.high == pytest.approx(theirs.high, abs=0.012)


def test_a_paired_difference_is_the_paired_bootstrap():
    from scipy import stats

    generator = np.random.default_rng(7)
    first = generator.integers(0, 2, 150)
    second = np.where(generator.random(150) < 0.7, first, 1 - first)
    ours = compare(np.arange(150), [first[:, None], second[:, None]], [(0, 1)])[0][0][-1]
    theirs = stats.bootstrap(
        (first, second),
        lambda a, b, axis: b.mean(axis=axis) - a.mean(axis=axis),
        paired=True,
        vectorized=True,
        method="percentile",
        n_resamples=10_000,
        rng=np.random.default_rng(1),
    ).confidence_interval
    assert ours.value == pytest.approx(second.mean() - first.mean())
    assert (ours.low, ours.high) == (pytest.approx(theirs.low, abs=0.012), pytest.approx(theirs.high, abs=0.012))


def test_questions_of_one_sequence_are_drawn_together():
    """Forty questions that are all alike within a sequence say no more than its four sequences do."""
    scores, numbers = np.repeat([0, 1, 1, 1], 10), np.repeat([2, 1, 3, 0], 10)
    sums = numbered_sums(numbers, 4, np.stack([scores, np.ones(40)], axis=1))
    assert sums.tolist() == [[10, 10], [10, 10], [0, 10], [10, 10]]
    found = interval(sums, mean_ratio((0, 1)))
    # By hand: in 4 of 4^4 draws of sequences no 1 is drawn ... the 2.5 % quantile is one 1 in four.
    assert (found.value, found.low, found.high) == (0.75, 0.25, 1.0)
    # The difference of two runs, the first of which scores nothing, is the second's share.
    runs = [np.zeros((40, 1), np.int8), scores[:, None]]
    difference = compare(np.repeat([5, 2, 9, 0], 10), runs, [(0, 1)])[0][0][-1]
    assert (difference.value, difference.low, difference.high) == (0.75, 0.25, 1.0)


def test_a_draw_is_seeded_and_of_as_many_clusters():
    assert (draws(27) == draws(27)).all()
    assert (draws(27, seed=1) != draws(27)).any()
    assert (draws(27, 50).sum(axis=1) == 27).all()


def test_what_nothing_was_asked_of_is_not_a_number():
    nothing = Interval(None, None, None)
    assert interval(np.zeros((0, 2)), mean_ratio((0, 1))) == nothing
    assert interval(np.zeros((3, 2)), mean_ratio((0, 1))) == nothing
    assert interval(np.array([[1.0, 4.0]]), mean_ratio((0, 1))) == Interval(0.25, None, None)


def test_a_macro_average_is_over_the_groups_that_were_asked():
    totals = np.array([[1.0, 2.0, 3.0, 4.0, 0.0, 0.0]])
    assert mean_ratio((0, 1), (2, 3), (4, 5))(totals).tolist() == [(0.5 + 0.75) / 2]


def test_the_papers_figures_fit_together():
    """Its groups add up to its totals; rounded shares of the totals are those of its ablation and main table."""
    total = {name: sum(getattr(counts, name) for counts in GROUPS.values()) for name in ("n", "answer", "combined")}
    assert total == {"n": 2098, "answer": 808, "combined": 305}
    assert sum(counts.evidence for counts in GROUPS.values()) == 577
    agent = ABLATION["agent"]
    assert (round(80800 / 2098, 2), round(57700 / 2098, 2), round(30500 / 2098, 2)) == (
        agent.answer,
        agent.evidence,
        agent.combined,
    )
    assert sum(100 * c.combined / c.n for c in GROUPS.values()) / 5 == pytest.approx(9.21, abs=0.005)
    for row in (*MAIN, *ABLATION.values()):
        # Of rounded figures, where the combined one is large enough to tell.
        if row.combined > 2:
            assert row.hallucination == pytest.approx(100 * (1 - row.combined / row.answer), abs=0.05)
    assert len(MAIN) == 25


def test_the_papers_groups_hold_every_family_once():
    assert sorted(family for group in GROUPS.values() for family in group.families) == sorted(set(FAMILIES.values()))
