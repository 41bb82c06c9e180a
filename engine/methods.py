"""The methods by name, as `evaluate --method` knows them: the edge at which the engine meets the agents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from jrdb_avr.agent.client import Chat
    from jrdb_avr.agent.decode import Convention
    from jrdb_avr.schema.method import Settled

METHODS: Final = ("react",)


def make_method(name: str, chat: Chat, convention: Convention) -> Settled:
    """The method of a name in `METHODS`."""
    match name:
        case "react":
            from jrdb_avr.agent.react import ReAct

            return ReAct(chat, convention)
        case _:
            raise ValueError(f"no method {name!r}")
