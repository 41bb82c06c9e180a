"""How far people agree who answered the same questions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.report.scored_runs import SCORES, QuestionIndex, ScoredRun, percent_of
from jrdb_avr.engine.report.truth import read_answer
from jrdb_avr.schema.answer_modes import same_answer

HUMAN: Final = "human"
"""The method of a run that `play` made; who played, its model says."""


def agreement_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    """A row per pair of people, in percent of the n questions that both have.

    `same_answer`: both gave an answer and each would score were the other's the true one, under the tolerances of the
    answer mode. `answer`, `evidence`, `combined`: both are right, or both wrong.
    """
    people = sorted((run for run in runs if run.manifest.method == HUMAN), key=lambda run: run.manifest.run_id)
    rows = []
    for first, second in combinations(people, 2):
        shared, mine, yours = np.intersect1d(first.rows, second.rows, assume_unique=True, return_indices=True)
        modes = index.labels["answer_mode"]
        same = sum(
            _same(modes.names[modes.numbers[row]], first.answers[own], second.answers[other])
            for row, own, other in zip(shared, mine, yours, strict=True)
        )
        alike = (first.scores[mine] == second.scores[yours]).sum(axis=0)
        if n := len(shared):
            ids: dict[str, Any] = {"first": first.manifest.run_id, "second": second.manifest.run_id}
            shares = {name: percent_of(float(own), n) for name, own in zip(SCORES, alike, strict=True)}
            rows.append(ids | {"n": n, "same_answer": percent_of(same, n)} | shares)
    return rows


def _same(mode: str, mine: str | None, yours: str | None) -> bool:
    first, second = read_answer(mode, mine), read_answer(mode, yours)
    return first is not None and second is not None and same_answer(first, second) and same_answer(second, first)
