"""Stored questions, read to be judged again: the record, its plan, and the differences found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from jrdb_avr.schema.answers import Choice, decode_answer
from jrdb_avr.schema.errors import AvrError, PlanError
from jrdb_avr.schema.plan import Plan, canonical, parse_plan
from jrdb_avr.schema.templates import Template, forms_of


@dataclass(frozen=True)
class Stored:
    """A question as it is stored; `said` is the true choice's text or the answer's JSON, `row` its row of answers."""

    question_id: str
    sequence: str
    template: str
    choices: tuple[str, ...]
    said: str
    row: Mapping[str, Any]


@dataclass(frozen=True)
class Difference:
    """Something that comes out otherwise than it is stored; `where` names the proof or the column."""

    question_id: str
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.question_id}: {self.where}: {self.what}"


def stored_question(row: dict[str, Any], own: dict[str, Any]) -> Stored:
    """A question from its rows of questions and answers. Raises DecodeError where its answer cannot be read."""
    answer, said = decode_answer(row["answer_mode"], own["answer"]), own["answer"]
    if isinstance(answer, Choice):
        said = row["choices"][answer.choice - 1] if answer.choice <= len(row["choices"]) else ""
    return Stored(row["question_id"], row["sequence"], row["template"], tuple(row["choices"]), said, own)


def read_plans(questions: Sequence[Stored]) -> tuple[list[tuple[Stored, Plan, Template]], list[Difference]]:
    """Plans with the forms of template that they are of; those that cannot be read are differences."""
    read, differences = [], []
    for question in questions:
        try:
            plan = parse_plan(question.row["plan"])
            read.append((question, plan, _form(question.template, plan)))
        except AvrError as error:
            differences.append(Difference(question.question_id, "plan", str(error)))
    return read, differences


def _form(name: str, plan: Plan) -> Template:
    """The form of a template that a plan is of. Raises PlanError where there is none."""
    for template in forms_of(name):
        slots = template.slots(plan)
        if slots is not None and canonical(template.build(slots)) == canonical(plan):
            return template
    raise PlanError("plan", f"it is no plan of the template {name!r}")


def decoded(text: str) -> Any:
    """What a JSON text holds; the text itself where it is none."""
    try:
        return msgspec.json.decode(text)
    except msgspec.DecodeError:
        return text


def short(value: Any) -> str:
    """A value in a line of a report."""
    text = value if isinstance(value, str) else msgspec.json.encode(value).decode()
    return text if len(text) <= 80 else f"{text[:77]}..."
