"""Options of a model's server, and the parts of a request that depend on these options."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal, get_args

from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.prices import Price
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.option import Options, option

ResponseFormat = Literal["json_schema", "json_object", "none"]
Thinking = Literal["off", "on", "template"]
TokenParameter = Literal["auto", "max_tokens", "max_completion_tokens"]

AUTO: Final = "auto"

_OWNED: Final = frozenset(
    ("model", "messages", "stream", "n", "temperature", "max_tokens", "max_completion_tokens", "response_format")
)
"""Keys that `extra_body` must not hold, because the program sets them."""

_HEADER: Final = re.compile(r"[A-Za-z0-9!#$%&'*+.^_`|~-]+")
_OWN_HEADERS: Final = ("content-type", "content-length", "host", "accept-encoding", "transfer-encoding", "connection")


@dataclass(frozen=True)
class EndpointOptions(Options):
    """Options of a model's server and of its requests.

    The manifest of a run stores the options. A resumed run must have the same options, except for the address, the keys
    and the limits. The object holds no key, only the name of the environment variable with the key.

    Raises:
        InputError: If a value cannot be sent in a request, or if values contradict each other.
    """

    base_url: str | None = option(None, "Address of an OpenAI-compatible server, such as http://localhost:8000/v1.")
    simulated: bool = option(
        False,
        "Declare that the model is simulated: each picture of a request then says which frame and angle it shows. The "
        "run is synthetic. Models named simulated or simulated:PROFILE need no declaration.",
    )
    response_format: ResponseFormat = option(
        "json_schema",
        "How requests demand JSON. 'json_schema': by the JSON schema of the reply. 'json_object': by the mode for JSON "
        "objects, without a schema. 'none': only by the text of the prompt.",
        choices=get_args(ResponseFormat),
    )
    thinking: Thinking = option(
        "off",
        "Whether the model thinks before it replies. 'template' keeps the default of the chat template.",
        choices=get_args(Thinking),
    )
    max_tokens: int = option(2048, "Maximum tokens of a reply, including thinking.", minimum=16, maximum=1 << 20)
    timeout_s: float = option(300.0, "Maximum seconds to wait for a reply.", flag="timeout", minimum=1, maximum=86_400)
    retries: int = option(4, "Maximum repetitions of a request after network or server errors.", minimum=0, maximum=100)
    temperature: float | None = option(0, "Sampling temperature. 'none' keeps the default of the server.")
    token_parameter: TokenParameter = option(
        AUTO,
        "Request key that holds --max-tokens. 'auto' tries max_tokens first, then max_completion_tokens.",
        choices=get_args(TokenParameter),
    )
    delimiters: tuple[str, ...] = option(
        (),
        "OPEN...CLOSE around thinking in replies, or TEXT beside an answer. May be repeated.",
        flag="delimiter",
    )
    extra_body: Mapping[str, Any] = option({}, "JSON object with keys to add to every request.")
    headers: Mapping[str, str] = option(
        {}, "Header of every request. The environment variable ENV holds its value. May be repeated.", flag="header"
    )
    api_key_env: str = option("OPENAI_API_KEY", "Environment variable that holds the key of the server.")
    rpm: int | None = option(None, "Maximum number of requests per minute.", minimum=1)
    tpm: int | None = option(None, "Maximum tokens per minute, for prompts and replies together.", minimum=1)
    price: Price | None = option(
        None,
        "TOML file of prices. Each model has a table with the keys input and output: dollars per million tokens.",
        flag="prices",
    )
    max_cost: float | None = option(
        None,
        "Stop the run when its calls have cost this much by --prices. Requests in progress may add to the cost. To "
        "go on, use --resume with a higher maximum. Earlier costs then count too, except for replies that were cut off "
        "or refused.",
        minimum=0,
        metavar="DOLLARS",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.temperature is not None and not 0 <= self.temperature < math.inf:
            raise InputError("--temperature is a number from 0, or none", field="temperature")
        for key in _OWNED & self.extra_body.keys():
            raise InputError(f"--extra-body must not hold {key!r}: leave it out or give its option", field="extra_body")
        if not all(text.partition("...")[0] for text in self.delimiters):
            raise InputError("--delimiter is OPEN...CLOSE, or a text beside an answer", field="delimiters")
        for name in self.headers:
            if not _HEADER.fullmatch(name) or name.lower() in _OWN_HEADERS:
                raise InputError(f"--header {name!a}: no header of this name can be set", field="headers")
        if self.max_cost is not None and (self.price is None or not self.max_cost > 0):
            raise InputError("--max-cost is a number above 0, and needs the price: --prices FILE", field="max_cost")

    def settings(self, convention: Convention) -> dict[str, Any]:
        """Return the options as plain JSON for the manifest of a run. The address of the server is left out.

        Args:
            convention: The convention of the model.

        Returns:
            The options by name. The key `chat_template_kwargs` holds the arguments of the chat template.
        """
        settings = {name: value for name, value in asdict(self).items() if name != "base_url"}
        return settings | {"delimiters": [*self.delimiters], "chat_template_kwargs": self.template(convention)}

    def request(self, model: str, convention: Convention, schema: Mapping[str, Any] | None) -> dict[str, Any]:
        """Return the body of a request without its messages.

        Args:
            model: The id of the model.
            convention: The convention of the model.
            schema: The JSON schema of the reply. None if the reply is free text.

        Returns:
            The values of the body by key. If `token_parameter` is "auto", the token limit has the key `max_tokens`.
        """
        name = "max_tokens" if self.token_parameter == AUTO else self.token_parameter
        request: dict[str, Any] = {"model": model}
        if self.temperature is not None:
            # Finished calls are looked up by the bytes of the request, so 0 and 0.0 must give the same bytes.
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

    def delimited(self, convention: Convention) -> Convention:
        """Add the delimiters of the options to a convention.

        Args:
            convention: The convention of the model.

        Returns:
            The convention with all delimiters.
        """
        pairs = [text.partition("...")[::2] for text in self.delimiters]
        thinking = [(opening, closing) for opening, closing in pairs if closing]
        around = [opening for opening, closing in pairs if not closing]
        return replace(convention, thinking=(*convention.thinking, *thinking), around=(*convention.around, *around))

    def thinks(self, convention: Convention) -> bool | None:
        """Return whether the options or the convention declare that replies hold thinking.

        Args:
            convention: The convention of the model.

        Returns:
            The declared value, or None if `thinking` is "template" and the convention declares nothing.
        """
        return convention.thinks if self.thinking == "template" else self.thinking == "on"

    def template(self, convention: Convention) -> dict[str, Any]:
        """Return the `chat_template_kwargs` of a request.

        Args:
            convention: The convention of the model.

        Returns:
            The arguments by name. They are empty if the chat template has no switch for thinking, or if the
            switch is not needed, because the template already does by default what the option `thinking` requests.
        """
        thinks = self.thinking == "on"
        changes = convention.switches and self.thinking != "template" and convention.thinks != thinks
        return {"enable_thinking": thinks} if changes else {}


DEFAULTS: Final = EndpointOptions()
