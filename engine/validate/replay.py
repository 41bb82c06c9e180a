"""Run stored questions again: the one comparison of records, all proofs, and the plans compiled to Cypher.

Nothing of the stored record is taken over: its plan is looked up among the candidates that the same statements find
and prove in the stored graph, set-wise per sequence.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from jrdb_avr.engine.generate.candidates import PASSED, RULES, Candidates, to_table
from jrdb_avr.engine.generate.context import LayerJob, SearchContext
from jrdb_avr.engine.generate.records import choice_sets, make_record
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.scene import NOBODY, Ints
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.engine.generate.stored_layer import ensure_layer, is_stored, layer_jobs
from jrdb_avr.engine.rederive import Annotations, Outcome, rederive
from jrdb_avr.queries.compiler.find import compile_find
from jrdb_avr.queries.compiler.mapping import SCENE
from jrdb_avr.queries.compiler.reads import SceneReader
from jrdb_avr.queries.compiler.solve import PlanQuery, solve
from jrdb_avr.queries.graph.handle import Graph, hold_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import Executor, map_sequences
from jrdb_avr.schema.errors import AvrError, PlanError
from jrdb_avr.schema.plan import Plan, canonical, parse_plan
from jrdb_avr.schema.questions import Proof, QuestionRecord
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Slots, Template, forms_of

_TOLERANCE: Final = 1e-9
"""Seconds and degrees that differ by no more are the same."""


class Difference(NamedTuple):
    """A column or a proof (`where`) that differs from the stored record."""

    question_id: str
    where: str
    what: str

    def __str__(self) -> str:
        return ": ".join(self)


class StoredPlan(NamedTuple):
    """A stored question with its plan, the form of its template that the plan has, and the plan's slots."""

    record: QuestionRecord
    plan: Plan
    form: Template
    slots: Slots


# -- comparison ---------------------------------------------------------------------------------------------------


def differences(stored: QuestionRecord, again: Mapping[str, Any]) -> Iterator[Difference]:
    """Compare a stored record with values by column that were found again.

    An answer is compared by its text, proofs one by one, a frozenset without regard to order.
    """
    for name, now in again.items():
        before: Any = stored.answer_text if name == "answer" else getattr(stored, name)
        if name == "proofs":
            yield from _differing_proofs(stored, now)
        elif isinstance(now, float):
            if abs(before - now) > _TOLERANCE:
                yield Difference(stored.question_id, name, f"stored {before}, now {now}")
        elif now != (frozenset(before) if isinstance(now, frozenset) else before):
            yield Difference(stored.question_id, name, f"stored {_short(before)}, now {_short(now)}")


def _differing_proofs(stored: QuestionRecord, again: Sequence[Proof]) -> Iterator[Difference]:
    """Proofs that are missing, superfluous or different."""
    before, now = ({(one.kind, one.variant): one for one in proofs} for proofs in (stored.proofs, again))
    for key in now | before:
        if before.get(key) != now.get(key):
            what = f"stored {_outcome(before.get(key))}, now {_outcome(now.get(key))}"
            yield Difference(stored.question_id, " ".join(key), what)
    if len(stored.proofs) != len(again) and before.keys() == now.keys():
        yield Difference(stored.question_id, "proofs", f"{len(stored.proofs)} are stored, {len(again)} are run")


def _outcome(proof: Proof | None) -> str:
    if proof is None:
        return "nothing"
    answer = f" ({_short(proof.answer)})" if proof.answer is not None else ""
    holds = "" if proof.holds is None else ", holds" if proof.holds else ", does not hold"
    return f"{proof.outcome}{answer}{holds}"


def _short(value: Any) -> str:
    """Shorten a value to fit a line of a report."""
    text = value if isinstance(value, str) else msgspec.json.encode(value).decode()
    return text if len(text) <= 80 else f"{text[:77]}..."


def read_plans(records: Iterable[QuestionRecord]) -> tuple[list[StoredPlan], list[Difference]]:
    """Read plans with their forms; a plan that cannot be read is a difference."""
    plans, unreadable = [], []
    for record in records:
        try:
            plan = parse_plan(record.plan)
            plans.append(StoredPlan(record, plan, *_form(record.template, plan)))
        except AvrError as error:
            unreadable.append(Difference(record.question_id, "plan", str(error)))
    return plans, unreadable


def _form(name: str, plan: Plan) -> tuple[Template, Slots]:
    """Find the form of a template that a plan has, and its slots. Raises PlanError where there is none."""
    for template in forms_of(name):
        slots = template.slots(plan)
        if slots is not None and canonical(template.build(slots)) == canonical(plan):
            return template, slots
    raise PlanError("plan", f"it is no plan of the template {name!r}")


# -- proofs -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ReplayJob(LayerJob):
    """A sequence, and its questions whose proofs one process computes again."""

    records: tuple[QuestionRecord, ...]


def replay(
    store: Store,
    records: Sequence[QuestionRecord],
    rules: Rules,
    workers: Executor,
    advance: Callable[[int], None] = lambda steps: None,
) -> list[Difference]:
    """Run the proofs of questions again; differences come in the questions' order.

    `advance` receives the number of finished questions. Raises StoreError where the store lacks a sequence's tables.
    The keyframe layer of these rules is made where the graph lacks it.
    """
    lows = {job.sequence: job.low for job in layer_jobs(store, rules)}
    if not is_stored(store, rules):
        with store.writing("validate --replay"):
            ensure_layer(store, rules, workers)
    jobs = [
        ReplayJob(store.path, name, lows[name], rules, tuple(record for record in records if record.sequence == name))
        for name in sorted({record.sequence for record in records})
    ]
    found: list[Difference] = []
    with hold_graph(store.graph_path, workers):
        for index, own in map_sequences(replay_sequence, jobs, workers, lambda job: job.weight):
            found += own
            advance(len(jobs[index].records))
    place = {record.question_id: number for number, record in enumerate(records)}
    return sorted(found, key=lambda difference: place[difference.question_id])


def replay_sequence(job: ReplayJob) -> list[Difference]:
    """Run the proofs of one sequence's questions again."""
    plans, found = read_plans(job.records)
    annotations = Annotations.read(Store(job.store), job.sequence, job.rules)
    with job.searching() as context:
        names = context.descriptions.numbers(
            (slots.conditions, slots.frames[form.described]) for _, _, form, slots in plans
        )
        by_form: dict[str, list[tuple[StoredPlan, int]]] = defaultdict(list)
        for stored_plan, name in zip(plans, names, strict=True):
            if name == NOBODY:
                what = "its description is none that generation chooses"
                found.append(Difference(stored_plan.record.question_id, "anchor match", what))
            else:
                by_form[stored_plan.form.query].append((stored_plan, name))
        for members in by_form.values():
            candidates = find_candidates(context, members[0][0].form)
            for (stored_plan, _), line in zip(members, _lines(context, candidates, members), strict=True):
                second = rederive(annotations, stored_plan.plan, stored_plan.record.template, job.rules)
                found += _compare(context, candidates, stored_plan.record, line, second)
    return found


_Line = Mapping[str, Any]
"""A candidate as a row of `to_table`."""


def _lines(
    context: SearchContext, candidates: Candidates, members: Sequence[tuple[StoredPlan, int]]
) -> list[_Line | None]:
    """For each plan with the number of its description, the candidate that has this plan, None where there is none."""
    order = np.argsort(candidates.name, kind="stable")
    names = candidates.name[order]
    likely: list[Ints] = []
    for (_, _, _, slots), name in members:
        low, high = np.searchsorted(names, [name, name + 1])
        rows: Ints = order[low:high].astype(np.int64)
        for time, frame in slots.frames.items():
            rows = rows[candidates.frames[time][rows] == frame]
        for codes, relation in zip(candidates.relations.values(), slots.relations, strict=True):
            rows = rows[codes[rows] == (RELATIONS.index(relation) if relation in RELATIONS else NOBODY)]
        likely.append(rows)
    every = np.unique(np.concatenate(likely)) if likely else np.zeros(0, np.int64)
    lines = {line["row"]: line for line in to_table(context, candidates, every).to_pylist()}
    texts = [canonical(stored.plan) for stored, _ in members]
    return [
        next((lines[row] for row in rows.tolist() if lines[row]["plan"] == text), None)
        for rows, text in zip(likely, texts, strict=True)
    ]


def _compare(
    context: SearchContext, candidates: Candidates, stored: QuestionRecord, line: _Line | None, second: Outcome
) -> Iterator[Difference]:
    """Compare a stored record with that of `line`, the candidate with the question's plan, found and proven again.

    second: what the second program finds.
    """
    name = stored.question_id
    if line is None:
        yield Difference(name, "plan", "the stored plan finds no candidate")
        return
    refusing = int(candidates.rule[line["row"]])
    if refusing != PASSED:
        yield Difference(name, RULES[refusing], "refuses the candidate, run again")
        return
    agrees = second.outcome == "defined" and second.answer == line["answer"] and not second.faults
    outcome = "same" if agrees else "different" if second.outcome == "defined" else second.outcome
    sets = choice_sets(context, candidates, line)
    if not sets:
        yield Difference(name, "choices", "now there are fewer than three wrong answers")
        return
    choices = next((choices for choices in sets if choices.texts == stored.choices), sets[0])
    rederived = Proof("rederive", "annotations", agrees, outcome, second.answer)
    record = make_record(context, candidates, line, parse_plan(line["plan"]), rederived, choices)
    again = msgspec.structs.asdict(record) | {"answer": record.answer_text}
    # The id is a hash of columns that are compared themselves.
    del again["question_id"]
    yield from differences(stored, again)


# -- plans as Cypher ----------------------------------------------------------------------------------------------


def run_compiled(
    store: Store, records: Sequence[QuestionRecord], rules: Rules, advance: Callable[[int], None] = lambda steps: None
) -> list[Difference]:
    """Compile the stored plans and run them on the store's graph; `advance` receives the number of finished ones.

    Raises StoreError where there is no sound graph, LockedError while another process writes it.
    """
    plans, found = read_plans(records)
    compiled: list[StoredPlan] = []
    for stored in plans:
        try:
            compile_find(stored.plan, SCENE)
            compiled.append(stored)
        except PlanError as error:
            found.append(Difference(stored.record.question_id, "compiled", str(error)))
    with Graph.open(store.graph_path, read_only=True) as graph:
        scoped = [PlanQuery(stored.plan, stored.record.sequence) for stored in compiled]
        solutions = solve(SceneReader(graph, SCENE, rules.load), scoped, rules, advance)
    for (record, plan, _, _), solution in zip(compiled, solutions, strict=True):
        if solution.outcome != "defined":
            what = f"{solution.outcome}, stored {_short(record.answer_text)}"
            found.append(Difference(record.question_id, "compiled", what))
            continue
        bindings = dict(solution.people) | dict(solution.times)
        again = {"answer": solution.answer, "target_track": solution.people[plan.target], "bindings": bindings}
        found += differences(record, again)
    return found
