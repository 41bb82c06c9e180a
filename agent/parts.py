"""Of whom the parts of a plan hold, by an episode's rows alone, and who fits all of them.

The same as the compiled plan finds, for what is asked after every turn: no engine is needed to say what is missing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.queries.compiler import BeliefReader
from jrdb_avr.queries.compiler.find import search_order, times_of
from jrdb_avr.queries.compiler.names import SYMMETRIC
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.plan import Condition, Plan

from .slots import wanted

MOST_VISITS: Final = 1_000_000
"""Beliefs that a compiled plan may go through, each as often as it does: the engine has one thread for all episodes."""

_Row = Mapping[str, Any]


@dataclass(frozen=True)
class Parts:
    """Of whom each part of a plan holds: people are those who are seen at all, sighted by node and time, conditions by
    node and number, edges as pairs from source to target; how many beliefs say so. beliefs: all there are.
    """

    plan: Plan
    people: tuple[str, ...]
    sighted: Mapping[tuple[str, str], Counter[str]]
    conditions: Mapping[tuple[str, int], Counter[str]]
    edges: tuple[Counter[tuple[str, str]], ...]
    beliefs: int

    @property
    def all(self) -> int:
        """How many conditions and edges there are."""
        return len(self.conditions) + len(self.edges)


def parts_of(reader: BeliefReader, plan: Plan) -> Parts:
    """The parts of a plan in an episode. Raises PlanError where a part holds at no stated frame."""
    seen, told, ties = reader.all("sighted"), reader.all("attributes"), reader.all("relations")
    sighted: dict[tuple[str, str], Counter[str]] = {}
    conditions: dict[tuple[str, int], Counter[str]] = {}
    for node in plan.nodes:
        times = times_of(plan, node.id)
        for time in times:
            frame = _frame(plan, time)
            sighted[node.id, time] = Counter(row["who"] for row in seen if row["frame"] == frame)
        for i, condition in enumerate(node.conditions):
            frame = _frame(plan, condition.at or times[0])
            conditions[node.id, i] = _who(condition, _at(told, frame), _at(ties, frame))
    edges = []
    for edge in plan.edges:
        pairs = Counter(
            (row["source"], row["target"]) for row in _at(ties, _frame(plan, edge.at)) if row["name"] == edge.relation
        )
        if edge.relation in SYMMETRIC:
            pairs += Counter({(b, a): count for (a, b), count in pairs.items()})
        edges.append(pairs)
    people = tuple(sorted({row["who"] for row in seen}))
    return Parts(plan, people, sighted, conditions, tuple(edges), len(seen) + len(told) + len(ties))


def _at(rows: Sequence[_Row], frame: int) -> list[_Row]:
    return [row for row in rows if row["first"] <= frame <= row["last"]]


def _who(condition: Condition, told: Sequence[_Row], ties: Sequence[_Row]) -> Counter[str]:
    """Of whom a condition holds, by the attributes and relations of a frame."""
    name, value = wanted(condition)
    if name == "group_size":
        return Counter(row["who"] for row in told if row["name"] == name and row["number"] == condition.value)
    found = Counter(row["who"] for row in told if row["name"] == name and row["value"] == value)
    if condition.interaction is not None:
        found.update(row[end] for row in ties if row["name"] == value for end in ("source", "target"))
    return found


def _frame(plan: Plan, time: str) -> int:
    frame = plan.times[time].frame
    if frame is None:
        raise PlanError(f"times.{time}", "conditions and edges hold at stated frames; an event is only read")
    return frame


def bindings(parts: Parts) -> list[dict[str, str]] | None:
    """All bindings of the plan's nodes to different people of whom every part holds; None where to find them the
    compiled plan would go through more beliefs than `MOST_VISITS`.

    It goes the way of the compiled plan: for each node through all beliefs for who is there, then again for each part
    that can be told by then, and a binding is as many rows as there are beliefs that tell it.
    """
    plan = parts.plan
    nodes: list[str] = []
    rows: dict[tuple[str, ...], int] = {(): 1}
    visits = 0
    for node, edges in search_order(plan):
        own = [held for (n, _), held in parts.sighted.items() if n == node]
        nodes.append(node)
        visits += sum(rows.values()) * parts.beliefs
        if visits > MOST_VISITS:
            return None
        rows = {(*row, who): n * own[0][who] for row, n in rows.items() for who in own[0] if who not in row}
        clauses = [(held, (len(nodes) - 1,)) for held in own[1:]]
        clauses += [(held, (len(nodes) - 1,)) for (n, _), held in parts.conditions.items() if n == node]
        tests: list[tuple[Counter[Any], tuple[int, ...]]] = [*clauses]
        tests += [(parts.edges[i], (nodes.index(e.source), nodes.index(e.target))) for i, e in edges]
        for held, places in tests:
            visits += sum(rows.values()) * parts.beliefs
            if visits > MOST_VISITS:
                return None
            kept = {}
            for row, n in rows.items():
                key = row[places[0]] if len(places) == 1 else (row[places[0]], row[places[1]])
                if count := held[key]:
                    kept[row] = n * count
            rows = kept
    return [dict(zip(nodes, row, strict=True)) for row in sorted(rows)]
