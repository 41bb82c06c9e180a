"""Weights of repeated readings: the information in a second reading of the same person."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Annotated, Final

import msgspec
from msgspec import Meta

Weight = Annotated[float, Meta(ge=0.0, le=1.0)]


class Repeats(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Weights of repeated readings, 0 to 1. A first reading has 1. Later ones repeat the errors of a model.

    Attributes:
        frame: Weight of a further reading in the same frame.
        person: Weight of the readings of a frame other than the nearest one.
    """

    frame: Weight = 0.05
    person: Weight = 0.25


USUAL_REPEATS: Final = Repeats()
"""Weights if no calibration of the model is known."""

LEAST_PEOPLE: Final = 5
"""Minimum number of people with an error. With fewer people, a correlation of errors is not estimated."""


class ErrorCorrelation(msgspec.Struct, frozen=True):
    """Correlation of the errors in two readings of one label.

    Attributes:
        people: Number of people with two readings of a label.
        pairs: Number of labels with two readings.
        errors: Number of wrong readings.
        correlation: Correlation of the errors. None if too few people have an error.
        standard_error: Standard error of the correlation, by leaving out one person at a time.
    """

    people: int = 0
    pairs: int = 0
    errors: int = 0
    correlation: float | None = None
    standard_error: float | None = None

    @property
    def words(self) -> str:
        """The correlation with its counts, for people."""
        counts = f"{self.errors} errors in {self.pairs} pairs of readings of {self.people} people"
        if self.correlation is None:
            return f"not measured, {counts}"
        return f"correlation of errors {self.correlation:.2f} +- {self.standard_error:.2f}, {counts}"

    def weight(self, usual: float) -> float:
        """Return the weight of the second reading, in readings.

        Two readings with the correlation r carry the information of 2 / (1 + r) independent readings. The first one
        counts 1, so the second one counts 2 / (1 + r) - 1 = (1 - r) / (1 + r). The weight is clipped to [0, 1].

        Args:
            usual: Weight if the correlation is not known.
        """
        r = self.correlation
        return usual if r is None else min(max((1 - r) / (1 + r), 0.0), 1.0) if r > -1 else 1.0


Errors = Sequence[Mapping[str, bool]]
"""Whether the reading of each label is wrong, by topic, of each person."""

_Pairs = Mapping[str, tuple[bool, bool]]


def correlate_errors(first: Errors, second: Errors) -> ErrorCorrelation:
    """Estimate the correlation of the errors in two readings of one label.

    The estimate is the intraclass correlation: the mean product of both deviations from the error rate of the topic,
    divided by the mean squared deviation. Each topic has its own rate, because the difference between an easy and a
    hard topic is no correlation.

    Args:
        first: The errors of the first reading of each person.
        second: The errors of the second reading of each person. A label counts if both readings have it.

    Returns:
        The correlation.
    """
    both = [
        {topic: (one[topic], two[topic]) for topic in one if topic in two}
        for one, two in zip(first, second, strict=True)
    ]
    people = [person for person in both if person]
    pairs = [pair for person in people for pair in person.values()]
    counts = ErrorCorrelation(len(people), len(pairs), sum(map(sum, pairs)))
    whole = _correlation(people)
    if whole is None or sum(any(map(any, person.values())) for person in people) < LEAST_PEOPLE:
        return counts
    rest = [_correlation([*people[:i], *people[i + 1 :]]) or 0.0 for i in range(len(people))]
    mean = math.fsum(rest) / len(rest)
    variance = (len(rest) - 1) / len(rest) * math.fsum((r - mean) ** 2 for r in rest)
    return msgspec.structs.replace(counts, correlation=round(whole, 4), standard_error=round(math.sqrt(variance), 4))


def _correlation(people: Sequence[_Pairs]) -> float | None:
    topics: dict[str, list[tuple[bool, bool]]] = defaultdict(list)
    for person in people:
        for topic, pair in person.items():
            topics[topic].append(pair)
    together = spread = 0.0
    for pairs in topics.values():
        rate = sum(map(sum, pairs)) / (2 * len(pairs))
        together += sum((first - rate) * (second - rate) for first, second in pairs)
        spread += sum((first - rate) ** 2 + (second - rate) ** 2 for first, second in pairs) / 2
    return together / spread if spread else None
