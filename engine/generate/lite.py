"""The profile lite: a stratified part of the questions that the profile paper selects."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.layer import TableRow
from jrdb_avr.engine.report.hashes import hash_of

LITE_SIZE: Final = 240
"""Number of questions of the profile lite."""

LeftOut = Counter[tuple[str, str, str]]
"""Number of candidates that are no questions, by sequence, template and rule."""


def thin(questions: pa.Table, report: Sequence[TableRow], left: LeftOut) -> tuple[pa.Table, list[TableRow]]:
    """Select the questions of the profile lite, by systematic sampling.

    Questions are sorted by template, answer and sequence, so that each of them keeps its share. Time twins stay pairs.

    Args:
        questions: All selected questions.
        report: Row of each template, as `select` returns it.
        left: Number of candidates by sequence, template and rule. Questions that are left out are added.

    Returns:
        The questions that stay, in their order, and the rows of the templates.
    """
    rows, units = questions.to_pylist(), defaultdict[str, list[TableRow]](list)
    for row in rows:
        units[row["twin_id"] or row["question_id"]].append(row)
    ordered = sorted(units, key=lambda name: (min(map(_stratum, units[name])), hash_of(name)))
    pairs, singles = ([units[name] for name in ordered if len(units[name]) == size] for size in (2, 1))
    of_pairs = round(min(LITE_SIZE, len(rows)) * len(pairs) / max(1, len(rows)))
    kept = _spread(pairs, of_pairs) + _spread(singles, min(len(singles), LITE_SIZE - 2 * of_pairs))
    ids = {row["question_id"] for unit in kept for row in unit}
    left.update((row["sequence"], row["template"], "selection") for row in rows if row["question_id"] not in ids)
    stay = questions.filter(pc.is_in(questions["question_id"], pa.array(sorted(ids), pa.string())))
    reached = Counter(stay["template"].to_pylist())
    twins = Counter(unit[0]["template"] for unit in kept if len(unit) == 2)
    return stay, [row | {"reached": reached[row["template"]], "twins": twins[row["template"]]} for row in report]


def _stratum(row: TableRow) -> tuple[str, str, str]:
    """Return the template, the text of the true choice or another answer, and the sequence."""
    answer = row["choices"][json.loads(row["answer"])["choice"] - 1] if row["choices"] else row["answer"]
    return row["template"], answer, row["sequence"]


def _spread(units: Sequence[list[TableRow]], count: int) -> list[list[TableRow]]:
    """Return evenly spaced units."""
    return [units[(2 * index + 1) * len(units) // (2 * count)] for index in range(count)]
