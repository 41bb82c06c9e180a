"""The tables `gaps` (searching or seeing), `looks` (budgets of looks) and `iou` (thresholds of evidence)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import Final

import msgspec
import numpy as np

from jrdb_avr.engine.report.scored_runs import SCORES, QuestionIndex, ScoredRun, percent_of
from jrdb_avr.engine.report.tables import Line, interval_label, run_names, score_columns, shares_with_bounds
from jrdb_avr.schema.arrays import Ints

THRESHOLDS: Final = (0.3, 0.5, 0.7)
"""Minimum IoUs of the table `iou`."""

_ACTIVE: Final = ("react", "agent", "agent-no-world")
_BESIDE: Final = ("random-looks", "given-looks", "given-target")
_BUDGETS: Final = ("budget", "looks", "most_calls")
"""Settings of a method that follow from its budget of looks."""


def iou_rows(scored: Mapping[float, Sequence[ScoredRun]]) -> list[Line]:
    """Compute the table `iou`.

    Args:
        scored: The same runs, scored under each minimum IoU.

    Returns:
        One row per run, with evidence and combined in percent under each minimum IoU.
    """
    rows: dict[str, Line] = {}
    for iou, runs in scored.items():
        for run in runs:
            row = rows.setdefault(run.manifest.run_id, run_names(run) | {"n": run.n})
            for name, right in zip(SCORES[1:], run.scores[:, 1:].sum(axis=0).tolist(), strict=True):
                row[f"{name} {iou:g}"] = percent_of(right, run.n)
    return list(rows.values())


def gap_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[Line]:
    """Compute the table `gaps`.

    Args:
        index: The questions of the store, with their labels.
        runs: Scored runs.

    Returns:
        For each run of an active method with a run of `given-looks` of the same model: a row per score, for all common
        questions and for each family. The search gap is given-looks minus the active method. The seeing gap is 100
        minus given-target. Both are in points, with intervals that resample sequences. If a model has several runs of
        a diagnostic method, the first one in alphabetical order of run ids counts.
    """
    rows = []
    for run in runs:
        same = sorted((other for other in runs if other.manifest.model == run.manifest.model), key=_run_id)
        beside = {name: other for other in reversed(same) for name in _BESIDE if other.manifest.method == name}
        if run.manifest.method in _ACTIVE and "given-looks" in beside:
            compared = {"active": run} | beside
            common = reduce(np.intersect1d, [of.rows for of in compared.values()])
            parts = [("all", common)]
            if labels := index.labels.get("family"):
                parts += [(name, common[labels.numbers[common] == code]) for code, name in enumerate(labels.names)]
            rows += [line for family, among in parts if len(among) for line in _gaps(index, compared, family, among)]
    return rows


def _run_id(run: ScoredRun) -> str:
    return run.manifest.run_id


def _gaps(index: QuestionIndex, compared: Mapping[str, ScoredRun], family: str, among: Ints) -> Iterator[Line]:
    """Yield the rows of a run for some questions: answer and combined."""
    for score in ("answer", "combined"):
        column = SCORES.index(score)
        right = {name: run.scores_of(among)[:, column].astype(float) for name, run in compared.items()}
        row = run_names(compared["active"]) | {"family": family, "score": score, "n": len(among)}
        row |= {name.replace("-", "_"): percent_of(float(of.sum()), len(among)) for name, of in right.items()}
        gaps = {"search_gap": right["given-looks"] - right["active"]}
        gaps |= {"seeing_gap": 1 - right["given-target"]} if "given-target" in right else {}
        ratios = {name: (position, 0) for position, name in enumerate(gaps, 1)}
        shares, sequences = shares_with_bounds(index, among, np.column_stack([*gaps.values()]), ratios)
        yield row | shares | {"interval": interval_label(sequences)}


def look_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[Line]:
    """Compute the table `looks`.

    Args:
        index: The questions of the store, with their labels.
        runs: Scored runs.

    Returns:
        One row per run, for runs that differ in their budget of looks alone. The rows of such runs follow each other,
        with the smallest budget first.
    """
    alike: dict[bytes, dict[int, ScoredRun]] = {}
    for run in sorted(runs, key=_run_id):
        method = run.manifest.settings.get("method", {})
        budget = method.get("budget", method.get("looks"))
        others = {name: value for name, value in method.items() if name not in _BUDGETS}
        settings = run.manifest.settings | {"method": others, "endpoint": None, "preflight": None}
        key = msgspec.json.encode([run.manifest.method, run.manifest.model, settings], order="sorted")
        if isinstance(budget, int):
            alike.setdefault(key, {})[budget] = run
    return [
        {"looks": budget} | run_names(run) | score_columns(index, run)
        for group in alike.values()
        if len(group) > 1
        for budget, run in sorted(group.items())
    ]
