"""The tables of a report, as rows of plain values.

Scores are in percent of `n`, the number of questions. If `n` is 0, a score is None, which is printed as n/a.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.report.bootstrap import LEAST_CLUSTERS, Interval, compare, intervals, mean_ratio, numbered_sums
from jrdb_avr.engine.report.scored_runs import (
    DIMENSIONS,
    SCORES,
    QuestionIndex,
    ScoredRun,
    distinguishing_settings,
    percent_of,
)
from jrdb_avr.schema.arrays import Bools, Digits, Floats, Ints

Line = dict[str, Any]

SHARES: Final = (*SCORES, "hallucination")
INTERVALS: Final = "95 %"
TOO_FEW: Final = "too few sequences for an interval"

CELLS: Final[dict[str, Line]] = {
    "agent-passive-no-world": {"active": "off", "world_model": "off"},
    "agent-passive": {"active": "off", "world_model": "on"},
    "agent-no-world": {"active": "on", "world_model": "off"},
    "agent": {"active": "on", "world_model": "on"},
}
"""Cell of the ablation by method: whether active observation and the world model are on or off."""

# -- the main table ---------------------------------------------------------------------------------------------------


def main_rows(index: QuestionIndex, runs: Sequence[ScoredRun], iou: float) -> list[Line]:
    """Compute the table `main`.

    Args:
        index: The questions of the store, with their labels.
        runs: Scored runs.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.

    Returns:
        One row per run: the scores with 95 % intervals (bootstrap over sequences), and macro averages of the scores
        over the families and over the paper's groups. Then the rows of `reference_rows`.
    """
    settings = distinguishing_settings(runs)
    rows = [_main_row(index, run, iou, settings[run.manifest.run_id]) for run in runs]
    return rows + reference_rows(index, runs)


def reference_rows(index: QuestionIndex, runs: Sequence[ScoredRun], among: Bools | bool = True) -> list[Line]:
    """Average the scores of the references over the questions that at least one run has.

    Args:
        index: The questions of the store, with their references.
        runs: Scored runs.
        among: Mask of the questions of `index` to average over. By default, all of them.

    Returns:
        One row per reference (`Reference.row`). The list is empty without questions.
    """
    asked = np.isin(np.arange(len(index.ids)), np.concatenate([np.empty(0, int), *(run.rows for run in runs)]))
    ids = index.ids.filter(pa.array(asked & among)).to_pylist()
    return [reference.row(ids) for reference in index.references if ids]


def _main_row(index: QuestionIndex, run: ScoredRun, iou: float, setting: str) -> Line:
    row = run_names(run) | {"setting": setting} | score_columns(index, run)
    row |= {"invalid": percent_of(int(run.invalid.sum()), run.n), "errors": percent_of(run.errors, run.n)}
    sequences, cluster = np.unique(index.labels["sequence"].numbers[run.rows], return_inverse=True)
    for title, dimension in (("families", "family"), ("groups", "group")):
        if (labels := index.labels.get(dimension)) is None:
            continue
        count = len(labels.names)
        sums = numbered_sums(cluster * count + labels.numbers[run.rows], len(sequences) * count, run.counts[:, :4])
        means = [mean_ratio(*((4 * k + score, 4 * k) for k in range(count))) for score in (1, 2, 3)]
        shares = intervals(sums.reshape(len(sequences), 4 * count), means)
        for name, share in zip(SCORES, shares, strict=True):
            row |= with_bounds(f"{name}_macro_{title}", share)
    return row | {"iou": iou}


def score_columns(index: QuestionIndex, run: ScoredRun, among: Bools | slice = slice(None)) -> Line:
    """Compute the scores of a run, or of some of its questions, with 95 % intervals.

    Args:
        index: The questions of the store, with their labels.
        run: The scored run.
        among: Mask or slice of the run's questions. By default, all of them.

    Returns:
        The columns n, sequences and interval, then each score and hallucination with its bounds, in percent.
    """
    rows, scores = run.rows[among], run.scores[among]
    # The last column is 1 if the answer is right but the evidence is not.
    columns = np.concatenate([scores, scores[:, :1] - scores[:, 2:]], axis=1)
    ratios = {name: (position, 0) for position, name in enumerate(SCORES, 1)} | {"hallucination": (4, 1)}
    shares, sequences = shares_with_bounds(index, rows, columns, ratios)
    return {"n": len(rows), "sequences": sequences, "interval": interval_label(sequences)} | shares


def shares_with_bounds(
    index: QuestionIndex, rows: Ints, columns: Ints | Digits | Floats, ratios: Mapping[str, tuple[int, int]]
) -> tuple[Line, int]:
    """Compute shares of questions, with intervals that resample sequences.

    Args:
        index: The questions of the store, with their labels.
        rows: Indexes in `index` of the n questions.
        columns: Values of the questions. Shape: (n, columns).
        ratios: For each share, the indexes of the columns to divide, from 1 on. Column 0 is 1 for each question.

    Returns:
        The columns of `with_bounds` for each share, and the number of sequences of the questions.
    """
    counted = np.concatenate([np.ones((len(rows), 1)), columns], axis=1)
    sequences, cluster = np.unique(index.labels["sequence"].numbers[rows], return_inverse=True)
    sums = numbered_sums(cluster, len(sequences), counted)
    row: Line = {}
    for name, share in zip(ratios, intervals(sums, [mean_ratio(ratio) for ratio in ratios.values()]), strict=True):
        row |= with_bounds(name, share)
    return row, len(sequences)


def interval_label(sequences: int) -> str:
    """Return the text that a row has in the column `interval`.

    Args:
        sequences: Number of sequences that the row's questions are about.

    Returns:
        `TOO_FEW` if there are fewer than `LEAST_CLUSTERS` sequences, otherwise `INTERVALS`. In printed tables, rows
        with `TOO_FEW` have no bounds of intervals.
    """
    return INTERVALS if sequences >= LEAST_CLUSTERS else TOO_FEW


def run_names(run: ScoredRun) -> Line:
    """Return the first columns of a run's row in a table: run, method, model and label."""
    manifest = run.manifest
    return {"run": manifest.run_id, "method": manifest.method, "model": manifest.model, "label": run.label}


def _percent(share: float | None) -> float | None:
    return None if share is None or math.isnan(share) else round(100 * share, 2)


def with_bounds(name: str, interval: Interval) -> Line:
    """Return the columns of a share in percent.

    Args:
        name: Name of the column.
        interval: The share, 0 to 1.

    Returns:
        The share and the bounds of its interval. The columns of the bounds are `NAME_low` and `NAME_high`.
    """
    shares = zip(("", "_low", "_high"), (interval.value, interval.low, interval.high), strict=True)
    return {f"{name}{end}": _percent(share) for end, share in shares}


# -- breakdowns -------------------------------------------------------------------------------------------------------


def breakdown_rows(index: QuestionIndex, runs: Sequence[ScoredRun], dimension: str) -> list[Line]:
    """Compute the scores of each run for each value of a dimension, such as for each family.

    Args:
        index: The questions of the store, with their labels.
        runs: Scored runs.
        dimension: A name of `index.labels`.

    Returns:
        For each value, one row per run that has questions with this value, then the rows of `reference_rows`.
    """
    labels = index.labels[dimension]
    sums = [numbered_sums(labels.numbers[run.rows], len(labels.names), run.counts) for run in runs]
    return [
        {dimension: name, **row}
        for value, name in enumerate(labels.names)
        for row in (
            *(run_names(run) | _shares(of[value]) for run, of in zip(runs, sums, strict=True) if of[value][0]),
            *reference_rows(index, runs, labels.numbers == value),
        )
    ]


def score_row(run: ScoredRun, iou: float) -> Line:
    """Return the row that the command `score` prints for a run.

    Args:
        run: The scored run.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.

    Returns:
        The scores of the run in percent of the run's questions.
    """
    head = {"run": run.manifest.run_id, "label": run_names(run)["label"]}
    return head | _shares(run.counts.sum(axis=0)) | {"errors": percent_of(run.errors, run.n), "iou": iou}


def _shares(counts: Ints | Floats) -> Line:
    """Return the scores of questions in percent. `counts` has the sums of the columns of `ScoredRun.counts`."""
    n, *right, invalid = counts.astype(np.int64).tolist()
    row = {"n": n} | {name: percent_of(count, n) for name, count in zip(SCORES, right, strict=True)}
    return row | {"hallucination": percent_of(right[0] - right[2], right[0]), "invalid": percent_of(invalid, n)}


# -- the ablation -----------------------------------------------------------------------------------------------------


def ablation_rows(runs: Sequence[ScoredRun]) -> list[Line]:
    """Compute the table `ablation`: scores for each combination of active observation and world model (on or off).

    Args:
        runs: Scored runs. Runs of methods that are not in `CELLS` are ignored.

    Returns:
        One row per run. Rows are grouped by model and setting.
    """
    methods = list(CELLS)
    among = [run for run in runs if run.manifest.method in methods]
    settings = distinguishing_settings(among)
    rows = [
        CELLS[run.manifest.method]
        | run_names(run)
        | {"setting": settings[run.manifest.run_id]}
        | _shares(run.counts.sum(axis=0))
        for run in among
    ]
    # Rows are grouped by model and setting. In a group, the passive cells come first.
    rows.sort(key=lambda row: (row["model"], row["setting"], methods.index(row["method"])))
    return rows


# -- pairs ------------------------------------------------------------------------------------------------------------


def pair_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[Line]:
    """Compare all pairs of runs.

    Args:
        index: The questions of the store, with their labels.
        runs: Scored runs.

    Returns:
        The rows of `rows_of_pairs` for all pairs. The first run of a pair is the one that comes first in alphabetical
        order of method, model and run id.
    """
    # The order of a pair does not depend on scores, so that a difference keeps its sign when scores change.
    return rows_of_pairs(index, list(combinations(sorted(runs, key=_name), 2)))


def rows_of_pairs(index: QuestionIndex, pairs: Sequence[tuple[ScoredRun, ScoredRun]]) -> list[Line]:
    """Compare pairs of runs on their common questions.

    Args:
        index: The questions of the store, with their labels.
        pairs: The pairs of scored runs.

    Returns:
        One row for each pair and each kind of score: the number of questions that only the first run has right, the
        number of questions that only the second run has right, the p-value of the exact McNemar test, and the score of
        the second run minus the score of the first run, in percentage points with an interval. A pair without a common
        question has no row.
    """
    groups: dict[bytes, tuple[Ints, list[int]]] = {}
    for index_of_pair, (first, second) in enumerate(pairs):
        common = np.intersect1d(first.rows, second.rows, assume_unique=True)
        groups.setdefault(common.tobytes(), (common, []))[1].append(index_of_pair)
    rows: dict[int, list[Line]] = {}
    for common, members in groups.values():
        if not len(common):
            continue
        clusters = index.labels["sequence"].numbers[common]
        label = interval_label(len(np.unique(clusters)))
        runs = list(dict.fromkeys(run for member in members for run in pairs[member]))
        scores = [run.scores_of(common) for run in runs]
        indexes = [(runs.index(pairs[member][0]), runs.index(pairs[member][1])) for member in members]
        for member, comparison in zip(members, compare(clusters, scores, indexes), strict=True):
            first, second = pairs[member]
            rows[member] = [
                {"first": first.manifest.run_id, "second": second.manifest.run_id, "score": name, "n": len(common)}
                | {"only_first": only_first, "only_second": only_second, "p": p}
                | with_bounds("difference", difference)
                | {"interval": label}
                for name, (only_first, only_second, p, difference) in zip(SCORES, comparison, strict=True)
            ]
    return [row for member in sorted(rows) for row in rows[member]]


def _name(run: ScoredRun) -> tuple[str, str, str]:
    return run.manifest.method, run.manifest.model, run.manifest.run_id


def ranked(runs: Sequence[ScoredRun]) -> list[ScoredRun]:
    """Sort runs by their combined score, the best run first.

    Partial and diagnostic runs come last, because they are not ranked.

    Args:
        runs: Scored runs.

    Returns:
        The sorted runs. Runs with equal scores are in the order of method, model and run id.
    """
    return sorted(runs, key=lambda run: (not run.is_ranked, -run.scores[:, 2].mean() if run.n else 0.0, *_name(run)))


_COMPUTED: Final = ("iou", "ablation", "gaps", "looks", "pairs", "people", "epochs")
"""Names of the computed tables after the dimensions."""

RESULTS: Final = ("evidence_failures", "cost")
"""Names of the tables that are SQL queries in `queries/results/`."""

PAPER_TABLES: Final = {
    "paper_main": "Table 3 of the paper, the main table",
    "paper_ablation": "Table 4 of the paper, active observation and world model",
    "paper_generators": "Table 5 of the paper, questions per generator",
    "paper_groups": "Table 6 of the paper, its agent by group of questions",
}
"""Titles of the tables that have the paper's figures beside the figures of the store, by name."""


def tables_of(dimensions: Iterable[str]) -> tuple[str, ...]:
    """Return the names of all tables of questions with labels for these dimensions."""
    paper = PAPER_TABLES if "group" in dimensions else ()
    return ("main", "twins", *dimensions, *_COMPUTED, *RESULTS, *paper)


TABLES: Final = tables_of(DIMENSIONS)
"""Names of all tables of generated questions.

`main` has the scores with intervals. `twins` is empty if the questions have no time twins. A dimension's table has the
scores per value."""
