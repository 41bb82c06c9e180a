"""Runs that answer the same questions several times: pass@k, and the answer of the majority."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np

from jrdb_avr.engine.report.scored_runs import SCORES, ScoredRun, percent_of
from jrdb_avr.schema.arrays import Ints


def epoch_rows(runs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    """A row per number k of epochs of each run that has several, in percent of the n questions that all of them have.

    `answer`, `evidence`, `combined`: pass@k, the share of questions that at least one of k epochs gets right, as the
    mean over all choices of k epochs; of k = 1 it is the mean score. `majority`: the share that the answer given most
    often by the first k epochs gets right, of answers given equally often the one given first.
    """
    return [row for name, own in _groups(runs).items() if len(own) > 1 for row in _rows(name, own)]


def _groups(runs: Sequence[ScoredRun]) -> dict[str, list[ScoredRun]]:
    """The epochs of each run, in their order, by what their ids have in common."""
    found: dict[str, dict[int, ScoredRun]] = {}
    for run in runs:
        number, run_id = run.manifest.settings.get("epoch"), run.manifest.run_id
        if type(number) is int and run_id.endswith(f"-{number}"):
            found.setdefault(run_id.removesuffix(f"-{number}"), {})[number] = run
    return {name: [own[number] for number in sorted(own)] for name, own in found.items()}


def _rows(name: str, epochs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    shared: Ints = reduce(np.intersect1d, [run.rows for run in epochs])
    n, total = len(shared), len(epochs)
    places = [np.argsort(run.rows)[np.searchsorted(run.rows, shared, sorter=np.argsort(run.rows))] for run in epochs]
    # Epoch, question, score.
    scores = np.stack([run.scores[place] for run, place in zip(epochs, places, strict=True)])
    answers = [[run.answers[row] for row in place] for run, place in zip(epochs, places, strict=True)]
    right = scores.sum(axis=0)
    rows = []
    for k in range(1, total + 1):
        passes = np.array([_pass(total, correct, k) for correct in range(total + 1)])[right].sum(axis=0)
        majority = sum(int(scores[_majority(given), q, 0]) for q, given in enumerate(zip(*answers[:k], strict=True)))
        rows.append(
            {
                "run": name,
                "method": epochs[0].manifest.method,
                "model": epochs[0].manifest.model,
                "label": "synthetic" if any(run.manifest.synthetic for run in epochs) else "",
                "n": n,
                "epochs": total,
                "k": k,
                **{score: percent_of(float(passes[place]), n) for place, score in enumerate(SCORES)},
                "majority": percent_of(majority, n),
            }
        )
    return rows


def _pass(total: int, correct: int, k: int) -> float:
    """The share of the choices of k out of `total` epochs that hold one of the `correct` ones."""
    return 1 - math.comb(total - correct, k) / math.comb(total, k)


def _majority(given: Sequence[str | None]) -> int:
    """The first of the epochs that gave the answer given most often; the first epoch where none gave any."""
    counts = Counter(answer for answer in given if answer is not None)
    # Answers that are counted equally often come in the order of their first one.
    return given.index(counts.most_common(1)[0][0]) if counts else 0
