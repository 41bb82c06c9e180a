"""The report as a page: tables, interval plots, answer against evidence, and how runs fail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.engine.failures import CAUSES
from jrdb_avr.engine.judged import DIMENSIONS, Facts, Judged
from jrdb_avr.engine.report import report_table
from jrdb_avr.engine.scoring import Truth
from jrdb_avr.queries.store import Store

from .charts import SQUARE, Part, intervals, scatter, stacked
from .page import render

_FIRST: Final = ("family", "group")


@dataclass(frozen=True)
class Crossed:
    """A breakdown with a column per run: a value of the dimension, and each run's row or None."""

    runs: tuple[str, ...]
    rows: tuple[tuple[str, tuple[dict[str, Any] | None, ...]], ...]


def report_page(
    store: Store, truth: Truth, facts: Facts, runs: Sequence[Judged], iou: float, *, published: bool = False
) -> str:
    """The page's HTML."""

    def table(name: str) -> list[dict[str, Any]]:
        return report_table(name, store, truth, facts, runs, iou, published=published)

    main = table("main")
    names = tuple(run.manifest.run_id for run in runs)
    own = [row for row in main if row["run"]]
    failures = table("evidence_failures")
    return render(
        "report",
        runs=runs,
        iou=iou,
        synthetic=any(run.manifest.synthetic for run in runs),
        main=own,
        published=[row for row in main if not row["run"]],
        chart=intervals(own),
        dots=scatter(own),
        square=SQUARE,
        breakdowns=[(name, crossed(table(name), name, names)) for name in DIMENSIONS],
        ablation=table("ablation"),
        pairs=table("pairs"),
        boxes=[(name, _causes(failures, name)) for name in names],
        causes=CAUSES,
        wrong=table("wrong_choices"),
        cost=table("cost"),
        settings=[(run.manifest.run_id, _pretty(run.manifest.settings)) for run in runs],
    )


def crossed(rows: Sequence[dict[str, Any]], dimension: str, runs: Sequence[str]) -> Crossed:
    """A breakdown's rows, by value and run; the paper's stand in a last column of their own."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(row[dimension], {})[row["run"] or row["label"]] = row
    columns = (*runs, *(["paper"] if any(not row["run"] for row in rows) else []))
    return Crossed(columns, tuple((value, tuple(own.get(run) for run in columns)) for value, own in found.items()))


def _causes(rows: Sequence[dict[str, Any]], run: str) -> tuple[Part, ...]:
    return stacked([(row["cause"], row["times"]) for row in rows if row["run"] == run])


def _pretty(settings: dict[str, Any]) -> str:
    return msgspec.json.format(msgspec.json.encode(settings, order="sorted"), indent=2).decode()
