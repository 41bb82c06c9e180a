"""Scores and comparisons of runs: the library functions `score`, `report` and `diff`, and their results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.report import formats
from jrdb_avr.engine.report.epochs import epoch_rows
from jrdb_avr.engine.report.looking import THRESHOLDS, gap_rows, iou_rows, look_rows
from jrdb_avr.engine.report.people import agreement_rows
from jrdb_avr.engine.report.run_scores import read_submission, score_runs, write_scores
from jrdb_avr.engine.report.scored_runs import SCORES, QuestionIndex, ScoredRun, read_index
from jrdb_avr.engine.report.side_by_side import paper_rows
from jrdb_avr.engine.report.tables import (
    PAPER_TABLES,
    RESULTS,
    Line,
    ablation_rows,
    breakdown_rows,
    main_rows,
    pair_rows,
    ranked,
    rows_of_pairs,
    score_row,
    tables_of,
)
from jrdb_avr.engine.report.time_grounding import twin_rows
from jrdb_avr.engine.report.truth import read_truth
from jrdb_avr.queries.display import Displayed, Tables
from jrdb_avr.queries.named import named_queries
from jrdb_avr.queries.runs import run_ids
from jrdb_avr.queries.sql import open_tables, query_tables
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.arrays import Digits, Ints
from jrdb_avr.schema.errors import InputError, StoreError, did_you_mean

_OF_RUNS: Final = {
    "twins": twin_rows,
    "gaps": gap_rows,
    "looks": look_rows,
    "pairs": pair_rows,
    "people": agreement_rows,
}
"""Functions of the tables that depend on the questions and the runs alone, by name."""


@dataclass(frozen=True, repr=False)
class Scores(Displayed):
    """Scores of runs, in percent of the questions of each run. `rows` has one row per run."""

    rows: list[Line]

    def _summary(self) -> str:
        return f"{len(self.rows)} runs"

    def _tables(self) -> Tables:
        return {"Scores in percent": self.rows}


@dataclass(frozen=True, repr=False)
class Comparison(Displayed):
    """Scored runs side by side.

    Attributes:
        store: The store of the runs.
        index: The questions of the store, with their labels.
        runs: The scored runs, the best run first.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.
        backbone: The paper's name for the model of the runs that no alias matches, or "".
    """

    store: Store
    index: QuestionIndex
    runs: list[ScoredRun]
    iou: float
    backbone: str

    @property
    def scores(self) -> pa.Table:
        """Rows of the table `scores` for all runs. The function `score` writes the same rows to files."""
        return pa.concat_tables(run.table for run in self.runs)

    @property
    def synthetic(self) -> bool:
        """Whether at least one run used the simulated model or the sample world.

        The scores of such a run do not describe JRDB.
        """
        return any(run.manifest.synthetic for run in self.runs)

    def table(self, name: str = "main") -> list[Line]:
        """Compute one table of the report.

        Args:
            name: A member of `names`.

        Returns:
            The rows of the table.

        Raises:
            InputError: If no table has this name.
        """
        return self.tables([name])[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all tables of the report."""
        return tables_of(self.index.labels)

    def tables(self, names: Sequence[str] | None = None) -> dict[str, list[Line]]:
        """Compute several tables of the report. All tables that SQL queries compute share one connection.

        Args:
            names: Members of `names`, or None for all.

        Returns:
            A dict from the name of each table to the rows of this table.

        Raises:
            InputError: If there is no table of a name.
        """
        names = self.names if names is None else names
        for name in names:
            if name not in self.names:
                raise InputError(f"no table {name!r}; there are {', '.join(self.names)}", field="table")
        computed = {name: self._computed(name) for name in names if name not in RESULTS}
        return computed | self._results([name for name in names if name in RESULTS])

    def _computed(self, name: str) -> list[Line]:
        index, runs = self.index, self.runs
        match name:
            case "main":
                return main_rows(index, runs, self.iou)
            case "ablation":
                return ablation_rows(runs)
            case "iou":
                ids = [run.manifest.run_id for run in runs]
                return iou_rows({iou: _scored(self.store, ids, iou) for iou in THRESHOLDS})
            case "epochs":
                return epoch_rows(runs)
        if name in _OF_RUNS:
            return _OF_RUNS[name](index, runs)
        if name in PAPER_TABLES:
            return paper_rows(name, index, runs, self.backbone)
        return breakdown_rows(index, runs, name)

    def _results(self, names: Sequence[str]) -> dict[str, list[Line]]:
        """Return the rows that queries of `queries/results/` find for the runs of this comparison.

        The key of each list of rows is the name of the query. The rows of each query are in the order of `self.runs`.
        """
        if not names:
            return {}
        order = {run.manifest.run_id: index for index, run in enumerate(self.runs)}
        with open_tables(self.store.path, {"scores": self.scores}) as select:
            results = {
                name: select(named_queries("sql")[name].text).rename_columns({"run_id": "run"}) for name in names
            }
        return {name: sorted(table.to_pylist(), key=lambda row: order[row["run"]]) for name, table in results.items()}

    def causes(self) -> dict[tuple[str, str], str]:
        """Find the cause for each evidence box that scores 0. The table `evidence_failures` counts the boxes per cause.

        Returns:
            The cause for each box that scores 0, by run id and question id.
        """
        # The last SELECT of the query counts the causes, so it is replaced.
        judged, _, _ = named_queries("sql")["evidence_failures"].text.rpartition("\nSELECT ")
        text = f"{judged}\nSELECT run_id, question_id, cause FROM judged JOIN causes USING (place)"
        rows = query_tables(self.store.path, text, tables={"scores": self.scores}).to_pylist()
        return {(row["run_id"], row["question_id"]): row["cause"] for row in rows}

    def markdown(self, name: str = "main") -> str:
        """Return a table in Markdown, with the columns that a paper prints.

        Args:
            name: A member of `names`.

        Returns:
            The Markdown text.
        """
        return formats.markdown(formats.for_paper(name, self.table(name)))

    def latex(self, name: str = "main") -> str:
        """Return a table in LaTeX for the package booktabs, with the columns that a paper prints.

        Args:
            name: A member of `names`.

        Returns:
            A `tabular` environment, and notes below it if the table has settings.
        """
        rows = self.table(name)
        return formats.latex(formats.for_paper(name, rows), formats.paper_caption(name, rows))

    def _summary(self) -> str:
        return f"{len(self.runs)} runs, evidence from IoU {self.iou:g} on"

    def _tables(self) -> Tables:
        return {"Runs in percent [95 % interval]": formats.with_intervals(self.table())}


def score(store: Store | str | Path, runs: Sequence[str] = (), iou: float = 0.5) -> Scores:
    """Score runs, and write the file `runs/<run_id>/scores.parquet` for each scored run.

    Args:
        store: The store, or its folder.
        runs: Ids of the runs. If empty, all runs of the store.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.

    Returns:
        The scores of each run, the best run first.

    Raises:
        StoreError: If `runs` names a run that cannot be scored, or if no run can be scored. If `runs` is empty, a run
            that cannot be scored is left out with an AvrWarning.
    """
    store = Store.of(store)
    rows = []
    for run in _scored(store, runs, iou):
        write_scores(store, run, iou)
        rows.append(score_row(run, iou))
    return Scores(rows)


def report(store: Store | str | Path, runs: Sequence[str] = (), *, iou: float = 0.5, backbone: str = "") -> Comparison:
    """Score runs and compare them in tables. Stored scores are not used, and nothing is written.

    Args:
        store: The store, or its folder.
        runs: Ids of the runs. If empty, all runs of the store.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.
        backbone: In the tables of `PAPER_TABLES`, the paper's name for the model of the runs that no alias matches.
            Runs of the simulated model and of the sample are in these tables only under this name.

    Returns:
        The comparison, which computes each table on request.

    Raises:
        StoreError: If `runs` names a run that cannot be scored, or if no run can be scored. If `runs` is empty, a run
            that cannot be scored is left out with an AvrWarning.
    """
    store = Store.of(store)
    return Comparison(store, read_index(store), _scored(store, runs, iou), iou, backbone)


@dataclass(frozen=True, repr=False)
class RunDifference(Displayed):
    """Comparison of two scored runs on their common questions.

    `rows` has one row of `rows_of_pairs` for each kind of score.
    """

    index: QuestionIndex
    first: ScoredRun
    second: ScoredRun
    rows: list[Line]

    @property
    def synthetic(self) -> bool:
        """Whether at least one of the runs used the simulated model or the sample world."""
        return self.first.manifest.synthetic or self.second.manifest.synthetic

    def scores(self) -> list[Line]:
        """Compare the scores of both runs on their common questions.

        Returns:
            One row per kind of score: the score of each run in percent, the difference of these scores in percentage
            points with its interval, the number of questions that only the first run has right, the number of questions
            that only the second run has right, and the p-value of the McNemar test.
        """
        _, first, second = self._common()
        first_means, second_means = ((100 * scores.mean(axis=0)).round(2).tolist() for scores in (first, second))
        return [
            {"score": row["score"], "n": row["n"], "first": first_means[index], "second": second_means[index]}
            | {name: row[name] for name in row if name.startswith("difference")}
            | {"only first": row["only_first"], "only second": row["only_second"]}
            | {"p": row["p"], "interval": row["interval"]}
            for index, row in enumerate(self.rows)
        ]

    def questions(self, score: str = "combined") -> list[Line]:
        """Return the questions that one run has right and the other run has wrong.

        Args:
            score: The kind of score to compare, a name of `SCORES`.

        Returns:
            One row per question. A row has the id, the template and the sequence of the question. The column `only` has
            the id of the run that scores 1. A column for each run says what is right in this run: "answer", "evidence",
            "both" or "none". Questions that the first run has right come first.

        Raises:
            InputError: If no score has this name.
        """
        if score not in SCORES:
            raise InputError(f"no score {score!r}{did_you_mean(score, SCORES)}", field="score")
        common, first, second = self._common()
        column = SCORES.index(score)
        names = (self.first.manifest.run_id, self.second.manifest.run_id)
        rows = []
        for index in np.flatnonzero(first[:, column] != second[:, column]).tolist():
            row = int(common[index])
            labels = ((name, self.index.labels[name]) for name in ("template", "sequence"))
            rows.append(
                {"question_id": self.index.ids[row].as_py(), "only": names[int(second[index, column])]}
                | {name: entry.names[entry.numbers[row]] for name, entry in labels}
                | {"first right": _right(first[index]), "second right": _right(second[index])}
            )
        return sorted(rows, key=lambda entry: (names.index(entry["only"]), entry["template"], entry["question_id"]))

    def _common(self) -> tuple[Ints, Digits, Digits]:
        """Return the questions that both runs have, and the scores of each run for these questions.

        Returns:
            Three arrays. The first has the row numbers in `index` of the common questions. The second has the scores of
            the first run, and the third has the scores of the second run. Arrays of scores have one row per common
            question and one column per kind of score.
        """
        common = np.intersect1d(self.first.rows, self.second.rows)
        return common, self.first.scores_of(common), self.second.scores_of(common)

    def _summary(self) -> str:
        n = self.rows[0]["n"]
        return f"{self.first.manifest.run_id} and {self.second.manifest.run_id} on {n} questions"

    def _tables(self) -> Tables:
        return {"Pair": formats.with_intervals(self.rows)}


def _right(scores: Digits) -> str:
    right = [name for name, score in zip(("answer", "evidence"), scores.tolist(), strict=False) if score]
    return "both" if len(right) == 2 else "".join(right) or "none"


def diff(store: Store | str | Path, first: str, second: str, *, iou: float = 0.5) -> RunDifference:
    """Compare two runs of a store question by question. Nothing is written.

    Args:
        store: The store, or its folder.
        first: Id of the first run.
        second: Id of the second run.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.

    Returns:
        The comparison of the two runs.

    Raises:
        StoreError: If a run cannot be scored, or if the runs have no common question.
    """
    store = Store.of(store)
    index = read_index(store)
    runs = {run.manifest.run_id: run for run in _scored(store, (first, second), iou)}
    rows = rows_of_pairs(index, [(runs[first], runs[second])])
    if not rows:
        raise StoreError(f"{first} and {second} have no question in common")
    return RunDifference(index, runs[first], runs[second], rows)


def _scored(store: Store, names: Sequence[str], iou: float) -> list[ScoredRun]:
    """Score runs, and return the scored runs. The best run comes first."""
    ids = run_ids(store)
    if not ids:
        raise StoreError(f"{store.path} has no runs yet: run 'jrdb-avr evaluate --store {store.path} ...'")
    store.warn_of_training()
    # Stored scores are not used, because they may have another IoU threshold. Scoring takes only milliseconds.
    # Repeated names are dropped, because the tables that are SQL queries would count such a run twice.
    runs = [*dict.fromkeys(names or ids)]
    read = partial(read_submission, store)
    done = [run for _, run in score_runs(read_truth(store), runs, read, iou, strict=bool(names))]
    if not done:
        raise StoreError(f"no run of {store.path} can be scored: evaluate the questions that the store has now")
    return ranked(done)
