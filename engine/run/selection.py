"""Choose the questions of a run: by id, family, template and sequence, at most so many of each template or in all.

The same selection of the same questions is always the same list, and a larger `limit` or `per_template` only adds to
it, so that a run can grow.
"""

from __future__ import annotations

import hashlib
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.queries.questions import QuestionRow
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError, did_you_mean


class QuestionSelection(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Which questions a run answers; without arguments all of them.

    questions, families, templates, sequences: names, of which a question needs one of each that is not empty.
    per_template, limit: at most so many of each template, and in all, of those that have panoramas; with both, `limit`
    takes the same number of each template, as far as there are so many. seed: draws them at random; without one the
    first are taken, in the order of `questions` or of the file.
    """

    questions: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    templates: tuple[str, ...] = ()
    sequences: tuple[str, ...] = ()
    per_template: int | None = None
    limit: int | None = None
    seed: int | None = None

    @classmethod
    def of(cls, questions: QuestionSelection | Iterable[str] | None, limit: int | None = None) -> QuestionSelection:
        """A selection itself, or that of some ids; `limit` goes before the selection's own."""
        if not isinstance(questions, QuestionSelection):
            ids = None if questions is None else tuple(dict.fromkeys(questions))
            if ids == ():
                raise InputError("no question is named", field="questions")
            questions = cls(questions=ids or ())
        return questions if limit is None else msgspec.structs.replace(questions, limit=limit)

    def record(self) -> dict[str, Any]:
        """What was chosen, as plain JSON for the manifest; empty for all questions."""
        found: dict[str, Any] = msgspec.to_builtins(self)
        return found


_COLUMN: Final = {
    "questions": "question_id",
    "families": "family",
    "templates": "template",
    "sequences": "sequence",
}
"""Per field of names: the column of questions that it restricts."""


def select_questions(
    questions: Sequence[QuestionRow], selection: QuestionSelection, image_root: str | None
) -> list[QuestionRow]:
    """The selected questions among those whose sequence has a folder with panoramas under `image_root`.

    Numbers are counted after questions without panoramas are left out, of which a warning tells. Raises InputError for
    an unknown name, StoreError where no question is left.
    """
    candidates = matching(questions, selection)
    found = _with_panoramas(candidates, image_root)
    if selection.seed is not None:
        found.sort(key=lambda question: _draw(selection.seed, question))
    if selection.per_template is not None:
        counts: Counter[str] = Counter()
        ranked = sorted(((_counted(counts, own.template), own) for own in found), key=itemgetter(0))
        found = [own for rank, own in ranked if rank <= selection.per_template]
    return found[: selection.limit]


def matching(questions: Sequence[QuestionRow], selection: QuestionSelection) -> list[QuestionRow]:
    """The questions of the selection's names, in the order of its ids or of the file, and however many.

    Raises InputError for an unknown name.
    """
    for field, column in _COLUMN.items():
        names, known = getattr(selection, field), {getattr(own, column): None for own in questions}
        if unknown := [name for name in names if name not in known]:
            which = f"{len(unknown)} of {len(names)} {field}" if len(names) > 1 else column.replace("_", " ")
            # An id is like every other.
            near = "" if field == "questions" else did_you_mean(unknown[0], known)
            raise InputError(
                f"{which} {unknown[0][:60]!r} is not in the store's questions{near}",
                field=column,
            )
    if selection.questions:
        by_id = {own.question_id: own for own in questions}
        questions = [by_id[name] for name in dict.fromkeys(selection.questions)]
    return [
        own
        for own in questions
        if all(
            not getattr(selection, field) or getattr(own, _COLUMN[field]) in getattr(selection, field)
            for field in _COLUMN
        )
    ]


def _counted(counts: Counter[str], name: str) -> int:
    counts[name] += 1
    return counts[name]


def _draw(seed: int | None, question: QuestionRow) -> bytes:
    """The question's place in a draw: the same for any others beside it."""
    return hashlib.sha256(f"{seed} {question.question_id}".encode()).digest()


def _with_panoramas(questions: Sequence[QuestionRow], image_root: str | None) -> list[QuestionRow]:
    sequences = sorted({question.sequence for question in questions})
    without = [name for name in sequences if image_root is None or not any(Path(image_root, name).glob("*.jpg"))]
    found = [question for question in questions if question.sequence not in without]
    if not questions:
        raise StoreError("no question is of all the chosen families, templates and sequences: choose fewer")
    lacking = (
        f"{len(without)} sequences have no panoramas ({', '.join(without[:3])}{', ...' if len(without) > 3 else ''})"
    )
    if not found:
        raise StoreError(f"no selected question can be asked: {lacking}; choose others, or give --images")
    if without:
        left = f"{len(questions) - len(found)} of {len(questions)} questions are left out: {lacking}"
        warnings.warn(f"{left}; {len(found)} can be asked", AvrWarning, stacklevel=4)
    return found
