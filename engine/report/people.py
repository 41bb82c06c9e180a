"""Agreement between people that answered the same questions of a store."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.report.scored_runs import SCORES, QuestionIndex, ScoredRun, percent_of
from jrdb_avr.engine.report.truth import read_answer
from jrdb_avr.schema.answer_modes import same_answer

HUMAN: Final = "human"
"""Name of the method in runs that `play` made. Such a run has the person's name as the name of its model."""


def agreement_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[dict[str, Any]]:
    """Compute how often people agree, for each pair of runs of people.

    Args:
        index: The questions of the store, with their labels.
        runs: Scored runs. Runs that are not of a person are ignored.

    Returns:
        One row per pair of runs that have common questions. Shares are in percent of the `n` common questions.
        `same_answer` is the share of questions with equal answers of both people. Two answers are equal if each
        answer scores 1 when it is compared with the other answer as the true answer. `answer`, `evidence` and
        `combined` are the shares of questions with an equal score of this kind (0 or 1) in both runs.
    """
    people = sorted((run for run in runs if run.manifest.method == HUMAN), key=lambda run: run.manifest.run_id)
    rows = []
    for first, second in combinations(people, 2):
        shared, first_rows, second_rows = np.intersect1d(first.rows, second.rows, return_indices=True)
        modes = index.labels["answer_mode"]
        same = sum(
            _same(modes.names[modes.numbers[row]], first.answers[index_a], second.answers[index_b])
            for row, index_a, index_b in zip(shared, first_rows, second_rows, strict=True)
        )
        alike = (first.scores[first_rows] == second.scores[second_rows]).sum(axis=0)
        if n := len(shared):
            ids: dict[str, Any] = {"first": first.manifest.run_id, "second": second.manifest.run_id}
            shares = {name: percent_of(float(index_a), n) for name, index_a in zip(SCORES, alike, strict=True)}
            rows.append(ids | {"n": n, "same_answer": percent_of(same, n)} | shares)
    return rows


def _same(mode: str, first_text: str | None, second_text: str | None) -> bool:
    first, second = read_answer(mode, first_text), read_answer(mode, second_text)
    return first is not None and second is not None and same_answer(first, second) and same_answer(second, first)
