"""Statistics of scores: intervals by bootstrap over sequences, and comparisons of two runs.

Questions about the same sequence share its people and its light, so they are not independent. The cluster bootstrap
therefore draws whole sequences with replacement. Intervals are percentile intervals at 95 %. The draws are seeded. All
runs on the same sequences get the same draws, so that differences between runs are paired.
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
"""Minimum number of sequences for an interval. Fewer sequences say little about sequences outside the sample."""

_TAILS: Final = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)

_BATCH: Final = 32
"""Maximum number of pairs of runs that are compared in one array. A pair takes 80 kB per score."""


@dataclass(frozen=True)
class Interval:
    """A statistic, such as a share of questions, with its interval.

    Attributes:
        value: The value, or None if it is undefined, for example because there are no questions.
        low: Lower bound, or None if `value` is None or if there are fewer than two sequences.
        high: Upper bound, or None if `value` is None or if there are fewer than two sequences.
    """

    value: float | None
    low: float | None
    high: float | None


Pair = tuple[int, int, float, Interval]
"""Comparison of two runs by one score: the number of questions that only the first run has right, the number that only
the second run has right, the p-value of the exact two-sided McNemar test, and the difference of the two shares (second
minus first) with its interval.
"""


@functools.lru_cache(maxsize=8)
def draws(clusters: int, n: int = DRAWS, seed: int = SEED) -> Floats:
    """Draw clusters with replacement.

    Args:
        clusters: Number of clusters. Each draw has this number of clusters, with repetitions.
        n: Number of draws.
        seed: Seed of the random generator.

    Returns:
        A read-only array that says how many times each draw contains each cluster. Shape: (n, clusters).
    """
    generator = np.random.default_rng(seed)
    counts = generator.multinomial(clusters, np.full(clusters, 1 / clusters), size=n).astype(np.float64)
    # The array is read-only, because all comparisons with this number of clusters share the cached array.
    counts.flags.writeable = False
    return counts


Statistic = Callable[[Floats], Floats]
"""Function that maps the column sums of each draw (draws, columns) to a value per draw (draws). NaN means undefined."""


def intervals(sums: Floats, statistics: Sequence[Statistic]) -> list[Interval]:
    """Compute statistics with their intervals.

    Args:
        sums: For each cluster, the sums over the questions of the cluster. Each column of the array sums one property
            of questions, such as a score. Shape: (clusters, columns).
        statistics: The statistics to compute from the columns.

    Returns:
        One `Interval` per statistic. If a statistic is undefined in a draw, its bounds ignore this draw.
    """
    total = sums.sum(axis=0, keepdims=True)
    values = [float(statistic(total)[0]) if len(sums) else math.nan for statistic in statistics]
    if len(sums) < 2:
        return [Interval(None if math.isnan(value) else value, None, None) for value in values]
    # The product is transposed so that each column is contiguous, because statistics read whole columns.
    drawn = (sums.T @ draws(len(sums)).T).T
    values_drawn = np.stack([statistic(drawn) for statistic in statistics])
    bounds = np.quantile(values_drawn, _TAILS, axis=1)
    for row in np.flatnonzero(np.isnan(values_drawn).any(axis=1)).tolist():
        defined = values_drawn[row][~np.isnan(values_drawn[row])]
        bounds[:, row] = np.quantile(defined, _TAILS) if len(defined) else math.nan
    return [
        Interval(None, None, None) if math.isnan(value) else Interval(value, *pair)
        for value, pair in zip(values, bounds.T.tolist(), strict=True)
    ]


def numbered_sums(numbers: Ints, count: int, columns: Digits | Floats) -> Floats:
    """Sum the rows of each group.

    Args:
        numbers: Index of each row's group, from 0 to `count` - 1. Shape: (n,).
        count: Number of groups.
        columns: Values to sum. Shape: (n, columns).

    Returns:
        The sum of each column in each group. Shape: (count, columns).
    """
    return np.stack([np.bincount(numbers, weights=column, minlength=count) for column in columns.T], axis=1)


def mean_ratio(*pairs: tuple[int, int]) -> Statistic:
    """Make the statistic that is the mean of several ratios.

    Each ratio divides the sum of one column by the sum of another column. A single ratio is, for example, a share. The
    mean of several ratios is a macro average.

    Args:
        *pairs: For each ratio, the index of the numerator's column and the index of the denominator's column.

    Returns:
        The statistic. Ratios with a denominator of 0 are left out. If all denominators are 0, the value is NaN.
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
    """Compute the p-value of the exact two-sided McNemar test.

    Args:
        only_first: Number of questions that only the first run has right.
        only_second: Number of questions that only the second run has right.

    Returns:
        The p-value. It is a probability under one assumption: each question that exactly one run has right is equally
        likely to belong to the first run or to the second run. The p-value is then the probability that the numbers of
        questions of the two runs differ at least as much as `only_first` and `only_second` do.
    """
    n, least = only_first + only_second, min(only_first, only_second)
    # The sum is computed in integers, because 2 ** n overflows a float if the benchmark is large.
    below = term = 1
    for k in range(1, least + 1):
        term = term * (n - k + 1) // k
        below += term
    return min(1.0, 2 * below / (1 << n))


def compare(clusters: Ints, scores: Sequence[Digits], pairs: Sequence[tuple[int, int]]) -> list[list[Pair]]:
    """Compare pairs of runs that answered the same questions.

    Args:
        clusters: Index of each question's cluster. Shape: (questions,).
        scores: For each run, an array of 0 and 1 with one row per question, in the order of `clusters`, and one column
            per kind of score. Shape: (questions, kinds).
        pairs: The pairs to compare, each as two indexes in `scores`.

    Returns:
        For each pair of runs, one `Pair` per kind of score (column).
    """
    names, numbers = np.unique(clusters, return_inverse=True)
    sums = numbered_sums(numbers, len(names), np.concatenate([*scores, np.ones((len(clusters), 1))], axis=1))
    # The sums of a run's draws serve all comparisons of the run. The first draw is the sample itself. It gives
    # the shares.
    times = np.concatenate([np.ones((1, len(sums))), draws(len(sums))])
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
            left_wins = (scores[left] > scores[right]).sum(axis=0).tolist()
            right_wins = (scores[right] > scores[left]).sum(axis=0).tolist()
            differences_of_pair = (
                Interval(value, *(limits if len(sums) > 1 else (None, None)))
                for value, limits in zip(*shares, strict=True)
            )
            p_values = map(mcnemar, left_wins, right_wins)
            comparisons.append([*zip(left_wins, right_wins, p_values, differences_of_pair, strict=True)])
    return comparisons
