"""The reference agent's solver: find the people and the answer of a plan in the beliefs of one episode.

An answer is judged by the compiled plan, which the engine runs, and which is solved and read by the solver that also
runs the stored plans on the scene. What is missing after every turn is found without the engine, by matching the plan
with the episode's rows. What was not written down is unknown, and what is unknown is no match.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import msgspec

from jrdb_avr.agent.beliefs.matching import PlanMatch
from jrdb_avr.queries.compiler.beliefs import (
    DISTANCE_CUT_M,
    BeliefReader,
    BeliefRows,
    Moment,
    notes_of,
)
from jrdb_avr.queries.compiler.believed import find_believed
from jrdb_avr.queries.compiler.find import Agreed, Outcome, outcome_of_target
from jrdb_avr.queries.compiler.reads import Queryable
from jrdb_avr.queries.compiler.solve import PlanQuery, Solution, read_with
from jrdb_avr.schema.answer_modes import MODES, decode_answer, same_answer
from jrdb_avr.schema.answers import TIE, Answer, Choice
from jrdb_avr.schema.beliefs import episode_key
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.labels import choice_of
from jrdb_avr.schema.method import Question
from jrdb_avr.schema.panorama import Box, center_angle
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS, Rules

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.world_model import WorldModel

TIMEOUT_S: Final = 10.0
"""For each statement."""

NEAR_FRAMES: Final = round(FPS)
"""An observation this near to a stated frame, or nearer, stands for it: a moment scores within a second."""

_NEAREST: Final = 3
"""Observed frames that are tried for a stated one."""

_MOST_PLACEMENTS: Final = 8
"""Of a plan; the farther ones are left out."""

_MOST_MISSING: Final = 12
"""Lines of `missing`: a model reads no more at once."""


@dataclass(frozen=True)
class Belief:
    """Result of solving a plan over the beliefs of an episode.

    outcome: defined where there is one target and its answer is known; ambiguous: several fit; empty: nobody does;
    unknown: the target is found, its answer is not. people: names of entities by node, those that are the same in all
    that fits. times: frames by name, as far as they are known. answer: a choice's text or another answer's stored JSON.
    seen: the target's box, stitched pixels, in the frame that the answer was read from (where it is not seen in it: in
    another one that tells it, or the newest). missing: what the graph lacks, in words. held: of a guess, the share
    of the plan's conditions and edges that hold.
    """

    outcome: Outcome
    people: Mapping[str, str] = field(default_factory=dict)
    times: Mapping[str, int] = field(default_factory=dict)
    answer: str | None = None
    seen: tuple[int, Box] | None = None
    missing: tuple[str, ...] = ()
    held: float = 0.0


_TOO_MANY: Final = Belief(
    "ambiguous", missing=("too many sets of people come near to fitting; what tells them apart is missing",)
)


@dataclass(frozen=True)
class BeliefSolver:
    """Solves plans over the beliefs of the episode with this key.

    _found: what compiled statements found, by the plan's target and the people who fit each of its parts.
    """

    graph: Queryable
    key: str
    choices: Sequence[str] = ()
    rules: Rules = Rules()  # noqa: RUF009
    _found: dict[Hashable, Agreed] = field(default_factory=dict, repr=False)

    def check(self, plan: Plan) -> None:
        """Have a plan's statement checked and parsed, before the turns that run it.

        Raises PlanError for a plan that cannot be compiled. What the engine refuses is left to `solve`.
        """
        compiled = find_believed(plan)
        with contextlib.suppress(QueryError):
            self._reader(None).prepare(compiled)

    def solve(self, plan: Plan, rows: BeliefRows | None = None) -> Belief:
        """Solve a plan by its compiled Cypher statement.

        rows: what is believed, where that is at hand: the engine then only looks for the people, and only where who
        fits the plan's parts is not as it was before. A plan that so many sets of people nearly fit that other episodes
        would wait for it is not run, and counts as ambiguous.
        Raises PlanError for a plan that cannot be compiled, QueryError where a statement takes too long.
        """
        return self._settled(plan, rows, self._compiled)

    def weigh(self, plan: Plan, rows: BeliefRows) -> Belief:
        """The same of beliefs that are at hand, without the engine."""
        return self._settled(plan, rows, lambda reader, match: outcome_of_target(plan, match.bindings or ()))

    def _settled(
        self, plan: Plan, rows: BeliefRows | None, find: Callable[[BeliefReader, PlanMatch], Agreed]
    ) -> Belief:
        reader, match = self._match(plan, rows)
        if match.bindings is None:
            return _TOO_MANY
        outcome, people = find(reader, match)
        solution = read_with(reader, self._query(plan), people, self._cut) if people else Solution(outcome)
        return _belief(reader, match, solution)

    def _compiled(self, reader: BeliefReader, match: PlanMatch) -> Agreed:
        """The target that the compiled statement finds, which runs once for the same people who fit the parts."""
        known = (match.plan.target, *match.parts)
        if known not in self._found:
            find = reader.find(match.plan)
            rows = reader.run(find.cypher, [{"id": 0, **find.row}])
            self._found[known] = reader.agreed(match.plan, find, rows)
        return self._found[known]

    def placements(self, plan: Plan, rows: BeliefRows, anywhere: bool) -> list[Plan]:
        """Copies of a plan whose stated frames are replaced by frames that were looked at, the smallest change first.

        A frame stands for one that is at most `NEAR_FRAMES` away; `anywhere`: where there is none, the nearest does. A
        stated frame that none stands for stays.
        """
        known = {row["frame"] for row in rows["sighted"]} | {*self._reader(rows).covered()}
        stated = {name: time for name, time in plan.times.items() if time.frame is not None}
        tried = []
        for time in stated.values():
            frame = time.frame or 0
            nearest = sorted(known, key=lambda other: (abs(other - frame), other))[:_NEAREST]
            near = [other for other in nearest if abs(other - frame) <= NEAR_FRAMES]
            tried.append([(abs(f - frame), f) for f in near or (nearest[:1] if anywhere else ()) or [frame]])
        placed = sorted(itertools.product(*tried), key=lambda places: sum(away for away, _ in places))
        return [
            msgspec.structs.replace(
                plan,
                times=plan.times
                | {
                    name: msgspec.structs.replace(stated[name], frame=frame)
                    for name, (_, frame) in zip(stated, places, strict=True)
                },
            )
            for places in placed[:_MOST_PLACEMENTS]
        ]

    def guess(self, plan: Plan, rows: BeliefRows | None = None, entity: str = "") -> Belief | None:
        """Read the plan's answer of one entity, or of the one that fits the plan best; None where no entity is known.

        That is the one with which most conditions and edges hold, then the one seen at most frames, then the smallest
        name. Its outcome is defined where the plan's read is known of it, else unknown, and its newest box is seen
        then. A moment may lie between any two looks. Nothing is read of others.
        """
        reader, match = self._match(plan, rows, anywhen=True)
        people = [who for who in match.people if entity in ("", who)]
        if not people:
            return None
        fits = {who: match.likeliest({plan.target: who})[1] for who in people}
        best = min(people, key=lambda who: (-fits[who], -len({one.frame for one in reader.moments(who)}), who))
        solution = read_with(reader, self._query(plan), {plan.target: best}, self._cut)
        if solution.outcome == "unknown":
            reader.evidence.clear()
        held = fits[best] / max(len(match.counted), 1)
        return replace(_belief(reader, match, solution), held=held)

    def prior(self, plan: Plan, belief: Belief) -> Answer:
        """Return an answer where nothing tells one, of a person who was seen."""
        assert belief.seen is not None, "somebody was seen"
        frame, (x, _, w, _) = belief.seen
        return MODES[plan.answer.mode].make((frame, frame), center_angle(x, w))

    def answer(self, plan: Plan, belief: Belief) -> Answer | None:
        """The answer that is read from the beliefs, None where there is none, or none of the choices says it."""
        if belief.outcome != "defined" or belief.answer is None:
            return None
        if not MODES[plan.answer.mode].is_choice:
            return decode_answer(plan.answer.mode, belief.answer)
        number = choice_of(belief.answer, self.choices)
        return None if number is None else Choice(number)

    def fault(self, plan: Plan, belief: Belief, proposed: Answer, entity: str) -> str:
        """Why a final answer is refused, "" where it is legal: the graph gives one target, which is `entity`, and an
        answer that is the same as the proposed one as scores go.
        """
        missing = "; ".join(belief.missing)
        if belief.outcome == "empty":
            return f"nobody in the graph fits the plan; missing: {missing}"
        if belief.outcome == "ambiguous":
            return f"the graph has no single target; {missing}"
        target = belief.people[plan.target]
        if entity != target:
            return f"the plan's target in the graph is {target}, not {entity}"
        if belief.outcome == "unknown" or belief.answer is None:
            return f"the graph does not give the answer; missing: {missing}"
        truth = self.answer(plan, belief)
        if truth is None:
            return f"the graph's answer is {belief.answer!r}, which is none of the choices"
        if same_answer(proposed, truth):
            return ""
        text = f"choice {truth.choice}, {belief.answer!r}" if isinstance(truth, Choice) else belief.answer
        return f"the graph's answer is {text}, which the proposed one is not"

    @property
    def _cut(self) -> Rules:
        """Rules under which distances are compared as the protocol of the agent says."""
        cut = DISTANCE_CUT_M - TIE
        return msgspec.structs.replace(self.rules, distance_changed_m=cut, distance_same_m=cut)

    def _query(self, plan: Plan) -> PlanQuery:
        return PlanQuery(plan, self.key, self.choices)

    def _match(self, plan: Plan, rows: BeliefRows | None, anywhen: bool = False) -> tuple[BeliefReader, PlanMatch]:
        reader = self._reader(rows, anywhen)
        return reader, PlanMatch(reader, plan)

    def _reader(self, rows: BeliefRows | None, anywhen: bool = False) -> BeliefReader:
        return BeliefReader(self.graph, self.key, TIMEOUT_S, rows, anywhen)


def beliefs_of(world: WorldModel, question: Question) -> BeliefSolver:
    """The solver of a question's episode."""
    return BeliefSolver(world.graph, episode_key(world.run_id, question.question_id), question.choices)


def _belief(reader: BeliefReader, match: PlanMatch, solution: Solution) -> Belief:
    people = {node: str(who) for node, who in solution.people.items()}
    if not people:
        return Belief(solution.outcome, missing=_unfound(reader, match, solution.outcome))
    seen = _seen(reader.moments(people[match.plan.target]), reader.evidence.get(0, []))
    missing = () if solution.outcome == "defined" else _unread(reader, match.plan, people)
    return Belief(solution.outcome, people, dict(solution.times), solution.answer, seen, missing)


def _seen(moments: Sequence[Moment], frames: Sequence[int]) -> tuple[int, Box] | None:
    """The box in the last of these frames that has one, else the newest box."""
    boxes = {moment.frame: moment.box for moment in moments}
    by_age = [moment.frame for moment in sorted(moments, key=lambda moment: moment.written)]
    frame = next((frame for frame in reversed([*by_age, *frames]) if frame in boxes), None)
    return None if frame is None else (frame, boxes[frame])


def _unfound(reader: BeliefReader, match: PlanMatch, outcome: Outcome) -> tuple[str, ...]:
    """What keeps the plan's people from being found."""
    if outcome == "ambiguous":
        target = match.plan.target
        fits = ", ".join(sorted({one[target] for one in match.bindings or ()}))
        return (f"several fit as {target}: {fits}; what tells them apart is missing",)
    named = {node: who for who, node in reader.nodes().items() if node and who in match.people}
    likeliest, _ = match.likeliest(named)
    return tuple(match.missing(likeliest)[:_MOST_MISSING])


def _unread(reader: BeliefReader, plan: Plan, people: Mapping[str, str]) -> tuple[str, ...]:
    """What keeps the answer from being read."""
    notes = notes_of(plan, reader.notes.get(0, []))
    if plan.answer.of not in people:
        notes.insert(0, f"several fit as {plan.answer.of}; what tells them apart is missing")
    if plan.answer.read != "next_action":
        for name, time in plan.times.items():
            start = plan.times[time.after or name]
            if time.event == "end" and (start.event, start.action) != ("start", time.action):
                notes.append(f"time {name}: an end is read only after the start of the same action")
    return tuple(f"the answer: {note}" for note in notes[:_MOST_MISSING]) or ("the answer: it is not known",)
