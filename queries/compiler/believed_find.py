"""The statement that finds the people of a plan among what is believed in an episode.

Beliefs are taken as texts: of whom, what is said and at which frame, and of a relation to whom before that
("/action=sitting@15/p1", "p2/conversation=@15/p1"); of a sighting nothing is said but when ("/=@15/p1"). Each condition
and edge of a plan asks for such a text: all of a plan is parameters, and the statement depends on its `Shape` alone.
For the first use of a statement the engine needs several times as long as for the next one, and while no two questions
of an agent have one plan, most have one of a few shapes. What is not believed is no match.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from jrdb_avr.queries.compiler.find import Find, joined, search_order, stated_frame, times_of
from jrdb_avr.queries.compiler.mapping import read_text
from jrdb_avr.schema.beliefs import TIMELESS
from jrdb_avr.schema.plan import Edge, Plan, validate
from jrdb_avr.schema.relations import SYMMETRIC

READS: Final = "world"
"""The folder of the world namespace's statements."""

MANY: Final = 4
"""A statement asks for so many texts of each person, or for the next multiple of it."""

_SMALL: Final = 5
"""People up to whom all orders of a plan are tried."""

_ENDS: Final = ("who", "whom")

_NOTHING: Final = ""
"""What no belief says."""


@dataclass(frozen=True)
class Shape:
    """What the statement of a plan depends on.

    people: how many nodes there are, called by their places in the search; edges: the places that each joins, the
    earlier first; texts: how many are asked for of each person; anybody: whether one says of a person only that it is
    in a relation, whoever the other one is.
    """

    people: int
    edges: tuple[tuple[int, int], ...]
    texts: int = MANY
    anybody: bool = False


def find_believed(plan: Plan) -> Find:
    """Compile a plan's conditions and edges, to a statement whose parameters are the values of `Find.row` and the
    episode's `hash`. It gives columns who0, who1, ..., every binding once, in any order.

    Raises PlanError where the plan is invalid or not of stated times.
    """
    validate(plan)
    places = {node: place for place, (node, _) in enumerate(believed_order(plan))}
    people = [_asked_of(plan, node) for node in places]
    edges = sorted(_asked_between(plan, edge, places) for edge in plan.edges)
    conditions = [one for node in plan.nodes for one in node.conditions if one.interaction is not None]
    ties = {_said(one.wanted[1], "", stated_frame(plan, one.at or "")) for one in conditions}
    shape = Shape(
        people=len(people),
        edges=tuple(pair for pair, _, _ in edges),
        texts=filled(max(map(len, people))),
        anybody=bool(ties),
    )
    row: dict[str, Any] = {}
    for place, texts in enumerate(people):
        # What is asked for once more changes nothing.
        asked = texts + texts[:1] * (shape.texts - len(texts))
        row |= {f"c{place}_{i}": f"/{text}/" for i, text in enumerate(asked)}
    for i, (_, there, back) in enumerate(edges):
        row |= {f"e{i}": f"/{there}/", f"b{i}": f"/{back}/"}
    row["wanted"] = sorted(({text[1:-1] for text in row.values()} | ties) - {_NOTHING})
    return Find(statement(shape), tuple(places), row)


def filled(texts: int) -> int:
    """How many texts of each person a statement asks for where there are so many."""
    return -(-texts // MANY) * MANY


def believed_order(plan: Plan) -> list[tuple[str, list[tuple[int, Edge]]]]:
    """Nodes in the order in which they are looked for, as `search_order`. Of the orders of a small plan it is the one
    with the smallest places in its shape: how the plan lists its edges does not matter then.
    """
    if len(plan.nodes) > _SMALL:
        return search_order(plan)

    def pairs(order: Sequence[str]) -> list[list[int]]:
        return sorted(sorted((order.index(edge.source), order.index(edge.target))) for edge in plan.edges)

    return joined(plan, min(_orders(plan, [plan.root]), key=pairs))


def _orders(plan: Plan, known: Sequence[str]) -> Iterator[Sequence[str]]:
    """All orders in which edges lead from the known nodes to the others."""
    if len(known) == len(plan.nodes):
        yield known
    for node in sorted({e.target for e in plan.edges if e.source in known} - {*known}):
        yield from _orders(plan, [*known, node])


@lru_cache(256)
def statement(shape: Shape) -> str:
    """The statement of a shape. Names in it are the compiler's own."""
    lines = read_text(READS, "beliefs").rstrip().splitlines()
    told = "concat(r.whom, '/', said, '/', r.who)"
    if shape.anybody:
        # A relation says of both ends what an attribute would.
        ends = [f"concat('/interaction=', r.name, '@', CAST(r.first AS STRING), '/', r.{end})" for end in _ENDS]
        lines.append(f"UNWIND CASE WHEN r.whom IS NULL THEN [{told}] ELSE [{', '.join([told, *ends])}] END AS one")
        told = "one"
    lines.append(f"WITH collect({told}) AS told, collect(DISTINCT r.who) AS people")
    bound = ["told", "people"]
    for place in range(shape.people):
        bound.append(f"n{place}")
        tests = " AND ".join(_tests(shape, place))
        lines += [f"UNWIND people AS n{place}", f"WITH {', '.join(bound)}", f"WHERE {tests}"]
    lines.append(f"RETURN {', '.join(f'n{place} AS who{place}' for place in range(shape.people))}")
    return "\n".join(lines)


def _tests(shape: Shape, place: int) -> Iterator[str]:
    """What must hold of the person at a place, alone and with those before."""
    own = f"n{place}"
    for other in range(place):
        yield f"{own} <> n{other}"
    for i in range(shape.texts):
        yield f"concat($c{place}_{i}, {own}) IN told"
    for i, (first, second) in enumerate(shape.edges):
        if second == place:
            yield f"(concat({own}, $e{i}, n{first}) IN told OR concat(n{first}, $b{i}, {own}) IN told)"


# -- what a plan asks for ---------------------------------------------------------------------------------------------


def _said(name: str, value: str, frame: int) -> str:
    """What is said at a frame, as the statement puts it: of a relation, which has no value, its name."""
    return f"{name}={value}@{frame}"


def _asked_of(plan: Plan, node: str) -> list[str]:
    """What is asked of one person; first that it is seen."""
    times = times_of(plan, node)
    texts = [_said("", "", stated_frame(plan, time)) for time in times]
    for condition in next(one.conditions for one in plan.nodes if one.id == node):
        name, value = condition.wanted
        texts.append(_said(name, value, 0 if name in TIMELESS else stated_frame(plan, condition.at or times[0])))
    return list(dict.fromkeys(texts))


def _asked_between(plan: Plan, edge: Edge, places: Mapping[str, int]) -> tuple[tuple[int, int], str, str]:
    """The places that an edge joins, the earlier first, and what is asked of them in this order, and the other way
    round.
    """
    said = _said(edge.relation, "", stated_frame(plan, edge.at))
    source, target = places[edge.source], places[edge.target]
    back = said if edge.relation in SYMMETRIC else _NOTHING
    return ((source, target), said, back) if source < target else ((target, source), back, said)
