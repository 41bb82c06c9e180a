"""Statistics of runs that answer the same questions several times (epochs): pass@k, and the majority answer."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np

from jrdb_avr.engine.report.scored_runs import SCORES, ScoredRun, percent_of
from jrdb_avr.engine.report.tables import run_names
from jrdb_avr.schema.arrays import Ints


def epoch_rows(runs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    """Compute pass@k and the score of the majority answer for runs that have several epochs.

    Args:
        runs: Scored runs. Runs form a group if their run ids differ only in the number of the epoch, which ends the id.

    Returns:
        One row for each group of several runs and each k, from 1 to the number of epochs. Shares are in percent of the
        questions that all epochs have. `answer`, `evidence` and `combined` are pass@k: the share of questions that at
        least one of k epochs has right, averaged over all choices of k epochs. `majority` is the share of questions for
        which the most frequent answer of the first k epochs is right. If several answers are equally frequent, the
        answer that came first counts.
    """
    return [row for name, epochs in _groups(runs).items() if len(epochs) > 1 for row in _rows(name, epochs)]


def _groups(runs: Sequence[ScoredRun]) -> dict[str, list[ScoredRun]]:
    """Group runs by the part of the run id that comes before the epoch. Sort the runs of each group by epoch.

    Runs that are not epochs are left out.
    """
    groups: dict[str, dict[int, ScoredRun]] = {}
    for run in runs:
        epoch, run_id = run.manifest.settings.get("epoch"), run.manifest.run_id
        if type(epoch) is int and run_id.endswith(f"-{epoch}"):
            groups.setdefault(run_id.removesuffix(f"-{epoch}"), {})[epoch] = run
    return {name: [epochs[epoch] for epoch in sorted(epochs)] for name, epochs in groups.items()}


def _rows(name: str, epochs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    shared: Ints = reduce(np.intersect1d, [run.rows for run in epochs])
    n, total = len(shared), len(epochs)
    indexes = [np.searchsorted(run.rows, shared) for run in epochs]
    # The axes of `scores` are epoch, question and score.
    scores = np.stack([run.scores[index] for run, index in zip(epochs, indexes, strict=True)])
    answers = [[run.answers[row] for row in index] for run, index in zip(epochs, indexes, strict=True)]
    right = scores.sum(axis=0)
    label = "synthetic" if any(run.manifest.synthetic for run in epochs) else ""
    head, rows = run_names(epochs[0]) | {"run": name, "label": label}, []
    for k in range(1, total + 1):
        passes = np.array([_pass(total, correct, k) for correct in range(total + 1)])[right].sum(axis=0)
        majority = sum(int(scores[_majority(given), q, 0]) for q, given in enumerate(zip(*answers[:k], strict=True)))
        rows.append(
            head
            | {"n": n, "epochs": total, "k": k}
            | {score: percent_of(float(passes[index]), n) for index, score in enumerate(SCORES)}
            | {"majority": percent_of(majority, n)}
        )
    return rows


def _pass(total: int, correct: int, k: int) -> float:
    """Return the probability that k epochs, drawn from `total` epochs, include at least one correct epoch.

    The argument `correct` is the number of correct epochs.
    """
    return 1 - math.comb(total - correct, k) / math.comb(total, k)


def _majority(given: Sequence[str | None]) -> int:
    """Return the index of the first epoch that gave the most frequent answer, or 0 if no epoch has an answer."""
    counts = Counter(answer for answer in given if answer is not None)
    # Counter keeps equally frequent answers in the order of their first occurrence.
    return given.index(counts.most_common(1)[0][0]) if counts else 0
