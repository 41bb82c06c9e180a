"""The solver.

It compiles plans and runs them on a graph to find their people, the frames of their events, and the answers.

A plan is solved if exactly one binding of its nodes is certain, no other binding is possible, and the requested value
is known. Plans with equal statements run together.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from jrdb_avr.queries.compiler.find import Outcome, frames_of_events
from jrdb_avr.queries.compiler.mapping import PersonId
from jrdb_avr.queries.compiler.reads import Person, SceneReader, Seen, Segment, events_of
from jrdb_avr.schema.answers import Answer, FrameAnswer, FrameViewpoint, Number, Span, encode_answer
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS, answer_of_choice
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS, Rules


@dataclass(frozen=True)
class PlanQuery:
    """A plan with its scope and the choices of its question.

    Attributes:
        plan: Plan.
        scope: Name of the sequence, or key of the episode.
        choices: Texts of the choices, as stored. Only the read `action` needs them.
    """

    plan: Plan
    scope: str
    choices: Sequence[str] = ()


@dataclass(frozen=True)
class Solution:
    """Result of one plan.

    Attributes:
        outcome: defined: the people are found and the answer is known. ambiguous: several bindings are certain (over
            beliefs: with different targets). empty: no binding is possible. unknown: otherwise.
        people: People by node, if they are found. Over beliefs, only nodes with the same person in all bindings.
        times: Known frames by name of the time.
        answer: Text of a choice, or stored JSON of another answer. None unless the outcome is defined.
    """

    outcome: Outcome
    people: Mapping[str, PersonId] = field(default_factory=dict)
    times: Mapping[str, int] = field(default_factory=dict)
    answer: str | None = None


def solve(
    reader: SceneReader, queries: Sequence[PlanQuery], rules: Rules, advance: Callable[[int], None] = lambda steps: None
) -> list[Solution]:
    """Solve plans with the reader of a namespace.

    Args:
        reader: Reader of the scene.
        queries: Plans with their scopes.
        rules: Thresholds.
        advance: Function that is called with the number of plans after each search.

    Returns:
        The solutions, in the order of `queries`.

    Raises:
        PlanError: If a plan cannot be compiled.
        QueryError: If a statement takes too long.
    """
    # The id of a plan is its index. The reader returns results by this id.
    finds = [reader.find(bound.plan) for bound in queries]
    solutions: dict[int, Solution] = {}
    plans: list[_BoundPlan] = []
    together: dict[str, list[int]] = defaultdict(list)
    for i, find in enumerate(finds):
        together[find.cypher].append(i)
    for cypher, members in together.items():
        bindings: dict[int, list[dict[str, Any]]] = defaultdict(list)
        values = {i: reader.rows(finds[i], queries[i].plan, queries[i].scope) for i in members}
        rows = [{"id": i, **row} for i in members for row in values[i]]
        for row in reader.run(cypher, rows):
            bindings[row["id"]].append(row)
        for i in members:
            outcome, people = reader.agreed(queries[i].plan, finds[i], bindings[i])
            if outcome == "defined":
                plans.append(_BoundPlan(i, queries[i], people))
                plans[-1].times |= frames_of_events(finds[i], bindings[i])
            else:
                solutions[i] = Solution(outcome)
        advance(len(members))
    solutions |= _read_all(reader, plans, rules)
    return [solutions[i] for i in range(len(queries))]


class _BoundPlan:
    """A plan with its people. The frames of its events are added as they become known."""

    def __init__(self, plan_id: int, query: PlanQuery, people: Mapping[str, PersonId]) -> None:
        self.id = plan_id
        self.plan = query.plan
        self.scope = query.scope
        self.offered = [answer_of_choice(choice) for choice in query.choices]
        self.people = people
        self.times = {name: time.frame for name, time in query.plan.times.items() if time.frame is not None}
        self.segments: dict[str, Segment] = {}

    @property
    def target(self) -> Person:
        return self.person(self.plan.answer.of)

    def person(self, node: str) -> Person:
        return Person(self.id, self.scope, self.people[node])

    @property
    def frames(self) -> list[int]:
        """The known frames of the times at which the answer is read."""
        return [self.times[name] for name in self.plan.answer.times if name in self.times]


def _read_all(reader: SceneReader, plans: Sequence[_BoundPlan], rules: Rules) -> dict[int, Solution]:
    solutions = {}
    _read_events(reader, plans)
    by_read: dict[str, list[_BoundPlan]] = defaultdict(list)
    for bound in plans:
        by_read[bound.plan.answer.read].append(bound)
    for read, group in by_read.items():
        answers = _answers(reader, read, [bound for bound in group if bound.plan.answer.of in bound.people], rules)
        for bound in group:
            answer = answers.get(bound.id)
            solutions[bound.id] = Solution("defined" if answer else "unknown", bound.people, bound.times, answer)
    return solutions


def _read_events(reader: SceneReader, plans: Sequence[_BoundPlan]) -> None:
    """Find the frames of all events. An event that follows another event comes later."""
    events = {bound.id: events_of(bound.plan) for bound in plans}
    for turn in range(max(map(len, events.values()), default=0)):
        starts: dict[int, tuple[_BoundPlan, str, tuple[Person, str, int]]] = {}
        absences: dict[int, tuple[_BoundPlan, str, tuple[Person, int]]] = {}
        for bound in plans:
            if turn >= len(events[bound.id]):
                continue
            name = events[bound.id][turn]
            time = bound.plan.times[name]
            before, after = time.after or "", bound.times.get(time.after or "")
            if after is None or time.of is None or time.of not in bound.people:
                continue
            if time.event == "start" and time.action is not None:
                starts[bound.id] = bound, name, (bound.person(time.of), time.action, after)
            elif time.event == "end" and before in bound.segments and bound.plan.times[before].action == time.action:
                # The plan must have the start of the segment too.
                if bound.segments[before].closed:
                    bound.times[name] = bound.segments[before].end
            elif time.event == "leaves":
                absences[bound.id] = bound, name, (bound.person(time.of), after)
        for i, segment in reader.starts([query for _, _, query in starts.values()]).items():
            bound, name, _ = starts[i]
            bound.segments[name], bound.times[name] = segment, segment.start
        for i, (leaves, returns) in reader.absences([query for _, _, query in absences.values()]).items():
            bound, name, _ = absences[i]
            if leaves is not None:
                bound.times[name] = leaves
            for later, time in bound.plan.times.items():
                comes_back = time.event == "returns" and time.after == name and time.of == bound.plan.times[name].of
                if comes_back and returns is not None:
                    bound.times[later] = returns


# -- answers ----------------------------------------------------------------------------------------------------------


def _answers(reader: SceneReader, read: str, plans: Sequence[_BoundPlan], rules: Rules) -> Mapping[int, str | None]:
    """Return the answers to plans with one kind of read, by id of the plan. Unknown answers are missing or None."""
    if read == "next_action":
        return _next_actions(reader, plans)
    stated = [(bound, bound.frames) for bound in plans if len(bound.frames) == len(bound.plan.answer.times)]
    if read in ("action", "attribute"):
        offers = [(b.target, frames[0], b.plan.answer.attribute or read, b.offered) for b, frames in stated]
        return reader.values_at(offers)
    if read == "count":
        stretches = [(bound.target, bound.plan.answer.relation or "", first, last) for bound, (first, last) in stated]
        return {i: encode_answer(Number(float(count))) for i, count in reader.counts(stretches).items()}
    if read in CHANGES:
        looks = reader.seen([(bound.target, frame) for bound, frames in stated for frame in frames])
        change = CHANGES[read]
        return {b.id: change(looks[b.id, first], looks[b.id, second], rules) for b, (first, second) in stated}
    return {bound.id: encode_answer(_BY_FRAMES[read](bound, frames)) for bound, frames in stated}


def _next_actions(reader: SceneReader, plans: Sequence[_BoundPlan]) -> dict[int, str | None]:
    """Return the next postures, and add their frames to the plans."""
    event = {bound.id: bound.plan.answer.times[0] for bound in plans}
    after = {bound.id: bound.times.get(bound.plan.times[event[bound.id]].after or "") for bound in plans}
    follows = reader.next_poses([(bound.target, frame) for bound in plans if (frame := after[bound.id]) is not None])
    for bound in plans:
        if bound.id in follows:
            bound.times[event[bound.id]] = follows[bound.id][1]
    return {i: pose for i, (pose, _) in follows.items()}


def _presence_change(first: Seen, second: Seen, rules: Rules) -> str | None:
    if first.present is None or second.present is None:
        return None
    return PRESENCE_ANSWERS[3 - 2 * first.present - second.present]


def _distance_change(first: Seen, second: Seen, rules: Rules) -> str | None:
    if first.distance is None:
        return None
    if second.present is False:
        return DISTANCE_ANSWERS[3]
    if not second.present or second.distance is None:
        return None
    nearer = first.distance - second.distance
    if abs(nearer) >= rules.distance_changed_m:
        return DISTANCE_ANSWERS[0 if nearer > 0 else 1]
    return DISTANCE_ANSWERS[2] if abs(nearer) < rules.distance_same_m else None


CHANGES: Final[Mapping[str, Callable[[Seen, Seen, Rules], str | None]]] = {
    "presence": _presence_change,
    "distance_change": _distance_change,
}
"""Answers of two views of a person, by read. None is an unknown answer."""

_BY_FRAMES: Final[Mapping[str, Callable[[_BoundPlan, list[int]], Answer]]] = {
    "start": lambda bound, frames: FrameAnswer(frames[0]),
    "span": lambda bound, frames: Span(*frames),
    "start_view": lambda bound, frames: FrameViewpoint(frames[0], bound.segments[bound.plan.answer.times[0]].angle),
    "seconds_between": lambda bound, frames: Number((frames[1] - frames[0]) / FPS),
}
"""Answers that depend only on the frames of the events."""
