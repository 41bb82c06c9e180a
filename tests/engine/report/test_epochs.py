"""Runs that answer the same questions again: pass@k and the majority, against a count over all choices of epochs."""

import itertools
from fractions import Fraction

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scored_runs import BOX, ELSEWHERE, Benchmark

from jrdb_avr.engine.report.epochs import epoch_rows

NAMES = [f"q{number}" for number in range(4)]
GIVEN = st.tuples(st.sampled_from([None, 1, 2, 3]), st.sampled_from([BOX, ELSEWHERE, None]), st.just(7))


def epochs_of(played, name="r", order=None):
    """The runs of a list of epochs, each the answers to `NAMES`."""
    benchmark = Benchmark([(question, "s", "long_range") for question in NAMES])
    runs = []
    for number, answers in enumerate(played, 1):
        run = benchmark.run(answers, f"{name}-{number}")
        run.manifest = msgspec.structs.replace(run.manifest, settings={"epoch": number})
        runs.append(run)
    return [runs[place] for place in order] if order else runs


def share(counts):
    return round(float(100 * Fraction(sum(counts), 1) / len(counts)), 2)


@given(st.lists(st.lists(GIVEN, min_size=4, max_size=4), min_size=2, max_size=5), st.randoms(use_true_random=False))
def test_pass_at_k_and_the_majority(played, rng):
    order = list(range(len(played)))
    rng.shuffle(order)
    rows = epoch_rows(epochs_of(played, order=order))
    assert [row["k"] for row in rows] == list(range(1, len(played) + 1))
    for row in rows:
        k = row["k"]
        answered = [[epoch[q][0] == 1 for epoch in played] for q in range(4)]
        boxed = [[epoch[q][1] == BOX for epoch in played] for q in range(4)]
        both = [[a and b for a, b in zip(*pair, strict=True)] for pair in zip(answered, boxed, strict=True)]
        for name, right in (("answer", answered), ("evidence", boxed), ("combined", both)):
            shares = []
            for own in right:
                chosen = [any(choice) for choice in itertools.combinations(own, k)]
                shares.append(Fraction(sum(chosen), len(chosen)))
            assert row[name] == pytest.approx(share(shares), abs=0.006)
        voted = []
        for q in range(4):
            votes = [epoch[q][0] for epoch in played[:k] if epoch[q][0] is not None]
            voted.append(bool(votes) and max(votes, key=lambda one: (votes.count(one), -votes.index(one))) == 1)
        assert row["majority"] == pytest.approx(share(voted), abs=0.006)


def test_runs_are_epochs_by_their_setting_and_their_name():
    right, wrong = (1, BOX, 7), (2, BOX, 7)
    many = epochs_of([[right] * 4, [wrong] * 4])
    others = epochs_of([[right] * 4, [wrong] * 4], "other")
    single = Benchmark([(question, "s", "long_range") for question in NAMES]).run([right] * 4, "r-3")
    rows = epoch_rows([*others, *many, single])
    assert [(row["run"], row["k"], row["answer"]) for row in rows] == [
        ("other", 1, 50.0),
        ("other", 2, 100.0),
        ("r", 1, 50.0),
        ("r", 2, 100.0),
    ]
    assert [row["majority"] for row in rows[2:]] == [100.0, 100.0], "of two answers the first one"
    assert epoch_rows([many[0], single]) == []
    odd = many[0]
    odd.manifest = msgspec.structs.replace(odd.manifest, settings={"epoch": ["1"]})
    assert epoch_rows([odd, many[1]]) == []


def test_epochs_are_compared_on_the_questions_that_all_have():
    benchmark = Benchmark([(question, "s", "long_range") for question in NAMES])
    runs = epochs_of([[(1, BOX, 7)] * 4, [(1, BOX, 7)] * 4])
    few = Benchmark([(question, "s", "long_range") for question in NAMES[2:]]).run([(2, BOX, 7), (1, BOX, 7)], "r-2")
    runs[1].rows, runs[1].scores, runs[1].answers = few.rows + 2, few.scores, few.answers
    rows = epoch_rows(runs)
    assert benchmark.ids == NAMES
    assert [(row["n"], row["answer"]) for row in rows] == [(2, 75.0), (2, 100.0)]
