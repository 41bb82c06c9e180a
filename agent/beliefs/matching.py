"""Which entities of an episode satisfy each part of a plan, found without the engine.

What was not written down is unknown, and what is unknown is no match.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any, Final, NamedTuple

from jrdb_avr.queries.compiler.beliefs import BeliefReader
from jrdb_avr.queries.compiler.find import search_order, stated_frame, times_of
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import SYMMETRIC

_MOST_STEPS: Final = 2_000
"""Bindings weighed; those of a real plan are a few dozens. Beyond them the best one so far is taken."""

_MOST_ROWS: Final = 50_000
"""Rows that a compiled plan may make: the engine serves one episode at a time, and takes about 1 µs for each."""


class _Part(NamedTuple):
    """A condition, sighting or edge of a plan: the entities that satisfy it, and what to report if none do.

    counts: whether it is a condition or an edge, not only a sighting of the node.
    """

    nodes: tuple[str, ...]
    fits: frozenset[tuple[str, ...]]
    lack: str
    counts: bool = True

    def holds(self, bound: Mapping[str, str]) -> bool:
        """Whether it is satisfied under a binding of nodes to people."""
        return tuple(map(bound.get, self.nodes)) in self.fits


class PlanMatch:
    """Entities that satisfy each part of a plan, by an episode's rows alone: what the compiled plan finds.

    people: those who are seen at all; own: the parts about each node alone, its sightings first; edges: the parts about
    two.
    """

    def __init__(self, reader: BeliefReader, plan: Plan) -> None:
        """Match the parts of a plan with an episode's rows. Raises PlanError where a part holds at no stated frame."""
        seen = reader.all("sighted")
        kinds = {row["who"]: row["kind"] for row in reader.all("entities")} if plan.things else {}
        self.plan = plan
        self.own: dict[str, list[_Part]] = {}

        def held(kind: str, frame: int, **wanted: Any) -> list[Mapping[str, Any]]:
            rows = [row for row in reader.all(kind) if row["first"] <= frame <= row["last"]]
            return [row for row in rows if all(row[name] == value for name, value in wanted.items())]

        def joined(relation: str, frame: int) -> frozenset[tuple[str, str]]:
            return frozenset((row["source"], row["target"]) for row in held("relations", frame, name=relation))

        def part(nodes: tuple[str, ...], fits: Iterable[tuple[str, ...]], lack: str, counts: bool = True) -> _Part:
            may = (fit for fit in fits if all(may_be(node, who) for node, who in zip(nodes, fit, strict=True)))
            return _Part(nodes, frozenset(may), lack, counts)

        def may_be(node: str, who: str) -> bool:
            """Whether an entity is a thing of the node's kind, or for a person no thing of the plan's kinds."""
            kind = kinds.get(who)
            return kind == plan.things[node] if node in plan.things else kind not in plan.things.values()

        for node in plan.nodes:
            times, parts = times_of(plan, node.id), self.own.setdefault(node.id, [])
            for time in times:
                frame = stated_frame(plan, time)
                there = ((row["who"],) for row in seen if row["frame"] == frame)
                parts.append(part((node.id,), there, f"not seen at frame {frame:06d}", counts=False))
            for condition in node.conditions:
                frame = stated_frame(plan, condition.at or times[0])
                name, value = condition.wanted
                who = {(row["who"],) for row in held("attributes", frame, name=name, value=value)}
                if condition.interaction is not None:
                    who.update((end,) for pair in joined(value, frame) for end in pair)
                when = "" if condition.at is None else f" at frame {frame:06d}"
                parts.append(part((node.id,), who, f"{name} {value} is not known{when}"))
        self.edges = []
        for edge in plan.edges:
            frame = stated_frame(plan, edge.at)
            found = joined(edge.wanted, frame)
            fits = found | {(b, a) for a, b in found} if edge.relation in SYMMETRIC else found
            self.edges.append(
                part((edge.source, edge.target), fits, f"{edge.relation} is not known at frame {frame:06d}")
            )
        self.people = tuple(sorted({row["who"] for row in seen if may_be(plan.target, row["who"])}))

    @cached_property
    def bindings(self) -> list[dict[str, str]] | None:
        """Every assignment of different people to the plan's nodes that satisfies all its conditions and edges.

        None where the compiled plan would make more rows than `_MOST_ROWS`. This goes the same way as it: each node is
        found by its first edge, the root by its first sighting.
        """
        found: list[dict[str, str]] = [{}]
        rows = 0
        for node, edges in search_order(self.plan):
            joining = [self.edges[i] for i, _ in edges]
            by = joining[0] if joining else self.own[node][0]
            other = next((one for one in by.nodes if one != node), "")
            reached: dict[str, list[str]] = defaultdict(list)
            for fit in by.fits:
                ends = dict(zip(by.nodes, fit, strict=True))
                reached[ends.get(other, "")].append(ends[node])
            rows += sum(len(reached[bound.get(other, "")]) for bound in found)
            if rows > _MOST_ROWS:
                return None
            parts = [*self.own[node], *joining]
            tried = (bound | {node: who} for bound in found for who in reached[bound.get(other, "")])
            found = [b for b in tried if len({*b.values()}) == len(b) and all(part.holds(b) for part in parts)]
        return found

    @cached_property
    def counted(self) -> list[_Part]:
        """The conditions and edges."""
        return [*(part for parts in self.own.values() for part in parts if part.counts), *self.edges]

    def likeliest(self, named: Mapping[str, str]) -> tuple[dict[str, str], int]:
        """A binding of nodes to different people, those `named` among them, under which most conditions and edges hold,
        and how many do. Of equal ones the first is taken, in the order of names; nobody is bound who adds nothing.
        """
        order, free = [*named], [node.id for node in self.plan.nodes if node.id not in named]
        while free:
            # Along edges, so that what joins a person to the rest is known when it is chosen.
            near = [n for n in free if any({n, o} == {*edge.nodes} for edge in self.edges for o in order)]
            order.append((near or free)[0])
            free.remove(order[-1])
        place = {node: at for at, node in enumerate(order)}
        decided = [max(place[node] for node in part.nodes) for part in self.counted]
        candidates = {node: self._candidates(node) for node in order[len(named) :]}
        best: dict[str, str] = {}
        most, steps = -1, 1

        def bind(at: int, bound: dict[str, str], held: int) -> None:
            """Try everybody for the node at a place, and nobody."""
            nonlocal best, most, steps
            if held + sum(one >= at for one in decided) <= most or steps > _MOST_STEPS:
                return
            if at == len(order):
                best, most = bound, held
                return
            tried = [bound | {order[at]: who} for who in candidates[order[at]] if who not in bound.values()]
            steps += len(tried)
            for count, one in sorted(((self._held(one), one) for one in tried), key=lambda pair: -pair[0]):
                bind(at + 1, one, count)
            bind(at + 1, bound, held)

        bind(len(named), dict(named), self._held(named))
        return best, most

    def _candidates(self, node: str) -> list[str]:
        """People who satisfy at least one condition or edge of a node."""
        parts = [part for part in self.counted if node in part.nodes]
        return sorted({fit[part.nodes.index(node)] for part in parts for fit in part.fits})

    def _held(self, bound: Mapping[str, str]) -> int:
        """How many conditions and edges hold under a binding."""
        return sum(part.holds(bound) for part in self.counted)

    def missing(self, bound: Mapping[str, str]) -> list[str]:
        """What does not hold under a binding, in words."""
        named = {node: f"{node} ({bound[node]})" if node in bound else node for node in self.own}
        lines = []
        for node, parts in self.own.items():
            if node not in bound:
                lines.append(f"{node}: nobody is known to be it")
            lacking = [part for part in parts if not part.holds(bound) and (part.counts or node in bound)]
            lines += [f"{named[node]}: {part.lack}" for part in lacking]
        for edge in self.edges:
            if not edge.holds(bound):
                lines.append(f"edge {' -> '.join(named[node] for node in edge.nodes)}: {edge.lack}")
        return lines
