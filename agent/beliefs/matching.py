"""Which entities of an episode satisfy each part of a plan, found without the engine.

What was not written down is unknown, and what is unknown is no match.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Set
from functools import cached_property
from typing import Any, Final, NamedTuple

from jrdb_avr.queries.compiler.beliefs import BeliefReader
from jrdb_avr.queries.compiler.find import limits, search_order, stated_frame, times_of
from jrdb_avr.schema.plan import Condition, Edge, Plan
from jrdb_avr.schema.relations import SYMMETRIC

_MOST_STEPS: Final = 2_000
"""Bindings weighed; those of a real plan are a few dozens. Beyond them the best one so far is taken."""

_MOST_ROWS: Final = 50_000
"""Rows that a compiled plan may make: the engine serves one episode at a time, and takes about 1 µs for each."""


_Found = Set[tuple[str, ...]]
_Fits = Callable[[int], _Found]
"""Who fits a part at a frame."""


class _Part(NamedTuple):
    """A condition, sighting or edge of a plan: the entities that satisfy it, and what to report if none do.

    nodes: those that it is about, and "@" with the name of the moment at which it holds; of a moment its frame fits.
    counts: whether it is a condition or an edge, not only a sighting of the node.
    """

    nodes: tuple[str, ...]
    fits: frozenset[tuple[str, ...]]
    lack: str
    counts: bool = True

    def holds(self, bound: Mapping[str, str]) -> bool:
        """Whether it is satisfied under a binding of nodes to people, and of moments to frames."""
        return tuple(map(bound.get, self.nodes)) in self.fits


class PlanMatch:
    """Entities that satisfy each part of a plan, by an episode's rows alone: what the compiled plan finds.

    people: those who are seen at all; own: the parts about each node alone, its sightings first; edges: the parts about
    two.
    """

    def __init__(self, reader: BeliefReader, plan: Plan) -> None:
        """Match the parts of a plan with an episode's rows. Raises PlanError where a part holds at an event."""
        seen = reader.all("sighted")
        kinds = {row["who"]: row["kind"] for row in reader.all("entities")} if plan.things else {}
        looked = sorted({row["frame"] for row in seen})
        self.plan = plan
        self.own: dict[str, list[_Part]] = {}

        def held(kind: str, frame: int, **wanted: Any) -> list[Mapping[str, Any]]:
            rows = [row for row in reader.all(kind) if row["first"] <= frame <= row["last"]]
            return [row for row in rows if all(row[name] == value for name, value in wanted.items())]

        def joined(relation: str, frame: int) -> frozenset[tuple[str, str]]:
            return frozenset((row["source"], row["target"]) for row in held("relations", frame, name=relation))

        def may_be(node: str, who: str) -> bool:
            """Whether an entity is a thing of the node's kind, or for a person no thing of the plan's kinds."""
            kind = kinds.get(who)
            return kind == plan.things[node] if node in plan.things else kind not in plan.things.values()

        def part(nodes: tuple[str, ...], time: str | None, fits: _Fits, lack: str, counts: bool = True) -> _Part:
            """What fits at a time: at its frame, or at each that a moment may be, with the frame; None: always."""

            def at(frame: int) -> Iterator[tuple[str, ...]]:
                return (fit for fit in fits(frame) if all(map(may_be, nodes, fit)))

            if time is None:
                return _Part(nodes, frozenset(at(0)), lack.format(), counts)
            within = limits(plan, time)
            if within is None:
                frame = stated_frame(plan, time)
                return _Part(nodes, frozenset(at(frame)), lack.format(f"at frame {frame:06d}"), counts)
            frames = [frame for frame in looked if within[0] < frame < within[1]]
            found = frozenset((*fit, f"{time}@{frame}") for frame in frames for fit in at(frame))
            return _Part((*nodes, f"@{time}"), found, lack.format(f"at a moment {time}"), counts)

        def sighted(frame: int) -> _Found:
            return {(row["who"],) for row in seen if row["frame"] == frame}

        for node in plan.nodes:
            times, parts = times_of(plan, node.id), self.own.setdefault(node.id, [])
            parts += [part((node.id,), time, sighted, "not seen {}", counts=False) for time in times]
            for condition in node.conditions:

                def described(frame: int, condition: Condition = condition) -> _Found:
                    name, value = condition.wanted
                    who = {(row["who"],) for row in held("attributes", frame, name=name, value=value)}
                    if condition.interaction is not None:
                        who.update((end,) for pair in joined(value, frame) for end in pair)
                    return who

                said = " ".join(condition.wanted)
                lack = f"{said.replace('{', '{{').replace('}', '}}')} is not known" + " {}" * (condition.at is not None)
                parts.append(part((node.id,), condition.at, described, lack))
        self.edges = []
        for edge in plan.edges:

            def related(frame: int, edge: Edge = edge) -> _Found:
                found = joined(edge.wanted, frame)
                return found | {(b, a) for a, b in found} if edge.relation in SYMMETRIC else found

            lack = f"{edge.relation.replace('{', '{{').replace('}', '}}')} is not known {{}}"
            self.edges.append(part((edge.source, edge.target), edge.at, related, lack))
        self.people = tuple(sorted({row["who"] for row in seen if may_be(plan.target, row["who"])}))

    @cached_property
    def bindings(self) -> list[dict[str, str]] | None:
        """Every assignment of different people to the plan's nodes that satisfies all its conditions and edges.

        None where the compiled plan would make more rows than `_MOST_ROWS`. This goes the same way as it: each node is
        found by its first edge, the root by its first sighting, and a moment by the first sighting at it.
        """
        found: list[dict[str, str]] = [{}]
        rows, known = 0, set[str]()
        for name, first in self._order():
            known.add(name)
            parts = [one for one in self.parts if name in one.nodes and {*one.nodes} <= known]
            others = [one for one in first.nodes if one in known and one != name]
            place = [first.nodes.index(one) for one in others]
            reached: dict[tuple[str, ...], set[str]] = defaultdict(set)
            for fit in first.fits:
                reached[tuple(fit[at] for at in place)].add(fit[first.nodes.index(name)])
            tried = [bound | {name: who} for bound in found for who in reached[tuple(bound[one] for one in others)]]
            rows += len(tried)
            if rows > _MOST_ROWS:
                return None
            found = [b for b in tried if len({*b.values()}) == len(b) and all(part.holds(b) for part in parts)]
        return [{name: who for name, who in bound.items() if name in self.own} for bound in found]

    def _order(self) -> Iterator[tuple[str, _Part]]:
        """The nodes and moments in the order of the search, each with the part by which it is found."""
        moments = set[str]()
        for node, edges in search_order(self.plan):
            yield node, self.edges[edges[0][0]] if edges else self.own[node][0]
            for one in self.own[node]:
                moment = one.nodes[-1]
                if moment not in moments and moment != node:
                    moments.add(moment)
                    yield moment, one

    @cached_property
    def parts(self) -> list[_Part]:
        """All parts."""
        return [*(part for parts in self.own.values() for part in parts), *self.edges]

    @cached_property
    def counted(self) -> list[_Part]:
        """The conditions and edges, without the parts that are only sightings."""
        return [*(part for parts in self.own.values() for part in parts if part.counts), *self.edges]

    def likeliest(self, named: Mapping[str, str]) -> tuple[dict[str, str], int]:
        """A binding of nodes to different people, those `named` among them, under which most conditions and edges hold,
        and how many do. Of equal ones the first is taken, in the order of names; nobody is bound who adds nothing.
        """
        names = [*self.own, *dict.fromkeys(name for part in self.parts for name in part.nodes if name not in self.own)]
        order, free = [*named], [name for name in names if name not in named]
        while free:
            # Along edges, so that what joins a person to the rest is known when it is chosen.
            near = [n for n in free if any({n, o} <= {*edge.nodes} for edge in self.edges for o in order)]
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
                lines.append(f"edge {' -> '.join(named[node] for node in edge.nodes[:2])}: {edge.lack}")
        return lines
