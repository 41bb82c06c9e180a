"""The statement that finds the people of a plan: its conditions and edges as one Cypher statement.

Each row binds the plan's nodes to different people, so that every condition and edge is possible. The columns `sure0`,
`sure1`, ... say whether each condition and edge is certain. The rows of a plan decide its outcome. The text of the
statement depends only on the form of the plan, so plans of one form run together. Their times and values are rows of
the parameter `$plans`. The compiler makes all names in the statement, so that no text of a plan is part of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
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
        cypher: Statement. It returns the columns id, who0, who1, ... and sure0, sure1, ..., ordered.
        nodes: Nodes of the plan, in the order of the columns `who`.
        row: Values of the plan in `$plans`, without `id` and `scope`.
    """

    cypher: str
    nodes: tuple[str, ...]
    row: dict[str, Any]


def compile_find(plan: Plan) -> Find:
    """Compile the conditions and edges of a plan.

    Args:
        plan: Plan.

    Raises:
        PlanError: If the plan is invalid, has conditions or edges at an event, or names an attribute without labels.
    """
    validate(plan)
    if plan.answer.attribute not in (None, *PEOPLE.conditions):
        raise PlanError("answer.attribute", f"{plan.answer.attribute!r} is not labelled; {_LABELLED}")
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

    def compiled(self) -> Find:
        people = [self._person(node, edges) for node, edges in search_order(self.plan)]
        bound = ["id", "scope", *self.row]
        lines = ["UNWIND $plans AS q", f"WITH {', '.join(f'q.{name} AS {name}' for name in bound)}"]
        sure: list[str] = []
        for index, (match, where, sightings, holds) in enumerate(people):
            bound += [f"n{index}", *sightings]
            certain = [f"{text} AS {name}" for name, text in holds.items()]
            lines += [f"MATCH {match}", f"WHERE {where}", f"WITH {', '.join([*bound, *certain])}"]
            bound += holds
            sure += holds
        things = [i for i, node in enumerate(self.nodes) if node in self.things]
        keys = [f"{self._space(node).key.format(n=f'n{i}')} AS who{i}" for i, node in enumerate(self.nodes)]
        # Each result has a column of its own, because the engine cannot join the results of several EXISTS.
        certain = [f"{name} AS sure{i}" for i, name in enumerate(sure)]
        lines.append(f"RETURN {', '.join(['id', *keys, *certain])}")
        # Names of things come last, because the engine orders numbers after a string wrongly.
        order = [i for i in range(len(self.nodes)) if i not in things] + things
        lines.append(f"ORDER BY {', '.join(['id', *(f'who{i}' for i in order)])}")
        return Find("\n".join(lines), tuple(self.nodes), self.row)

    def _person(self, node: str, edges: Edges) -> tuple[str, str, list[str], dict[str, str]]:
        """Return the parts of the MATCH of a node: pattern, conditions, sightings, and tests of certainty by name."""
        self.nodes.append(node)
        index, space = len(self.nodes) - 1, self._space(node)
        times = times_of(self.plan, node)
        # A thing has no sighting, so only the first time is needed.
        bound = [self._at(node, time) for time in (times[:1] if node in self.things else times)]
        where = [space.present.format(**at) for at in reversed(bound)]
        where += [text for time, at in zip(times, bound, strict=False) for text in self._begun(node, time, at)]
        where += [f"n{index}.id <> n{earlier}.id" for earlier in range(index)]
        holds: dict[str, str] = {}
        for name, clause, at in self._clauses(node, edges):
            where.append(clause.could.format(**at))
            holds[f"{name}_sure"] = clause.sure.format(**at)
        match = ", ".join(space.pattern.format(**at) for at in bound)
        return match, " AND ".join(where), [] if node in self.things else [at["s"] for at in bound], holds

    def _space(self, node: str) -> NodeMapping:
        return THINGS if node in self.things else PEOPLE

    def _clauses(self, node: str, edges: Edges) -> Iterator[tuple[str, Clause, Variables]]:
        """Yield name, clause and variables of the conditions of a node, and of its edges to earlier nodes."""
        for i, condition in enumerate(conditions_of(self.plan, node)):
            name = f"c{self.nodes.index(node)}_{i}"
            if condition.kind not in PEOPLE.conditions:
                raise PlanError(f"conditions of {node}", f"{condition.attribute!r} is not labelled; {_LABELLED}")
            at = self._at(node, condition.at or times_of(self.plan, node)[0])
            yield name, PEOPLE.conditions[condition.kind], at | self._values(name, condition_values(condition))
        if node in self.things:
            name, at = f"k{self.nodes.index(node)}", self._at(node, times_of(self.plan, node)[0])
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
        if limits(self.plan, time) is None:
            self.row[t] = stated_frame(self.plan, time)
        elif node not in self.things or time in self.moments:
            # The sighting of the first person at a moment decides the frame.
            bound["t"] = self.moments.setdefault(time, f"{bound['s']}.frame")
        return bound

    def _begun(self, node: str, time: str, at: Variables) -> list[str]:
        """Return the conditions for the frame of a moment that a sighting of the node decides."""
        within = limits(self.plan, time)
        if within is None or node in self.things or at["t"] != f"{at['s']}.frame":
            return []
        names = [f"{self.times[time]}_{name}" for name in ("after", "before")]
        self.row |= dict(zip(names, within, strict=True))
        return [f"{at['t']} > {names[0]}", f"{at['t']} < {names[1]}"]

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
        raise PlanError(f"times.{time}", "conditions and edges hold at stated frames; an event is only read")
    return frame


def limits(plan: Plan, time: str) -> tuple[int, int] | None:
    """Return the frames before and after a moment, or None if the time is not a moment.

    Args:
        plan: Plan.
        time: Name of the time.
    """
    moment = plan.times[time]
    if not moment.is_moment:
        return None
    after, before = (None if name is None else plan.times[name].frame for name in (moment.after, moment.before))
    return -1 if after is None else after, ALWAYS if before is None else before


def times_of(plan: Plan, node: str) -> list[str]:
    """Return the names of the times of a node's conditions and edges, or the first stated time if it has neither.

    Args:
        plan: Plan.
        node: Id of the node.

    Raises:
        PlanError: If the plan states no time.
    """
    times = [condition.at for condition in conditions_of(plan, node) if condition.at is not None]
    times += [edge.at for edge in plan.edges if node in (edge.source, edge.target)]
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
        sure[people] = sure.get(people, False) or all(row[name] for name in row if name.startswith("sure"))
    certain = sum(sure.values())
    if certain > 1:
        return "ambiguous", {}
    if not rows:
        return "empty", {}
    return ("defined", people_of(find, rows[0])) if len(sure) == certain else ("unknown", {})


def outcome_of_target(plan: Plan, people: Sequence[Mapping[str, PersonId]]) -> Agreed:
    """Return the outcome if all bindings are certain and must have the same target.

    Args:
        plan: Plan.
        people: People of each binding, by node.

    Returns:
        The outcome, with the nodes that have the same person in all bindings.
    """
    if len({binding[plan.target] for binding in people}) != 1:
        return "ambiguous" if people else "empty", {}
    same = {node: person for node, person in people[0].items() if all(b[node] == person for b in people)}
    return "defined", same
