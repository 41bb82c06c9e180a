"""Who comes nearest to fitting a plan: the binding of its nodes under which most of its parts hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from jrdb_avr.agent.beliefs.parts import Parts
from jrdb_avr.schema.plan import Plan

_MOST_STEPS: Final = 2_000
"""Bindings weighed; those of a real plan are a few dozens. Beyond them the best one so far is taken."""


def likeliest(parts: Parts, given: Mapping[str, str]) -> tuple[dict[str, str], int]:
    """A binding of nodes to different people, those `given` among them, under which most conditions and edges hold,
    and how many do. Of equal ones the first is taken, in the order of names; nobody is bound who adds nothing.
    """
    search = _Search(parts, given)
    search.bind(0, dict(given), search.gain_of(given), frozenset(given.values()))
    return search.best, search.most


class _Search:
    """Branch and bound over the nodes that are not given."""

    def __init__(self, parts: Parts, given: Mapping[str, str]) -> None:
        self.parts = parts
        edges = parts.plan.edges
        order = [*given]
        # Along edges, so that what joins a person to the rest is known when it is chosen.
        left = [node.id for node in parts.plan.nodes if node.id not in given]
        while left:
            near = [n for n in left if any({n, o} == {e.source, e.target} for e in edges for o in order)]
            order.append((near or left)[0])
            left.remove(order[-1])
        self.nodes = order[len(given) :]
        self.candidates = [self._candidates(node) for node in self.nodes]
        self.most = -1
        self.best: dict[str, str] = {}
        self.steps = 0
        place = {node: i for i, node in enumerate(order)}
        closing = [max(place[e.source], place[e.target]) - len(given) for e in edges]
        conditions = [place[node] - len(given) for node, _ in parts.conditions]
        # What the nodes from each place on could add at most.
        self.left = [sum(k >= i for k in (*closing, *conditions)) for i in range(len(self.nodes) + 1)]

    def _candidates(self, node: str) -> list[str]:
        """Who does anything for a node."""
        found = set[str]().union(*(who for (n, _), who in self.parts.conditions.items() if n == node))
        for edge, pairs in zip(self.parts.plan.edges, self.parts.edges, strict=True):
            if node in (edge.source, edge.target):
                found |= {pair[0 if node == edge.source else 1] for pair in pairs}
        return sorted(found)

    def gain_of(self, bound: Mapping[str, str]) -> int:
        """How many conditions and edges hold under a binding."""
        self.steps += 1
        return sum(node in bound and bound[node] in who for (node, _), who in self.parts.conditions.items()) + sum(
            (bound.get(edge.source), bound.get(edge.target)) in pairs
            for edge, pairs in zip(self.parts.plan.edges, self.parts.edges, strict=True)
        )

    def bind(self, place: int, bound: dict[str, str], gain: int, taken: frozenset[str]) -> None:
        """Try everybody for the node at `place`, and nobody."""
        if gain + self.left[place] <= self.most or self.steps > _MOST_STEPS:
            return
        if place == len(self.nodes):
            self.best, self.most = bound, gain
            return
        tried = [bound | {self.nodes[place]: who} for who in self.candidates[place] if who not in taken]
        gains = [self.gain_of(one) for one in tried]
        for i in sorted(range(len(tried)), key=lambda i: -gains[i]):
            self.bind(place + 1, tried[i], gains[i], taken | {tried[i][self.nodes[place]]})
        self.bind(place + 1, bound, gain, taken)


def rest(parts: Parts, bound: Mapping[str, str]) -> list[str]:
    """What does not hold under a binding, in words."""
    said = []
    for node in parts.plan.nodes:
        who = bound.get(node.id)
        named = f"{node.id} ({who})" if who is not None else node.id
        if who is None:
            said.append(f"{node.id}: nobody is known to be it")
        else:
            unseen = [time for (n, time), seen in parts.sighted.items() if n == node.id and who not in seen]
            said += [f"{named}: not seen{_at(parts.plan, time)}" for time in unseen]
        for i, condition in enumerate(node.conditions):
            if who not in parts.conditions[node.id, i]:
                said.append(f"{named}: {' '.join(condition.wanted)} is not known{_at(parts.plan, condition.at)}")
    for edge, pairs in zip(parts.plan.edges, parts.edges, strict=True):
        if (bound.get(edge.source), bound.get(edge.target)) not in pairs:
            ends = [f"{n} ({bound[n]})" if n in bound else n for n in (edge.source, edge.target)]
            said.append(f"edge {ends[0]} -> {ends[1]}: {edge.relation} is not known{_at(parts.plan, edge.at)}")
    return said


def _at(plan: Plan, time: str | None) -> str:
    frame = plan.times[time].frame if time is not None else None
    return "" if frame is None else f" at frame {frame:06d}"
