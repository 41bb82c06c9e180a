"""What is set of an endpoint beside its address and model: part of a run's manifest, never changed while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from jrdb_avr.agent.model.conventions import Convention, ResponseFormat, Thinking

RESPONSE_FORMATS: Final[tuple[ResponseFormat, ...]] = ("json_schema", "json_object", "none")
THINKING: Final[tuple[Thinking, ...]] = ("off", "on", "template")


@dataclass(frozen=True)
class Options:
    """How a server is asked.

    `response_format`: what makes the reply JSON: the schema itself, the promise of some JSON object, or the prompt
    alone. `thinking`: off or on, or as the server's template has it. `max_tokens` bounds a reply, thinking included;
    `timeout_s` each wait for a reply; `retries` how often a broken try is repeated.
    """

    response_format: ResponseFormat = "json_schema"
    thinking: Thinking = "off"
    max_tokens: int = 2048
    timeout_s: float = 300.0
    retries: int = 4

    def settings(self) -> dict[str, Any]:
        """The options as plain JSON."""
        return asdict(self)

    def thinks(self, convention: Convention) -> bool | None:
        """Whether replies are declared to hold thinking; None where nothing is declared."""
        return convention.thinks if self.thinking == "template" else self.thinking == "on"

    def template(self, convention: Convention) -> Mapping[str, Any]:
        """The request's `chat_template_kwargs`: sent only where they change what the template does by itself."""
        if self.thinking == "template" or convention.thinks == (self.thinking == "on"):
            return {}
        return convention.switch.get(self.thinking, {})

    def response(self, schema: Mapping[str, Any]) -> dict[str, Any]:
        """The request's `response_format` for a schema; empty where none is sent."""
        match self.response_format:
            case "json_schema":
                named = {"name": "reply", "schema": dict(schema), "strict": True}
                return {"response_format": {"type": "json_schema", "json_schema": named}}
            case "json_object":
                return {"response_format": {"type": "json_object"}}
            case "none":
                return {}


DEFAULTS: Final = Options()
