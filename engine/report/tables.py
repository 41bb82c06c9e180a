"""The tables of a report, by name: rows of plain values in percent of `n`, the number of questions.

A value is None (printed as n/a) where n is 0.
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

_CELLS: Final[dict[str, Row]] = {
    "agent-passive-no-world": {"active": "off", "world_model": "off"},
    "agent-passive": {"active": "off", "world_model": "on"},
    "agent-no-world": {"active": "on", "world_model": "off"},
    "agent": {"active": "on", "world_model": "on"},
}
"""Cells of the ablation, active observation by world model, by method."""

# -- the main table ---------------------------------------------------------------------------------------------------


def main_rows(index: QuestionIndex, runs: Sequence[ScoredRun], iou: float) -> list[Row]:
    """A row per run: shares with 95 % intervals over sequences, and macro averages over families and paper groups."""
    settings = distinguishing_settings(runs)
    return [_main_row(index, run, iou, settings[run.manifest.run_id]) for run in runs]


def _main_row(index: QuestionIndex, run: ScoredRun, iou: float, setting: str) -> Row:
    # Columns: the questions, the three scores, the answers without evidence.
    base = np.concatenate([np.ones((run.n, 1)), run.scores, run.scores[:, :1] - run.scores[:, 2:]], axis=1)
    found, cluster = np.unique(index.labels["sequence"].numbers[run.rows], return_inverse=True)
    sums = [numbered_sums(cluster, len(found), base)]
    statistics = {name: mean_ratio((place, 0)) for place, name in enumerate(SCORES, 1)}
    statistics["hallucination"] = mean_ratio((4, 1))
    column = base.shape[1]
    for title, dimension in (("families", "family"), ("groups", "group")):
        labels = index.labels[dimension]
        count = len(labels.names)
        parts = numbered_sums(cluster * count + labels.numbers[run.rows], len(found) * count, base[:, :4])
        sums.append(parts.reshape(len(found), 4 * count))
        for place, name in enumerate(SCORES, 1):
            places = [(column + 4 * k + place, column + 4 * k) for k in range(count)]
            statistics[f"{name}_macro_{title}"] = mean_ratio(*places)
        column += 4 * count
    shares = intervals(np.concatenate(sums, axis=1), tuple(statistics.values()))
    bounds = {name: _with_bounds(name, share) for name, share in zip(statistics, shares, strict=True)}
    row = _head(run) | {"setting": setting, "n": run.n, "sequences": len(found), "interval": interval_label(len(found))}
    for name in (*SCORES, "hallucination"):
        row |= bounds.pop(name)
    row |= {"invalid": percent_of(int(run.invalid.sum()), run.n), "errors": percent_of(run.errors, run.n)}
    for macro in bounds.values():
        row |= macro
    return row | {"iou": iou}


def interval_label(sequences: int) -> str:
    """What the intervals of a row are: at 95 %, or `TOO_FEW`, with which tables for people leave them out."""
    return INTERVALS if sequences >= LEAST_CLUSTERS else TOO_FEW


def _head(run: ScoredRun) -> Row:
    manifest = run.manifest
    label = "synthetic" if manifest.synthetic else ""
    return {"run": manifest.run_id, "method": manifest.method, "model": manifest.model, "label": label}


def _percent(share: float | None) -> float | None:
    return None if share is None or math.isnan(share) else round(100 * share, 2)


def _with_bounds(name: str, found: Interval) -> Row:
    return {name: _percent(found.value), f"{name}_low": _percent(found.low), f"{name}_high": _percent(found.high)}


def published_rows() -> list[Row]:
    """The paper's main table, in the columns of `main_rows` that it has."""
    return [_published(row) for row in MAIN]


def _published(row: Published) -> Row:
    n = sum(counts.n for counts in GROUPS.values())
    return {"run": "", "method": row.method, "model": row.model, "label": "paper", "n": n} | row._asdict()


# -- breakdowns -------------------------------------------------------------------------------------------------------


def breakdown_rows(index: QuestionIndex, runs: Sequence[ScoredRun], dimension: str) -> list[Row]:
    """A row per value of a dimension and run, the runs of a value together."""
    labels = index.labels[dimension]
    columns = [np.concatenate([np.ones((run.n, 1)), run.scores, run.invalid[:, None]], axis=1) for run in runs]
    sums = [
        numbered_sums(labels.numbers[run.rows], len(labels.names), own).astype(np.int64).tolist()
        for run, own in zip(runs, columns, strict=True)
    ]
    return [
        {dimension: name, **_head(run), **_shares(*own[number])}
        for number, name in enumerate(labels.names)
        for run, own in zip(runs, sums, strict=True)
        if own[number][0]
    ]


def published_groups() -> list[Row]:
    """The paper's agent by its groups, in the columns of `breakdown_rows`."""
    return [
        {"group": group, "run": "", "method": "agent", "model": "Qwen3.5 9B", "label": "paper", "n": counts.n}
        | {name: percent_of(getattr(counts, name), counts.n) for name in SCORES}
        | {"hallucination": percent_of(counts.answer - counts.combined, counts.answer)}
        for group, counts in GROUPS.items()
    ]


def score_row(run: ScoredRun, iou: float) -> Row:
    """The row of `score`: a run's scores in percent of its questions."""
    head = {"run": run.manifest.run_id, "label": _head(run)["label"]}
    return head | _shares(*_totals(run)) | {"errors": percent_of(run.errors, run.n), "iou": iou}


def _totals(run: ScoredRun) -> list[int]:
    """The arguments of `_shares` for a whole run."""
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
    """The cells, active observation by world model by policy, of every model that ran one of them."""
    places = list(_CELLS)
    among = [run for run in runs if run.manifest.method in places]
    settings: dict[str, str] = {}
    for policy in {_policy(run) for run in among}:
        # A policy brings settings of its own, which tell no more than its column does.
        settings |= distinguishing_settings([run for run in among if _policy(run) == policy])
    rows = [
        _CELLS[run.manifest.method]
        | {"policy": _policy(run)}
        | _head(run)
        | {"setting": settings[run.manifest.run_id]}
        | _shares(*_totals(run))
        for run in among
    ]
    # The cells of a model stand together, and of those the ones of one setting, the passive ones first.
    rows.sort(key=lambda row: (row["model"], row["setting"], places.index(row["method"]), row["policy"]))
    if published:
        rows += [cell | {"policy": "model"} | _published(ABLATION[method]) for method, cell in _CELLS.items()]
    return rows


def _policy(run: ScoredRun) -> str:
    """Who chose the looks of an agent's run."""
    return str(run.manifest.settings.get("method", {}).get("policy", "model"))


# -- pairs ------------------------------------------------------------------------------------------------------------


def pair_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[Row]:
    """For each two runs and score, on their common questions: the exact McNemar test and the difference."""
    # Which of two is the first does not depend on their scores, so that a difference keeps its sign.
    return rows_of_pairs(index, list(combinations(sorted(runs, key=_name), 2)))


def rows_of_pairs(index: QuestionIndex, of: Sequence[tuple[ScoredRun, ScoredRun]]) -> list[Row]:
    """The rows of `pair_rows` for these pairs; none for one without common questions."""
    groups: dict[bytes, tuple[Ints, list[int]]] = {}
    for number, (first, second) in enumerate(of):
        common = np.intersect1d(first.rows, second.rows, assume_unique=True)
        groups.setdefault(common.tobytes(), (common, []))[1].append(number)
    found: dict[int, list[Row]] = {}
    for common, numbers in groups.values():
        if not len(common):
            continue
        clusters = index.labels["sequence"].numbers[common]
        label = interval_label(len(np.unique(clusters)))
        place = {run: place for place, run in enumerate({run: None for number in numbers for run in of[number]})}
        scores = [run.scores[np.searchsorted(run.rows, common)] for run in place]
        pairs = compare(clusters, scores, [(place[of[own][0]], place[of[own][1]]) for own in numbers])
        for number, pair in zip(numbers, pairs, strict=True):
            first, second = of[number]
            found[number] = [
                {"first": first.manifest.run_id, "second": second.manifest.run_id, "score": name, "n": len(common)}
                | {"only_first": only_first, "only_second": only_second, "p": p}
                | _with_bounds("difference", difference)
                | {"interval": label}
                for name, (only_first, only_second, p, difference) in zip(SCORES, pair, strict=True)
            ]
    return [row for number in sorted(found) for row in found[number]]


def _name(run: ScoredRun) -> tuple[str, str, str]:
    return run.manifest.method, run.manifest.model, run.manifest.run_id


def ranked(runs: Sequence[ScoredRun]) -> list[ScoredRun]:
    """The runs by their share of combined, the best first; equal ones by method, model and id."""
    return sorted(runs, key=lambda run: (-run.scores[:, 2].mean() if run.n else 0.0, *_name(run)))


RESULTS: Final = ("wrong_choices", "evidence_failures", "cost")
"""Tables that are queries of `queries/results/`."""

TABLES: Final = ("main", *DIMENSIONS, "ablation", "pairs", "people", "epochs", *RESULTS)
"""`main`: shares with intervals and macro averages; a dimension's name: a breakdown by it."""
