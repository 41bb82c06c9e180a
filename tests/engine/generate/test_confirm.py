"""What the second program does not confirm is refused, and something else takes its place."""

import random

import msgspec
import pytest
from keyframe_layers import layers_in_memory
from loaded_stores import graphless_store
from random_worlds import lively_world

from jrdb_avr.engine.generate import question
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.rederive import Outcome
from jrdb_avr.schema.plan import canonical
from jrdb_avr.schema.rules import Rules

NAME = "yard-2020-01-01_0"


@pytest.fixture
def store(tmp_path):
    return graphless_store(tmp_path, lively_world(random.Random(5), NAME))


def questions(store):
    with layers_in_memory():
        report = generate(store, Rules(), workers=1)
    return report, {row["plan"]: row for row in store.questions("answers").to_pylist()}


def test_a_question_that_is_not_confirmed_makes_way(store, monkeypatch):
    report, before = questions(store)
    assert report.faults == () and len(before) > 10
    wrong, checked = min(before), []

    def rederive(annotations, plan, *rest, own=question.rederive):
        checked.append(canonical(plan))
        return Outcome("unknown") if canonical(plan) == wrong else own(annotations, plan, *rest)

    monkeypatch.setattr(question, "rederive", rederive)
    report, after = questions(store)
    (fault,) = report.faults
    assert fault.startswith(f"{NAME} {wrong}: ") and fault.endswith("rederived unknown")
    assert wrong not in after and after.keys() <= set(checked)
    refused = [row for row in store.questions("rejected").to_pylist() if row["rule"] == "unconfirmed"]
    assert [row["candidates"] for row in refused] == [1]
    counts = {row["template"]: row for row in report.templates}
    assert sum(row["unconfirmed"] for row in counts.values()) == 1
    for row in counts.values():
        kept = sum(row[rule] for rule in ("unconfirmed", "selection"))
        assert row["proven"] == kept + row["questions"]


def test_a_question_whose_proofs_the_statements_do_not_give_makes_way(store, monkeypatch):
    _, before = questions(store)
    wrong, changed = min(before), []

    def prove(program, answer, *rest, own=question.prove):
        first, *others = own(program, answer, *rest)
        if (program, answer) in changed:
            return [msgspec.structs.replace(first, outcome="same", holds=False), *others]
        return [first, *others]

    made = question.program_of
    monkeypatch.setattr(question, "program_of", lambda one: note(made(one), canonical(one.plan) == wrong, changed))
    monkeypatch.setattr(question, "prove", prove)
    report, after = questions(store)
    (fault,) = report.faults
    assert fault.startswith(f"{NAME} {wrong}: by statements, anchor without ") and fault.endswith(" do not hold")
    assert wrong not in after


def note(made, wanted, noted):
    noted += [made] if wanted else []
    return made
