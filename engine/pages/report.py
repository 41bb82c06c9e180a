"""The report page: tables, intervals, answer against evidence, and how runs fail."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

import msgspec

from jrdb_avr.engine.pages.page import render
from jrdb_avr.engine.pages.svg import SQUARE, scatter
from jrdb_avr.engine.report.bootstrap import LEAST_CLUSTERS
from jrdb_avr.engine.report.comparison import Comparison
from jrdb_avr.engine.report.formats import filled, without_rough
from jrdb_avr.engine.report.scored_runs import DIMENSIONS, SCORES, distinguishing_settings
from jrdb_avr.engine.report.tables import TOO_FEW, Row

_TITLES: Final = {name: name.replace("_", " ") for name in DIMENSIONS} | {
    "group": "the paper's groups",
    "time_gap_s": "time gap, seconds",
    "separation_deg": "angular separation, degrees",
}


def report_page(comparison: Comparison, links: Callable[..., str] | None = None) -> str:
    """The page's HTML; `links` makes the addresses of pages that `view` serves, to which runs and pairs then lead."""
    runs = comparison.runs
    tables = {name: without_rough(rows) for name, rows in comparison.tables().items()}
    names = [run.manifest.run_id for run in runs]
    own = [row for row in tables["main"] if row["run"]]
    families = pivot(tables["family"], "family", "run")
    perturbations: Counter[str] = Counter()
    for row in tables["wrong_choices"]:
        perturbations[row["perturbation"]] += row["times"]
    return render(
        "report.html",
        names=names,
        comparison=comparison,
        tables=tables,
        main=own,
        published=[row for row in tables["main"] if not row["run"]],
        dots=scatter(own),
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
        breakdowns=[(name, Crossed(tables[name], name, names)) for name in DIMENSIONS],
        ablation=filled(tables["ablation"]),
        causes=list(dict.fromkeys(row["cause"] for row in tables["evidence_failures"])),
        titles=_TITLES,
        wrong=pivot(tables["wrong_choices"], "run", "perturbation"),
        perturbations=sorted(perturbations, key=lambda name: (-perturbations[name], name)),
        apart=distinguishing_settings(runs),
        labels={row["run"]: row["label"] for row in own},
        too_few=TOO_FEW,
        least=LEAST_CLUSTERS,
        kinds=SCORES,
        settings=[(run.manifest.run_id, settings_text(run.manifest.settings)) for run in runs],
    )


def pivot(rows: Sequence[Row], down: str, across: str) -> dict[str, dict[str, Row]]:
    """Rows by their values in two columns, in the order of first appearance."""
    found: dict[str, dict[str, Row]] = {}
    for row in rows:
        found.setdefault(row[down], {})[row[across]] = row
    return found


class Crossed:
    """A breakdown by run and value of a dimension, the fewer of the two across: each cell a row or None.

    counts: the questions of each value in most runs; cells with another `n` state it.
    """

    def __init__(self, rows: Sequence[Row], dimension: str, runs: Sequence[str]) -> None:
        """Cross the rows of a breakdown by value and run; the paper's are a run named by their label."""
        cells = pivot([row | {"run": row["run"] or row["label"]} for row in rows], dimension, "run")
        questions = {value: Counter(r["n"] for run, r in own.items() if run in runs) for value, own in cells.items()}
        self.counts = {value: times.most_common(1)[0][0] for value, times in questions.items() if times}
        names = [*runs, *(["paper"] if any(not row["run"] for row in rows) else [])]
        self.values_across = len(names) > len(cells)
        self.across = list(cells) if self.values_across else names
        if self.values_across:
            self.rows = [(run, [own.get(run) for own in cells.values()]) for run in names]
        else:
            self.rows = [(value, [own.get(run) for run in names]) for value, own in cells.items()]


def settings_text(settings: Row) -> str:
    """A run's settings as JSON that people can read."""
    return msgspec.json.format(msgspec.json.encode(settings, order="sorted"), indent=2).decode()
