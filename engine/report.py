"""The tables of a report, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from jrdb_avr.queries.store import Store

from .comparison import ablation_rows, breakdown_rows, cost_rows, main_rows, pair_rows, published_groups, published_rows
from .failures import evidence_failure_rows, wrong_choice_rows
from .judged import DIMENSIONS, Facts, Judged
from .scoring import Truth

Rows = list[dict[str, Any]]

TABLES: Final = ("main", *DIMENSIONS, "ablation", "pairs", "wrong_choices", "evidence_failures", "cost")
"""`main`: shares with intervals and macro averages; a dimension's name: a breakdown by it."""


def report_table(
    name: str, store: Store, truth: Truth, facts: Facts, runs: Sequence[Judged], iou: float, *, published: bool = False
) -> Rows:
    """One of `TABLES`; `published` adds the paper's figures to those that have some, labelled so."""
    if name in DIMENSIONS:
        return breakdown_rows(facts, runs, name) + (published_groups() if published and name == "group" else [])
    make: dict[str, Callable[[], Rows]] = {
        "main": lambda: main_rows(facts, runs, iou) + (published_rows() if published else []),
        "ablation": lambda: ablation_rows(runs, published=published),
        "pairs": lambda: pair_rows(facts, runs),
        "wrong_choices": lambda: wrong_choice_rows(store, facts, runs),
        "evidence_failures": lambda: evidence_failure_rows(store, truth, facts, runs),
        "cost": lambda: cost_rows(runs),
    }
    return make[name]()
