"""Rows of one episode in the world tables, made by applying its writes in order.

A run applies each write as it is made and puts the new rows into the graph by statements (the files of
`queries/world/`); a replay applies a whole record and hands over all rows. So both come to the same tables.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.queries.beliefs.graph import Statement
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.beliefs import (
    ALWAYS,
    WORLD_NODES,
    WORLD_RELS,
    AttributeRow,
    EntityRow,
    EpisodeRow,
    Fact,
    HypothesisRow,
    ObservationRow,
    RelationRow,
    SightingRow,
    SlotRow,
    Write,
    episode_hash,
    episode_key,
)
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import row_schema

Edge = SightingRow | AttributeRow | RelationRow

_TABLES: Final[Mapping[type[Edge], str]] = {SightingRow: "Sighted", AttributeRow: "Has", RelationRow: "Related"}
_COLUMN: Final = re.compile(r"\br\.(\w+)")


class EpisodeRows:
    """The rows of one episode: nodes by key, edges by the write that made them, and from which step on an edge is not
    current.
    """

    def __init__(self, run: str, question: str) -> None:
        self.run, self.question = run, question
        self.key = episode_key(run, question)
        self.written = 0
        self.begun: EpisodeRow | None = None
        self.slots: dict[str, SlotRow] = {}
        self.observations: dict[str, ObservationRow] = {}
        self.entities: dict[str, EntityRow] = {}
        self.hypotheses: dict[str, HypothesisRow] = {}
        self.edges: dict[int, Edge] = {}
        self.until: dict[int, int] = {}

    def apply(self, number: int, step: int, fact: Fact | None) -> None:
        """Take the next write. Raises StoreError for one that no run can have made: not the next, a row that is there
        already, or a change of what is not there.
        """
        if number != self.written:
            raise self._broken(f"has no write {self.written}, or has it twice")
        self.written += 1
        if number == 0 and (fact is None or fact.episode is None):
            raise self._broken("does not begin as its own")
        if fact is None:
            return
        self.begun = fact.episode or self.begun
        for slot in fact.slots:
            self._add(self.slots, slot)
        for hypothesis in fact.hypotheses:
            self._add(self.hypotheses, hypothesis)
        if fact.observation is not None:
            self._add(self.observations, fact.observation)
        for freed in fact.freed:
            if freed not in self.entities:
                raise self._broken(f"frees {freed[:80]!r}, which it does not hold")
            self.entities[freed] = msgspec.structs.replace(self.entities[freed], node="")
        if fact.entity is not None:
            self._add(self.entities, fact.entity)
        if fact.changed is not None:
            if fact.changed.id not in self.entities:
                raise self._broken(f"changes {fact.changed.id[:80]!r}, which it does not hold")
            self.entities[fact.changed.id] = fact.changed
        edges = [edge for edge in (fact.sighted, fact.has, fact.related) if edge is not None]
        if len(edges) > 1 or any(edge.write != number for edge in edges):
            raise self._broken(f"makes an edge in write {number} that is not its own")
        for edge in edges:
            self.edges[number] = edge
        for replaced in fact.replaced:
            if replaced not in self.edges:
                raise self._broken(f"replaces write {replaced}, which made nothing")
            self.until[replaced] = step

    def _add(self, rows: dict[str, Any], row: ObservationRow | EntityRow | SlotRow | HypothesisRow) -> None:
        if row.id in rows:
            raise self._broken(f"makes {row.id[:80]!r} twice")
        rows[row.id] = row

    # -- all rows -----------------------------------------------------------------------------------------------------

    def add_to(self, tables: Mapping[str, list[tuple[Any, ...]]]) -> None:
        """Append all rows but the writes' to lists by table, as tuples in the order of its columns. Raises StoreError
        where one is of another episode, or an edge leads to nothing.
        """
        begun = self.begun
        if begun is None or (begun.id, begun.run, begun.question) != (self.key, self.run, self.question):
            raise self._broken("does not begin as its own")
        tables["Episode"].append(msgspec.structs.astuple(begun))
        nodes: tuple[tuple[str, str, Mapping[str, Any], tuple[str, ...]], ...] = (
            ("Observation", "Made", self.observations, (episode_hash(self.key),)),
            ("Entity", "Holds", self.entities, (episode_hash(self.key),)),
            ("Slot", "Asks", self.slots, ()),
            ("Hypothesis", "Ranks", self.hypotheses, ()),
        )
        for node, edge, rows, hashed in nodes:
            for key, row in rows.items():
                if row.episode != self.key or not key.startswith(f"{self.key}/"):
                    raise self._broken(f"holds {key[:80]!r} of another episode")
                tables[node].append((*msgspec.structs.astuple(row), *hashed))
                tables[edge].append((self.key, key))
        for number, made in self.edges.items():
            targets = self.entities if isinstance(made, RelationRow) else self.observations
            if made.episode != self.key or made.source not in self.entities or made.target not in targets:
                raise self._broken(f"makes an edge in write {number} between what it does not hold")
            tables[_TABLES[type(made)]].append(self._edge(number))

    def _edge(self, number: int) -> tuple[Any, ...]:
        edge, until = self.edges[number], self.until.get(number, ALWAYS)
        ends = [self.entities[edge.source].name]
        if isinstance(edge, RelationRow):
            ends.append(self.entities[edge.target].name)
        return (*msgspec.structs.astuple(edge), until == ALWAYS, until, *ends)

    def _broken(self, why: str) -> StoreError:
        return StoreError(f"the record of episode {self.key[:120]} {why}: evaluate its run again")

    # -- new rows, as statements --------------------------------------------------------------------------------------

    def statements(self, made: Sequence[tuple[Write, Fact]]) -> Iterator[Statement]:
        """Statements that put the rows made by the newest accepted writes into the tables, nodes before edges."""
        assert self.begun is not None
        first, facts = made[0][0].number, [fact for _, fact in made]
        if first == 0:
            yield read_statement("world/begin.cypher"), msgspec.structs.asdict(self.begun)
        elif any(fact.episode for fact in facts):
            known = {"plan": self.begun.plan, "verdict": self.begun.verdict}
            yield read_statement("world/episode.cypher"), {"id": self.key, **known}
        new = dict.fromkeys(fact.entity.id for fact in facts if fact.entity is not None)
        older = [fact.changed.id for fact in facts if fact.changed is not None]
        older += [key for fact in facts for key in fact.freed]
        yield from self._rows("slot", [msgspec.structs.asdict(slot) for fact in facts for slot in fact.slots])
        ranked = [msgspec.structs.asdict(one) for fact in facts for one in fact.hypotheses]
        yield from self._rows("hypothesis", ranked)
        looks = [fact.observation for fact in facts if fact.observation is not None]
        yield from self._rows("observation", [msgspec.structs.asdict(look) for look in looks])
        yield from self._rows("entity", [msgspec.structs.asdict(self.entities[key]) for key in new])
        for key in dict.fromkeys(older):
            if key not in new:
                changed = {"id": key, "kind": self.entities[key].kind, "node": self.entities[key].node}
                yield read_statement("world/changed.cypher"), changed
        for write, fact in made:
            for number in fact.replaced:
                if number < first:
                    edge = self.edges[number]
                    ended = {"source": edge.source, "write": number, "until": write.step}
                    yield read_statement(f"world/{_TABLES[type(edge)].lower()}_before.cypher"), ended
        for kind, table in _TABLES.items():
            edges = [number for number in range(first, self.written) if isinstance(self.edges.get(number), kind)]
            yield from self._rows(table.lower(), [self._edge_columns(table, number) for number in edges])

    def lines(self, writes: Sequence[Write]) -> Iterator[Statement]:
        """Statements that put writes' lines of the record into the tables, after what they made."""
        lines = [{f: getattr(write, f) for f in Write.__slots__} for write in writes]
        yield from self._rows("write", [line | {"id": f"{self.key}/{line['number']}"} for line in lines])

    def _edge_columns(self, table: str, number: int) -> dict[str, Any]:
        """An edge's row by column, with the sides of a box and the numbers of its ends in the episode."""
        row = dict(zip(world_schema(table).names, self._edge(number), strict=True))
        targets: Mapping[str, Any] = self.entities if table == "Related" else self.observations
        numbers = {"source_number": self.entities[row["from"]].number, "target_number": targets[row["to"]].number}
        return row | numbers | (row["box"]._asdict() if "box" in row else {})

    def _rows(self, name: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[Statement]:
        """The statement that makes rows, if there are any, of the columns that it names: each costs the engine time."""
        if not rows:
            return
        text = read_statement(f"world/{name}.cypher")
        columns = set(_COLUMN.findall(text))
        named = [{column: row[column] for column in columns} for row in rows]
        values = {"episode": self.key, "hash": episode_hash(self.key), "rows": named}
        yield text, {name: values[name] for name in parameters(text)}


@cache
def world_schema(table: str) -> pa.Schema:
    """The columns of a table of the world namespace as COPY takes them: edges begin with the two keys."""
    return row_schema(table, WORLD_NODES, WORLD_RELS)
