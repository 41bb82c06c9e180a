"""Proofs run again: every stored plan is searched for once more, and all that is stored of it is compared.

Nothing of the stored record is taken over. A plan's own description, found once more among everybody with a box, takes
the place of those that generation chooses; from there the same queries search and prove, set-wise per sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.generate.candidates import PASSED, RULES, Candidates, to_table
from jrdb_avr.engine.generate.conditions import find_conditions
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.descriptions import resolve
from jrdb_avr.engine.generate.records import make_record
from jrdb_avr.engine.generate.relations import RELATIONS, find_facts
from jrdb_avr.engine.generate.scene import NOBODY, Ints, box_count, load_scene
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.engine.validate.stored import Difference, Stored, decoded, read_plans, short
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import map_shards
from jrdb_avr.schema.plan import Plan, canonical
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Template

_TOLERANCE: Final = 1e-9
"""Seconds and degrees that differ by no more are the same."""


@dataclass(frozen=True)
class ReplayJob:
    """A sequence whose questions' proofs are to be run again."""

    store: Path
    sequence: str
    rules: Rules
    questions: tuple[Stored, ...]


def replay(
    store: Store,
    questions: Sequence[Stored],
    rules: Rules,
    workers: int,
    advance: Callable[[int], None] = lambda steps: None,
) -> list[Difference]:
    """Run the proofs of questions again; differences in the questions' order. `advance` is told how many are done.

    Raises StoreError where the store lacks a sequence's tables.
    """
    by_sequence: dict[str, list[Stored]] = {}
    for question in questions:
        by_sequence.setdefault(question.sequence, []).append(question)
    jobs = [ReplayJob(store.path, name, rules, tuple(members)) for name, members in sorted(by_sequence.items())]
    found: dict[str, list[Difference]] = {}
    for index, differences in map_shards(replay_sequence, jobs, workers, lambda job: box_count(store, job.sequence)):
        for difference in differences:
            found.setdefault(difference.question_id, []).append(difference)
        advance(len(jobs[index].questions))
    return [difference for question in questions for difference in found.pop(question.question_id, [])]


def replay_sequence(job: ReplayJob) -> list[Difference]:
    """Run the proofs of one sequence's questions again."""
    store = Store(job.store)
    scene = load_scene(store, job.sequence)
    facts = find_facts(scene)
    given, differences = read_plans(job.questions)
    conditions = find_conditions(scene, facts, job.rules)
    stated = [(_root(plan), _frame(plan)) for _, plan, _ in given]
    descriptions, names = resolve(conditions, stated, job.rules)
    searched: dict[str, list[tuple[Stored, Plan, int]]] = {}
    forms: dict[str, Template] = {}
    for (question, plan, form), name in zip(given, names, strict=True):
        if name < 0:
            differences.append(Difference(question.question_id, "anchor match", "its description fits nobody alone"))
            continue
        forms[form.query] = form
        searched.setdefault(form.query, []).append((question, plan, name))
    annotations = Annotations.read(store, job.sequence, job.rules)
    with SearchContext(scene, job.rules, facts, descriptions) as context:
        for query, members in searched.items():
            again = _Regenerated(context, find_candidates(context, forms[query]), annotations)
            for (question, plan, _), line in zip(members, _lines(again, members), strict=True):
                differences += again.compared(question, plan, line)
    return differences


def _root(plan: Plan) -> tuple[Any, ...]:
    return next(node.conditions for node in plan.nodes if node.id == plan.root)


def _frame(plan: Plan) -> int:
    """The frame at which the description holds: the first stated one."""
    return next(time.frame for _, time in sorted(plan.times.items()) if time.frame is not None)


_Line = Mapping[str, Any]
"""A candidate as a row of `to_table`."""


def _lines(again: _Regenerated, members: Sequence[tuple[Stored, Plan, int]]) -> list[_Line | None]:
    """For each plan with the number of its description, the candidate that has this plan, None where there is none."""
    candidates = again.candidates
    order = np.argsort(candidates.name, kind="stable")
    names = candidates.name[order]
    likely: list[Ints] = []
    for _, plan, name in members:
        low, high = np.searchsorted(names, [name, name + 1])
        rows: Ints = order[low:high].astype(np.int64)
        for time in candidates.template.stated:
            rows = rows[candidates.frames[time][rows] == plan.times[time].frame]
        for column, codes in candidates.relations.items():
            relation = _relation(plan, column)
            rows = rows[codes[rows] == (RELATIONS.index(relation) if relation in RELATIONS else NOBODY)]
        likely.append(rows)
    every = np.unique(np.concatenate(likely)) if likely else np.zeros(0, np.int64)
    table = to_table(again.context, candidates, every)
    lines = {line["row"]: line for line in table.to_pylist()}
    texts = [canonical(plan) for _, plan, _ in members]
    return [
        next((lines[row] for row in rows.tolist() if lines[row]["plan"] == text), None)
        for rows, text in zip(likely, texts, strict=True)
    ]


def _relation(plan: Plan, name: str) -> str | None:
    """The relation of an edge by its column, r1, r2, ...; without edges, that which is counted."""
    return plan.edges[int(name[1:]) - 1].relation if plan.edges else plan.answer.relation


@dataclass(frozen=True)
class _Regenerated:
    """Candidates of a template, found and proven again."""

    context: SearchContext
    candidates: Candidates
    annotations: Annotations

    def compared(self, question: Stored, plan: Plan, line: _Line | None) -> Iterator[Difference]:
        """What differs from what is stored; `line` is the candidate with the question's plan."""
        if line is None:
            yield Difference(question.question_id, "plan", "the stored plan finds no candidate")
            return
        refusing = int(self.candidates.rule[line["row"]])
        if refusing != PASSED:
            yield Difference(question.question_id, RULES[refusing], "refuses the candidate, run again")
            return
        second = rederive(self.annotations, plan, question.template, self.context.rules)
        agrees = second.outcome == "defined" and second.answer == line["answer"] and not second.faults
        outcome = "same" if agrees else "different" if second.outcome == "defined" else second.outcome
        rederived = Proof("rederive", "annotations", agrees, outcome, second.answer)
        record = make_record(self.context, self.candidates, line, rederived)
        if record is None:
            yield Difference(question.question_id, "choices", "now there are fewer than three wrong answers")
            return
        again = record.columns()
        yield from _proofs_differ(question, decoded(again["proofs"]))
        columns = {"answer": (question.said, line["answer"]), "choices": (list(question.choices), list(record.choices))}
        columns |= {name: (question.row[name], again[name]) for name in _COMPARED}
        for name, (before, now) in columns.items():
            if name in _JSON:
                before, now = decoded(str(before)), decoded(str(now))
            if not _same(before, now):
                yield Difference(question.question_id, name, f"stored {short(before)}, now {short(now)}")


_JSON: Final = ("bindings", "needed", "distractors")
_COMPARED: Final = ("target_track", *_JSON, "hops", "time_gap_s", "separation_deg", "people_in_scene")


def _proofs_differ(question: Stored, again: Sequence[Mapping[str, Any]]) -> Iterator[Difference]:
    """Proofs that are missing, too many, or come out otherwise."""
    stored = decoded(question.row["proofs"])
    if not isinstance(stored, list) or not all(isinstance(one, dict) for one in stored):
        yield Difference(question.question_id, "proofs", "no list of proofs")
        return
    named = [{(str(one.get("kind")), str(one.get("variant"))): one for one in proofs} for proofs in (stored, again)]
    for key in dict.fromkeys([*named[1], *named[0]]):
        before, now = (proofs.get(key) for proofs in named)
        if before != now:
            where = f"{key[0]} {key[1]}"
            yield Difference(question.question_id, where, f"stored {_outcome(before)}, now {_outcome(now)}")
    if len(stored) != len(again) and set(named[0]) == set(named[1]):
        yield Difference(question.question_id, "proofs", f"{len(stored)} are stored, {len(again)} are run")


def _outcome(one: Mapping[str, Any] | None) -> str:
    if one is None:
        return "nothing"
    answer = f" ({short(one['answer'])})" if one.get("answer") is not None else ""
    rest = "".join(f", {name} {short(one[name])}" for name in sorted(one.keys() - _PROOF_FIELDS))
    return f"{one.get('outcome')}{answer}, {'holds' if one.get('holds') is True else 'does not hold'}{rest}"


_PROOF_FIELDS: Final = {"kind", "variant", "holds", "outcome", "answer"}


def _same(before: Any, now: Any) -> bool:
    if isinstance(now, float) and isinstance(before, float):
        return abs(before - now) <= _TOLERANCE
    return bool(before == now)
