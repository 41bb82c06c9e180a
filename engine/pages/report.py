"""The report page: tables and charts of the scores of runs, and the causes of wrong boxes and choices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

import msgspec

from jrdb_avr.engine.pages.page import render
from jrdb_avr.engine.pages.svg import SQUARE, budget_curves, scatter
from jrdb_avr.engine.report.bootstrap import LEAST_CLUSTERS
from jrdb_avr.engine.report.comparison import Comparison
from jrdb_avr.engine.report.formats import filled, for_paper, paper_caption, with_intervals, without_rough
from jrdb_avr.engine.report.scored_runs import DIMENSIONS, SCORES, distinguishing_settings
from jrdb_avr.engine.report.tables import PAPER_TABLES, TOO_FEW, Line

_TITLES: Final = {name: name.replace("_", " ") for name in DIMENSIONS} | {
    "group": "the paper's groups",
    "time_gap_s": "time gap, seconds",
    "separation_deg": "angular separation, degrees",
}


def report_page(comparison: Comparison, links: Callable[..., str] | None = None, paper: bool = False) -> str:
    """Render the report page.

    Args:
        comparison: The scored runs.
        links: The function `view.address` if `view` shows the page, so that the page links to the other pages of
            `view`. Otherwise None.
        paper: Whether the page has the paper's tables beside the figures of the store.

    Returns:
        The HTML.
    """
    runs = comparison.runs
    tables = {name: without_rough(rows) for name, rows in comparison.tables().items()}
    names = [run.manifest.run_id for run in runs]
    guessers = [row for row in tables["main"] if not row["method"]]
    tables["main"] = [row for row in tables["main"] if row["method"]]
    across = [*names, *(row["run"] for row in guessers)]
    families = pivot(tables["family"], "family", "run")
    return render(
        "report.html",
        names=names,
        comparison=comparison,
        guessers=guessers,
        tables=tables,
        paper={
            paper_caption(name, tables[name]): filled(for_paper(name, tables[name])) for name in PAPER_TABLES if paper
        },
        dots=scatter(tables["main"]),
        families=families,
        about={run.manifest.run_id: {"method": run.manifest.method, "model": run.manifest.model} for run in runs},
        options={
            "method": sorted({run.manifest.method for run in runs}),
            "model": sorted({run.manifest.model for run in runs}),
            "family": list(families),
        },
        square=SQUARE,
        links=links,
        store=comparison.store.path.name,
        breakdowns=[(name, Crossed(tables[name], name, across)) for name in comparison.index.labels],
        ablation=filled(tables["ablation"]),
        causes=list(dict.fromkeys(row["cause"] for row in tables["evidence_failures"])),
        titles=_TITLES,
        curves=budget_curves(tables["looks"]),
        without_bounds=with_intervals,
        apart=distinguishing_settings(runs),
        labels={row["run"]: row["label"] for row in (*tables["main"], *guessers, *tables["twins"])},
        too_few=TOO_FEW,
        least=LEAST_CLUSTERS,
        kinds=SCORES,
        settings=[(run.manifest.run_id, settings_text(run.manifest.settings)) for run in runs],
    )


def pivot(rows: Sequence[Line], down: str, across: str) -> dict[str, dict[str, Line]]:
    """Arrange rows by their values in two columns.

    Args:
        rows: The rows. Each pair of values occurs once.
        down: Name of the column that gives the outer keys.
        across: Name of the column that gives the inner keys.

    Returns:
        A dictionary from each outer key to an inner dictionary. An inner dictionary maps each inner key to a row. All
        keys are in the order of their first appearance in the rows.
    """
    groups: dict[str, dict[str, Line]] = {}
    for row in rows:
        groups.setdefault(row[down], {})[row[across]] = row
    return groups


class Crossed:
    """Table of the scores of runs, broken down by a dimension.

    There is one cell for each pair of a run and a value of the dimension. If there are fewer values than runs, the
    columns are the values. Otherwise the columns are the runs.

    Attributes:
        counts: For each value, the most frequent number of questions (`n`) among the runs. The page shows the `n` of a
            cell only if it differs from this most frequent `n`.
        values_across: True if the columns are the values, False if the columns are the runs.
        across: Names of the columns.
        rows: Name and cells of each row of this table. The cell of a run and a value is the row of `breakdown_rows`
            for this pair, or None if this pair has no row. Guessers are among the runs.
    """

    def __init__(self, rows: Sequence[Line], dimension: str, runs: Sequence[str]) -> None:
        """Arrange rows of `breakdown_rows`."""
        cells = pivot(rows, dimension, "run")
        questions = {
            value: Counter(row["n"] for row in rows_of_value.values() if row["method"])
            for value, rows_of_value in cells.items()
        }
        self.counts = {value: times.most_common(1)[0][0] for value, times in questions.items() if times}
        self.values_across = len(runs) > len(cells)
        self.across = list(cells if self.values_across else runs)
        if self.values_across:
            self.rows = [(run, [rows_of_value.get(run) for rows_of_value in cells.values()]) for run in runs]
        else:
            self.rows = [(value, [rows_of_value.get(run) for run in runs]) for value, rows_of_value in cells.items()]


def settings_text(settings: Line) -> str:
    """Return the settings of a run as text.

    Args:
        settings: The settings, as in the run's manifest.

    Returns:
        The settings as indented JSON with sorted keys.
    """
    return msgspec.json.format(msgspec.json.encode(settings, order="sorted"), indent=2).decode()
