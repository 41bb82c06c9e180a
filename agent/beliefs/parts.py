"""Of whom the parts of a plan hold, by an episode's rows alone, and who fits all of them.

The same as the compiled plan finds, for what is asked after every turn: no engine is needed to say what is missing.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.queries.compiler import BeliefReader
from jrdb_avr.queries.compiler.believed_find import believed_order, filled
from jrdb_avr.queries.compiler.find import stated_frame, times_of
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import SYMMETRIC

MOST_VISITS: Final = 10_000_000
"""Texts that a compiled plan may compare: the engine has one thread for all episodes, and takes about 3 ns for each."""

_Row = Mapping[str, Any]


@dataclass(frozen=True)
class Parts:
    """Of whom each part of a plan holds: people are those who are seen at all, sighted by node and time, conditions by
    node and number, edges as pairs from source to target. told: how many texts the compiled plan gathers.
    """

    plan: Plan
    people: tuple[str, ...]
    sighted: Mapping[tuple[str, str], frozenset[str]]
    conditions: Mapping[tuple[str, int], frozenset[str]]
    edges: tuple[frozenset[tuple[str, str]], ...]
    told: int

    @property
    def all(self) -> int:
        """How many conditions and edges there are."""
        return len(self.conditions) + len(self.edges)


def parts_of(reader: BeliefReader, plan: Plan) -> Parts:
    """The parts of a plan in an episode. Raises PlanError where a part holds at no stated frame."""
    seen, told, ties = reader.all("sighted"), reader.all("attributes"), reader.all("relations")
    sighted: dict[tuple[str, str], frozenset[str]] = {}
    conditions: dict[tuple[str, int], frozenset[str]] = {}
    texts: dict[Hashable, int] = {}
    pairs: dict[tuple[str, int], frozenset[tuple[str, str]]] = {}

    def joined(relation: str, frame: int) -> frozenset[tuple[str, str]]:
        found = {(row["source"], row["target"]) for row in _at(ties, frame) if row["name"] == relation}
        return pairs.setdefault((relation, frame), frozenset(found))

    for node in plan.nodes:
        times = times_of(plan, node.id)
        for time in times:
            frame = stated_frame(plan, time)
            sighted[node.id, time] = frozenset(row["who"] for row in seen if row["frame"] == frame)
            texts[frame] = len(sighted[node.id, time])
        for i, condition in enumerate(node.conditions):
            frame = stated_frame(plan, condition.at or times[0])
            name, value = condition.wanted
            who = {row["who"] for row in _at(told, frame) if (row["name"], row["value"]) == (name, value)}
            texts[name, value, frame] = len(who)
            if condition.interaction is not None:
                who.update(end for pair in joined(value, frame) for end in pair)
            conditions[node.id, i] = frozenset(who)
    edges = []
    for edge in plan.edges:
        found = joined(edge.relation, stated_frame(plan, edge.at))
        edges.append(found | {(b, a) for a, b in found} if edge.relation in SYMMETRIC else found)
    anybody = any(one.interaction is not None for node in plan.nodes for one in node.conditions)
    gathered = sum(texts.values()) + (3 if anybody else 1) * sum(map(len, pairs.values()))
    people = tuple(sorted({row["who"] for row in seen}))
    return Parts(plan, people, sighted, conditions, tuple(edges), gathered)


def _at(rows: Sequence[_Row], frame: int) -> list[_Row]:
    return [row for row in rows if row["first"] <= frame <= row["last"]]


def bindings(parts: Parts) -> list[dict[str, str]] | None:
    """All bindings of the plan's nodes to different people of whom every part holds; None where to find them the
    compiled plan would compare more texts than `MOST_VISITS`.

    It goes the way of the compiled plan: at each node it tries everybody, and compares what each part that can be told
    by then asks for with all that it has gathered.
    """
    own = {
        node.id: [held for (n, _), held in (*parts.sighted.items(), *parts.conditions.items()) if n == node.id]
        for node in parts.plan.nodes
    }
    there = sorted(frozenset[str]().union(*parts.sighted.values(), *parts.conditions.values()))
    texts = filled(max(map(len, own.values())))
    places: dict[str, int] = {}
    found: list[tuple[str, ...]] = [()]
    visits = 0
    for node, edges in believed_order(parts.plan):
        places[node] = len(places)
        fit = there
        for held in own[node]:
            visits += len(found) * len(fit) * parts.told
            fit = [who for who in fit if who in held]
        # What is asked for once more, to make the statement one of a few.
        visits += len(found) * len(fit) * parts.told * (texts - len(own[node]))
        if visits > MOST_VISITS:
            return None
        found = [(*people, who) for people in found for who in fit if who not in people]
        for i, edge in edges:
            visits += 2 * len(found) * parts.told
            if visits > MOST_VISITS:
                return None
            source, target = places[edge.source], places[edge.target]
            found = [people for people in found if (people[source], people[target]) in parts.edges[i]]
    return [dict(zip(places, people, strict=True)) for people in found]
