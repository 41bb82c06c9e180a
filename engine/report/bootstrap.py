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

from jrdb_avr.schema.arrays import Digits, Floats, Ints

DRAWS: Final = 10_000
SEED: Final = 0
LEVEL: Final = 0.95
LEAST_CLUSTERS: Final = 10
"""Below so many sequences the draws say little of others: tables show no interval."""

_TAILS: Final = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)

_BATCH: Final = 32
"""Comparisons at a time, of 80 kB for each score."""


@dataclass(frozen=True)
class Interval:
    """A share with its interval; all None without questions, the bounds None for a single sequence."""

    value: float | None
    low: float | None
    high: float | None


Pair = tuple[int, int, float, Interval]
"""Two runs on the same questions: on how many the first scores and the second does not, and the other way round; p of
the exact McNemar test, two sided; the difference of the shares, the second's less the first's."""


@functools.lru_cache(maxsize=8)
def draws(clusters: int, n: int = DRAWS, seed: int = SEED) -> Floats:
    """How often each of the clusters is drawn in each of `n` draws of as many: (n, clusters), read-only."""
    generator = np.random.default_rng(seed)
    found = generator.multinomial(clusters, np.full(clusters, 1 / clusters), size=n).astype(np.float64)
    # Cached, as hundreds of pairs of runs are compared over the same sequences.
    found.flags.writeable = False
    return found


Statistic = Callable[[Floats], Floats]
"""Totals (draws, columns) to values (draws), NaN where undefined."""


def intervals(sums: Floats, statistics: Sequence[Statistic], n: int = DRAWS, seed: int = SEED) -> list[Interval]:
    """Statistics of the same sums over clusters, with their intervals.

    sums: (clusters, columns), what is added up in each cluster. Draws in which a statistic is undefined are left out.
    """
    total = sums.sum(axis=0, keepdims=True)
    values = [float(statistic(total)[0]) if len(sums) else math.nan for statistic in statistics]
    if len(sums) < 2:
        return [Interval(None if math.isnan(value) else value, None, None) for value in values]
    # Laid out by column, as statistics go through columns.
    drawn = (sums.T @ draws(len(sums), n, seed).T).T
    found = np.stack([statistic(drawn) for statistic in statistics])
    bounds = np.quantile(found, _TAILS, axis=1)
    for number in np.flatnonzero(np.isnan(found).any(axis=1)).tolist():
        known = found[number][~np.isnan(found[number])]
        bounds[:, number] = np.quantile(known, _TAILS) if len(known) else math.nan
    return [
        Interval(None, None, None) if math.isnan(value) else Interval(value, *own)
        for value, own in zip(values, bounds.T.tolist(), strict=True)
    ]


def cluster_sums(clusters: Ints, columns: Floats) -> Floats:
    """Sums of the rows of (n, columns) by cluster, in the clusters' sorted order."""
    found, numbers = np.unique(clusters, return_inverse=True)
    return numbered_sums(numbers, len(found), columns)


def numbered_sums(numbers: Ints, count: int, columns: Floats) -> Floats:
    """Sums of the rows of (n, columns) by their number below `count`: (count, columns)."""
    return np.stack([np.bincount(numbers, weights=column, minlength=count) for column in columns.T], axis=1)


def mean_ratio(*pairs: tuple[int, int]) -> Statistic:
    """The mean of ratios of columns' totals, each (above, below), over those not divided by 0; NaN without any.

    Of one pair it is the ratio, of several a macro average.
    """

    def mean(totals: Floats) -> Floats:
        added, count = np.zeros(len(totals)), np.zeros(len(totals))
        for above, below in pairs:
            known = totals[:, below] > 0
            added += np.divide(totals[:, above], totals[:, below], out=np.zeros(len(totals)), where=known)
            count += known
        found: Floats = np.divide(added, count, out=np.full(len(totals), np.nan), where=count > 0)
        return found

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


def compare(
    clusters: Ints, scores: Sequence[Digits], pairs: Sequence[tuple[int, int]], n: int = DRAWS, seed: int = SEED
) -> list[list[Pair]]:
    """Compare runs on the same questions, two by two: for each of `pairs`, places in `scores`, a Pair per score.

    clusters: of the questions (questions); scores: each run's 0/1 scores (questions, scores), in the same order.
    """
    sums = cluster_sums(clusters, np.concatenate([*scores, np.ones((len(clusters), 1))], axis=1))
    # Every run is drawn once, however often it is compared. In front of the draws, each cluster once: the shares.
    times = np.concatenate([np.ones((1, len(sums))), draws(len(sums), n, seed)])
    *drawn, questions = sums.T @ times.T
    of_runs = np.reshape(drawn, (len(scores), -1, len(times)))
    found = []
    for batch in (pairs[start : start + _BATCH] for start in range(0, len(pairs), _BATCH)):
        first, second = np.transpose(batch)
        differences = of_runs[second]
        differences -= of_runs[first]
        differences /= questions
        values = differences[..., 0].tolist()
        bounds = np.moveaxis(np.quantile(differences[..., 1:], _TAILS, axis=-1, overwrite_input=True), 0, -1).tolist()
        for (one, other), *shares in zip(batch, values, bounds, strict=True):
            known = [
                Interval(value, *(own if len(sums) > 1 else (None, None))) for value, own in zip(*shares, strict=True)
            ]
            found.append(_pairs(scores[one], scores[other], known))
    return found


def _pairs(first: Digits, second: Digits, differences: Sequence[Interval]) -> list[Pair]:
    only_first, only_second = ((one > other).sum(axis=0).tolist() for one, other in ((first, second), (second, first)))
    return [
        (mine, yours, mcnemar(mine, yours), difference)
        for mine, yours, difference in zip(only_first, only_second, differences, strict=True)
    ]
