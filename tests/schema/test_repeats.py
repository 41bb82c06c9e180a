"""The correlation of a reader's errors, and the weight of a second reading."""

import random

import pytest

from jrdb_avr.schema.repeats import USUAL_REPEATS, ErrorCorrelation, correlate_errors

TOPICS = {"gender": 0.1, "pose": 0.5, "age": 0.3}


def read_twice(rng, people, correlation):
    """Two readings of each person: the second repeats the first one with a chance, else it is drawn anew."""
    first = [{topic: rng.random() < rate for topic, rate in TOPICS.items()} for _ in range(people)]
    second = [
        {topic: wrong if rng.random() < correlation else rng.random() < TOPICS[topic] for topic, wrong in one.items()}
        for one in first
    ]
    return first, second


@pytest.mark.parametrize("correlation", [0.0, 0.4, 0.8])
def test_a_known_correlation_is_recovered_within_its_standard_error(correlation):
    rng = random.Random(4)
    estimates = [correlate_errors(*read_twice(rng, 50, correlation)) for _ in range(100)]
    off = [abs(one.correlation - correlation) / one.standard_error for one in estimates]
    # A normal estimate is within one standard error in 68 %, and within three in 99.7 %.
    assert 0.55 < sum(deviation < 1 for deviation in off) / len(off) < 0.8
    assert sum(deviation < 3 for deviation in off) >= 96
    assert abs(sum(one.correlation for one in estimates) / len(estimates) - correlation) < 0.03


@pytest.mark.parametrize(("correlation", "weight"), [(0.0, 1.0), (1.0, 0.0), (0.6, 0.25), (-0.5, 1.0), (-1.0, 1.0)])
def test_the_second_reading_counts_what_it_adds_to_the_first(correlation, weight):
    assert ErrorCorrelation(correlation=correlation).weight(0.05) == pytest.approx(weight)


def test_without_enough_errors_the_usual_weight_stays():
    read = [{"pose": True}] * 4 + [{"pose": False}] * 30
    found = correlate_errors([*read, {}, {"age": True}], [*read, {"pose": True}, {"pose": True}])
    assert found == ErrorCorrelation(people=34, pairs=34, errors=8)
    assert found.weight(USUAL_REPEATS.frame) == 0.05 and found.words.startswith("not measured")
    assert correlate_errors([], []) == ErrorCorrelation()
    assert correlate_errors([{"pose": True}] * 9, [{"pose": True}] * 9).correlation is None


def test_topics_of_different_difficulty_are_no_correlation():
    rng = random.Random(1)
    rates = {"easy": 0.02, "hard": 0.98}
    readings = [{topic: rng.random() < rate for topic, rate in rates.items()} for _ in range(800)]
    assert abs(correlate_errors(readings[::2], readings[1::2]).correlation) < 0.15
