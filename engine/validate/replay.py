"""Replay of stored questions: their proofs by statements over the graph, and their plans compiled to Cypher.

This module also compares stored records with values that were computed again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.perturb import (
    FactSource,
    MissingFactsError,
    NoAnswerError,
    Setting,
    find_tracks,
    prove_changes,
    prove_conditions,
    require_all,
)
from jrdb_avr.engine.generate.programs import Answer, Program, make_program
from jrdb_avr.queries.compiler.find import compile_find
from jrdb_avr.queries.compiler.reads import SceneReader
from jrdb_avr.queries.compiler.solve import PlanQuery, solve
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.errors import AvrError, PlanError
from jrdb_avr.schema.plan import Plan, parse_plan
from jrdb_avr.schema.questions import Proof, QuestionRecord
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Template
from jrdb_avr.schema.wording.text import form_of

_TOLERANCE: Final = 1e-9
"""Maximum difference of two equal numbers, in seconds or degrees."""

_SHORT: Final = 80
"""Maximum characters of a value in a message."""


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
        """Answer of the question in the form that proofs compare."""
        answer = decode_answer(self.record.answer_mode, self.record.answer)
        return answer if isinstance(answer, FrameViewpoint) else self.record.answer_text


# -- comparison -------------------------------------------------------------------------------------------------------


def compare_record(stored: QuestionRecord, again: Mapping[str, Any]) -> Iterator[str]:
    """Compare a stored record with values that were computed again.

    Args:
        stored: Stored record.
        again: Values by column. An answer is a text. A set is compared with the items of the stored list.

    Yields:
        A line per column that differs, and per proof that is missing, additional or different. The line begins with the
        id of the question and the name of the column or proof.
    """
    for column, now in again.items():
        before: Any = stored.answer_text if column == "answer" else getattr(stored, column)
        if column == "proofs":
            yield from _compare_proofs(stored, now)
        elif isinstance(now, float):
            if not abs(before - now) <= _TOLERANCE:
                yield f"{stored.question_id}: {column}: stored {before}, now {now}"
        elif now != (frozenset(before) if isinstance(now, frozenset) else before):
            yield f"{stored.question_id}: {column}: stored {_shorten(before)}, now {_shorten(now)}"


def _compare_proofs(stored: QuestionRecord, again: Sequence[Proof]) -> Iterator[str]:
    before, now = ({(proof.kind, proof.variant): proof for proof in proofs} for proofs in (stored.proofs, again))
    for key in now | before:
        if before.get(key) != now.get(key):
            change = f"stored {_describe(before.get(key))}, now {_describe(now.get(key))}"
            yield f"{stored.question_id}: {' '.join(key)}: {change}"
    if len(stored.proofs) != len(again) and before.keys() == now.keys():
        yield f"{stored.question_id}: proofs: {len(stored.proofs)} are stored, {len(again)} are run"


def _describe(proof: Proof | None) -> str:
    return "nothing" if proof is None else f"{proof.outcome}, answer {proof.answer}, holds {proof.holds}"


def _shorten(value: Any) -> str:
    text = value if isinstance(value, str) else msgspec.json.encode(value).decode()
    return text if len(text) <= _SHORT else f"{text[: _SHORT - 3]}..."


def read_plans(records: Iterable[QuestionRecord]) -> tuple[list[StoredPlan], list[str]]:
    """Read the plans of questions.

    Args:
        records: Records of the questions.

    Returns:
        The plans that can be proved and compiled, and one line for each other question.
    """
    plans, unreadable = [], []
    for record in records:
        try:
            plan = parse_plan(record.plan)
            compile_find(plan)
            form, slots = form_of(record.template, plan)
            # Programs read all conditions at one time.
            if any(condition.at not in (None, form.described) for condition in slots.conditions):
                raise PlanError("nodes[0].conditions", f"must hold at {form.described!r}")
            plans.append(StoredPlan(record, plan, form))
        except AvrError as error:
            unreadable.append(f"{record.question_id}: plan: {error}")
    return plans, unreadable


# -- proofs -----------------------------------------------------------------------------------------------------------


def replay(
    store: Store, plans: Sequence[StoredPlan], rules: Rules, advance: Callable[[int], None] = lambda count: None
) -> list[str]:
    """Prove questions again by statements over the graph. A statement runs for many questions together.

    Args:
        store: Store with the graph.
        plans: Questions.
        rules: Rules of the questions.
        advance: Function that receives the number of questions that have just been finished.

    Returns:
        A line per difference from the stored proofs and people, as `compare_record` yields it.

    Raises:
        StoreError: If the graph is missing or damaged.
        LockedError: If another process writes the graph.
    """
    with Graph.open(store.graph_path, read_only=True) as graph:
        source = CypherFacts(graph, rules.load)
        again = {index: partial(_replay_one, stored, source, rules) for index, stored in enumerate(plans)}
        differences = source.complete_all(again, advance)
    return [line for index in again for line in differences[index]]


def _replay_one(stored: StoredPlan, source: CypherFacts, rules: Rules) -> list[str]:
    """Prove a question, and compare its record. Raise MissingFactsError if facts are missing."""
    record, plan = stored.record, stored.plan
    setting = Setting(source, source.keyframes(record.sequence), rules)
    try:
        proofs = require_all(iterate_stored_proofs(stored, setting))
        people = find_tracks(stored.program, setting)
    except NoAnswerError as reason:
        return [f"{record.question_id}: anchor match: stored same, now {reason}"]
    stated = {name: time.frame for name, time in plan.times.items() if time.frame is not None}
    again = {"target_track": people[plan.target], "bindings": record.bindings | people | stated, "proofs": proofs}
    return list(compare_record(record, again))


def iterate_stored_proofs(stored: StoredPlan, setting: Setting) -> Iterator[Proof | None]:
    """Yield all proofs of a stored question. A proof that lacks facts is None.

    The second program does not run here. The proof "rederive" is repeated as it is stored with every question.

    Args:
        stored: Question with its plan.
        setting: Source of facts, keyframes of the sequence, and rules of the question.

    Yields:
        The proofs.

    Raises:
        NoAnswerError: If the plan does not lead to exactly one person.
        MissingFactsError: If facts that are needed to find the people are missing.
    """
    record, program = stored.record, stored.program
    people = find_tracks(program, setting)
    yield Proof("anchor", "match", True, "same", record.answer_text)
    yield from prove_conditions(program, setting)
    yield _prove_views_clear(record, setting.source)
    yield from prove_changes(program, people, stored.answer, setting)
    yield from _prove_crops(record, setting.rules)
    yield Proof("rederive", "annotations", True, "same", record.answer_text)


def _prove_views_clear(record: QuestionRecord, source: FactSource) -> Proof | None:
    """Return the proof that each needed box is a clear view. Return None if facts are missing."""
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
    store: Store, plans: Sequence[StoredPlan], rules: Rules, advance: Callable[[int], None] = lambda count: None
) -> list[str]:
    """Run the plans of questions on the graph, each compiled to Cypher.

    Args:
        store: Store with the graph.
        plans: Questions.
        rules: Rules of the questions.
        advance: Function that receives the number of questions that have just been finished.

    Returns:
        A line per difference from the stored people, times and answers, as `compare_record` yields it.

    Raises:
        StoreError: If the graph is missing or damaged.
        LockedError: If another process writes the graph.
    """
    with Graph.open(store.graph_path, read_only=True) as graph:
        queries = [PlanQuery(stored.plan, stored.record.sequence, stored.record.choices) for stored in plans]
        solutions = solve(SceneReader(graph, rules.load), queries, rules, advance)
    differences: list[str] = []
    for (record, plan, _), solution in zip(plans, solutions, strict=True):
        again: dict[str, Any] = {"answer": solution.outcome}
        if solution.outcome == "defined":
            bindings = dict(solution.people) | dict(solution.times)
            again = {"answer": solution.answer, "target_track": solution.people[plan.target], "bindings": bindings}
        differences += compare_record(record, again)
    return differences
