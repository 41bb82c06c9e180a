"""Statements that put a write of an agent into the world tables, and take an episode out of them.

The statements are the files of `queries/world/`; what goes where is said by the write's `Fact`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any, Final

import msgspec

from jrdb_avr.schema.world import ALWAYS, Fact, HasRow, RelatedRow, SightedRow, Write

from .world import Statement, WorldGraph


def write_statements(episode: str, made: Sequence[tuple[Write, Fact]]) -> list[Statement]:
    """What makes writes of an episode true in the tables: their facts in order, then their lines of the record."""
    facts = [statement for write, fact in made for statement in _fact_statements(episode, write, fact)]
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
    return [*facts, (_text("write"), {"episode": episode, "writes": lines})]


def _fact_statements(episode: str, write: Write, fact: Fact) -> list[Statement]:
    statements: list[Statement] = []

    def add(name: str, /, **params: Any) -> None:
        statements.append((_text(name), params))

    if fact.episode is not None:
        if write.tool == "begin":
            add("begin", **msgspec.structs.asdict(fact.episode))
        else:
            add("plan", id=fact.episode.id, plan=fact.episode.plan)
    if fact.slots:
        add("slots", episode=episode, slots=[msgspec.structs.asdict(slot) for slot in fact.slots])
    if fact.observation is not None:
        add("observation", **msgspec.structs.asdict(fact.observation))
    for freed in fact.freed:
        add("freed", id=freed)
    if fact.entity is not None:
        add("entity", **msgspec.structs.asdict(fact.entity))
    if fact.changed is not None:
        add("changed", id=fact.changed.id, kind=fact.changed.kind, node=fact.changed.node)
    edges: tuple[tuple[str, SightedRow | HasRow | RelatedRow | None], ...] = (
        ("sighted", fact.sighted),
        ("has", fact.has),
        ("related", fact.related),
    )
    for name, edge in edges:
        if edge is not None:
            # An edge that holds both ways may have been written the other way round.
            sources = (edge.source, edge.target) if name == "related" else (edge.source,)
            for replaced in fact.replaced:
                for source in sources:
                    add(f"{name}_before", source=source, write=replaced, until=write.step)
            add(name, **_columns(edge), until=ALWAYS)
    return statements


def _columns(edge: SightedRow | HasRow | RelatedRow) -> dict[str, Any]:
    values = msgspec.structs.asdict(edge)
    if isinstance(edge, SightedRow):
        del values["box"]
        values |= edge.box._asdict()
    return values


DROPPED: Final = ("entity", "observation", "slot", "write", "episode")


def drop_episode(graph: WorldGraph, episode: str) -> None:
    """Take an episode and all that it holds out of the tables, if it is there. Raises as `WorldGraph.write`."""
    if graph.query(_text("there"), {"episode": episode})["episodes"][0].as_py():
        graph.write([(_text(f"drop_{name}"), {"episode": episode}) for name in DROPPED])


@cache
def _text(name: str) -> str:
    """The text of `queries/world/<name>.cypher`."""
    return resources.files("jrdb_avr.queries").joinpath("world", f"{name}.cypher").read_text("utf-8")
