"""Ranked hypotheses: which people the nodes of a plan are, by what readings tell of its parts.

A hypothesis binds the plan's nodes to different entities. Its log-odds are those of being who is meant, rather than
anybody: that a condition holds tells little where it holds of many, that it does not tells much. What nobody read
counts nothing. The best hypotheses are found by a beam along the plan's edges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.association import expected_place
from jrdb_avr.agent.perceive.geometry import EDGE_DEG, FIRST, around, covered
from jrdb_avr.agent.perceive.readings import topic_of
from jrdb_avr.agent.perceive.votes import MOST_VOTES, UNIT, SlotState, Support, Tracks
from jrdb_avr.queries.compiler.find import conditions_of, search_order, stated_frame, times_of
from jrdb_avr.schema.plan import Plan

BEAM: Final = 32
"""Hypotheses that are kept at each node."""


_HOLDS: Final = {1: 0.4, 2: 0.2}
"""Prior share of people for whom a condition is true (1), and of pairs for whom an edge is (2)."""
_RARELY: Final = 0.03
"""Prior share of people for whom an action, object or interaction is true: there are many of each."""

_CLOSED: Final = frozenset({"gender", "age", "pose", "sector", "distance", "group_size"})


class PlanPart(NamedTuple):
    """A condition of a node or an edge between two, at a stated frame (None: at any); `value` is "" for an edge."""

    nodes: tuple[str, ...]
    name: str
    value: str
    frame: int | None

    def support(self, tracks: Tracks, people: Sequence[str]) -> Support:
        """What readings say of it where the nodes are these people."""
        if len(people) == 2:
            return tracks.relation(people[0], self.name, people[1], self.frame or 0)
        return tracks.statement(people[0], self.name, self.value, self.frame)

    def evidence(self, tracks: Tracks, people: Sequence[str]) -> float:
        """The log-odds that it gives for these people being the ones who are meant."""
        often = _RARELY if topic_of(self.name, self.value) not in _CLOSED and len(people) == 1 else _HOLDS[len(people)]
        told = -math.log(often + (1 - often) * math.exp(-self.support(tracks, people).log_odds))
        # Somebody is the first beside everybody, so that this does not tell who the source is.
        return told + math.log(often) if self.name in FIRST else told


@dataclass(frozen=True)
class RankedHypothesis:
    """Entities by node, how likely they are all together, and by how much the best other target is less likely.

    A node is missing where there are fewer entities than nodes.
    """

    nodes: Mapping[str, str]
    log_odds: float
    margin: float


class SlotSupport(NamedTuple):
    """A part of the plan and its support under a hypothesis."""

    part: PlanPart
    support: Support

    @property
    def state(self) -> SlotState:
        """Whether the part is open, supported, certain or contradicted."""
        return self.support.state


def parts_of(plan: Plan) -> tuple[PlanPart, ...]:
    """The conditions and edges of a plan. Raises PlanError where one of them holds at no stated frame."""
    conditions = [
        PlanPart((node.id,), *one.wanted, None if one.at is None else stated_frame(plan, one.at))
        for node in plan.nodes
        for one in node.conditions
    ]
    edges = [
        PlanPart((edge.source, edge.target), edge.relation, "", stated_frame(plan, edge.at)) for edge in plan.edges
    ]
    return (*conditions, *edges)


def frames_of(plan: Plan, node: str) -> tuple[int, ...]:
    """The stated frames at which a plan says something of a node."""
    return tuple(dict.fromkeys(stated_frame(plan, time) for time in times_of(plan, node)))


def rank(plan: Plan, tracks: Tracks) -> tuple[RankedHypothesis, ...]:
    """The likeliest hypotheses, the best first; of equal ones that of the people who were read most often."""
    own = {node.id: [part for part in parts_of(plan) if part.nodes == (node.id,)] for node in plan.nodes}
    edges = parts_of(plan)[sum(len(conditions_of(plan, node.id)) for node in plan.nodes) :]
    seen = {who: len(readings) for who, readings in tracks.people.items()}

    @cache
    def odds(part: PlanPart, *people: str) -> float:
        return part.evidence(tracks, people)

    @cache
    def alone(node: str, who: str) -> float:
        absent = sum(_absence(tracks, who, frame) for frame in frames_of(plan, node))
        return absent + sum(odds(part, who) for part in own[node])

    beam: list[tuple[float, dict[str, str]]] = [(0.0, {})]
    for node, joins in search_order(plan):
        grown = [(score + alone(node, who), {**bound, node: who})
                 for score, bound in beam for who in seen if who not in bound.values()]  # fmt: skip
        for at, (score, bound) in enumerate(grown):
            ends = [(edges[i], [bound.get(end) for end in edges[i].nodes]) for i, _ in joins]
            score += sum(odds(edge, *people) for edge, people in ends if None not in people)
            grown[at] = score, bound
        order = sorted(grown, key=lambda one: (-one[0], -sum(seen[who] for who in one[1].values()), *one[1].values()))
        beam = _varied(order, node) or beam
    return tuple(
        RankedHypothesis(bound, score, _margin(beam, plan.target, at)) for at, (score, bound) in enumerate(beam)
    )


def _varied(order: Sequence[tuple[float, dict[str, str]]], node: str) -> list[tuple[float, dict[str, str]]]:
    """The best hypotheses of a sorted list, and the best one for each person who may be the node."""
    first = {bound[node]: at for at, (_, bound) in reversed([*enumerate(order)])}
    return [one for at, one in enumerate(order) if at < BEAM or first[one[1][node]] == at]


def _margin(beam: Sequence[tuple[float, dict[str, str]]], target: str, at: int) -> float:
    score, bound = beam[at]
    others = [other for other, people in beam if people.get(target) != bound.get(target)]
    return score - max(others, default=-math.inf)


def _absence(tracks: Tracks, who: str, frame: int) -> float:
    """Log-odds against a person who is missing from looks that should show the person at a frame."""
    place = expected_place(tracks.people[who], frame)
    where = around(place.angle, max(place.angle_spread, EDGE_DEG))
    looks, readings = tracks.looks.get(frame, ()), len(tracks.at(who, frame))
    missed = sum(covered([look], where) for look in looks) - readings
    if not readings:
        return -UNIT if covered(looks, where) else 0.0
    return max(-MOST_VOTES * UNIT, min(0.0, readings - 1 - missed) * UNIT)


def best_of_each(hypotheses: Sequence[RankedHypothesis], node: str) -> dict[str, RankedHypothesis]:
    """The best hypothesis for each person who may be a node, in the order of the hypotheses, the best first."""
    found: dict[str, RankedHypothesis] = {}
    for one in hypotheses:
        if node in one.nodes:
            found.setdefault(one.nodes[node], one)
    return found


def shares(hypotheses: Sequence[RankedHypothesis], node: str) -> dict[str, float]:
    """How likely each entity is to be a node, among these hypotheses, the likeliest first."""
    most = max((one.log_odds for one in hypotheses), default=0.0)
    found: dict[str, float] = {}
    for one in hypotheses:
        if node in one.nodes:
            found[one.nodes[node]] = found.get(one.nodes[node], 0.0) + math.exp(one.log_odds - most)
    total = sum(found.values())
    return {who: found[who] / total for who in sorted(found, key=lambda who: (-found[who], who))}


def slot_supports(plan: Plan, tracks: Tracks, hypothesis: RankedHypothesis) -> tuple[SlotSupport, ...]:
    """The support of each part of the plan under a hypothesis; a part of a node without an entity is open."""
    found = []
    for part in parts_of(plan):
        people = [hypothesis.nodes[node] for node in part.nodes if node in hypothesis.nodes]
        found.append(SlotSupport(part, part.support(tracks, people) if len(people) == len(part.nodes) else Support()))
    return tuple(found)
