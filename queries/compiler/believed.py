"""The statement that finds the people of a plan among an agent's beliefs: each part of the plan is a Cypher pattern.

A node of the plan is a variable; a sighting, a condition or an edge is a MATCH of its own over what is current and
holds at the frame. A part names its people anew and finds them by identity: one MATCH of many edges takes the engine
seconds to plan, in a circle it loses rows, and from variables bound before it scans the edges of all episodes. Values
are parameters, so that the text depends on the form of a plan alone. What is not believed is no match.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from jrdb_avr.queries.compiler.find import Edges, Find, conditions_of, limits, search_order, stated_frame, times_of
from jrdb_avr.schema.plan import Condition, Edge, Plan, validate
from jrdb_avr.schema.relations import SYMMETRIC

_PERSON: Final = "({}:Entity {{episode_hash: UUID($hash)}})"
_HOLDS: Final = "r.current AND r.first <= {0} AND r.last >= {0}"
_IS: Final = "r.name = ${0}_name AND r.value = ${0}_value"


def find_believed(plan: Plan) -> Find:
    """Compile a plan to a Cypher statement over one episode's beliefs that finds the people of its nodes.

    The parameters of the statement are the values of `Find.row` and the episode's `hash`. It returns the columns who0,
    who1, ..., with each binding once, in any order. Raises PlanError if the plan is invalid or has other than stated
    times.
    """
    validate(plan)
    return _Pattern(plan).compiled()


class _Pattern:
    """Builder of the statement. It adds the people in the order in which edges reach them."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.nodes: dict[str, str] = {}
        # The variable of each moment: the frame of a sighting at it.
        self.moments: dict[str, str] = {}
        self.row: dict[str, Any] = {}

    def compiled(self) -> Find:
        lines: list[str] = []
        for node, edges in search_order(self.plan):
            others = list(self.nodes.values())
            own = self.nodes[node] = f"n{len(others)}"
            distinct = [f" AND id({own}) <> id({other})" for other in others]
            known = list(self.moments.values())
            for place, part in enumerate(self._parts(node, edges)):
                lines.append(part if place else "".join([part, *distinct, self._kind(node)]))
                new = [frame for frame in self.moments.values() if frame not in known]
                carried = [*others, own, *known, *(f"r.frame AS {frame}" for frame in new)]
                lines.append(f"WITH {', '.join(carried)}")
                known += new
            lines[-1] = lines[-1].replace("WITH", "WITH DISTINCT", 1)
        names = (f"{variable}.name AS who{place}" for place, variable in enumerate(self.nodes.values()))
        lines[-1] = f"RETURN DISTINCT {', '.join(names)}"
        return Find("\n".join(lines), tuple(self.nodes), self.row)

    def _kind(self, node: str) -> str:
        """Return the test that a thing has its kind, or that a person has no kind of a thing of the plan."""
        things, own = self.plan.things, self.nodes[node]
        if not things:
            return ""
        self.row |= {f"{own}_kind": things[node]} if node in things else {"kinds": sorted({*things.values()})}
        return f" AND {own}.kind = ${own}_kind" if node in things else f" AND NOT {own}.kind IN $kinds"

    def _parts(self, node: str, edges: Edges) -> Iterator[str]:
        """Yield the clauses of a node and of its edges to earlier nodes. The first clause introduces the variable."""
        own = self.nodes[node]
        for place, (i, edge) in enumerate(edges):
            yield self._edge(f"e{i}", edge, new="" if place else node)
        for i, time in enumerate(times_of(self.plan, node)):
            pattern = f"{_PERSON.format('x' if i or edges else own)}-[r:Sighted]->(:Observation)"
            same = _same(x=own) if i or edges else ""
            yield f"MATCH {pattern}\nWHERE {same}r.current AND {self._sighted(f'{own}_s{i}', time)}"
        for i, condition in enumerate(conditions_of(self.plan, node)):
            yield self._condition(f"{own}_c{i}", own, condition, condition.at or times_of(self.plan, node)[0])

    def _frame(self, key: str, time: str) -> str:
        """The frame of a time: a parameter, or of a moment the variable that a sighting bound."""
        if time in self.moments:
            return self.moments[time]
        self.row[f"{key}_frame"] = stated_frame(self.plan, time)
        return f"${key}_frame"

    def _sighted(self, key: str, time: str) -> str:
        """The test of a sighting's frame; the first sighting at a moment binds it."""
        within = limits(self.plan, time)
        if within is None or time in self.moments:
            return f"r.frame = {self._frame(key, time)}"
        self.moments[time] = f"f{len(self.moments)}"
        self.row |= {f"{key}_after": within[0], f"{key}_before": within[1]}
        return f"r.frame > ${key}_after AND r.frame < ${key}_before"

    def _edge(self, key: str, edge: Edge, new: str) -> str:
        self.row[f"{key}_name"] = edge.wanted
        ends = {"x": edge.source, "y": edge.target}
        source, target = (self.nodes[node] if node == new else end for end, node in ends.items())
        way = "-" if edge.relation in SYMMETRIC else "->"
        same = _same(**{end: self.nodes[node] for end, node in ends.items() if node != new})
        pattern = f"{_PERSON.format(source)}-[r:Related]{way}{_PERSON.format(target)}"
        holds = _HOLDS.format(self._frame(key, edge.at))
        return f"MATCH {pattern}\nWHERE {same}{holds} AND r.name = ${key}_name"

    def _condition(self, key: str, own: str, condition: Condition, time: str) -> str:
        name, value = condition.wanted
        self.row |= {f"{key}_name": name, f"{key}_value": value}
        edge, fits = "-[r:Has]->(:Observation)", _IS.format(key)
        if condition.interaction is not None:
            # What joins somebody to anybody stands for an attribute of both.
            edge = "-[r:Has|Related]-(:Observation:Entity)"
            fits = f"(label(r) = 'Has' AND {fits} OR label(r) = 'Related' AND r.name = ${key}_value)"
        holds = _HOLDS.format(self._frame(key, time))
        return f"MATCH {_PERSON.format('x')}{edge}\nWHERE {_same(x=own)}{holds} AND {fits}"


def _same(**ends: str) -> str:
    """Tests that people named anew are those of bound variables."""
    return "".join(f"id({end}) = id({bound}) AND " for end, bound in ends.items())
