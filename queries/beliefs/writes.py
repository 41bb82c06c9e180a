"""Statements that put writes of an agent into the world tables, and take an episode out of them.

The statements are the files of `queries/world/`; what goes where is said by the write's `Fact`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import islice
from typing import Any, Final

import msgspec

from jrdb_avr.queries.beliefs.graph import Statement, WorldGraph
from jrdb_avr.schema.beliefs import (
    ALWAYS,
    AttributeRow,
    EntityRow,
    EpisodeRow,
    Fact,
    ObservationRow,
    RelationRow,
    SightingRow,
    SlotRow,
    Write,
    episode_hash,
    name_of,
)

Edge = SightingRow | AttributeRow | RelationRow

FEW: Final = 1
"""Edges of a table that are made one by one at most: to make more together takes as long as two."""

MANY: Final = 48
MANY_EDGES: Final = 24
"""Nodes and edges that one statement makes at most: it is done in a few milliseconds, and others need not wait for it
longer.
"""

_EDGES: Final[dict[type[Edge], str]] = {SightingRow: "sighted", AttributeRow: "has", RelationRow: "related"}
"""The name of an edge's statements."""


def write_statements(
    episode: str, made: Sequence[tuple[Write, Fact]], entities: Mapping[str, EntityRow]
) -> list[list[Statement]]:
    """What makes writes of an episode, given in order, true in the tables, with their lines of the record.

    entities: all of the episode, by name. Each list is to be one transaction, in order: of one statement, as the engine
    needs twice the time for a transaction that is begun and ended by statements of its own, and others wait for it.
    """
    statements = (*_changes(made).statements(episode, entities), *_lines(episode, made))
    return [[statement] for statement in statements]


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
        sources = (by.source, by.target) if isinstance(by, RelationRow) else (by.source,)
        self.ended.extend((_EDGES[type(by)], source, number, step) for source in sources)

    def statements(self, episode: str, entities: Mapping[str, EntityRow]) -> Iterator[Statement]:
        """The statements, nodes before edges."""
        begun = {"episode": episode}
        hashed = {"hash": episode_hash(episode)}
        if self.begun is not None:
            yield _text("begin"), msgspec.structs.asdict(self.begun)
        if self.planned is not None:
            yield _text("plan"), {"id": episode, "plan": self.planned.plan}
        yield from _rows("slots", begun, map(msgspec.structs.asdict, self.slots))
        yield from _rows("observation", begun | hashed, map(msgspec.structs.asdict, self.observations))
        yield from _rows("entity", begun | hashed, map(msgspec.structs.asdict, self.entities.values()))
        for row in self.named.values():
            yield _text("changed"), {"id": row.id, "kind": row.kind, "node": row.node}
        for key in self.freed:
            yield _text("freed"), {"id": key}
        for name, source, number, step in self.ended:
            yield _text(f"{name}_before"), {"source": source, "write": number, "until": step}
        for kind, name in _EDGES.items():
            edges = [edge for edge in self.edges.values() if isinstance(edge, kind)]
            if len(edges) <= FEW:
                yield from ((_text(name), self._columns(edge)) for edge in edges)
            else:
                rows = [self._columns(edge) | _numbers(edge, entities) for edge in edges]
                yield from _rows(f"{name}_many", begun | hashed, map(_short, rows), MANY_EDGES)

    def _columns(self, edge: Edge) -> dict[str, Any]:
        values = msgspec.structs.asdict(edge)
        if isinstance(edge, SightingRow):
            del values["box"]
            values |= edge.box._asdict()
        if isinstance(edge, RelationRow):
            values["whom"] = name_of(edge.target)
        until = self.until.get(edge.write, ALWAYS)
        return {**values, "current": until == ALWAYS, "until": until, "who": name_of(edge.source)}


def _short(edge: Mapping[str, Any]) -> dict[str, Any]:
    """Without what is said once for all edges, or by their numbers: each column costs the engine time."""
    return {name: value for name, value in edge.items() if name not in ("episode", "source", "target")}


def _numbers(edge: Edge, entities: Mapping[str, EntityRow]) -> dict[str, int]:
    """The numbers of the edge's ends in their episode; that of an observation is in its name."""
    target = name_of(edge.target)
    number = entities[target].number if isinstance(edge, RelationRow) else int(target.removeprefix("o"))
    return {"source_number": entities[name_of(edge.source)].number, "target_number": number}


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
    return _rows("write", {"episode": episode}, lines)


def _rows(
    name: str, given: Mapping[str, Any], rows: Iterable[Mapping[str, Any]], most: int = MANY
) -> Iterator[Statement]:
    """Statements that make rows, `most` of them at a time."""
    left = iter(rows)
    while some := list(islice(left, most)):
        yield _text(name), {**given, "rows": some}


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
