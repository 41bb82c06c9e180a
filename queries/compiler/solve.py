"""The solver: plans, compiled and asked of a graph; their people, the frames of their events, and their answers.

A plan is solved where exactly one binding of its nodes certainly matches while no other could, and what is read of it
is known. Plans whose statements are alike are asked together.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from jrdb_avr.queries.compiler.find import Outcome
from jrdb_avr.queries.compiler.mapping import PersonId, SchemaMapping
from jrdb_avr.queries.compiler.reads import Person, Queryable, Reader, SceneReader, Seen, Segment, events_of
from jrdb_avr.schema.answers import Answer, FrameAnswer, FrameViewpoint, Number, Span, encode_answer
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS, Rules

TIMEOUT_S: Final = 60.0
"""For each statement."""


@dataclass(frozen=True)
class PlanQuery:
    """A plan and where it is asked: a sequence, or an episode."""

    plan: Plan
    scope: str


@dataclass(frozen=True)
class Solution:
    """What a plan comes to.

    outcome: defined where its people are found and the answer is known; ambiguous: two or more bindings certainly
    match (over beliefs: with different targets); empty: none could; else unknown. people: by node, once they are found
    (over beliefs those that are the same in all bindings); times: frames by name, as far as they
    are known; answer: a choice's text or another answer's stored JSON, None unless the outcome is defined.
    """

    outcome: Outcome
    people: Mapping[str, PersonId] = field(default_factory=dict)
    times: Mapping[str, int] = field(default_factory=dict)
    answer: str | None = None


def solve(
    graph: Queryable,
    names: SchemaMapping,
    asked: Sequence[PlanQuery],
    rules: Rules,
    *,
    timeout_s: float = TIMEOUT_S,
    advance: Callable[[int], None] = lambda steps: None,
) -> list[Solution]:
    """Solve plans over a scene, in their order; `advance` is told how many have been looked for.

    Raises PlanError for a plan that cannot be compiled, QueryError where a statement takes too long.
    """
    return solve_with(SceneReader(graph, names, rules.load, timeout_s), asked, rules, advance)


def solve_with(
    reader: Reader, asked: Sequence[PlanQuery], rules: Rules, advance: Callable[[int], None] = lambda steps: None
) -> list[Solution]:
    """Solve plans by a namespace's reader, as `solve`. The plans' numbers, by which it reads, are their places."""
    finds = [reader.find(one.plan) for one in asked]
    solutions: dict[int, Solution] = {}
    found: list[_Found] = []
    together: dict[str, list[int]] = defaultdict(list)
    for i, find in enumerate(finds):
        together[find.cypher].append(i)
    for cypher, members in together.items():
        bindings: dict[int, list[dict[str, Any]]] = defaultdict(list)
        for row in reader.ask(cypher, [{"id": i, "scope": asked[i].scope, **finds[i].row} for i in members]):
            bindings[row["id"]].append(row)
        for i in members:
            outcome, agreed = reader.agreed(asked[i].plan, finds[i], bindings[i])
            if outcome == "defined":
                found.append(_Found(i, asked[i], agreed))
            else:
                solutions[i] = Solution(outcome)
        advance(len(members))
    solutions |= _read_all(reader, found, rules)
    return [solutions[i] for i in range(len(asked))]


def read_with(reader: Reader, asked: PlanQuery, people: Mapping[str, PersonId], rules: Rules) -> Solution:
    """What is read by one plan of people who are taken for its nodes, whatever the plan says of them.

    Of nodes that are not in `people` nothing is read: what waits for their events is unknown.
    """
    return _read_all(reader, [_Found(0, asked, people)], rules)[0]


def _read_all(reader: Reader, found: Sequence[_Found], rules: Rules) -> dict[int, Solution]:
    solutions = {}
    _read_events(reader, found)
    by_read: dict[str, list[_Found]] = defaultdict(list)
    for one in found:
        by_read[one.plan.answer.read].append(one)
    for read, ones in by_read.items():
        answers = _READS[read](reader, [one for one in ones if one.plan.answer.of in one.people], rules)
        for one in ones:
            answer = answers.get(one.id)
            solutions[one.id] = Solution("defined" if answer else "unknown", one.people, one.times, answer)
    return solutions


class _Found:
    """A plan whose people are found; the frames of its events are added as they become known."""

    def __init__(self, number: int, asked: PlanQuery, people: Mapping[str, PersonId]) -> None:
        self.id = number
        self.plan = asked.plan
        self.scope = asked.scope
        self.people = people
        self.times = {name: time.frame for name, time in asked.plan.times.items() if time.frame is not None}
        self.segments: dict[str, Segment] = {}

    @property
    def target(self) -> Person:
        return self.person(self.plan.answer.of)

    def person(self, node: str) -> Person:
        return Person(self.id, self.scope, self.people[node])

    @property
    def asked(self) -> list[int | None]:
        """Frames at which the answer is read."""
        return [self.times.get(name) for name in self.plan.answer.times]


def _read_events(reader: Reader, found: Sequence[_Found]) -> None:
    """Find the frames of all events, those first that others wait for."""
    events = {one.id: events_of(one.plan) for one in found}
    for turn in range(max(map(len, events.values()), default=0)):
        starts, absences = [], []
        for one in found:
            if turn >= len(events[one.id]):
                continue
            name = events[one.id][turn]
            time = one.plan.times[name]
            before, after = time.after or "", one.times.get(time.after or "")
            if after is None or time.of is None or time.of not in one.people:
                continue
            if time.event == "start" and time.action is not None:
                starts.append((one, name, time.action, after))
            elif time.event == "end" and before in one.segments and one.plan.times[before].action == time.action:
                # Only what starts at a time of the plan ends at one.
                if one.segments[before].closed:
                    one.times[name] = one.segments[before].end
            elif time.event == "leaves":
                absences.append((one, name, after))
        for (one, name, _, _), segment in _matched(
            starts, reader.starts([(one.person(_of(one, name)), action, after) for one, name, action, after in starts])
        ):
            one.segments[name] = segment
            one.times[name] = segment.start
        for (one, name, _), (leaves, returns) in _matched(
            absences, reader.absences([(one.person(_of(one, name)), after) for one, name, after in absences])
        ):
            if leaves is not None:
                one.times[name] = leaves
            for other, time in one.plan.times.items():
                comes_back = time.event == "returns" and time.after == name and time.of == one.plan.times[name].of
                if comes_back and returns is not None:
                    one.times[other] = returns


def _of(one: _Found, name: str) -> str:
    return one.plan.times[name].of or ""


def _matched(asked: Sequence[tuple[Any, ...]], found: Mapping[int, Any]) -> list[tuple[tuple[Any, ...], Any]]:
    return [(row, found[row[0].id]) for row in asked if row[0].id in found]


# -- reads ------------------------------------------------------------------------------------------------------------

_Answers = dict[int, str]


def _stated(found: Sequence[_Found]) -> list[tuple[_Found, list[int]]]:
    """Those whose times are all known, with the frames at which they are read."""
    times = [(one, [frame for frame in one.asked if frame is not None]) for one in found]
    return [(one, frames) for one, frames in times if len(frames) == len(one.asked)]


def _read_action(reader: Reader, found: Sequence[_Found], rules: Rules) -> _Answers:
    return reader.poses([(one.target, frames[0]) for one, frames in _stated(found)])


def _seen_twice(reader: Reader, found: Sequence[_Found]) -> list[tuple[_Found, Seen, Seen]]:
    stated = _stated(found)
    seen = reader.seen([(one.target, frame) for one, frames in stated for frame in frames])
    return [(one, seen[one.id, first], seen[one.id, second]) for one, (first, second) in stated]


def _read_presence(reader: Reader, found: Sequence[_Found], rules: Rules) -> _Answers:
    answers = {}
    for one, first, second in _seen_twice(reader, found):
        if first.present is not None and second.present is not None:
            answers[one.id] = PRESENCE_ANSWERS[3 - 2 * first.present - second.present]
    return answers


def _read_distance(reader: Reader, found: Sequence[_Found], rules: Rules) -> _Answers:
    answers = {}
    for one, first, second in _seen_twice(reader, found):
        if first.distance is None:
            continue
        if second.present is False:
            answers[one.id] = DISTANCE_ANSWERS[3]
        elif second.present and second.distance is not None:
            nearer = first.distance - second.distance
            if abs(nearer) >= rules.distance_changed_m:
                answers[one.id] = DISTANCE_ANSWERS[0 if nearer > 0 else 1]
            elif abs(nearer) < rules.distance_same_m:
                answers[one.id] = DISTANCE_ANSWERS[2]
    return answers


def _read_next_action(reader: Reader, found: Sequence[_Found], rules: Rules) -> _Answers:
    waiting = []
    for one in found:
        after = one.times.get(one.plan.times[one.plan.answer.times[0]].after or "")
        if after is not None:
            waiting.append((one, after))
    follows = reader.next_poses([(one.target, after) for one, after in waiting])
    answers = {}
    for one, _ in waiting:
        if one.id in follows:
            answers[one.id], one.times[one.plan.answer.times[0]] = follows[one.id]
    return answers


def _encoded(answer: Callable[[_Found, list[int]], Answer]) -> Callable[[Reader, Sequence[_Found], Rules], _Answers]:
    """A read that is told by the frames of the events alone."""

    def read(reader: Reader, found: Sequence[_Found], rules: Rules) -> _Answers:
        return {one.id: encode_answer(answer(one, frames)) for one, frames in _stated(found)}

    return read


def _view(one: _Found, frames: list[int]) -> Answer:
    return FrameViewpoint(frames[0], one.segments[one.plan.answer.times[0]].angle)


def _read_count(reader: Reader, found: Sequence[_Found], rules: Rules) -> _Answers:
    stated = [(one, one.plan.answer.relation or "", frames) for one, frames in _stated(found)]
    counted = reader.counts([(one.target, relation, first, last) for one, relation, (first, last) in stated])
    return {i: encode_answer(Number(float(count))) for i, count in counted.items()}


_READS: Final[dict[str, Callable[[Reader, Sequence[_Found], Rules], _Answers]]] = {
    "action": _read_action,
    "presence": _read_presence,
    "distance_change": _read_distance,
    "next_action": _read_next_action,
    "start": _encoded(lambda one, frames: FrameAnswer(frames[0])),
    "span": _encoded(lambda one, frames: Span(frames[0], frames[1])),
    "start_view": _encoded(_view),
    "seconds_between": _encoded(lambda one, frames: Number((frames[1] - frames[0]) / FPS)),
    "count": _read_count,
}
