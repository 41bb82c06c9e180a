"""The statement that finds the people of a plan: its conditions and edges as one Cypher statement.

Each row binds the plan's nodes to different people, so that every condition and edge is possible. The columns `sure0`,
`sure1`, ... say whether each condition, edge and event is certain. The rows of a plan decide its outcome. The text of
the statement depends only on the form of the plan, so plans of one form run together. Their times and values are in
the rows of `$plans`. The compiler makes all names in the statement, so that no text of a plan is part of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from jrdb_avr.queries.compiler.clauses import Clause, Variables
from jrdb_avr.queries.compiler.mapping import (
    PEOPLE,
    THINGS,
    NodeMapping,
    PersonId,
    condition_values,
    edge_kind,
    edge_values,
    thing_edge_kind,
)
from jrdb_avr.schema.beliefs import ALWAYS
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.plan import ATTRIBUTES, Condition, Edge, Plan, validate


@dataclass(frozen=True)
class Find:
    """The Cypher statement that finds the people of a plan.

    Attributes:
        cypher: Statement. It returns the columns id, who0, ..., when0, ... and sure0, ..., ordered.
        nodes: Nodes of the plan, in the order of the columns `who`.
        row: Values of the plan in `$plans`, without `id`, `scope` and the changes of groups.
        events: Events of `GROUP_EVENTS`, in the order of the columns `when`, by the variable of their changes.
    """

    cypher: str
    nodes: tuple[str, ...]
    row: dict[str, Any]
    events: Mapping[str, str] = field(default_factory=dict)


def compile_find(plan: Plan) -> Find:
    """Compile the conditions and edges of a plan.

    Args:
        plan: Plan.

    Raises:
        PlanError: If the plan is invalid, names an attribute without labels, or has conditions or edges at an event
            that is not of `GROUP_EVENTS`.
    """
    validate(plan)
    if plan.answer.attribute not in (None, *PEOPLE.conditions):
        raise PlanError("answer.attribute", f"{plan.answer.attribute!r} is not labelled; {_LABELLED}")
    if plan.answer.of in plan.things and plan.answer.attribute != "sector":
        raise PlanError("answer.attribute", f"{plan.answer.attribute!r} of a thing is not labelled; use 'sector'")
    return _Pattern(plan).compiled()


class _Pattern:
    """Builder of the statement. It adds one person after the other, in the order of `search_order`."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.nodes: list[str] = []
        self.row: dict[str, Any] = {}
        self.times = {name: f"t{i}" for i, name in enumerate(sorted(plan.times))}
        self.things = plan.things
        self.moments: dict[str, str] = {}
        self.events = {self.times[name]: name for name, time in plan.times.items() if time.is_group_event}

    def compiled(self) -> Find:
        people = [self._person(node, edges) for node, edges in search_order(self.plan)]
        changes = [f"{t}{part}" for t in self.events for part in ("", "_who", "_sure")]
        bound = ["id", "scope", *self.row, *changes]
        lines = ["UNWIND $plans AS q", f"WITH {', '.join(f'q.{name} AS {name}' for name in bound)}"]
        sure: list[str] = []
        for index, (matches, sightings, holds) in enumerate(people):
            bound.append(f"n{index}")
            for at, (match, where) in enumerate(matches):
                certain = [f"{text} AS {name}" for name, text in holds.items()] if at == len(matches) - 1 else []
                new = [name for name in sightings if f"[{name}:" in match]
                bound += new
                lines += [f"MATCH {match}", f"WHERE {where}", f"WITH {', '.join([*bound, *certain])}"]
            bound += holds
            sure += holds
        things = [i for i, node in enumerate(self.nodes) if node in self.things]
        keys = [f"{self._space(node).key.format(n=f'n{i}')} AS who{i}" for i, node in enumerate(self.nodes)]
        # Each result has a column of its own, because the engine cannot join the results of several EXISTS.
        certain = [f"{name} AS sure{i}" for i, name in enumerate(sure)]
        frames = [f"{t} AS when{i}" for i, t in enumerate(self.events)]
        lines.append(f"RETURN {', '.join(['id', *keys, *frames, *certain])}")
        # Names of things come last, because the engine orders numbers after a string wrongly.
        order = [i for i in range(len(self.nodes)) if i not in things] + things
        lines.append(f"ORDER BY {', '.join(['id', *(f'who{i}' for i in order)])}")
        return Find("\n".join(lines), tuple(self.nodes), self.row, self.events)

    def _person(self, node: str, edges: Edges) -> tuple[list[tuple[str, str]], list[str], dict[str, str]]:
        """Return patterns with conditions of each MATCH of a node, sightings, and tests of certainty by name."""
        self.nodes.append(node)
        index, space = len(self.nodes) - 1, self._space(node)
        # A moment comes last, because its sightings are many.
        times = sorted(self._times(node), key=lambda time: self.plan.times[time].is_moment)
        # A thing has no sighting, so only the first time is needed.
        bound = [self._at(node, time) for time in (times[:1] if node in self.things else times)]
        seen = [
            [space.present.format(**at), *self._begun(node, time, at)] for time, at in zip(times, bound, strict=False)
        ]
        where = [f"n{index}.id <> n{earlier}.id" for earlier in range(index)]
        changed = zip(times, bound, strict=False)
        holds = {f"{at['t']}_changes": f"{self._change(node, time)} AND {at['t']}_sure" for time, at in changed
                 if self._change(node, time)}  # fmt: skip
        for name, clause, at in self._clauses(node, edges):
            where.append(clause.could.format(**at))
            holds[f"{name}_sure"] = clause.sure.format(**at)
        seen[-1] += where
        sightings = [] if node in self.things else [at["s"] for at in bound]
        # One pattern of all sightings would need memory for every combination of frames.
        matches = [(space.pattern.format(**at), " AND ".join(tests)) for at, tests in zip(bound, seen, strict=True)]
        return matches, sightings, holds

    def _times(self, node: str) -> list[str]:
        return times_of(self.plan, node, group_events_of(self.plan, node))

    def _space(self, node: str) -> NodeMapping:
        return THINGS if node in self.things else PEOPLE

    def _clauses(self, node: str, edges: Edges) -> Iterator[tuple[str, Clause, Variables]]:
        """Yield name, clause and variables of the conditions of a node, and of its edges to earlier nodes."""
        for i, condition in enumerate(conditions_of(self.plan, node)):
            name = f"c{self.nodes.index(node)}_{i}"
            if condition.kind not in PEOPLE.conditions:
                raise PlanError(f"conditions of {node}", f"{condition.attribute!r} is not labelled; {_LABELLED}")
            at = self._at(node, condition.at or self._times(node)[0])
            yield name, PEOPLE.conditions[condition.kind], at | self._values(name, condition_values(condition))
        if node in self.things:
            name, at = f"k{self.nodes.index(node)}", self._at(node, self._times(node)[0])
            yield name, THINGS.conditions["kind"], at | self._values(name, {"v": self.things[node]})
        for i, edge in edges:
            to, at = self._at(edge.target, edge.at), self._at(edge.source, edge.at)
            at |= {"m": to["n"], "z": to["s"]} | self._values(f"e{i}", edge_values(edge.relation))
            if edge.target in self.things:
                kind = thing_edge_kind(f"edges[{i}].relation", edge.relation)
            else:
                kind = edge_kind(edge.relation)
            yield f"e{i}", self._space(edge.target).edges[kind], at

    def _at(self, node: str, time: str) -> Variables:
        index, t = self.nodes.index(node), self.times[time]
        bound = {"n": f"n{index}", "s": f"s{index}_{t}", "t": t, "scope": "scope"}
        if self.plan.times[time].is_moment:
            if node not in self.things or time in self.moments:
                # The sighting of the first person at a moment decides the frame.
                bound["t"] = self.moments.setdefault(time, f"{bound['s']}.frame")
        elif not self.plan.times[time].is_group_event:
            self.row[t] = stated_frame(self.plan, time)
        return bound

    def _change(self, node: str, time: str) -> str:
        """Return the test that a node is the person of a group event, or "" if the time is no event of the node."""
        t = self.times[time]
        return f"n{self.nodes.index(node)}.track = {t}_who" if time in group_events_of(self.plan, node) else ""

    def _begun(self, node: str, time: str, at: Variables) -> Iterator[str]:
        """Yield the test of a group event, or of the frame of a moment that a sighting of the node decides."""
        if change := self._change(node, time):
            yield change
        moment = self.plan.times[time]
        if not moment.is_moment or node in self.things or at["t"] != f"{at['s']}.frame":
            return
        for sign, limit in ((">", moment.after), ("<", moment.before)):
            if limit is not None:
                t = self.times[limit]
                if t not in self.events:
                    self.row[t] = self.plan.times[limit].frame
                yield f"{at['t']} {sign} {t}"

    def _values(self, prefix: str, values: Mapping[str, Any]) -> Variables:
        self.row |= {f"{prefix}_{variable}": value for variable, value in values.items()}
        return {variable: f"{prefix}_{variable}" for variable in values}


_LABELLED: Final = f"use one of {', '.join(ATTRIBUTES)}, or an action, object or interaction"

Edges = list[tuple[int, Edge]]
"""Edges, each with its index in the plan."""


def conditions_of(plan: Plan, node: str) -> tuple[Condition, ...]:
    """Return the conditions of a node.

    Args:
        plan: Plan.
        node: Id of the node.
    """
    return next(row.conditions for row in plan.nodes if row.id == node)


def search_order(plan: Plan) -> list[tuple[str, Edges]]:
    """Order the nodes from the root on, so that edges lead to each node from earlier ones.

    A node without edges comes last.

    Args:
        plan: Plan.

    Returns:
        Each node, with the edges that join it to earlier nodes.
    """
    order = [plan.root]
    while len(order) < len(plan.nodes):
        reached = [target for source, target in plan.ways if source in order]
        order.append(next(node for node in (*reached, *(node.id for node in plan.nodes)) if node not in order))
    edges = list(enumerate(plan.edges))
    return [
        (node, [(i, e) for i, e in edges if node in (e.source, e.target) and {e.source, e.target} <= {*order[: k + 1]}])
        for k, node in enumerate(order)
    ]


def group_events_of(plan: Plan, node: str) -> list[str]:
    """Return the names of the events at which a node joins or leaves a group, sorted.

    Args:
        plan: Plan.
        node: Id of the node.
    """
    return sorted(name for name, time in plan.times.items() if time.is_group_event and time.of == node)


def stated_frame(plan: Plan, time: str) -> int:
    """Return the frame of a time of conditions or edges.

    Args:
        plan: Plan.
        time: Name of the time.

    Raises:
        PlanError: If the time is an event.
    """
    frame = plan.times[time].frame
    if frame is None:
        raise PlanError(
            f"times.{time}", "conditions and edges hold at stated frames and group events, not at this event"
        )
    return frame


def limits(plan: Plan, time: str) -> tuple[int, int] | None:
    """Return the frames before and after a moment, or None if the time is not a moment.

    Args:
        plan: Plan.
        time: Name of the time.

    Raises:
        PlanError: If an event limits the moment.
    """
    moment = plan.times[time]
    if not moment.is_moment:
        return None
    after, before = (None if name is None else stated_frame(plan, name) for name in (moment.after, moment.before))
    return -1 if after is None else after, ALWAYS if before is None else before


def times_of(plan: Plan, node: str, further: Sequence[str] = ()) -> list[str]:
    """Return the names of the times of a node's conditions and edges, or the first stated time if there is none.

    Args:
        plan: Plan.
        node: Id of the node.
        further: Further times of the node, which follow the others.

    Raises:
        PlanError: If the plan states no time.
    """
    times = [condition.at for condition in conditions_of(plan, node) if condition.at is not None]
    times += [edge.at for edge in plan.edges if node in (edge.source, edge.target)]
    times += further
    stated = sorted(name for name, time in plan.times.items() if time.frame is not None)
    if not times and not stated:
        raise PlanError("times", "a stated frame is needed, at which people are looked for")
    return list(dict.fromkeys(times)) or stated[:1]


Outcome = Literal["defined", "ambiguous", "empty", "unknown"]

Agreed = tuple[Outcome, Mapping[str, PersonId]]
"""Outcome, and the people of the plan by node if the outcome is defined."""


def people_of(find: Find, row: Mapping[str, Any]) -> dict[str, PersonId]:
    """Return the people of a row of a plan's statement, by node.

    Args:
        find: Statement.
        row: Row of the statement.
    """
    return {node: row[f"who{index}"] for index, node in enumerate(find.nodes)}


def frames_of_events(find: Find, rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Return the frames of the group events of a plan that is defined, by the name of the time.

    Args:
        find: Statement.
        rows: Rows of the statement. The first certain row has the frames.
    """
    row = next((row for row in rows if _is_sure(row)), None) if find.events else None
    return {} if row is None else {name: row[f"when{i}"] for i, name in enumerate(find.events.values())}


def _is_sure(row: Mapping[str, Any]) -> bool:
    return all(row[name] for name in row if name.startswith("sure"))


def outcome_of_people(find: Find, rows: Sequence[Mapping[str, Any]]) -> Agreed:
    """Return the outcome if one binding must be certain, and no other binding possible.

    Args:
        find: Statement.
        rows: Rows of the statement.
    """
    # Several rows of the same people are of different moments. One certain moment is enough.
    sure: dict[tuple[PersonId, ...], bool] = {}
    for row in rows:
        people = tuple(people_of(find, row).values())
        sure[people] = sure.get(people, False) or _is_sure(row)
    certain = sum(sure.values())
    if certain > 1:
        return "ambiguous", {}
    if not rows:
        return "empty", {}
    return ("defined", people_of(find, rows[0])) if len(sure) == certain else ("unknown", {})
