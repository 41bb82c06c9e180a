"""Statements that put writes of an agent into the world tables, and take an episode out of them.

The statements are the files of `queries/world/`; what goes where is said by the write's `Fact`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, Final

import msgspec

from jrdb_avr.schema.world import (
    ALWAYS,
    EntityRow,
    EpisodeRow,
    Fact,
    HasRow,
    ObservationRow,
    RelatedRow,
    SightedRow,
    SlotRow,
    Write,
)

from .world import WorldGraph
from .world_tables import Statement

Edge = SightedRow | HasRow | RelatedRow

LONGEST: Final = 5
"""Weight of the statements that share a transaction at most, so that none takes long: see `_weight`."""

FEW: Final = 2
"""Edges of a table that are made one by one at most: to make more together takes as long as these."""

MANY: Final = 48
MANY_EDGES: Final = 24
"""Nodes and edges that one statement makes at most: it is done in a few milliseconds, and others need not wait for it
longer.
"""

_EDGES: Final[dict[type[Edge], str]] = {SightedRow: "sighted", HasRow: "has", RelatedRow: "related"}
"""The name of an edge's statements."""


def write_statements(episode: str, made: Sequence[tuple[Write, Fact]]) -> list[list[Statement]]:
    """What makes writes of an episode, given in order, true in the tables, with their lines of the record.

    Each list is to be one transaction, in order.
    """
    transactions: list[list[Statement]] = []
    weight = LONGEST
    for statement in (*_changes(made).statements(episode), *_lines(episode, made)):
        weight += _weight(statement)
        if weight > LONGEST:
            transactions.append([])
            weight = _weight(statement)
        transactions[-1].append(statement)
    return transactions


def _weight(statement: Statement) -> int:
    """About how many milliseconds a statement takes: of one row, of many nodes, of many edges."""
    cypher, params = statement
    return 2 if "rows" not in params else 4 if "r.source" in cypher else 3


@dataclass
class _Changes:
    """What several writes come to: new rows as the last of them leaves them, and changes of older rows.

    edges: under the write that made them; until: of such an edge, the step from which it is not current; ended: older
    edges, as name of their table, key of an end, write and that step; named: kind and node of older entities; freed:
    older entities that lose their node.
    """

    begun: EpisodeRow | None = None
    planned: EpisodeRow | None = None
    slots: list[SlotRow] = field(default_factory=list)
    observations: list[ObservationRow] = field(default_factory=list)
    entities: dict[str, EntityRow] = field(default_factory=dict)
    named: dict[str, EntityRow] = field(default_factory=dict)
    freed: dict[str, None] = field(default_factory=dict)
    edges: dict[int, Edge] = field(default_factory=dict)
    until: dict[int, int] = field(default_factory=dict)
    ended: list[tuple[str, str, int, int]] = field(default_factory=list)

    def add(self, write: Write, fact: Fact) -> None:
        """Take the next write."""
        if fact.episode is not None:
            if write.tool == "begin" or self.begun is not None:
                self.begun = fact.episode
            else:
                self.planned = fact.episode
        self.slots.extend(fact.slots)
        if fact.observation is not None:
            self.observations.append(fact.observation)
        for key in fact.freed:
            self._free(key)
        for entity in (fact.entity, fact.changed):
            if entity is not None:
                self._name(entity, new=entity is fact.entity)
        for edge in (fact.sighted, fact.has, fact.related):
            if edge is not None:
                for number in fact.replaced:
                    self._end(edge, number, write.step)
                self.edges[edge.write] = edge

    def _free(self, key: str) -> None:
        for rows in (self.entities, self.named):
            if key in rows:
                rows[key] = msgspec.structs.replace(rows[key], node="")
                return
        self.freed[key] = None

    def _name(self, entity: EntityRow, *, new: bool) -> None:
        self.freed.pop(entity.id, None)
        (self.entities if new or entity.id in self.entities else self.named)[entity.id] = entity

    def _end(self, by: Edge, number: int, step: int) -> None:
        if number in self.edges:
            self.until[number] = step
            return
        # An edge that holds both ways may have been written the other way round.
        sources = (by.source, by.target) if isinstance(by, RelatedRow) else (by.source,)
        self.ended.extend((_EDGES[type(by)], source, number, step) for source in sources)

    def statements(self, episode: str) -> Iterator[Statement]:
        """The statements, nodes before edges."""
        if self.begun is not None:
            yield _text("begin"), msgspec.structs.asdict(self.begun)
        if self.planned is not None:
            yield _text("plan"), {"id": episode, "plan": self.planned.plan}
        for name, nodes in (("slots", self.slots), ("observation", self.observations), ("entity", self.entities)):
            rows = nodes.values() if isinstance(nodes, dict) else nodes
            yield from _rows(name, episode, [msgspec.structs.asdict(row) for row in rows])
        for row in self.named.values():
            yield _text("changed"), {"id": row.id, "kind": row.kind, "node": row.node}
        for key in self.freed:
            yield _text("freed"), {"id": key}
        for name, source, number, step in self.ended:
            yield _text(f"{name}_before"), {"source": source, "write": number, "until": step}
        for kind, name in _EDGES.items():
            yield from self._edge_statements(
                name, episode, [self._columns(edge) for edge in self.edges.values() if isinstance(edge, kind)]
            )

    def _edge_statements(self, name: str, episode: str, edges: Sequence[dict[str, Any]]) -> Iterator[Statement]:
        if len(edges) <= FEW:
            yield from ((_text(name), edge) for edge in edges)
            return
        yield from _rows(f"{name}_many", episode, edges, MANY_EDGES)

    def _columns(self, edge: Edge) -> dict[str, Any]:
        values = msgspec.structs.asdict(edge)
        if isinstance(edge, SightedRow):
            del values["box"]
            values |= edge.box._asdict()
        until = self.until.get(edge.write, ALWAYS)
        return {**values, "current": until == ALWAYS, "until": until}


def _changes(made: Sequence[tuple[Write, Fact]]) -> _Changes:
    changes = _Changes()
    for write, fact in made:
        changes.add(write, fact)
    return changes


def _lines(episode: str, made: Sequence[tuple[Write, Fact]]) -> Iterator[Statement]:
    lines = [
        {
            "id": f"{episode}/{write.number}",
            "number": write.number,
            "step": write.step,
            "tool": write.tool,
            "arguments": write.arguments,
            "accepted": write.accepted,
            "reason": write.reason,
        }
        for write, _ in made
    ]
    return _rows("write", episode, lines)


def _rows(name: str, episode: str, rows: Sequence[Mapping[str, Any]], most: int = MANY) -> Iterator[Statement]:
    """Statements that make rows, `most` of them at a time."""
    for start in range(0, len(rows), most):
        yield _text(name), {"episode": episode, "rows": rows[start : start + most]}


DROPPED: Final = ("entity", "observation", "slot", "write", "episode")


def drop_episode(graph: WorldGraph, episode: str) -> None:
    """Take an episode and all that it holds out of the tables. Raises as `WorldGraph.write`."""
    graph.write([(_text(f"drop_{name}"), {"episode": episode}) for name in DROPPED])


def episodes_of(graph: WorldGraph, run_id: str) -> set[str]:
    """Keys of the episodes of a run that the tables hold."""
    return set(graph.query(_text("episodes"), {"run": run_id})["episode"].to_pylist())


@cache
def _text(name: str) -> str:
    """The text of `queries/world/<name>.cypher`."""
    return resources.files("jrdb_avr.queries").joinpath("world", f"{name}.cypher").read_text("utf-8")
