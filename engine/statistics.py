"""Statistics of scores: intervals by bootstrap over sequences, and comparisons of two runs.

Questions of one sequence share its people and its light, so they are no independent draws: whole sequences are drawn
again (the cluster bootstrap), and every interval is the percentile one at 95 %. Draws are seeded, and the same for all
runs over the same sequences, so that differences are paired.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Labels = npt.NDArray[np.int64] | npt.NDArray[np.str_]

DRAWS: Final = 10_000
SEED: Final = 0
LEVEL: Final = 0.95


@dataclass(frozen=True)
class Interval:
    """A share with its interval; all None where nothing was asked, the bounds None for a single sequence."""

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Pair:
    """Two runs on the same questions.

    only_first, only_second: questions on which one scores and the other does not; p: of the exact McNemar test, two
    sided; difference: of the shares, the second's less the first's.
    """

    n: int
    only_first: int
    only_second: int
    p: float
    difference: Interval


@functools.lru_cache(maxsize=8)
def draws(clusters: int, n: int = DRAWS, seed: int = SEED) -> Floats:
    """How often each of the clusters is drawn in each of `n` draws of as many: (n, clusters), read-only."""
    generator = np.random.default_rng(seed)
    found = generator.multinomial(clusters, np.full(clusters, 1 / clusters), size=n).astype(np.float64)
    # Kept, as hundreds of pairs of runs are compared over the same sequences.
    found.flags.writeable = False
    return found


def interval(
    sums: Floats,
    statistic: Callable[[Floats], Floats],
    n: int = DRAWS,
    seed: int = SEED,
) -> Interval:
    """A statistic of sums over clusters, with its interval.

    sums: (clusters, columns), what is added up in each cluster; statistic: totals (draws, columns) to values (draws),
    NaN where undefined. Draws in which it is undefined are left out.
    """
    value = float(statistic(sums.sum(axis=0, keepdims=True))[0]) if len(sums) else math.nan
    if math.isnan(value):
        return Interval(None, None, None)
    if len(sums) < 2:
        return Interval(value, None, None)
    found = statistic(draws(len(sums), n, seed) @ sums)
    found = found[~np.isnan(found)]
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(found, [tail, 1 - tail])
    return Interval(value, float(low), float(high))


def cluster_sums(clusters: Labels, columns: Floats) -> Floats:
    """Sums of the rows of (n, columns) by cluster, in the clusters' sorted order."""
    _, number = np.unique(clusters, return_inverse=True)
    sums = np.zeros((int(number.max(initial=-1)) + 1, columns.shape[1]))
    np.add.at(sums, number, columns)
    return sums


def ratio(numerator: int, denominator: int) -> Callable[[Floats], Floats]:
    """The statistic that divides one column's total by another's; NaN over zero."""

    def divide(totals: Floats) -> Floats:
        below = totals[:, denominator]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(below > 0, totals[:, numerator] / below, np.nan)

    return divide


def mean_of_ratios(pairs: Sequence[tuple[int, int]]) -> Callable[[Floats], Floats]:
    """The mean of several ratios, a macro average: over those whose denominator is not zero."""

    def mean(totals: Floats) -> Floats:
        shares = np.stack([ratio(above, below)(totals) for above, below in pairs], axis=1)
        known = ~np.isnan(shares)
        with np.errstate(invalid="ignore"):
            return np.where(known.any(axis=1), np.where(known, shares, 0).sum(axis=1) / known.sum(axis=1), np.nan)

    return mean


def mcnemar(only_first: int, only_second: int) -> float:
    """p of the exact two-sided McNemar test: how rare as uneven a split of the disagreements is by chance."""
    n, least = only_first + only_second, min(only_first, only_second)
    # In whole numbers: a share of 2 ** n is beyond a float long before n is beyond a benchmark.
    below = term = 1
    for k in range(1, least + 1):
        term = term * (n - k + 1) // k
        below += term
    return min(1.0, 2 * below / (1 << n))


def compare(clusters: Labels, first: Ints, second: Ints, n: int = DRAWS, seed: int = SEED) -> Pair:
    """Two runs' 0/1 scores on the same questions, in the same order."""
    columns = np.stack([second - first, np.ones(len(first))], axis=1).astype(np.float64)
    only_first, only_second = int(((first == 1) & (second == 0)).sum()), int(((first == 0) & (second == 1)).sum())
    return Pair(
        len(first),
        only_first,
        only_second,
        mcnemar(only_first, only_second),
        interval(cluster_sums(clusters, columns), ratio(0, 1), n, seed),
    )
