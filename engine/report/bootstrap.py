"""Statistics of scores: intervals by bootstrap over sequences, and comparisons of two runs.

Questions of one sequence share its people and its light, and are not independent draws. The cluster bootstrap
therefore draws whole sequences. Intervals are percentile intervals at 95 %. Draws are seeded and equal for all runs
over the same sequences, so that differences between runs are paired.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from jrdb_avr.schema.arrays import Digits, Floats, Ints

DRAWS: Final = 10_000
SEED: Final = 0
LEVEL: Final = 0.95
LEAST_CLUSTERS: Final = 10
"""Minimum number of sequences for an interval: fewer draws say little about other sequences."""

_TAILS: Final = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)

_BATCH: Final = 32
"""Number of comparisons computed together; each takes 80 kB per score."""


@dataclass(frozen=True)
class Interval:
    """A share with its interval.

    Attributes:
        value: The share, or None without questions.
        low: Lower bound, or None with fewer than two sequences.
        high: Upper bound, or None with fewer than two sequences.
    """

    value: float | None
    low: float | None
    high: float | None


Pair = tuple[int, int, float, Interval]
"""Comparison of two runs by one score: the number of questions that only the first run scores, the number that only
the second scores, the p-value of the exact two-sided McNemar test, and the share of the second minus the first's.
"""


@functools.lru_cache(maxsize=8)
def draws(clusters: int, n: int = DRAWS, seed: int = SEED) -> Floats:
    """Draw clusters with replacement.

    Args:
        clusters: Number of clusters, and of clusters in each draw.
        n: Number of draws.
        seed: Seed of the generator.

    Returns:
        How often each draw contains each cluster, read-only (n, clusters).
    """
    generator = np.random.default_rng(seed)
    counts = generator.multinomial(clusters, np.full(clusters, 1 / clusters), size=n).astype(np.float64)
    # The cached array is shared by all comparisons over the same sequences.
    counts.flags.writeable = False
    return counts


Statistic = Callable[[Floats], Floats]
"""Function of totals (draws, columns) that returns values (draws), NaN if undefined."""


def intervals(sums: Floats, statistics: Sequence[Statistic], n: int = DRAWS, seed: int = SEED) -> list[Interval]:
    """Compute statistics with their intervals.

    Args:
        sums: Sums over the questions of each cluster (clusters, columns).
        statistics: Functions of the columns' totals.
        n: Number of draws.
        seed: Seed of the draws.

    Returns:
        The interval of each statistic. Draws with an undefined statistic are left out.
    """
    total = sums.sum(axis=0, keepdims=True)
    values = [float(statistic(total)[0]) if len(sums) else math.nan for statistic in statistics]
    if len(sums) < 2:
        return [Interval(None if math.isnan(value) else value, None, None) for value in values]
    # Column-major layout, because statistics read whole columns.
    drawn = (sums.T @ draws(len(sums), n, seed).T).T
    values_drawn = np.stack([statistic(drawn) for statistic in statistics])
    bounds = np.quantile(values_drawn, _TAILS, axis=1)
    for row in np.flatnonzero(np.isnan(values_drawn).any(axis=1)).tolist():
        defined = values_drawn[row][~np.isnan(values_drawn[row])]
        bounds[:, row] = np.quantile(defined, _TAILS) if len(defined) else math.nan
    return [
        Interval(None, None, None) if math.isnan(value) else Interval(value, *pair)
        for value, pair in zip(values, bounds.T.tolist(), strict=True)
    ]


def numbered_sums(numbers: Ints, count: int, columns: Floats) -> Floats:
    """Sum rows by number.

    Args:
        numbers: Number of each row, below `count` (n).
        count: Number of groups.
        columns: Values to sum (n, columns).

    Returns:
        The sums (count, columns).
    """
    return np.stack([np.bincount(numbers, weights=column, minlength=count) for column in columns.T], axis=1)


def mean_ratio(*pairs: tuple[int, int]) -> Statistic:
    """Make a statistic: the mean of ratios of columns' totals. Several pairs give a macro average.

    Args:
        *pairs: Columns of numerator and denominator.

    Returns:
        The statistic; ratios with a denominator of 0 are left out, and NaN remains if all are.
    """

    def mean(totals: Floats) -> Floats:
        added, count = np.zeros(len(totals)), np.zeros(len(totals))
        for above, below in pairs:
            defined = totals[:, below] > 0
            added += np.divide(totals[:, above], totals[:, below], out=np.zeros(len(totals)), where=defined)
            count += defined
        means: Floats = np.divide(added, count, out=np.full(len(totals), np.nan), where=count > 0)
        return means

    return mean


def mcnemar(only_first: int, only_second: int) -> float:
    """Compute the exact two-sided McNemar test.

    Args:
        only_first: Number of questions that only the first run scores.
        only_second: Number of questions that only the second run scores.

    Returns:
        The p-value: the probability of a split at least as uneven if both runs are equally good.
    """
    n, least = only_first + only_second, min(only_first, only_second)
    # Integers, because 2 ** n overflows a float for a large benchmark.
    below = term = 1
    for k in range(1, least + 1):
        term = term * (n - k + 1) // k
        below += term
    return min(1.0, 2 * below / (1 << n))


def compare(
    clusters: Ints, scores: Sequence[Digits], pairs: Sequence[tuple[int, int]], n: int = DRAWS, seed: int = SEED
) -> list[list[Pair]]:
    """Compare pairs of runs on the same questions.

    Args:
        clusters: Cluster of each question (questions).
        scores: 0/1 scores of each run, in the same order (questions, scores).
        pairs: Indexes of two runs in `scores`.
        n: Number of draws.
        seed: Seed of the draws.

    Returns:
        For each pair one `Pair` per score.
    """
    names, numbers = np.unique(clusters, return_inverse=True)
    sums = numbered_sums(numbers, len(names), np.concatenate([*scores, np.ones((len(clusters), 1))], axis=1))
    # Draw each run once for all its comparisons. The first row counts each cluster once and gives the shares.
    times = np.concatenate([np.ones((1, len(sums))), draws(len(sums), n, seed)])
    *drawn, questions = sums.T @ times.T
    of_runs = np.reshape(drawn, (len(scores), -1, len(times)))
    comparisons = []
    for batch in (pairs[start : start + _BATCH] for start in range(0, len(pairs), _BATCH)):
        first, second = np.transpose(batch)
        differences = of_runs[second]
        differences -= of_runs[first]
        differences /= questions
        values = differences[..., 0].tolist()
        bounds = np.moveaxis(np.quantile(differences[..., 1:], _TAILS, axis=-1, overwrite_input=True), 0, -1).tolist()
        for (left, right), *shares in zip(batch, values, bounds, strict=True):
            shares_of_pair = [
                Interval(value, *(limits if len(sums) > 1 else (None, None)))
                for value, limits in zip(*shares, strict=True)
            ]
            comparisons.append(_pairs(scores[left], scores[right], shares_of_pair))
    return comparisons


def _pairs(first: Digits, second: Digits, differences: Sequence[Interval]) -> list[Pair]:
    only_first = (first > second).sum(axis=0).tolist()
    only_second = (second > first).sum(axis=0).tolist()
    return [
        (left_wins, right_wins, mcnemar(left_wins, right_wins), difference)
        for left_wins, right_wins, difference in zip(only_first, only_second, differences, strict=True)
    ]
