"""Of whom the parts of a plan hold, by an episode's rows alone, and who fits all of them.

The same as the compiled plan finds, for what is asked after every turn: no engine is needed to say what is missing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.queries.compiler import BeliefReader
from jrdb_avr.queries.compiler.believed_find import SYMMETRIC
from jrdb_avr.queries.compiler.find import search_order, stated_frame, times_of
from jrdb_avr.schema.plan import Condition, Plan

MOST_VISITS: Final = 2_000_000
"""Beliefs that a compiled plan may go through, each as often as it does: the engine has one thread for all episodes,
and takes 2 to 7 ns for each."""

_Row = Mapping[str, Any]


@dataclass(frozen=True)
class Parts:
    """Of whom each part of a plan holds: people are those who are seen at all, sighted by node and time, conditions by
    node and number, edges as pairs from source to target.
    """

    plan: Plan
    people: tuple[str, ...]
    sighted: Mapping[tuple[str, str], frozenset[str]]
    conditions: Mapping[tuple[str, int], frozenset[str]]
    edges: tuple[frozenset[tuple[str, str]], ...]

    @property
    def all(self) -> int:
        """How many conditions and edges there are."""
        return len(self.conditions) + len(self.edges)


def parts_of(reader: BeliefReader, plan: Plan) -> Parts:
    """The parts of a plan in an episode. Raises PlanError where a part holds at no stated frame."""
    seen, told, ties = reader.all("sighted"), reader.all("attributes"), reader.all("relations")
    sighted: dict[tuple[str, str], frozenset[str]] = {}
    conditions: dict[tuple[str, int], frozenset[str]] = {}
    for node in plan.nodes:
        times = times_of(plan, node.id)
        for time in times:
            frame = stated_frame(plan, time)
            sighted[node.id, time] = frozenset(row["who"] for row in seen if row["frame"] == frame)
        for i, condition in enumerate(node.conditions):
            frame = stated_frame(plan, condition.at or times[0])
            conditions[node.id, i] = frozenset(_who(condition, _at(told, frame), _at(ties, frame)))
    edges = []
    for edge in plan.edges:
        at = _at(ties, stated_frame(plan, edge.at))
        pairs = {(row["source"], row["target"]) for row in at if row["name"] == edge.relation}
        edges.append(frozenset(pairs | {(b, a) for a, b in pairs} if edge.relation in SYMMETRIC else pairs))
    people = tuple(sorted({row["who"] for row in seen}))
    return Parts(plan, people, sighted, conditions, tuple(edges))


def _at(rows: Sequence[_Row], frame: int) -> list[_Row]:
    return [row for row in rows if row["first"] <= frame <= row["last"]]


def _who(condition: Condition, told: Sequence[_Row], ties: Sequence[_Row]) -> Iterator[str]:
    """Of whom a condition holds, by the attributes and relations of a frame."""
    name, value = condition.wanted
    yield from (row["who"] for row in told if row["name"] == name and row["value"] == value)
    if condition.interaction is not None:
        yield from (row[end] for row in ties if row["name"] == value for end in ("source", "target"))


def bindings(parts: Parts) -> list[dict[str, str]] | None:
    """All bindings of the plan's nodes to different people of whom every part holds; None where to find them the
    compiled plan would go through more beliefs than `MOST_VISITS`.

    It goes the way of the compiled plan: at each node it tries everybody, and for every part that can be told by then
    it goes through the beliefs of all parts.
    """
    plan = parts.plan
    there = sorted(frozenset[str]().union(*parts.sighted.values()))
    beliefs = sum(map(len, (*parts.sighted.values(), *parts.conditions.values(), *parts.edges)))
    places: dict[str, int] = {}
    found: list[tuple[str, ...]] = [()]
    visits = 0
    for node, edges in search_order(plan):
        places[node] = len(places)
        fit = there
        for held in (held for (n, _), held in (*parts.sighted.items(), *parts.conditions.items()) if n == node):
            visits += len(found) * len(fit) * beliefs
            fit = [who for who in fit if who in held]
        if visits > MOST_VISITS:
            return None
        found = [(*people, who) for people in found for who in fit if who not in people]
        for i, edge in edges:
            visits += len(found) * beliefs
            if visits > MOST_VISITS:
                return None
            source, target = places[edge.source], places[edge.target]
            found = [people for people in found if (people[source], people[target]) in parts.edges[i]]
    return [dict(zip(places, people, strict=True)) for people in found]
