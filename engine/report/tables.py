"""The tables of a report: rows of plain values in percent of `n`, the number of questions.

A value is None (printed as n/a) if n is 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.report.bootstrap import LEAST_CLUSTERS, Interval, compare, intervals, mean_ratio, numbered_sums
from jrdb_avr.engine.report.paper import ABLATION, GROUPS, MAIN, Published
from jrdb_avr.engine.report.scored_runs import (
    DIMENSIONS,
    SCORES,
    QuestionIndex,
    ScoredRun,
    distinguishing_settings,
    percent_of,
)
from jrdb_avr.schema.arrays import Ints

Row = dict[str, Any]

INTERVALS: Final = "95 %"
TOO_FEW: Final = "too few sequences for an interval"

CELLS: Final[dict[str, Row]] = {
    "agent-passive-no-world": {"active": "off", "world_model": "off"},
    "agent-passive": {"active": "off", "world_model": "on"},
    "agent-no-world": {"active": "on", "world_model": "off"},
    "agent": {"active": "on", "world_model": "on"},
}
"""Cells of the ablation by method: active observation by world model."""

# -- the main table ---------------------------------------------------------------------------------------------------


def main_rows(index: QuestionIndex, runs: Sequence[ScoredRun], iou: float) -> list[Row]:
    """Compute the main table.

    Args:
        index: The store's questions.
        runs: Scored runs.
        iou: Minimum IoU for evidence to score.

    Returns:
        A row per run: shares with 95 % intervals over sequences, and macro averages over families and paper groups.
    """
    settings = distinguishing_settings(runs)
    return [_main_row(index, run, iou, settings[run.manifest.run_id]) for run in runs]


def _main_row(index: QuestionIndex, run: ScoredRun, iou: float, setting: str) -> Row:
    # Columns: the questions, the three scores, the answers without evidence.
    base = np.concatenate([np.ones((run.n, 1)), run.scores, run.scores[:, :1] - run.scores[:, 2:]], axis=1)
    sequences, cluster = np.unique(index.labels["sequence"].numbers[run.rows], return_inverse=True)
    sums = [numbered_sums(cluster, len(sequences), base)]
    statistics = {name: mean_ratio((index_of_score, 0)) for index_of_score, name in enumerate(SCORES, 1)}
    statistics["hallucination"] = mean_ratio((4, 1))
    column = base.shape[1]
    for title, dimension in (("families", "family"), ("groups", "group")):
        labels = index.labels[dimension]
        count = len(labels.names)
        parts = numbered_sums(cluster * count + labels.numbers[run.rows], len(sequences) * count, base[:, :4])
        sums.append(parts.reshape(len(sequences), 4 * count))
        for index_of_score, name in enumerate(SCORES, 1):
            ratios = [(column + 4 * k + index_of_score, column + 4 * k) for k in range(count)]
            statistics[f"{name}_macro_{title}"] = mean_ratio(*ratios)
        column += 4 * count
    shares = intervals(np.concatenate(sums, axis=1), tuple(statistics.values()))
    bounds = {name: _with_bounds(name, share) for name, share in zip(statistics, shares, strict=True)}
    row = _head(run) | {
        "setting": setting,
        "n": run.n,
        "sequences": len(sequences),
        "interval": interval_label(len(sequences)),
    }
    for name in (*SCORES, "hallucination"):
        row |= bounds.pop(name)
    row |= {"invalid": percent_of(int(run.invalid.sum()), run.n), "errors": percent_of(run.errors, run.n)}
    for macro in bounds.values():
        row |= macro
    return row | {"iou": iou}


def interval_label(sequences: int) -> str:
    """Return the label of a row's intervals.

    Args:
        sequences: Number of sequences of the row.

    Returns:
        `INTERVALS`, or `TOO_FEW`, for which tables for people show no intervals.
    """
    return INTERVALS if sequences >= LEAST_CLUSTERS else TOO_FEW


def _head(run: ScoredRun) -> Row:
    manifest = run.manifest
    label = "synthetic" if manifest.synthetic else ""
    return {"run": manifest.run_id, "method": manifest.method, "model": manifest.model, "label": label}


def _percent(share: float | None) -> float | None:
    return None if share is None or math.isnan(share) else round(100 * share, 2)


def _with_bounds(name: str, interval: Interval) -> Row:
    return {
        name: _percent(interval.value),
        f"{name}_low": _percent(interval.low),
        f"{name}_high": _percent(interval.high),
    }


def published_rows() -> list[Row]:
    """Return the paper's main table, in the columns of `main_rows` that it has."""
    return [_published(row) for row in MAIN]


def _published(row: Published) -> Row:
    n = sum(counts.n for counts in GROUPS.values())
    return {"run": "", "method": row.method, "model": row.model, "label": "paper", "n": n} | row._asdict()


# -- breakdowns -------------------------------------------------------------------------------------------------------


def breakdown_rows(index: QuestionIndex, runs: Sequence[ScoredRun], dimension: str) -> list[Row]:
    """Break scores down by a dimension.

    Args:
        index: The store's questions.
        runs: Scored runs.
        dimension: A name of `DIMENSIONS`.

    Returns:
        A row per value and run, grouped by value.
    """
    labels = index.labels[dimension]
    columns = [np.concatenate([np.ones((run.n, 1)), run.scores, run.invalid[:, None]], axis=1) for run in runs]
    sums = [
        numbered_sums(labels.numbers[run.rows], len(labels.names), sums_of_run).astype(np.int64).tolist()
        for run, sums_of_run in zip(runs, columns, strict=True)
    ]
    return [
        {dimension: name, **_head(run), **_shares(*sums_of_run[value])}
        for value, name in enumerate(labels.names)
        for run, sums_of_run in zip(runs, sums, strict=True)
        if sums_of_run[value][0]
    ]


def published_groups() -> list[Row]:
    """Return the paper's agent by its groups, in the columns of `breakdown_rows`."""
    return [
        {"group": group, "run": "", "method": "agent", "model": "Qwen3.5 9B", "label": "paper", "n": counts.n}
        | {name: percent_of(getattr(counts, name), counts.n) for name in SCORES}
        | {"hallucination": percent_of(counts.answer - counts.combined, counts.answer)}
        for group, counts in GROUPS.items()
    ]


def score_row(run: ScoredRun, iou: float) -> Row:
    """Return the row of `score` of a run.

    Args:
        run: The scored run.
        iou: Minimum IoU for evidence to score.

    Returns:
        The run's scores in percent of its questions.
    """
    head = {"run": run.manifest.run_id, "label": _head(run)["label"]}
    return head | _shares(*_totals(run)) | {"errors": percent_of(run.errors, run.n), "iou": iou}


def _totals(run: ScoredRun) -> list[int]:
    """Return the arguments of `_shares` for a whole run."""
    return [run.n, *run.scores.sum(axis=0).tolist(), int(run.invalid.sum())]


def _shares(n: int, answer: int, evidence: int, combined: int, invalid: int) -> Row:
    return {
        "n": n,
        "answer": percent_of(answer, n),
        "evidence": percent_of(evidence, n),
        "combined": percent_of(combined, n),
        "hallucination": percent_of(answer - combined, answer),
        "invalid": percent_of(invalid, n),
    }


# -- the ablation -----------------------------------------------------------------------------------------------------


def ablation_rows(runs: Sequence[ScoredRun], *, published: bool = False) -> list[Row]:
    """Compute the ablation: active observation by world model by policy.

    Args:
        runs: Scored runs; runs of other methods are ignored.
        published: Whether to add the paper's ablation.

    Returns:
        A row per run, grouped by model and setting.
    """
    methods = list(CELLS)
    among = [run for run in runs if run.manifest.method in methods]
    settings: dict[str, str] = {}
    for policy in {_policy(run) for run in among}:
        # Settings of a policy repeat its column, so they are compared only within a policy.
        settings |= distinguishing_settings([run for run in among if _policy(run) == policy])
    rows = [
        CELLS[run.manifest.method]
        | {"policy": _policy(run)}
        | _head(run)
        | {"setting": settings[run.manifest.run_id]}
        | _shares(*_totals(run))
        for run in among
    ]
    # Group the cells by model and setting, passive cells first.
    rows.sort(key=lambda row: (row["model"], row["setting"], methods.index(row["method"]), row["policy"]))
    if published:
        rows += [cell | {"policy": "model"} | _published(ABLATION[method]) for method, cell in CELLS.items()]
    return rows


def _policy(run: ScoredRun) -> str:
    """Return the policy that chose the looks of an agent's run."""
    return str(run.manifest.settings.get("method", {}).get("policy", "model"))


# -- pairs ------------------------------------------------------------------------------------------------------------


def pair_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[Row]:
    """Compare all pairs of runs.

    Args:
        index: The store's questions.
        runs: Scored runs.

    Returns:
        The rows of `rows_of_pairs`, with the runs of each pair in alphabetical order.
    """
    # Which of two is the first does not depend on their scores, so that a difference keeps its sign.
    return rows_of_pairs(index, list(combinations(sorted(runs, key=_name), 2)))


def rows_of_pairs(index: QuestionIndex, pairs: Sequence[tuple[ScoredRun, ScoredRun]]) -> list[Row]:
    """Compare pairs of runs on their common questions.

    Args:
        index: The store's questions.
        pairs: The pairs.

    Returns:
        A row per pair and score: the exact McNemar test, and the difference with its interval. Pairs without a common
        question have no row.
    """
    groups: dict[bytes, tuple[Ints, list[int]]] = {}
    for index_of_pair, (first, second) in enumerate(pairs):
        common = np.intersect1d(first.rows, second.rows, assume_unique=True)
        groups.setdefault(common.tobytes(), (common, []))[1].append(index_of_pair)
    rows: dict[int, list[Row]] = {}
    for common, members in groups.values():
        if not len(common):
            continue
        clusters = index.labels["sequence"].numbers[common]
        label = interval_label(len(np.unique(clusters)))
        runs = list(dict.fromkeys(run for member in members for run in pairs[member]))
        scores = [run.scores[np.searchsorted(run.rows, common)] for run in runs]
        indexes = [(runs.index(pairs[member][0]), runs.index(pairs[member][1])) for member in members]
        for member, comparison in zip(members, compare(clusters, scores, indexes), strict=True):
            first, second = pairs[member]
            rows[member] = [
                {"first": first.manifest.run_id, "second": second.manifest.run_id, "score": name, "n": len(common)}
                | {"only_first": only_first, "only_second": only_second, "p": p}
                | _with_bounds("difference", difference)
                | {"interval": label}
                for name, (only_first, only_second, p, difference) in zip(SCORES, comparison, strict=True)
            ]
    return [row for member in sorted(rows) for row in rows[member]]


def _name(run: ScoredRun) -> tuple[str, str, str]:
    return run.manifest.method, run.manifest.model, run.manifest.run_id


def ranked(runs: Sequence[ScoredRun]) -> list[ScoredRun]:
    """Sort runs by their combined share, the best first; equal runs by method, model and id.

    Args:
        runs: Scored runs.

    Returns:
        The sorted runs.
    """
    return sorted(runs, key=lambda run: (-run.scores[:, 2].mean() if run.n else 0.0, *_name(run)))


RESULTS: Final = ("wrong_choices", "evidence_failures", "cost")
"""Tables that are queries of `queries/results/`."""

TABLES: Final = ("main", *DIMENSIONS, "ablation", "pairs", "people", "epochs", *RESULTS)
"""Names of all tables. `main` has shares with intervals; the name of a dimension means a breakdown by it."""
