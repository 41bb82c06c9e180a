"""Runs with their scores, question by question, beside what is known of each question: what reports are made of.

In which settings runs of one method and model differ, in words.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.paper import GROUPS
from jrdb_avr.queries.runs import RunManifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.arrays import Floats, Ints
from jrdb_avr.schema.tables import QUESTIONS

SCORES: Final = ("answer", "evidence", "combined")

GAP_EDGES_S: Final = (5.0, 15.0, 30.0)
SEPARATION_EDGES_DEG: Final = (10.0, 30.0, 60.0)

DIMENSIONS: Final = ("family", "group", "template", "answer_mode", "hops", "time_gap_s", "separation_deg", "sequence")
"""What questions are told apart by; the last three but one in bins."""

_GROUP_OF: Final = {family: group for group, families in GROUPS.items() for family in families}


@dataclass(frozen=True)
class Labels:
    """A text per question: `names`, each once and in the order in which they are shown, and each question's number."""

    names: tuple[str, ...]
    numbers: Ints


@dataclass(frozen=True)
class Facts:
    """What is known of every question of a store: its labels by dimension."""

    ids: pa.Array
    labels: dict[str, Labels]

    def rows(self, ids: pa.Array) -> Ints:
        """The row of each id."""
        found: Ints = pc.index_in(ids, value_set=self.ids).to_numpy(zero_copy_only=False).astype(np.int64)
        return found


@dataclass(frozen=True)
class Judged:
    """A run: a row per question asked, in the order asked.

    rows: of `Facts`; scores: 0 or 1 for answer, evidence and combined, (n, 3); invalid: 0 or 1; errors: questions that
    ended in an error or have no prediction.
    """

    manifest: RunManifest
    rows: Ints
    scores: Ints
    invalid: Ints
    errors: int
    predictions: pa.Table

    @property
    def n(self) -> int:
        return len(self.rows)


def read_facts(store: Store) -> Facts:
    """The facts of a store's questions. Raises StoreError where there are none."""
    questions = store.questions("questions")
    answers = store.questions("answers", ["question_id", "hops", "time_gap_s", "separation_deg"])
    return make_facts(questions.select(QUESTIONS["questions"].names), answers)


def make_facts(questions: pa.Table, answers: pa.Table) -> Facts:
    """Facts from the two tables."""
    ids = questions["question_id"].combine_chunks()
    at = pc.index_in(ids, value_set=answers["question_id"].combine_chunks())
    known = answers.take(at)
    texts = {name: questions[name].to_pylist() for name in ("family", "template", "answer_mode", "sequence")}
    texts["group"] = [_GROUP_OF[family] for family in texts["family"]]
    texts["hops"] = [str(hops) for hops in known["hops"].to_pylist()]
    for name, edges in (("time_gap_s", GAP_EDGES_S), ("separation_deg", SEPARATION_EDGES_DEG)):
        texts[name] = _bins(known[name].to_numpy(zero_copy_only=False).astype(np.float64), edges)
    return Facts(ids, {name: _labels(own) for name, own in texts.items()})


def judge(facts: Facts, manifest: RunManifest, predictions: pa.Table, scores: pa.Table) -> Judged:
    """A run from its predictions and its scores, which hold every question asked."""
    columns = [scores[f"{name}_score"].to_numpy().astype(np.int64) for name in SCORES]
    status = predictions["status"]
    judged = int(pc.sum(pc.is_in(status, value_set=pa.array(["answered", "invalid"]))).as_py() or 0)
    return Judged(
        manifest,
        facts.rows(scores["question_id"].combine_chunks()),
        np.stack(columns, axis=1),
        scores["invalid"].to_numpy(zero_copy_only=False).astype(np.int64),
        scores.num_rows - judged,
        predictions,
    )


def share(part: float, n: float) -> float | None:
    """Percent with two decimals; None of nothing."""
    return round(100 * part / n, 2) if n else None


def percent(value: float | None) -> float | None:
    """A share as percent with two decimals."""
    return None if value is None or math.isnan(value) else round(100 * value, 2)


def _labels(texts: Sequence[str]) -> Labels:
    names = tuple(sorted(set(texts), key=lambda name: (_first_number(name), name)))
    number = {name: number for number, name in enumerate(names)}
    return Labels(names, np.array([number[text] for text in texts], np.int64))


def _bins(values: Floats, edges: Sequence[float]) -> list[str]:
    """The name of each value's bin, `[low, high)`."""
    bounds = (0.0, *edges, math.inf)
    names = [f"[{low:g}, {high:g})" for low, high in pairwise(bounds)]
    return [names[place] for place in np.searchsorted(edges, values, side="right").tolist()]


def _first_number(value: str) -> float:
    digits = value.lstrip("[").partition(",")[0]
    try:
        return float(digits)
    except ValueError:
        return -1.0


_ADDRESS: Final = ("endpoint", "base_url")

Path = tuple[str, ...]


def told_apart(runs: Sequence[Judged]) -> dict[str, str]:
    """Run -> the settings in which it differs from others of its method and model, in a line; "" where there are none.

    Settings of one part stand together behind its name (`marker: seed 3, wrong_box 0.1`). The server's address is left
    out: it differs whenever a server is started anew.
    """
    leaves = {run.manifest.run_id: dict(_leaves((), run.manifest.settings)) for run in runs}
    alike: dict[tuple[str, str], list[dict[Path, str]]] = {}
    for run in runs:
        alike.setdefault((run.manifest.method, run.manifest.model), []).append(leaves[run.manifest.run_id])
    return {
        run.manifest.run_id: _in_words(leaves[run.manifest.run_id], alike[run.manifest.method, run.manifest.model])
        for run in runs
    }


def _in_words(own: dict[Path, str], others: Sequence[dict[Path, str]]) -> str:
    parts: dict[Path, list[str]] = {}
    for path, value in sorted(own.items()):
        if path != _ADDRESS and any(other.get(path) != value for other in others):
            parts.setdefault(path[:-1], []).append(f"{path[-1]} {value}")
    return "; ".join(
        f"{' '.join(above)}: {', '.join(said)}" if above else ", ".join(said) for above, said in parts.items()
    )


def _leaves(path: Path, settings: Any) -> Iterator[tuple[Path, str]]:
    """Every setting as its path and its value: a text as it is, anything else as JSON."""
    if isinstance(settings, dict) and (settings or not path):
        for name, value in settings.items():
            yield from _leaves((*path, str(name)), value)
    else:
        yield path, settings if isinstance(settings, str) else msgspec.json.encode(settings).decode()
