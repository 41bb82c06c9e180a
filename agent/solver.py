"""The reference agent's solver: what a plan comes to over the beliefs of one episode.

The plan is compiled to Cypher by the compiler that also runs the stored plans on the scene. What was not written down
is unknown, and what is unknown is no match. Where the graph does not give an answer yet, `Belief.missing` says in words
what it lacks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import msgspec

from jrdb_avr.queries.compiler import (
    WORLD,
    Asked,
    BeliefReader,
    Outcome,
    Queried,
    Solution,
    compile_parts,
    solve_with,
)
from jrdb_avr.queries.compiler.beliefs import DISTANCE_CUT_M, Moment, notes_of
from jrdb_avr.queries.compiler.find import Ways
from jrdb_avr.schema.answers import TIE, Answer, Choice, decode_answer, same_answer
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import Rules

from .likely import Parts, likeliest, rest

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


def solve_beliefs(graph: Queried, episode: str, plan: Plan, rules: Rules) -> Belief:
    """Solve a plan over the beliefs of the episode with this key.

    Raises PlanError for a plan that cannot be compiled, QueryError where a statement takes too long.
    """
    cut = DISTANCE_CUT_M - TIE
    rules = msgspec.structs.replace(rules, distance_changed_m=cut, distance_same_m=cut)
    reader = BeliefReader(graph, episode, TIMEOUT_S)
    solution = solve_with(reader, [Asked(plan, episode)], rules)[0]
    answer = solution.answer
    people = {node: str(who) for node, who in solution.people.items()}
    if not people:
        return Belief(solution.outcome, missing=_lacking(reader, plan, solution))
    seen = _seen(reader.moments(people[plan.target]), reader.shown.get(0, []))
    missing = () if solution.outcome == "defined" else _unread(reader, plan, people)
    return Belief(solution.outcome, people, dict(solution.times), answer, seen, missing)


def best_guess(graph: Queried, episode: str, plan: Plan, rules: Rules) -> tuple[int, Box] | None:
    """Frame and newest box of the entity that comes nearest to being the plan's target, None where there is nobody.

    That is the one with which most conditions and edges hold, then the one seen at most frames, then the smallest name.
    """
    reader = BeliefReader(graph, episode, TIMEOUT_S)
    parts = _parts(reader, plan)
    fits = {who: likeliest(parts, {plan.target: who})[1] for who in parts.people}
    best = [who for who in parts.people if fits[who] == max(fits.values())]
    seen = {who: reader.moments(who) for who in best}
    ranked = sorted(best, key=lambda who: (-len({moment.frame for moment in seen[who]}), who))
    return _seen(seen[ranked[0]], []) if ranked else None


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


def _parts(reader: BeliefReader, plan: Plan) -> Parts:
    """Which parts of the plan hold, of whom."""
    compiled = compile_parts(plan, WORLD)
    rows = reader.ask(compiled.cypher, [{"id": 0, **compiled.row}])

    def one(ways: Ways) -> frozenset[str]:
        return frozenset(row[n] for n, _, name in ways for row in rows if row[name])

    return Parts(
        plan,
        tuple(sorted({row["id"] for row in rows})),
        {key: one(ways) for key, ways in compiled.sighted.items()},
        {key: one(ways) for key, ways in compiled.conditions.items()},
        tuple(
            frozenset((row[n], row[m]) for n, m, name in ways for row in rows if row[name]) for ways in compiled.edges
        ),
    )


def _lacking(reader: BeliefReader, plan: Plan, solution: Solution) -> tuple[str, ...]:
    """What keeps the plan's people from being found."""
    parts = _parts(reader, plan)
    if solution.outcome == "ambiguous":
        fits = ", ".join(who for who in parts.people if likeliest(parts, {plan.target: who})[1] == parts.all)
        return (f"several fit as {plan.target}: {fits}; what tells them apart is missing",)
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
