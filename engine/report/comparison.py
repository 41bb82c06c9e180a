"""Score and compare runs: the library functions `score` and `report`, and their results."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.report import formats
from jrdb_avr.engine.report.epochs import epoch_rows
from jrdb_avr.engine.report.people import agreement_rows
from jrdb_avr.engine.report.run_scores import make_scores_table, read_submission, score_runs, write_scores
from jrdb_avr.engine.report.scored_runs import SCORES, QuestionIndex, ScoredRun, read_index
from jrdb_avr.engine.report.tables import (
    RESULTS,
    TABLES,
    Row,
    ablation_rows,
    breakdown_rows,
    main_rows,
    pair_rows,
    published_groups,
    published_rows,
    ranked,
    rows_of_pairs,
    score_row,
)
from jrdb_avr.engine.report.truth import read_truth
from jrdb_avr.queries.display import Displayed, Tables
from jrdb_avr.queries.named import named_queries
from jrdb_avr.queries.runs import run_ids
from jrdb_avr.queries.sql import open_tables, query_tables
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.arrays import Digits, Ints
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError, did_you_mean


@dataclass(frozen=True, repr=False)
class Scores(Displayed):
    """Scores of runs, in percent of their questions: `rows` holds one row per run."""

    rows: list[Row]

    def _summary(self) -> str:
        return f"{len(self.rows)} runs"

    def _tables(self) -> Tables:
        return {"Scores in percent": self.rows}


@dataclass(frozen=True, repr=False)
class Comparison(Displayed):
    """Scored runs side by side. `paper` adds the paper's figures to the tables that have some."""

    store: Store
    index: QuestionIndex
    runs: list[ScoredRun]
    iou: float
    paper: bool

    @property
    def scores(self) -> pa.Table:
        """The rows of all runs, as `score` would write them."""
        return pa.concat_tables(map(make_scores_table, self.runs))

    @property
    def synthetic(self) -> bool:
        """Whether a run is of the simulated model or on the sample world, and so no result about JRDB."""
        return any(run.manifest.synthetic for run in self.runs)

    def table(self, name: str = "main") -> list[Row]:
        """The rows of one table of `engine.report.tables.TABLES`. Raises InputError for another name."""
        return self.tables([name])[name]

    def tables(self, names: Sequence[str] = TABLES) -> dict[str, list[Row]]:
        """The rows of several tables by name, quicker than one by one. Raises InputError for a name of none."""
        for name in names:
            if name not in TABLES:
                raise InputError(f"no table {name!r}; there are {', '.join(TABLES)}", field="table")
        own = {name: self._computed(name) for name in names if name not in RESULTS}
        return own | self._results([name for name in names if name in RESULTS])

    def _computed(self, name: str) -> list[Row]:
        index, runs = self.index, self.runs
        match name:
            case "main":
                return main_rows(index, runs, self.iou) + (published_rows() if self.paper else [])
            case "ablation":
                return ablation_rows(runs, published=self.paper)
            case "pairs":
                return pair_rows(index, runs)
            case "people":
                return agreement_rows(index, runs)
            case "epochs":
                return epoch_rows(runs)
        return breakdown_rows(index, runs, name) + (published_groups() if self.paper and name == "group" else [])

    def _results(self, names: Sequence[str]) -> dict[str, list[Row]]:
        """The rows of queries of `queries/results/` over these runs, in their order."""
        if not names:
            return {}
        place = {run.manifest.run_id: place for place, run in enumerate(self.runs)}
        with open_tables(self.store.path, {"scores": self.scores}) as select:
            found = {name: select(named_queries("sql")[name].text).rename_columns({"run_id": "run"}) for name in names}
        return {name: sorted(table.to_pylist(), key=lambda row: place[row["run"]]) for name, table in found.items()}

    def causes(self) -> dict[tuple[str, str], str]:
        """Why each box that does not score fails, by run and question: what the table `evidence_failures` counts."""
        # All of that query but the SELECT that counts.
        judged, _, _ = named_queries("sql")["evidence_failures"].text.rpartition("\nSELECT ")
        text = f"{judged}\nSELECT run_id, question_id, cause FROM judged JOIN causes USING (place)"
        rows = query_tables(self.store.path, text, tables={"scores": self.scores}).to_pylist()
        return {(row["run_id"], row["question_id"]): row["cause"] for row in rows}

    def markdown(self, name: str = "main") -> str:
        """A table in Markdown, in the columns of a paper."""
        return formats.markdown(formats.for_paper(name, self.table(name)))

    def latex(self, name: str = "main") -> str:
        """A table in LaTeX for the package booktabs, in the columns of a paper."""
        return formats.latex(formats.for_paper(name, self.table(name)))

    def _summary(self) -> str:
        return f"{len(self.runs)} runs, evidence from IoU {self.iou:g} on"

    def _tables(self) -> Tables:
        return {"Runs in percent [95 % interval]": formats.with_intervals(self.table())}


def score(store: Store | str | Path, runs: Sequence[str] = (), iou: float = 0.5) -> Scores:
    """Score runs (all without names) and write `runs/<run_id>/scores.parquet`; evidence counts from `iou` on.

    Raises StoreError for a named run that cannot be scored; of all runs, such a one is left out with an AvrWarning.
    """
    store = Store.of(store)
    rows = []
    for run in _scored(store, runs, iou):
        write_scores(store, run, iou)
        rows.append(score_row(run, iou))
    return Scores(rows)


def report(store: Store | str | Path, runs: Sequence[str] = (), *, iou: float = 0.5, paper: bool = False) -> Comparison:
    """Compare runs (all without names) in tables; scores are computed anew and nothing is written.

    Raises StoreError for a named run that cannot be scored; of all runs, such a one is left out with an AvrWarning.
    """
    store = Store.of(store)
    return Comparison(store, read_index(store), _scored(store, runs, iou), iou, paper)


@dataclass(frozen=True, repr=False)
class RunDifference(Displayed):
    """Two scored runs on the questions that both have; `rows` holds a row per score, as the table `pairs`."""

    index: QuestionIndex
    first: ScoredRun
    second: ScoredRun
    rows: list[Row]

    @property
    def synthetic(self) -> bool:
        """Whether a run is of the simulated model or on the sample world."""
        return self.first.manifest.synthetic or self.second.manifest.synthetic

    def scores(self) -> list[Row]:
        """A row per score: those of either run on the common questions, in percent; their difference in points, how
        many questions one alone scores, and p, as in `rows`."""
        _, first, second = self._common()
        mine, yours = ((100 * own.mean(axis=0)).round(2).tolist() for own in (first, second))
        return [
            {
                "score": row["score"],
                "n": row["n"],
                "first": mine[place],
                "second": yours[place],
                **{name: value for name, value in row.items() if name.startswith("difference")},
                "only first": row["only_first"],
                "only second": row["only_second"],
                "p": row["p"],
                "interval": row["interval"],
            }
            for place, row in enumerate(self.rows)
        ]

    def questions(self, score: str = "combined") -> list[Row]:
        """The questions that one run scores and the other does not, those of the first run before: a row each, with
        what either gets right. Raises InputError for an unknown score."""
        if score not in SCORES:
            raise InputError(f"no score {score!r}{did_you_mean(score, SCORES)}", field="score")
        common, first, second = self._common()
        place = SCORES.index(score)
        names = (self.first.manifest.run_id, self.second.manifest.run_id)
        found = []
        for number in np.flatnonzero(first[:, place] != second[:, place]).tolist():
            row = int(common[number])
            labels = {name: own.names[own.numbers[row]] for name, own in self.index.labels.items()}
            found.append(
                {
                    "question_id": self.index.ids[row].as_py(),
                    "only": names[int(second[number, place])],
                    "template": labels["template"],
                    "sequence": labels["sequence"],
                    **{f"{who} right": _right(own[number]) for who, own in (("first", first), ("second", second))},
                }
            )
        return sorted(found, key=lambda own: (names.index(own["only"]), own["template"], own["question_id"]))

    def _common(self) -> tuple[Ints, Digits, Digits]:
        """The common questions' rows of the index, and the scores of either run there (questions, scores)."""
        common, mine, yours = np.intersect1d(self.first.rows, self.second.rows, return_indices=True)
        return common, self.first.scores[mine], self.second.scores[yours]

    def _summary(self) -> str:
        n = self.rows[0]["n"]
        return f"{self.first.manifest.run_id} and {self.second.manifest.run_id} on {n} questions"

    def _tables(self) -> Tables:
        return {"Pair": formats.with_intervals(self.rows)}


def _right(scores: Digits) -> str:
    right = [name for name, own in zip(("answer", "evidence"), scores.tolist(), strict=False) if own]
    return "both" if len(right) == 2 else "".join(right) or "none"


def diff(store: Store | str | Path, first: str, second: str, *, iou: float = 0.5) -> RunDifference:
    """Compare two runs of a store question by question; nothing is written.

    Raises StoreError for a run that is missing or cannot be scored, and for two without a common question.
    """
    store = Store.of(store)
    index = read_index(store)
    runs = {run.manifest.run_id: run for run in _scored(store, (first, second), iou)}
    rows = rows_of_pairs(index, [(runs[first], runs[second])])
    if not rows:
        raise StoreError(f"{first} and {second} have no question in common")
    return RunDifference(index, runs[first], runs[second], rows)


def _scored(store: Store, names: Sequence[str], iou: float) -> list[ScoredRun]:
    """The runs with their scores, the best run first."""
    known = run_ids(store)
    if not known:
        raise StoreError(f"{store.path} has no runs yet: run 'jrdb-avr evaluate --store {store.path} ...'")
    store.warn_of_training()

    def refuse(error: StoreError | InputError) -> None:
        if names:
            raise error
        warnings.warn(f"left out: {error}", AvrWarning, stacklevel=3)

    # Scoring takes milliseconds, so scores of an earlier threshold or question file are never trusted.
    # Tables that are queries would add up the rows of a run that is named twice.
    runs = [*dict.fromkeys(names or known)]
    done = [run for _, run in score_runs(read_truth(store), runs, partial(read_submission, store), iou, refuse)]
    if not done:
        raise StoreError(f"no run of {store.path} can be scored: evaluate on the store's present questions")
    return ranked(done)
