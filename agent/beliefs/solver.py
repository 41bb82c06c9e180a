"""The reference agent's solver: what a plan comes to over the beliefs of one episode.

The plan is compiled to Cypher, and solved and read by the solver that also runs the stored plans on the scene. What was
not written down is unknown, and what is unknown is no match. Where the graph does not give an answer yet,
`Belief.missing` says in words what it lacks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.agent.beliefs.likely import likeliest, rest
from jrdb_avr.agent.beliefs.parts import Parts, bindings, parts_of
from jrdb_avr.queries.compiler import (
    Asked,
    BeliefReader,
    Outcome,
    Queried,
    Rows,
    Solution,
    outcome_of_target,
    read_with,
    solve_with,
)
from jrdb_avr.queries.compiler.beliefs import DISTANCE_CUT_M, Moment, notes_of
from jrdb_avr.schema.answers import TIE, Answer, Choice, decode_answer, same_answer
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import Rules

TIMEOUT_S: Final = 10.0
"""For each statement."""

_MOST_MISSING: Final = 12
"""Lines of `missing`: a model is told no more at once."""


@dataclass(frozen=True)
class Belief:
    """What a plan comes to over an episode's beliefs.

    outcome: defined where there is one target and its answer is known; ambiguous: several fit; empty: nobody does;
    unknown: the target is found, its answer is not. people: names of entities by node, those that are the same in all
    that fits. times: frames by name, as far as they are known. answer: a choice's text or another answer's stored JSON.
    seen: the target's box, stitched pixels, in the frame that the answer was read from (where it is not seen in it: in
    another one that tells it, or the newest). missing: what the graph lacks, in words.
    """

    outcome: Outcome
    people: Mapping[str, str] = field(default_factory=dict)
    times: Mapping[str, int] = field(default_factory=dict)
    answer: str | None = None
    seen: tuple[int, Box] | None = None
    missing: tuple[str, ...] = ()


def solve_beliefs(graph: Queried, episode: str, plan: Plan, rules: Rules, rows: Rows | None = None) -> Belief:
    """Solve a plan over the beliefs of the episode with this key: compiled, by the engine.

    rows: what is believed, where that is at hand: the engine then only looks for the people. A plan that so many sets
    of people nearly fit that the engine would be kept from other episodes is not run, and counts as ambiguous.
    Raises PlanError for a plan that cannot be compiled, QueryError where a statement takes too long.
    """
    reader = BeliefReader(graph, episode, TIMEOUT_S, rows)
    parts = parts_of(reader, plan)
    if bindings(parts) is None:
        return _TOO_MANY
    return _belief(reader, parts, solve_with(reader, [Asked(plan, episode)], _cut(rules))[0])


def weigh_beliefs(rows: Rows, plan: Plan, rules: Rules) -> Belief:
    """The same of an episode whose beliefs are at hand, without the engine: what is missing after every turn. What
    counts as an answer is what `solve_beliefs` finds.
    """
    reader = BeliefReader(_Nothing(), "", TIMEOUT_S, rows)
    parts = parts_of(reader, plan)
    found = bindings(parts)
    if found is None:
        return _TOO_MANY
    outcome, people = outcome_of_target(plan, found)
    solution = read_with(reader, Asked(plan, ""), people, _cut(rules)) if people else Solution(outcome)
    return _belief(reader, parts, solution)


def best_guess(graph: Queried, episode: str, plan: Plan, rules: Rules, rows: Rows | None = None) -> Belief | None:
    """What is read of the entity that comes nearest to being the plan's target, None where there is nobody.

    That is the one with which most conditions and edges hold, then the one seen at most frames, then the smallest name.
    Its outcome is defined where the plan's read is known of it, else unknown, and its newest box is seen then. Nothing
    is read of others. rows: as of `solve_beliefs`.
    """
    reader = BeliefReader(graph, episode, TIMEOUT_S, rows)
    parts = parts_of(reader, plan)
    if not parts.people:
        return None
    fits = {who: likeliest(parts, {plan.target: who})[1] for who in parts.people}
    best = min(parts.people, key=lambda who: (-fits[who], -len({one.frame for one in reader.moments(who)}), who))
    solution = read_with(reader, Asked(plan, episode), {plan.target: best}, _cut(rules))
    if solution.outcome == "unknown":
        reader.shown.clear()
    return _belief(reader, parts, solution)


class _Nothing:
    """In the place of a graph, where all that is believed is at hand."""

    def query(
        self,
        cypher: str,
        params: Mapping[str, Any] | None = None,
        *,
        ordered: bool = True,
        timeout_s: float | None = None,
    ) -> pa.Table:
        raise AssertionError("what is at hand is not asked for")


def _cut(rules: Rules) -> Rules:
    """Rules under which distances are compared as the protocol of the agent says."""
    cut = DISTANCE_CUT_M - TIE
    return msgspec.structs.replace(rules, distance_changed_m=cut, distance_same_m=cut)


def _belief(reader: BeliefReader, parts: Parts, solution: Solution) -> Belief:
    plan = parts.plan
    people = {node: str(who) for node, who in solution.people.items()}
    if not people:
        return Belief(solution.outcome, missing=_lacking(reader, parts, solution.outcome))
    seen = _seen(reader.moments(people[plan.target]), reader.shown.get(0, []))
    missing = () if solution.outcome == "defined" else _unread(reader, plan, people)
    return Belief(solution.outcome, people, dict(solution.times), solution.answer, seen, missing)


_TOO_MANY: Final = Belief(
    "ambiguous", missing=("too many sets of people come near to fitting; what tells them apart is missing",)
)


def legal(plan: Plan, belief: Belief, proposed: Answer, entity: str, choices: Sequence[str]) -> str:
    """Why a final answer is refused, "" where it is legal: the graph gives one target, which is `entity`, and an answer
    that is the same as the proposed one as scores go.
    """
    lacks = "; ".join(belief.missing)
    if belief.outcome == "empty":
        return f"nobody in the graph fits the plan; missing: {lacks}"
    if belief.outcome == "ambiguous":
        return f"the graph has no single target; {lacks}"
    target = belief.people[plan.target]
    if entity != target:
        return f"the plan's target in the graph is {target}, not {entity}"
    if belief.outcome == "unknown" or belief.answer is None:
        return f"the graph does not give the answer; missing: {lacks}"
    truth = answer_of(plan, belief, choices)
    if truth is None:
        return f"the graph's answer is {belief.answer!r}, which is none of the choices"
    if not same_answer(proposed, truth):
        said = belief.answer
        if isinstance(truth, Choice):
            said = f"choice {truth.choice}, {belief.answer!r}"
        return f"the graph's answer is {said}, which the proposed one is not"
    return ""


def answer_of(plan: Plan, belief: Belief, choices: Sequence[str]) -> Answer | None:
    """The answer that is read from the graph, None where there is none, or none of the choices says it."""
    if belief.outcome != "defined" or belief.answer is None:
        return None
    if plan.answer.mode != "multiple_choice":
        return decode_answer(plan.answer.mode, belief.answer)
    return Choice(list(choices).index(belief.answer) + 1) if belief.answer in choices else None


# -- boxes ------------------------------------------------------------------------------------------------------------


def _seen(moments: Sequence[Moment], frames: Sequence[int]) -> tuple[int, Box] | None:
    """The box in the last of these frames that has one, else the newest box."""
    by_frame = {moment.frame: moment for moment in moments}
    for frame in reversed(frames):
        if frame in by_frame:
            return frame, by_frame[frame].box
    newest = max(moments, key=lambda moment: moment.written, default=None)
    return None if newest is None else (newest.frame, newest.box)


# -- what is missing --------------------------------------------------------------------------------------------------


def _lacking(reader: BeliefReader, parts: Parts, outcome: Outcome) -> tuple[str, ...]:
    """What keeps the plan's people from being found."""
    if outcome == "ambiguous":
        target = parts.plan.target
        fits = ", ".join(sorted({one[target] for one in bindings(parts) or ()}))
        return (f"several fit as {target}: {fits}; what tells them apart is missing",)
    said = {node: who for who, node in reader.nodes().items() if node}
    named, _ = likeliest(parts, {node: who for node, who in said.items() if who in parts.people})
    return tuple(rest(parts, named)[:_MOST_MISSING])


def _unread(reader: BeliefReader, plan: Plan, people: Mapping[str, str]) -> tuple[str, ...]:
    """What keeps the answer from being read."""
    notes = notes_of(plan, reader.notes.get(0, []))
    if plan.answer.of not in people:
        notes.insert(0, f"several fit as {plan.answer.of}; what tells them apart is missing")
    unplaced = [name for name, time in plan.times.items() if time.event == "end" and not _follows_start(plan, name)]
    if plan.answer.read != "next_action":
        notes += [f"time {name}: an end is read only after the start of the same action" for name in unplaced]
    return tuple(f"the answer: {note}" for note in notes[:_MOST_MISSING]) or ("the answer: it is not known",)


def _follows_start(plan: Plan, name: str) -> bool:
    time = plan.times[name]
    before = plan.times[time.after or name]
    return before.event == "start" and before.action == time.action
