"""Bindings of a plan: which people are the nodes of the plan, ordered by the evidence of the plan's parts.

The evidence of a part is the log-odds that these people are meant, not that any people are. A condition that holds for
many people is weak evidence if it holds, and strong evidence if it does not. Tables of evidence come from readings
(`rank`) or from statements over the world model; `join` combines them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.expectation import expected_place
from jrdb_avr.agent.perceive.geometry import EDGE_DEG, FIRST, around, covered
from jrdb_avr.agent.perceive.readings import topic_of
from jrdb_avr.agent.perceive.votes import CAP, UNIT, Support, Tracks
from jrdb_avr.queries.compiler.find import search_order, stated_frame, times_of
from jrdb_avr.schema.plan import Plan

BEAM: Final = 32
"""Maximum number of bindings that are kept after each node."""

_HOLDS: Final = {1: 0.4, 2: 0.2}
"""Prior probability of a part by its number of nodes: 1 (condition) or 2 (edge)."""

_RARELY: Final = 0.03
"""Prior probability of one of the many actions, objects or interactions."""

_CLOSED: Final = frozenset({"gender", "age", "pose", "sector", "distance", "group_size"})


class PlanPart(NamedTuple):
    """A condition of a node, or an edge between two nodes, at a stated frame.

    nodes: one node or two. frame: None if the part holds at any frame. value: "" for an edge.
    """

    nodes: tuple[str, ...]
    name: str
    value: str
    frame: int | None

    @property
    def often(self) -> float:
        """Prior probability of the part."""
        rare = len(self.nodes) == 1 and topic_of(self.name, self.value) not in _CLOSED
        return _RARELY if rare else _HOLDS[len(self.nodes)]

    def support(self, tracks: Tracks, people: Sequence[str]) -> Support:
        """Return the support of the part if the nodes are these people."""
        if len(people) == 2:
            return tracks.relation(people[0], self.name, people[1], self.frame or 0)
        return tracks.statement(people[0], self.name, self.value, self.frame)

    def evidence(self, log_odds: float) -> float:
        """Return the log-odds that these people are meant, from the log-odds that the part holds for them."""
        evidence = -math.log(self.often + (1 - self.often) * math.exp(-log_odds))
        # Each person has a first person beside, so this edge is no evidence for the source.
        return evidence + math.log(self.often) if self.name in FIRST else evidence


@dataclass(frozen=True)
class RankedHypothesis:
    """A binding: entities by node, their summed log-odds, and the margin over the best binding with another target.

    A node is missing if there are fewer entities than nodes.
    """

    nodes: Mapping[str, str]
    log_odds: float
    margin: float


SlotSupport = tuple[PlanPart, Support]
"""A part of the plan and its support under a binding."""

Alone = Mapping[tuple[str, str], float]
"""Evidence of all conditions of a node, by node and entity. All entities have a value for each node."""

Pairs = Mapping[tuple[int, str, str], float]
"""Evidence of an edge, by the index of the edge, the source entity and the target entity. A missing pair counts 0
log-odds for the edge.
"""


def parts_of(plan: Plan) -> tuple[PlanPart, ...]:
    """Return the conditions of a plan, and then its edges.

    Args:
        plan: The plan.

    Returns:
        The parts.

    Raises:
        PlanError: If a part holds at no stated frame.
    """
    conditions = [
        PlanPart((node.id,), *condition.wanted, None if condition.at is None else stated_frame(plan, condition.at))
        for node in plan.nodes
        for condition in node.conditions
    ]
    return (*conditions, *edges_of(plan))


def edges_of(plan: Plan) -> tuple[PlanPart, ...]:
    """Return the edges of a plan as parts, in the plan's order."""
    return tuple(
        PlanPart((edge.source, edge.target), edge.relation, "", stated_frame(plan, edge.at)) for edge in plan.edges
    )


def frames_of(plan: Plan, node: str) -> tuple[int, ...]:
    """Return the stated frames at which a plan says something about a node."""
    return tuple(dict.fromkeys(stated_frame(plan, time) for time in times_of(plan, node)))


def rank(plan: Plan, tracks: Tracks) -> tuple[RankedHypothesis, ...]:
    """Return the bindings with the highest summed log-odds.

    Args:
        plan: The plan, as `perceivable` returns it.
        tracks: All readings so far.

    Returns:
        The bindings, the best first.
    """
    parts, edges = parts_of(plan), edges_of(plan)
    alone = {
        (node.id, entity): sum(
            part.evidence(part.support(tracks, (entity,)).log_odds) for part in parts if part.nodes == (node.id,)
        )
        + sum(absence_evidence(tracks, entity, frame) for frame in frames_of(plan, node.id))
        for node in plan.nodes
        for entity in tracks.people
    }
    pairs = {
        (index, source, target): edge.evidence(edge.support(tracks, (source, target)).log_odds)
        for index, edge in enumerate(edges)
        for source in tracks.people
        for target in tracks.people
        if source != target
    }
    return join(plan, alone, pairs)


def join(plan: Plan, alone: Alone, pairs: Pairs) -> tuple[RankedHypothesis, ...]:
    """Combine the evidence of nodes and edges into bindings, node by node with a beam.

    Args:
        plan: The plan.
        alone: Evidence of the nodes' conditions.
        pairs: Evidence of the edges.

    Returns:
        The bindings, the best first. Bindings with equal log-odds are in the order of the entities' names.
    """
    edges, people = edges_of(plan), sorted({entity for _, entity in alone})
    missing = [edge.evidence(0.0) for edge in edges]
    beam: list[tuple[float, dict[str, str]]] = [(0.0, {})]
    for node, joins in search_order(plan):
        grown = []
        for log_odds, bound in beam:
            for entity in people:
                if entity not in bound.values():
                    nodes = {**bound, node: entity}
                    total = log_odds + alone[node, entity]
                    for index, _ in joins:
                        source, target = (nodes.get(end) for end in edges[index].nodes)
                        if source is not None and target is not None:
                            total += pairs.get((index, source, target), missing[index])
                    grown.append((total, nodes))
        # Because the graph stores rounded sums, evidence that differs less is equal.
        order = sorted(grown, key=lambda binding: (-round(binding[0], 6), *binding[1].values()))
        beam = _with_each(order, node) or beam
    return tuple(
        RankedHypothesis(bound, log_odds, _margin(beam, plan.target, index))
        for index, (log_odds, bound) in enumerate(beam)
        if bound
    )


def _with_each(order: Sequence[tuple[float, dict[str, str]]], node: str) -> list[tuple[float, dict[str, str]]]:
    """Return the first `BEAM` bindings of a sorted list, and the first one of each entity of the node."""
    first = {bound[node]: index for index, (_, bound) in reversed([*enumerate(order)])}
    return [binding for index, binding in enumerate(order) if index < BEAM or first[binding[1][node]] == index]


def _margin(beam: Sequence[tuple[float, dict[str, str]]], target: str, index: int) -> float:
    log_odds, bound = beam[index]
    rivals = [odds for odds, people in beam if people.get(target) != bound.get(target)]
    return log_odds - max(rivals, default=-math.inf)


def absence_evidence(tracks: Tracks, entity: str, frame: int) -> float:
    """Return the log-odds against a person who is missing from looks that should show the person at a frame."""
    angle, spread = expected_place(tracks.people[entity], frame)
    arc = around(angle, max(spread, EDGE_DEG))
    looks, readings = tracks.looks.get(frame, ()), len(tracks.readings_at(entity, frame))
    if not readings:
        return -UNIT if covered(looks, arc) else 0.0
    missed = sum(covered([look], arc) for look in looks) - readings
    return max(-CAP, min(0.0, (readings - 1 - missed) * UNIT))


def best_of_each(hypotheses: Sequence[RankedHypothesis], node: str) -> dict[str, RankedHypothesis]:
    """Return the best binding for each person who may be a node, the best first."""
    best: dict[str, RankedHypothesis] = {}
    for hypothesis in hypotheses:
        if node in hypothesis.nodes:
            best.setdefault(hypothesis.nodes[node], hypothesis)
    return best


def slot_supports(plan: Plan, tracks: Tracks, hypothesis: RankedHypothesis) -> list[SlotSupport]:
    """Return the support of each part of a plan under a binding. A part of a node without an entity is open."""
    supports = []
    for part in parts_of(plan):
        people = [hypothesis.nodes[node] for node in part.nodes if node in hypothesis.nodes]
        supports.append((part, part.support(tracks, people) if len(people) == len(part.nodes) else Support()))
    return supports
