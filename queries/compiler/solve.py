"""The solver: it compiles plans and runs them on a graph, for their people, the frames of their events, and answers.

A plan is solved where exactly one binding of its nodes certainly matches while no other could, and what it reads is
known. Plans whose statements are alike run together.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from jrdb_avr.queries.compiler.find import Outcome
from jrdb_avr.queries.compiler.mapping import PersonId
from jrdb_avr.queries.compiler.reads import Person, Reader, Seen, Segment, events_of
from jrdb_avr.schema.answers import Answer, FrameAnswer, FrameViewpoint, Number, Span, encode_answer
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS, answer_of_choice
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS, Rules


@dataclass(frozen=True)
class PlanQuery:
    """A plan, its scope (a sequence, or an episode), and the choices that its question offers."""

    plan: Plan
    scope: str
    choices: Sequence[str] = ()


@dataclass(frozen=True)
class Solution:
    """Result of one plan.

    outcome: defined where its people are found and the answer is known; ambiguous: two or more bindings certainly
    match (over beliefs: with different targets); empty: none could; else unknown. people: by node, once they are found
    (over beliefs those that are the same in all bindings); times: the known frames by name; answer: a choice's text or
    another answer's stored JSON, None unless the outcome is defined.
    """

    outcome: Outcome
    people: Mapping[str, PersonId] = field(default_factory=dict)
    times: Mapping[str, int] = field(default_factory=dict)
    answer: str | None = None


def solve(
    reader: Reader, queries: Sequence[PlanQuery], rules: Rules, advance: Callable[[int], None] = lambda steps: None
) -> list[Solution]:
    """Solve plans by the reader of a namespace, in their order; `advance` receives the number of plans searched.

    Raises PlanError for a plan that cannot be compiled, QueryError where a statement takes too long.
    """
    # A plan's number, by which the reader refers to it, is its place.
    finds = [reader.find(one.plan) for one in queries]
    solutions: dict[int, Solution] = {}
    found: list[_Found] = []
    together: dict[str, list[int]] = defaultdict(list)
    for i, find in enumerate(finds):
        together[find.cypher].append(i)
    for cypher, members in together.items():
        bindings: dict[int, list[dict[str, Any]]] = defaultdict(list)
        for row in reader.run(cypher, [{"id": i, "scope": queries[i].scope, **finds[i].row} for i in members]):
            bindings[row["id"]].append(row)
        for i in members:
            outcome, people = reader.agreed(queries[i].plan, finds[i], bindings[i])
            if outcome == "defined":
                found.append(_Found(i, queries[i], people))
            else:
                solutions[i] = Solution(outcome)
        advance(len(members))
    solutions |= _read_all(reader, found, rules)
    return [solutions[i] for i in range(len(queries))]


def read_with(reader: Reader, query: PlanQuery, people: Mapping[str, PersonId], rules: Rules) -> Solution:
    """Read one plan with these people as its nodes, whatever its conditions and edges.

    Nothing is read of nodes that are not in `people`: what waits for their events is unknown.
    """
    return _read_all(reader, [_Found(0, query, people)], rules)[0]


class _Found:
    """A plan with its people; the frames of its events are added as they become known."""

    def __init__(self, number: int, query: PlanQuery, people: Mapping[str, PersonId]) -> None:
        self.id = number
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
        """The known frames among those at which the answer is read."""
        return [self.times[name] for name in self.plan.answer.times if name in self.times]


def _read_all(reader: Reader, found: Sequence[_Found], rules: Rules) -> dict[int, Solution]:
    solutions = {}
    _read_events(reader, found)
    by_read: dict[str, list[_Found]] = defaultdict(list)
    for one in found:
        by_read[one.plan.answer.read].append(one)
    for read, ones in by_read.items():
        answers = _answers(reader, read, [one for one in ones if one.plan.answer.of in one.people], rules)
        for one in ones:
            answer = answers.get(one.id)
            solutions[one.id] = Solution("defined" if answer else "unknown", one.people, one.times, answer)
    return solutions


def _read_events(reader: Reader, found: Sequence[_Found]) -> None:
    """Find the frames of all events, those first that others wait for."""
    events = {one.id: events_of(one.plan) for one in found}
    for turn in range(max(map(len, events.values()), default=0)):
        starts: dict[int, tuple[_Found, str, tuple[Person, str, int]]] = {}
        absences: dict[int, tuple[_Found, str, tuple[Person, int]]] = {}
        for one in found:
            if turn >= len(events[one.id]):
                continue
            name = events[one.id][turn]
            time = one.plan.times[name]
            before, after = time.after or "", one.times.get(time.after or "")
            if after is None or time.of is None or time.of not in one.people:
                continue
            if time.event == "start" and time.action is not None:
                starts[one.id] = one, name, (one.person(time.of), time.action, after)
            elif time.event == "end" and before in one.segments and one.plan.times[before].action == time.action:
                # Only what starts at a time of the plan ends at one.
                if one.segments[before].closed:
                    one.times[name] = one.segments[before].end
            elif time.event == "leaves":
                absences[one.id] = one, name, (one.person(time.of), after)
        for number, segment in reader.starts([query for _, _, query in starts.values()]).items():
            one, name, _ = starts[number]
            one.segments[name], one.times[name] = segment, segment.start
        for number, (leaves, returns) in reader.absences([query for _, _, query in absences.values()]).items():
            one, name, _ = absences[number]
            if leaves is not None:
                one.times[name] = leaves
            for other, time in one.plan.times.items():
                comes_back = time.event == "returns" and time.after == name and time.of == one.plan.times[name].of
                if comes_back and returns is not None:
                    one.times[other] = returns


# -- answers ----------------------------------------------------------------------------------------------------------


def _answers(reader: Reader, read: str, found: Sequence[_Found], rules: Rules) -> Mapping[int, str | None]:
    """Answers to plans of one kind of read, by number of the plan; an unknown answer is left out or None."""
    if read == "next_action":
        return _next_actions(reader, found)
    stated = [(one, one.frames) for one in found if len(one.frames) == len(one.plan.answer.times)]
    if read in ("action", "attribute"):
        asked = [(one.target, frames[0], one.plan.answer.attribute or read, one.offered) for one, frames in stated]
        return reader.values_at(asked)
    if read == "count":
        stretches = [(one.target, one.plan.answer.relation or "", first, last) for one, (first, last) in stated]
        return {i: encode_answer(Number(float(count))) for i, count in reader.counts(stretches).items()}
    if read in _CHANGES:
        seen = reader.seen([(one.target, frame) for one, frames in stated for frame in frames])
        change = _CHANGES[read]
        return {one.id: change(seen[one.id, first], seen[one.id, second], rules) for one, (first, second) in stated}
    return {one.id: encode_answer(_BY_FRAMES[read](one, frames)) for one, frames in stated}


def _next_actions(reader: Reader, found: Sequence[_Found]) -> dict[int, str | None]:
    """The postures that follow; their frames become known with them."""
    event = {one.id: one.plan.answer.times[0] for one in found}
    after = {one.id: one.times.get(one.plan.times[event[one.id]].after or "") for one in found}
    follows = reader.next_poses([(one.target, frame) for one in found if (frame := after[one.id]) is not None])
    for one in found:
        if one.id in follows:
            one.times[event[one.id]] = follows[one.id][1]
    return {number: pose for number, (pose, _) in follows.items()}


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


_CHANGES: Final[Mapping[str, Callable[[Seen, Seen, Rules], str | None]]] = {
    "presence": _presence_change,
    "distance_change": _distance_change,
}

_BY_FRAMES: Final[Mapping[str, Callable[[_Found, list[int]], Answer]]] = {
    "start": lambda one, frames: FrameAnswer(frames[0]),
    "span": lambda one, frames: Span(*frames),
    "start_view": lambda one, frames: FrameViewpoint(frames[0], one.segments[one.plan.answer.times[0]].angle),
    "seconds_between": lambda one, frames: Number((frames[1] - frames[0]) / FPS),
}
"""Answers that the frames of the events alone decide."""
