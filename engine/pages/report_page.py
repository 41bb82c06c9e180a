"""The report as a page: tables, interval plots, answer against evidence, and how runs fail."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.engine.pages.page import render
from jrdb_avr.engine.pages.svg import SQUARE, TICKS, Part, intervals, scatter, stacked, tags
from jrdb_avr.engine.report.failures import CAUSES
from jrdb_avr.engine.report.formats import filled
from jrdb_avr.engine.report.scored_runs import DIMENSIONS, SCORES, Facts, Judged, told_apart
from jrdb_avr.engine.report.scoring import Truth
from jrdb_avr.engine.report.tables import report_table
from jrdb_avr.queries.store import Store

_TITLES: Final = {name: name.replace("_", " ") for name in DIMENSIONS} | {
    "group": "the paper's groups",
    "time_gap_s": "time gap, seconds",
    "separation_deg": "angular separation, degrees",
}

_OPEN_PAIRS: Final = 12
"""More pairs of runs than these are folded away."""


@dataclass(frozen=True)
class Crossed:
    """A breakdown by run and value of the dimension, the fewer of the two across: each cell a row or None.

    counts: the questions of each value, as most runs were asked them; cells that have another `n` say so.
    """

    across: tuple[str, ...]
    rows: tuple[tuple[str, tuple[dict[str, Any] | None, ...]], ...]
    counts: dict[str, int]
    values_across: bool


def report_page(
    store: Store, truth: Truth, facts: Facts, runs: Sequence[Judged], iou: float, *, published: bool = False
) -> str:
    """The page's HTML."""

    def table(name: str) -> list[dict[str, Any]]:
        return report_table(name, store, truth, facts, runs, iou, published=published)

    main = table("main")
    names = tuple(run.manifest.run_id for run in runs)
    own = [row for row in main if row["run"]]
    dots = scatter(own)
    failures = table("evidence_failures")
    return render(
        "report.html",
        runs=runs,
        iou=iou,
        synthetic=any(run.manifest.synthetic for run in runs),
        main=own,
        published=[row for row in main if not row["run"]],
        chart=intervals(own),
        dots=dots,
        tags=tags(dots),
        square=SQUARE,
        breakdowns=[(name, crossed(table(name), name, names)) for name in DIMENSIONS],
        ablation=filled(table("ablation")),
        pairs=paired(table("pairs")),
        open_pairs=_OPEN_PAIRS,
        boxes=[(name, _causes(failures, name)) for name in names],
        causes=CAUSES,
        failures=failures,
        titles=_TITLES,
        wrong=wrong_choices(table("wrong_choices"), names),
        apart=told_apart(runs),
        labels={row["run"]: row["label"] for row in own},
        ticks=TICKS,
        kinds=SCORES,
        cost=table("cost"),
        settings=[(run.manifest.run_id, _pretty(run.manifest.settings)) for run in runs],
    )


def crossed(rows: Sequence[dict[str, Any]], dimension: str, runs: Sequence[str]) -> Crossed:
    """A breakdown's rows, by value and run; the paper's stand last, under a name of their own."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(row[dimension], {})[row["run"] or row["label"]] = row
    asked = {value: Counter(row["n"] for row in own.values() if row["run"]) for value, own in found.items()}
    counts = {value: times.most_common(1)[0][0] for value, times in asked.items() if times}
    names, values = (*runs, *(["paper"] if any(not row["run"] for row in rows) else [])), tuple(found)
    if len(names) > len(values):
        lines = tuple((run, tuple(found[value].get(run) for value in values)) for run in names)
        return Crossed(values, lines, counts, values_across=True)
    lines = tuple((value, tuple(own.get(run) for run in names)) for value, own in found.items())
    return Crossed(names, lines, counts, values_across=False)


def paired(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row per two runs, with the row of each score under its name."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        names = {"first": row["first"], "second": row["second"], "n": row["n"]}
        found.setdefault((row["first"], row["second"]), names)[row["score"]] = row
    return list(found.values())


@dataclass(frozen=True)
class WrongChoices:
    """What the wrong choices of each run are true of: perturbations across, the commonest first; cells are rows."""

    across: tuple[str, ...]
    rows: tuple[tuple[str, int, tuple[dict[str, Any] | None, ...]], ...]


def wrong_choices(rows: Sequence[dict[str, Any]], runs: Sequence[str]) -> WrongChoices:
    """A row per run that has wrong choices."""
    times: Counter[str] = Counter()
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        times[row["perturbation"]] += row["times"]
        found.setdefault(row["run"], {})[row["perturbation"]] = row
    across = tuple(sorted(times, key=lambda name: (-times[name], name)))
    own = [(run, found[run]) for run in runs if run in found]
    return WrongChoices(
        across,
        tuple(
            (run, next(iter(by.values()))["wrong_choices"], tuple(by.get(name) for name in across)) for run, by in own
        ),
    )


def _causes(rows: Sequence[dict[str, Any]], run: str) -> tuple[Part, ...]:
    own = [row for row in rows if row["run"] == run]
    return stacked([(row["cause"], row["times"]) for row in own], own[0]["n"])


def _pretty(settings: dict[str, Any]) -> str:
    return msgspec.json.format(msgspec.json.encode(settings, order="sorted"), indent=2).decode()
