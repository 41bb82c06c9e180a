"""Request settings of a model's server, and the request that they make.

They are part of a run's manifest and never change while it runs. Of keys and headers they hold the names of environment
variables, never the values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal, get_args

from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.prices import Price
from jrdb_avr.schema.errors import InputError

ResponseFormat = Literal["json_schema", "json_object", "none"]
Thinking = Literal["off", "on", "template"]
TokenParameter = Literal["auto", "max_tokens", "max_completion_tokens"]

RESPONSE_FORMATS: Final[tuple[ResponseFormat, ...]] = get_args(ResponseFormat)
THINKING: Final[tuple[Thinking, ...]] = get_args(Thinking)
TOKEN_PARAMETERS: Final[tuple[TokenParameter, ...]] = get_args(TokenParameter)

KEY_VARIABLE: Final = "OPENAI_API_KEY"
AUTO: Final = "auto"

_OWNED: Final = {
    "model": "--model",
    "messages": "",
    "stream": "",
    "n": "",
    "temperature": "--temperature",
    "max_tokens": "--max-tokens",
    "max_completion_tokens": "--max-tokens and --token-parameter",
    "response_format": "--response-format",
}
"""Keys of a request that an extra body may not hold, and the option that sets each."""

_HEADER: Final = re.compile(r"[A-Za-z0-9!#$%&'*+.^_`|~-]+")
_OWN_HEADERS: Final = ("content-type", "content-length", "host", "accept-encoding", "transfer-encoding", "connection")


@dataclass(frozen=True)
class Options:
    """Request settings of a server, stored in a run's manifest and never changed while it runs.

    `response_format`: what makes the reply JSON: the schema itself, the promise of some JSON object, or the prompt
    alone. `thinking`: off or on, or as the server's template has it. `max_tokens` bounds a reply, thinking included;
    `token_parameter` is its name in the request, "auto" the one that the server takes. `temperature`: None sends none.
    `extra_body`: further keys of every request. `timeout_s` bounds each wait for a reply; `retries` is how often a
    broken try is repeated. `headers`: names of further headers and of the environment variables that hold their values;
    `api_key_env`: that of the key. `rpm`, `tpm`: most requests and tokens a minute. `price` in dollars, and `max_cost`,
    at which a run stops. Raises InputError for values that no request can have.
    """

    response_format: ResponseFormat = "json_schema"
    thinking: Thinking = "off"
    max_tokens: int = 2048
    timeout_s: float = 300.0
    retries: int = 4
    temperature: float | None = 0
    token_parameter: TokenParameter = AUTO
    extra_body: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    api_key_env: str = KEY_VARIABLE
    rpm: int | None = None
    tpm: int | None = None
    price: Price | None = None
    max_cost: float | None = None

    def __post_init__(self) -> None:
        if self.temperature is not None and not 0 <= self.temperature < math.inf:
            raise InputError("--temperature is a number from 0, or none", field="temperature")
        for key in self.extra_body:
            if key in _OWNED:
                raise InputError(
                    f"--extra-body must not hold {key!r}" + (f": give {_OWNED[key]}" if _OWNED[key] else ""),
                    field="extra_body",
                )
        for name in self.headers:
            if not _HEADER.fullmatch(name) or name.lower() in _OWN_HEADERS:
                raise InputError(f"--header {name!a}: no header of this name can be set", field="headers")
        if self.max_cost is not None and self.price is None:
            raise InputError("--max-cost needs the model's price: name it in a file, --prices FILE", field="max_cost")

    @property
    def names_itself(self) -> bool:
        """Whether the client finds the name of the reply's limit."""
        return self.token_parameter == AUTO

    def settings(self, convention: Convention) -> dict[str, Any]:
        """The options in a run's manifest, as plain JSON."""
        return asdict(self) | {"chat_template_kwargs": self.template(convention)}

    def request(self, model: str, convention: Convention, schema: Mapping[str, Any] | None) -> dict[str, Any]:
        """A request without its messages. The limit of a reply is called `max_tokens` where the name is "auto"."""
        name = "max_tokens" if self.names_itself else self.token_parameter
        request: dict[str, Any] = {"model": model}
        if self.temperature is not None:
            # Whole numbers as such: a call is stored under the bytes of its request.
            whole = int(self.temperature) == self.temperature
            request["temperature"] = int(self.temperature) if whole else self.temperature
        request[name] = self.max_tokens
        if template := self.template(convention):
            request["chat_template_kwargs"] = template
        return request | dict(self.extra_body) | ({} if schema is None else self.response(schema))

    def thinks(self, convention: Convention) -> bool | None:
        """Whether replies are declared to hold thinking; None where nothing is declared."""
        return convention.thinks if self.thinking == "template" else self.thinking == "on"

    def template(self, convention: Convention) -> dict[str, Any]:
        """The request's `chat_template_kwargs`: sent only where they change what the template does by itself."""
        thinks = self.thinking == "on"
        changes = convention.switches and self.thinking != "template" and convention.thinks != thinks
        return {"enable_thinking": thinks} if changes else {}

    def response(self, schema: Mapping[str, Any]) -> dict[str, Any]:
        """The request's `response_format` for a schema; empty where none is sent."""
        if self.response_format == "none":
            return {}
        form: dict[str, Any] = {"type": self.response_format}
        if self.response_format == "json_schema":
            form["json_schema"] = {"name": "reply", "schema": dict(schema), "strict": True}
        return {"response_format": form}


DEFAULTS: Final = Options()
