"""The input of all reports: the scores of runs for each question, and labels that group the questions."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.paper import GROUPS
from jrdb_avr.engine.report.truth import is_imported, sort_by_sequence
from jrdb_avr.queries.runs import RunManifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.arrays import Digits, Ints
from jrdb_avr.schema.method import DIAGNOSTIC
from jrdb_avr.schema.references import Reference
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import forms_of

SCORES: Final = ("answer", "evidence", "combined")

_GAP_EDGES_S: Final = (5.0, 15.0, 30.0)
_SEPARATION_EDGES_DEG: Final = (10.0, 30.0, 60.0)

DIMENSIONS: Final = ("family", "group", "template", "answer_mode", "hops", "time_gap_s", "separation_deg", "sequence")
"""Names of the properties that group questions. The values of `time_gap_s` and `separation_deg` form bins."""

_TEXTS: Final = ("family", "template", "answer_mode", "sequence")
"""Names of the dimensions that are a column of the table `questions`."""

_GROUP_OF: Final = {family: group for group, counts in GROUPS.items() for family in counts.families}


class Labels(NamedTuple):
    """One label per question.

    Attributes:
        names: The distinct labels, in the order of rows in tables.
        numbers: For each question, the index of its label in `names`.
    """

    names: tuple[str, ...]
    numbers: Ints


class QuestionIndex:
    """The questions of a store.

    Attributes:
        ids: Ids of the questions. All arrays and lists of this object have this order.
        labels: Labels of the questions, by dimension.
        twins: For each question, the key that it shares with its time twin. None without a twin.
        references: Guessers that tables of scores have below the runs.
    """

    def __init__(self, questions: pa.Table, answers: pa.Table, others: Sequence[str] | None = None) -> None:
        """Group questions by `DIMENSIONS`, or imported ones by `_TEXTS` and `others`, columns of `answers`."""
        self.ids = questions["question_id"].combine_chunks()
        matching = answers.take(pc.index_in(self.ids, value_set=answers["question_id"].combine_chunks()))
        values: dict[str, list[str]] = {name: questions[name].to_pylist() for name in _TEXTS}
        if others is None:
            values["group"] = [_GROUP_OF[family] for family in values["family"]]
            hops = {name: str(forms_of(name)[0].hops) for name in set(values["template"])}
            values["hops"] = [hops[name] for name in values["template"]]
            for name, edges in (("time_gap_s", _GAP_EDGES_S), ("separation_deg", _SEPARATION_EDGES_DEG)):
                bins = [f"[{low:g}, {high:g})" for low, high in pairwise((0.0, *edges, math.inf))]
                values[name] = [bins[bisect_right(edges, value)] for value in matching[name].to_pylist()]
        values |= {name: matching[name].to_pylist() for name in others or ()}
        self.labels = {name: _labels(values[name]) for name in (DIMENSIONS if others is None else values)}
        self.twins: list[str | None] = matching["twin_id"].to_pylist()
        self.references: Sequence[Reference] = ()


@dataclass(eq=False)
class ScoredRun:
    """A run with its scores. Arrays have one row per question of the run, in the order of `sort_by_sequence`.

    Attributes:
        manifest: The run's manifest.
        rows: Indexes of the run's questions in `QuestionIndex.ids`, ascending. Shape: (n,).
        table: The rows of the table `scores`.
        errors: Number of questions that ended in an error.
        answers: The predicted answer to each of the n questions as JSON, or None without an answer.
    """

    manifest: RunManifest
    rows: Ints
    table: pa.Table
    errors: int
    answers: list[str | None]

    @cached_property
    def scores(self) -> Digits:
        """The three scores of each question, each 0 or 1: answer, evidence, combined. Shape: (n, 3)."""
        return np.stack([self.table[f"{name}_score"].to_numpy() for name in SCORES], axis=1)

    @cached_property
    def invalid(self) -> Digits:
        """1 for each question with an output of the model that could not be read, else 0. Shape: (n,)."""
        invalid: Digits = self.table["invalid"].to_numpy().astype(np.int8)
        return invalid

    @cached_property
    def counts(self) -> Digits:
        """1 for each question, then its three scores and its value of `invalid`. Shape: (n, 5)."""
        return np.column_stack([np.ones(self.n, np.int8), self.scores, self.invalid])

    @property
    def label(self) -> str:
        """Text that marks a run in tables: synthetic, partial if some questions have no prediction, or both."""
        marks, total = ["synthetic"] if self.manifest.synthetic else [], len(self.manifest.question_ids)
        marks += ["diagnostic"] if self.manifest.method in DIAGNOSTIC else []
        return ", ".join([*marks, f"partial, {self.n} of {total}"] if self.n < total else marks)

    @property
    def is_ranked(self) -> bool:
        """Whether the run has a rank. Partial and diagnostic runs have none."""
        return self.n >= len(self.manifest.question_ids) and self.manifest.method not in DIAGNOSTIC

    @property
    def n(self) -> int:
        """Number of questions of the run that have a prediction."""
        return len(self.rows)

    def scores_of(self, rows: Ints) -> Digits:
        """Return the scores of some questions of the run. `rows` are their indexes in `ids`. Shape: (m, 3)."""
        return self.scores[np.searchsorted(self.rows, rows)]


def read_index(store: Store) -> QuestionIndex:
    """Read the questions of a store with their labels.

    Args:
        store: The store.

    Returns:
        The questions, in the order of `sort_by_sequence`.

    Raises:
        StoreError: If the store has no questions, or no answers.
    """
    answers = store.questions("answers")
    others = [name for name in answers.column_names if name not in QUESTIONS["answers"].names]
    questions = store.questions("questions", ["question_id", *_TEXTS])
    return QuestionIndex(sort_by_sequence(questions), answers, others if is_imported(store) else None)


def percent_of(part: float, n: float) -> float | None:
    """Return `part` as a percentage of `n`, rounded to two decimals.

    Args:
        part: The part.
        n: The whole.

    Returns:
        The percentage, or None if `n` is 0.
    """
    return round(100 * part / n, 2) if n else None


def _labels(values: Sequence[str]) -> Labels:
    names = tuple(sorted(set(values), key=lambda name: (_first_number(name), name)))
    numbers = {name: index for index, name in enumerate(names)}
    return Labels(names, np.array([numbers[value] for value in values], np.int64))


def _first_number(value: str) -> float:
    """Return the number that a name consists of, or the lower bound if the name is a bin such as "[5, 15)".

    For all other names, return -1.
    """
    try:
        return float(value.lstrip("[").partition(",")[0])
    except ValueError:
        return -1.0


_NO_SETTINGS: Final = (("endpoint", "base_url"), ("preflight",))

Path = tuple[str, ...]


def distinguishing_settings(runs: Sequence[ScoredRun]) -> dict[str, str]:
    """Summarise, for each run, the settings that differ between runs of the same method and model.

    The address of the server and the results of the server's checks are left out, because they change when the server
    restarts.

    Args:
        runs: Scored runs.

    Returns:
        The text for each run id, such as `simulated: seed 3, box 0.1`. A text is empty if no setting differs.
    """
    leaves = [(run.manifest, dict(_leaves((), run.manifest.settings))) for run in runs]
    alike: dict[tuple[str, str], list[dict[Path, str]]] = {}
    for manifest, settings in leaves:
        alike.setdefault((manifest.method, manifest.model), []).append(settings)
    return {
        manifest.run_id: _in_words(settings, alike[manifest.method, manifest.model]) for manifest, settings in leaves
    }


def _in_words(leaves: dict[Path, str], others: Sequence[dict[Path, str]]) -> str:
    parts: dict[Path, list[str]] = {}
    for path, value in sorted(leaves.items()):
        if path not in _NO_SETTINGS and any(alternative.get(path) != value for alternative in others):
            parts.setdefault(path[:-1], []).append(f"{path[-1]} {value}")
    return "; ".join(
        f"{' '.join(above)}: {', '.join(texts)}" if above else ", ".join(texts) for above, texts in parts.items()
    )


def _leaves(path: Path, settings: Any) -> Iterator[tuple[Path, str]]:
    """Yield the path and the value of every setting. Values are texts.

    A path consists of the keys that lead to the setting in the nested dicts, the outermost key first. A value that is
    not a text becomes JSON.
    """
    if isinstance(settings, dict) and (settings or not path):
        for name, value in settings.items():
            yield from _leaves((*path, str(name)), value)
    else:
        yield path, settings if isinstance(settings, str) else msgspec.json.encode(settings).decode()
