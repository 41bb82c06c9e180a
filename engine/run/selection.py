"""Apply the options of a `QuestionSelection` to select the questions of a run."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from itertools import count
from operator import itemgetter
from pathlib import Path
from typing import Final

from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.queries.questions import HIDDEN, QuestionRow
from jrdb_avr.schema.errors import InputError, StoreError, did_you_mean, warn

_COLUMNS: Final = {
    "questions": "question_id",
    "families": "family",
    "templates": "template",
    "sequences": "sequence",
}
"""For each option that lists names or ids, the column of the table `questions` that must have one of these values."""


def select_questions(
    questions: Sequence[QuestionRow], selection: QuestionSelection, image_root: str | None
) -> list[QuestionRow]:
    """Select questions that have panoramas.

    Questions without panoramas are left out first, with a warning. The options `limit` and `per_template` then count
    only the remaining questions. If the selection is a shard, a question without panoramas is an error instead, because
    the machines that answer the shards must agree on the questions.

    Args:
        questions: All questions of the store, in the order of the questions file.
        selection: The options of the selection.
        image_root: The folder that has one folder of panoramas per sequence, or None without panoramas.

    Returns:
        The selected questions. If the selection has a seed, they are in the random order of this seed, otherwise in the
        order of `matching`. If the selection has `per_template`, the templates take turns: the first question of each
        template comes before the second question of any template, and so on. The list can be empty only if the
        selection is a shard.

    Raises:
        InputError: If the selection names a question, family, template or sequence that the store lacks, or if it
            selects by a column that a public store leaves out.
        StoreError: If no question matches, if no matching question has panoramas, or if the selection is a shard and
            one of its questions has no panoramas.
    """
    if selection.shard is None:
        return draw_questions(_with_panoramas(matching(questions, selection), image_root), selection)
    # Count all sequences of the store, so that selecting more questions moves no sequence to another shard.
    index, shards = selection.shard
    members = set(sorted({row.sequence for row in questions})[index - 1 :: shards])
    chosen = [row for row in draw_questions(matching(questions, selection), selection) if row.sequence in members]
    if without := _without_panoramas(chosen, image_root):
        raise StoreError(f"sequence {without[0]} of this shard has no panoramas: add them, or give --images")
    return chosen


def draw_questions(questions: Sequence[QuestionRow], selection: QuestionSelection) -> list[QuestionRow]:
    """Apply the seed and the limits of a selection to the questions that match it.

    Args:
        questions: The result of `matching`, or a part of it.
        selection: The options of the selection. Its shard is ignored.

    Returns:
        The selected questions, in the order that `select_questions` describes.

    Raises:
        InputError: If the selection has `per_template`, but the store is a public store, which has no templates.
        StoreError: If `questions` is empty.
    """
    if not questions:
        raise StoreError("no question matches all selected families, templates and sequences: select by fewer options")
    chosen = list(questions)
    if selection.seed is not None:
        # The sort key of a question does not depend on other questions.
        chosen.sort(key=lambda row: hashlib.sha256(f"{selection.seed} {row.question_id}".encode()).digest())
    if selection.per_template is not None:
        _check_columns(questions, "template")
        ranks: defaultdict[str, count[int]] = defaultdict(count)
        ranked = sorted(((next(ranks[row.template]), row) for row in chosen), key=itemgetter(0))
        chosen = [row for rank, row in ranked if rank < selection.per_template]
    return chosen[: selection.limit]


def matching(questions: Sequence[QuestionRow], selection: QuestionSelection) -> list[QuestionRow]:
    """Return all questions that match the ids, families, templates and sequences of a selection.

    Args:
        questions: All questions of the store, in the order of the questions file.
        selection: The options of the selection. Its seed, its limits and its shard are ignored.

    Returns:
        The questions. They are in the order of the selection's ids if it lists ids, otherwise in the given order.

    Raises:
        InputError: If the selection names a question, family, template or sequence that the store lacks, or if it
            selects by a column that a public store leaves out.
    """
    for field, column in _COLUMNS.items():
        names, values = getattr(selection, field), {getattr(row, column): None for row in questions}
        if names:
            _check_columns(questions, column)
        if unknown := [name for name in names if name not in values]:
            which = f"{len(unknown)} of {len(names)} {field}" if len(names) > 1 else column.replace("_", " ")
            # Ids are too similar to each other for a suggestion to help.
            near = "" if field == "questions" else did_you_mean(unknown[0], values)
            raise InputError(f"{which} {unknown[0][:60]!r} is not in the store's questions{near}", field=column)
    if selection.questions:
        by_id = {row.question_id: row for row in questions}
        questions = [by_id[name] for name in dict.fromkeys(selection.questions)]
    required = [(column, getattr(selection, field)) for field, column in _COLUMNS.items() if getattr(selection, field)]
    return [row for row in questions if all(getattr(row, column) in names for column, names in required)]


def _check_columns(questions: Sequence[QuestionRow], column: str) -> None:
    if column in HIDDEN and not any(getattr(row, column) for row in questions):
        raise InputError(
            f"the questions of a public store have no {column}: select by --sequence, --questions or --limit",
            field=column,
        )


def _without_panoramas(questions: Sequence[QuestionRow], image_root: str | None) -> list[str]:
    sequences = sorted({question.sequence for question in questions})
    return [name for name in sequences if image_root is None or not any(Path(image_root, name).glob("*.jpg"))]


def _with_panoramas(questions: Sequence[QuestionRow], image_root: str | None) -> list[QuestionRow]:
    without = _without_panoramas(questions, image_root)
    complete = [question for question in questions if question.sequence not in without]
    names = ", ".join(without[:3]) + (", ..." if len(without) > 3 else "")
    lacking = f"{len(without)} sequences have no panoramas ({names})"
    if without and not complete:
        raise StoreError(f"no selected question can be asked: {lacking}; select others, or give --images")
    if without:
        left = f"{len(questions) - len(complete)} of {len(questions)} questions are left out: {lacking}"
        warn(f"{left}; {len(complete)} can be asked")
    return complete
