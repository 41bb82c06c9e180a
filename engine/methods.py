"""The methods by name, as `evaluate --method` knows them: the edge at which the engine meets the agents."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import pyarrow as pa

    from jrdb_avr.agent.client import Chat
    from jrdb_avr.agent.decode import Convention
    from jrdb_avr.agent.world import World
    from jrdb_avr.schema.method import Settled

METHODS: Final = (
    "monolithic",
    "chain-of-thought",
    "search-recognize",
    "react",
    "agent",
    "agent-passive",
    "agent-no-world",
    "agent-passive-no-world",
)

WORLD_METHODS: Final = ("agent", "agent-passive")
"""Those that keep a world model, and are given one."""


@contextlib.contextmanager
def open_world(path: Path, run_id: str, record: pa.Table) -> Iterator[World]:
    """A run's world model in the graph file at `path`, which is made if there is none; closed at the end of the block.

    record: the run's world rows so far; what the graph lacks of them is brought back first. Raises LockedError where
    another process has the graph open, StoreError where it cannot be opened.
    """
    from jrdb_avr.agent.world import World
    from jrdb_avr.queries.world import WorldGraph
    from jrdb_avr.queries.world_record import open_to_replay, restore_world

    with open_to_replay(path) as graph:
        restore_world(graph, run_id, record)
    with WorldGraph.open(path) as world:
        yield World(world, run_id)


def make_method(name: str, chat: Chat, convention: Convention, world: World | None = None) -> Settled:
    """The method of a name in `METHODS`; one of `WORLD_METHODS` is given its world model."""
    match name:
        case "monolithic":
            from jrdb_avr.agent.monolithic import Monolithic

            return Monolithic(chat, convention)
        case "chain-of-thought":
            from jrdb_avr.agent.chain_of_thought import ChainOfThought

            return ChainOfThought(chat, convention)
        case "search-recognize":
            from jrdb_avr.agent.search_recognize import SearchRecognize

            return SearchRecognize(chat, convention)
        case "react":
            from jrdb_avr.agent.react import ReAct

            return ReAct(chat, convention)
        case "agent" | "agent-passive":
            from jrdb_avr.agent.reference.method import ReferenceAgent

            if world is None:
                raise ValueError(f"the method {name!r} needs a world model")
            return ReferenceAgent(chat, convention, world, looks=name == "agent")
        case "agent-no-world" | "agent-passive-no-world":
            from jrdb_avr.agent.reference.method import ReferenceAgent

            return ReferenceAgent(chat, convention, looks=name == "agent-no-world")
        case _:
            raise ValueError(f"no method {name!r}")
