"""Replay of stored questions: their proofs by statements over the graph, and their plans compiled to Cypher.

This module also compares stored records with values that were computed again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.perturb import (
    Answer,
    FactSource,
    MissingFactsError,
    NoAnswerError,
    Program,
    find_people,
    make_program,
    prove_changes,
    prove_conditions,
)
from jrdb_avr.queries.compiler.find import compile_find
from jrdb_avr.queries.compiler.mapping import SCENE
from jrdb_avr.queries.compiler.reads import SceneReader
from jrdb_avr.queries.compiler.solve import PlanQuery, solve
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.errors import AvrError, PlanError
from jrdb_avr.schema.plan import Plan, canonical, parse_plan
from jrdb_avr.schema.questions import Proof, QuestionRecord
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Template, forms_of

_TOLERANCE: Final = 1e-9
"""Maximum difference of two equal numbers, in seconds or degrees."""

_SHORT: Final = 80
"""Maximum characters of a value in a message."""

Advance = Callable[[int], None]
"""Function that receives the number of questions that have just been finished."""


class Difference(NamedTuple):
    """A difference from a stored record.

    Attributes:
        question_id: Id of the question.
        part: Name of the column, or kind and variant of the proof.
        message: Text that says how the part differs.
    """

    question_id: str
    part: str
    message: str

    def __str__(self) -> str:
        """Return the difference as one line."""
        return ": ".join(self)


class StoredPlan(NamedTuple):
    """A stored question with its plan.

    Attributes:
        record: Record of the question.
        plan: Plan of the question.
        form: Form of the question's template that the plan has.
    """

    record: QuestionRecord
    plan: Plan
    form: Template

    @property
    def program(self) -> Program:
        """Program of the question, for proofs."""
        return make_program(self.record.sequence, self.plan, self.form)

    @property
    def answer(self) -> Answer:
        """Answer of the question, as programs return it."""
        answer = decode_answer(self.record.answer_mode, self.record.answer)
        return answer if isinstance(answer, FrameViewpoint) else self.record.answer_text


# -- comparison -------------------------------------------------------------------------------------------------------


def compare_record(stored: QuestionRecord, again: Mapping[str, Any]) -> Iterator[Difference]:
    """Compare a stored record with values that were computed again.

    Args:
        stored: Stored record.
        again: Values by column. An answer is a text. A set is compared with the items of the stored list.

    Yields: A difference per column that differs, and per proof that is missing, surplus or different.
    """
    for column, now in again.items():
        before: Any = stored.answer_text if column == "answer" else getattr(stored, column)
        if column == "proofs":
            yield from _compare_proofs(stored, now)
        elif isinstance(now, float):
            if abs(before - now) > _TOLERANCE:
                yield Difference(stored.question_id, column, f"stored {before}, now {now}")
        elif now != (frozenset(before) if isinstance(now, frozenset) else before):
            yield Difference(stored.question_id, column, f"stored {_shorten(before)}, now {_shorten(now)}")


def _compare_proofs(stored: QuestionRecord, again: Sequence[Proof]) -> Iterator[Difference]:
    before, now = ({(proof.kind, proof.variant): proof for proof in proofs} for proofs in (stored.proofs, again))
    for key in now | before:
        if before.get(key) != now.get(key):
            message = f"stored {_describe(before.get(key))}, now {_describe(now.get(key))}"
            yield Difference(stored.question_id, " ".join(key), message)
    if len(stored.proofs) != len(again) and before.keys() == now.keys():
        yield Difference(stored.question_id, "proofs", f"{len(stored.proofs)} are stored, {len(again)} are run")


def _describe(proof: Proof | None) -> str:
    if proof is None:
        return "nothing"
    answer = f" ({_shorten(proof.answer)})" if proof.answer is not None else ""
    holds = "" if proof.holds is None else ", holds" if proof.holds else ", does not hold"
    return f"{proof.outcome}{answer}{holds}"


def _shorten(value: Any) -> str:
    text = value if isinstance(value, str) else msgspec.json.encode(value).decode()
    return text if len(text) <= _SHORT else f"{text[: _SHORT - 3]}..."


def read_plans(records: Iterable[QuestionRecord]) -> tuple[list[StoredPlan], list[Difference]]:
    """Read the plans of questions.

    Args:
        records: Records of the questions.

    Returns:
        The plans that can be read, and a difference per question with another plan.
    """
    plans, unreadable = [], []
    for record in records:
        try:
            plan = parse_plan(record.plan)
            plans.append(StoredPlan(record, plan, _find_form(record.template, plan)))
        except AvrError as error:
            unreadable.append(Difference(record.question_id, "plan", str(error)))
    return plans, unreadable


def _find_form(name: str, plan: Plan) -> Template:
    """Return the form of a template that a plan has. Raise PlanError if the template has no such form."""
    for template in forms_of(name):
        slots = template.slots(plan)
        if slots is None or canonical(template.build(slots)) != canonical(plan):
            continue
        # Programs read all conditions at one time.
        if all(condition.at in (None, template.described) for condition in slots.conditions):
            return template
    raise PlanError("plan", f"the template {name!r} has no such plan")


# -- proofs -----------------------------------------------------------------------------------------------------------


def replay(
    store: Store, records: Sequence[QuestionRecord], rules: Rules, advance: Advance = lambda count: None
) -> list[Difference]:
    """Prove questions again by statements over the graph, each statement for all questions at a time.

    Args:
        store: Store with the graph.
        records: Questions.
        rules: Rules of the questions.
        advance: Function that receives the number of questions that have just been finished.

    Returns:
        The differences from the stored proofs and people, in the order of the questions.

    Raises:
        StoreError: If the graph is missing or damaged.
        LockedError: If another process writes the graph.
    """
    plans, differences = read_plans(records)
    advance(len(differences))
    with Graph.open(store.graph_path, read_only=True) as graph:
        source = CypherFacts(graph, rules.load)
        while plans:
            waiting = []
            for stored in plans:
                try:
                    differences += _replay_one(stored, source, rules)
                except MissingFactsError:
                    waiting.append(stored)
            advance(len(plans) - len(waiting))
            plans = waiting
            source.fill()
    position = {record.question_id: index for index, record in enumerate(records)}
    return sorted(differences, key=lambda difference: position[difference.question_id])


def _replay_one(stored: StoredPlan, source: CypherFacts, rules: Rules) -> list[Difference]:
    """Prove a question, and compare its record. Raise MissingFactsError if facts are missing."""
    record, plan = stored.record, stored.plan
    try:
        people = find_people(stored.program, source)
        proofs = list(iterate_stored_proofs(stored, source, source.keyframes(record.sequence), rules))
    except NoAnswerError as reason:
        return [Difference(record.question_id, "anchor match", f"stored same, now {reason}")]
    if None in proofs:
        raise MissingFactsError
    stated = {name: time.frame for name, time in plan.times.items() if time.frame is not None}
    bindings = record.bindings | people | stated
    again = {"target_track": people[plan.target], "bindings": bindings, "proofs": proofs}
    return list(compare_record(record, again))


def iterate_stored_proofs(
    stored: StoredPlan, source: FactSource, keyframes: Sequence[int], rules: Rules
) -> Iterator[Proof | None]:
    """Yield all proofs of a stored question, None for one that lacks facts.

    The second program does not run here. Its proof is the one that each question has.

    Args:
        stored: Question with its plan.
        source: Source of facts.
        keyframes: Keyframes of the sequence, in order.
        rules: Rules of the question.

    Yields: The proofs.

    Raises:
        NoAnswerError: If the plan finds no single person.
        MissingFactsError: If the facts that find the people are missing.
    """
    record, program = stored.record, stored.program
    people = find_people(program, source)
    yield Proof("anchor", "match", True, "same", record.answer_text)
    yield from prove_conditions(program, source)
    yield _prove_views_clear(record, source)
    yield from prove_changes(program, people, stored.answer, keyframes, rules, source)
    yield from _prove_crops(record, rules)
    yield Proof("rederive", "annotations", True, "same", record.answer_text)


def _prove_views_clear(record: QuestionRecord, source: FactSource) -> Proof | None:
    """Prove that each needed box is a clear view. Return None if facts are missing."""
    try:
        views_of_boxes = source.ask([("seen", record.sequence, box.track, box.frame) for box in record.needed])
    except MissingFactsError:
        return None
    clear = all(view.present for view in views_of_boxes)
    outcome, answer = ("same", record.answer_text) if clear else ("unknown", None)
    return Proof("evidence", "clear views", clear, outcome, answer)


def _prove_crops(record: QuestionRecord, rules: Rules) -> Iterator[Proof]:
    """Yield the proofs that the forward view, and any other single view, misses needed boxes."""
    x, w = (np.array([getattr(box, side) for box in record.needed]) for side in "xw")
    decisive = np.array([box.decisive for box in record.needed], bool)
    ahead = bool(views.ahead(x[decisive], w[decisive], rules.visible_share).all())
    single = views.single_view(x, w, rules.visible_share)
    for kind, variant, shown in (("view.ahead", "180", ahead), ("view.single", "any angle", single)):
        outcome, answer = ("same", record.answer_text) if shown else ("empty", None)
        yield Proof(kind, variant, not shown, outcome, answer)


# -- plans as Cypher --------------------------------------------------------------------------------------------------


def run_compiled(
    store: Store, records: Sequence[QuestionRecord], rules: Rules, advance: Advance = lambda count: None
) -> list[Difference]:
    """Compile the plans of questions to Cypher, and run them on the graph.

    Args:
        store: Store with the graph.
        records: Questions.
        rules: Rules of the questions.
        advance: Function that receives the number of questions that have just been finished.

    Returns:
        The differences from the stored people, times and answers.

    Raises:
        StoreError: If the graph is missing or damaged.
        LockedError: If another process writes the graph.
    """
    plans, differences = read_plans(records)
    compiled: list[StoredPlan] = []
    for stored in plans:
        try:
            compile_find(stored.plan, SCENE)
            compiled.append(stored)
        except PlanError as error:
            differences.append(Difference(stored.record.question_id, "compiled", str(error)))
    with Graph.open(store.graph_path, read_only=True) as graph:
        queries = [PlanQuery(stored.plan, stored.record.sequence, stored.record.choices) for stored in compiled]
        solutions = solve(SceneReader(graph, SCENE, rules.load), queries, rules, advance)
    for (record, plan, _), solution in zip(compiled, solutions, strict=True):
        if solution.outcome != "defined":
            message = f"{solution.outcome}, stored {_shorten(record.answer_text)}"
            differences.append(Difference(record.question_id, "compiled", message))
            continue
        bindings = dict(solution.people) | dict(solution.times)
        again = {"answer": solution.answer, "target_track": solution.people[plan.target], "bindings": bindings}
        differences += compare_record(record, again)
    return differences
