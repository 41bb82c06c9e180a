"""Options of a model's server, and the parts of a request that follow from them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, get_args

from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.prices import Price
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.option import option

ResponseFormat = Literal["json_schema", "json_object", "none"]
Thinking = Literal["off", "on", "template"]
TokenParameter = Literal["auto", "max_tokens", "max_completion_tokens"]

AUTO: Final = "auto"

_OWNED: Final = frozenset(
    ("model", "messages", "stream", "n", "temperature", "max_tokens", "max_completion_tokens", "response_format")
)
"""Keys of a request that an extra body must not hold."""

_HEADER: Final = re.compile(r"[A-Za-z0-9!#$%&'*+.^_`|~-]+")
_OWN_HEADERS: Final = ("content-type", "content-length", "host", "accept-encoding", "transfer-encoding", "connection")


@dataclass(frozen=True)
class EndpointOptions:
    """Options of a model's server and of its requests.

    The manifest of a run stores them, and a resumed run needs equal ones, except for the address, the keys and the
    limits. The class holds names of environment variables in place of keys.

    Raises:
        InputError: No request can have these values.
    """

    base_url: str | None = option(None, "Address of an OpenAI-compatible server, such as http://localhost:8000/v1.")
    response_format: ResponseFormat = option(
        "json_schema",
        "How replies become JSON: by the schema itself, by a promise of some JSON object, or by the prompt alone.",
        choices=get_args(ResponseFormat),
    )
    thinking: Thinking = option(
        "off",
        "Whether the model thinks before it replies; 'template' leaves this to the server.",
        choices=get_args(Thinking),
    )
    max_tokens: int = option(2048, "Maximum tokens of a reply, thinking included.", minimum=16, maximum=1 << 20)
    timeout_s: float = option(300.0, "Seconds to wait for a reply.", flag="timeout", minimum=1, maximum=86_400)
    retries: int = option(4, "Repetitions of a call that the transport or the server broke.", minimum=0, maximum=100)
    temperature: float | None = option(0, "Sampling temperature; 'none' leaves it to the server.")
    token_parameter: TokenParameter = option(
        AUTO,
        "Name of the reply limit in a request; 'auto' takes the newer name if the server refuses the older.",
        choices=get_args(TokenParameter),
    )
    extra_body: Mapping[str, Any] = option({}, "Further keys of every request, as a JSON object.")
    headers: Mapping[str, str] = option(
        {}, "A header of every request, with its value in an environment variable. May be repeated.", flag="header"
    )
    api_key_env: str = option("OPENAI_API_KEY", "Environment variable that holds the key.")
    rpm: int | None = option(None, "Maximum requests per minute.", minimum=1)
    tpm: int | None = option(None, "Maximum tokens per minute, read and written.", minimum=1)
    price: Price | None = option(
        None,
        "TOML file of prices: a table per model with input and output, in dollars per million tokens.",
        flag="prices",
    )
    max_cost: float | None = option(
        None,
        "Stop when the calls of the run have cost this much, by --prices; --resume with a higher maximum continues. "
        "Calls in flight may exceed it. --resume does not count replies that were cut off or refused.",
        minimum=0,
        metavar="DOLLARS",
    )

    def __post_init__(self) -> None:
        if self.temperature is not None and not 0 <= self.temperature < math.inf:
            raise InputError("--temperature is a number from 0, or none", field="temperature")
        for key in _OWNED & self.extra_body.keys():
            raise InputError(f"--extra-body must not hold {key!r}: leave it out or give its option", field="extra_body")
        for name in self.headers:
            if not _HEADER.fullmatch(name) or name.lower() in _OWN_HEADERS:
                raise InputError(f"--header {name!a}: no header of this name can be set", field="headers")
        if math.isnan(self.timeout_s):
            raise InputError("--timeout is a number of seconds", field="timeout_s")
        if self.max_cost is not None and (self.price is None or not self.max_cost > 0):
            raise InputError("--max-cost is a number above 0, and needs the price: --prices FILE", field="max_cost")

    def settings(self, convention: Convention) -> dict[str, Any]:
        """Return the options without the address, as plain JSON for the manifest of a run.

        Args:
            convention: The convention of the model.

        Returns:
            The options by name, and the `chat_template_kwargs` that are sent.
        """
        settings = {name: value for name, value in asdict(self).items() if name != "base_url"}
        return settings | {"chat_template_kwargs": self.template(convention)}

    def request(self, model: str, convention: Convention, schema: Mapping[str, Any] | None) -> dict[str, Any]:
        """Return a request without its messages.

        Args:
            model: The id of the model.
            convention: The convention of the model.
            schema: The JSON schema of the reply, if any.

        Returns:
            The request. If `token_parameter` is "auto", the key of the reply limit is `max_tokens`.
        """
        name = "max_tokens" if self.token_parameter == AUTO else self.token_parameter
        request: dict[str, Any] = {"model": model}
        if self.temperature is not None:
            # A call is stored under the bytes of its request, so 0 and 0.0 must be equal there.
            whole = int(self.temperature) == self.temperature
            request["temperature"] = int(self.temperature) if whole else self.temperature
        request[name] = self.max_tokens
        if template := self.template(convention):
            request["chat_template_kwargs"] = template
        request |= self.extra_body
        if schema is not None and self.response_format != "none":
            request["response_format"] = {"type": self.response_format}
            if self.response_format == "json_schema":
                form = {"name": "reply", "schema": dict(schema), "strict": True}
                request["response_format"]["json_schema"] = form
        return request

    def thinks(self, convention: Convention) -> bool | None:
        """Return whether replies are declared to hold thinking.

        Args:
            convention: The convention of the model.

        Returns:
            The declared value, or None if the model declares nothing.
        """
        return convention.thinks if self.thinking == "template" else self.thinking == "on"

    def template(self, convention: Convention) -> dict[str, Any]:
        """Return the `chat_template_kwargs` of a request.

        Args:
            convention: The convention of the model.

        Returns:
            The arguments, empty if the template does the same by default.
        """
        thinks = self.thinking == "on"
        changes = convention.switches and self.thinking != "template" and convention.thinks != thinks
        return {"enable_thinking": thinks} if changes else {}


DEFAULTS: Final = EndpointOptions()
