"""Rows of one episode in the world tables, made by applying its writes in order.

A run applies each write when it is made, and adds its rows to the graph by the statements of `queries/world/`. A replay
applies a whole record and returns all rows, also of calls and bindings, which an agent does not read.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.queries.beliefs.graph import Statement
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.beliefs import (
    WORLD_NODES,
    WORLD_RELS,
    EntityRow,
    Fact,
    HypothesisRow,
    LookRow,
    SlotRow,
    episode_hash,
    episode_key,
)
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import row_schema

Node = LookRow | EntityRow | SlotRow | HypothesisRow
"""Row of a node that belongs to an episode."""

_NODES: Final = {"slots": ("Slot", "Asks"), "looks": ("Look", "Made"), "entities": ("Entity", "Holds"),
                 "hypotheses": ("Hypothesis", "Ranks")}  # fmt: skip
"""Tables of nodes, and of the edges that lead to them, by the field of a fact."""

_EDGES: Final = {"listed": "Listed", "sighted": "Sighted", "has": "Has", "related": "Related"}
"""Tables of edges, by the field of a fact."""

_HASHED: Final = ("Slot", "Look", "Entity")
_COLUMN: Final = re.compile(r"\br\.(\w+)")


class EpisodeRows:
    """Nodes of one episode by key, and the number of its writes.

    Attributes:
        run: Id of the run.
        question: Id of the question.
        key: Key of the episode.
        written: Number of writes so far.
        nodes: Nodes by key.
        facts: Facts of the writes so far, if they are kept for `tables`.
    """

    def __init__(self, run: str, question: str) -> None:
        self.run, self.question = run, question
        self.key = episode_key(run, question)
        self.written = 0
        self.nodes: dict[str, Node] = {}
        self.facts: list[Fact] = []

    def apply(self, number: int, fact: Fact | None) -> None:
        """Take the next write.

        Args:
            number: Index of the write.
            fact: Rows that the write adds, or None.

        Raises:
            StoreError: If no run can have made the write: it is not the next one, it adds a node twice, or an edge has
                no nodes at its ends.
        """
        if number != self.written:
            raise self._broken(f"has no write {self.written}, or has it twice")
        self.written += 1
        start = fact and fact.episode
        if (start and (start.id, start.run)) != ((self.key, self.run) if number == 0 else None):
            raise self._broken("does not begin as its own")
        if fact is None:
            return
        for field in _NODES:
            for node in getattr(fact, field):
                if node.id in self.nodes or node.episode != self.key or not node.id.startswith(f"{self.key}/"):
                    raise self._broken(f"adds {node.id[:80]!r} twice, or for another episode")
                self.nodes[node.id] = node
        for field in _EDGES:
            for edge in getattr(fact, field):
                source, target = self.nodes.get(edge.source), self.nodes.get(edge.target)
                begins = edge.source == self.key if field == "listed" else isinstance(source, EntityRow)
                ends = isinstance(target, EntityRow if field == "related" else LookRow)
                if not (begins and ends) or edge.episode != self.key or edge.write != number:
                    raise self._broken(f"adds an edge in write {number} between nodes that it does not have")
        self.facts.append(fact)

    def _broken(self, why: str) -> StoreError:
        return StoreError(f"the record of episode {self.key[:120]} {why}: evaluate its run again")

    def tables(self, facts: Sequence[Fact]) -> dict[str, list[tuple[Any, ...]]]:
        """Return all rows except `Write` rows, by table, as tuples in the order of the table's columns."""
        rows: dict[str, list[tuple[Any, ...]]] = defaultdict(list)
        for fact in facts:
            if fact.episode is not None:
                rows["Episode"].append(msgspec.structs.astuple(fact.episode))
            for field, (table, edges) in _NODES.items():
                hashed = (episode_hash(self.key),) if table in _HASHED else ()
                for node in getattr(fact, field):
                    rows[table].append((*msgspec.structs.astuple(node), *hashed))
                    rows[edges].append((self.key, node.id))
            for field, table in _EDGES.items():
                rows[table] += map(msgspec.structs.astuple, getattr(fact, field))
        return rows

    # -- new rows, as statements --------------------------------------------------------------------------------------

    def statements(self, facts: Sequence[Fact]) -> Iterator[Statement]:
        """Yield the statements that add the rows of the newest writes, nodes before edges.

        An agent reads no `Write` and no `Hypothesis`, so only a replay adds these.
        """
        rows = self.tables(facts)
        for table in filter(rows.get, ("Episode", "Slot", "Look", "Entity", *_EDGES.values())):
            text = read_statement(f"world/{table.lower()}.cypher")
            # Each column costs time, so a row has only the columns that the statement names.
            columns = set(_COLUMN.findall(text))
            full = (self._numbered(dict(zip(world_schema(table).names, row, strict=True))) for row in rows[table])
            named = [{column: row[column] for column in columns} for row in full]
            values = {"episode": self.key, "hash": episode_hash(self.key), "rows": named}
            yield text, {name: values[name] for name in parameters(text)}

    def _numbered(self, row: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the row of an edge with the numbers of its ends, by which statements find these nodes."""
        if "from" not in row:
            return row
        keys = {"source_number": row["from"], "target_number": row["to"]}
        numbers = {name: self.nodes[key].number for name, key in keys.items() if key in self.nodes}
        return {**row, **numbers, **(row["box"]._asdict() if "box" in row else {})}


@cache
def world_schema(table: str) -> pa.Schema:
    """Return the columns of a world table as COPY takes them: edges begin with the two keys `from` and `to`."""
    return row_schema(table, WORLD_NODES, WORLD_RELS)
