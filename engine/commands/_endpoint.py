"""Options of the commands that use a model's server."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Final, TypeVar

import click

from jrdb_avr.agent.model.conventions import DEFAULTS, RESPONSE_FORMATS, THINKING, Options

_C = TypeVar("_C", bound=Callable[..., Any])

_REQUEST: Final[dict[str, tuple[str, click.ParamType[Any], str]]] = {
    "response_format": (
        "--response-format",
        click.Choice(RESPONSE_FORMATS),
        "How replies are made JSON: the schema itself, some JSON object, or the prompt alone.",
    ),
    "thinking": (
        "--thinking",
        click.Choice(THINKING),
        "Whether the model thinks before it replies; 'template' leaves it to the server.",
    ),
    "max_tokens": ("--max-tokens", click.IntRange(16, 1 << 20), "Longest reply, thinking included."),
    "timeout_s": ("--timeout", click.FloatRange(1, 86_400), "Seconds to wait for a reply."),
    "retries": (
        "--retries",
        click.IntRange(0, 100),
        "How often a call is repeated that the transport or server broke.",
    ),
}
"""Per field of `Options`: its flag, its type and its help."""


def endpoint_options(optional: bool = False) -> Callable[[_C], Callable[..., Any]]:
    """Add the options of a model's server; the command gets `model`, `base_url`, and all others as one `options`.

    A model without an address is a usage error, unless it is the built-in one or, where a model is `optional`, none.
    """
    models = ", 'none' for a method of your own without any." if optional else "."
    server = [
        click.option(
            "--model",
            required=True,
            help=f"Id of the model; 'simulated:PROFILE' is the built-in one, and 'marker' its perfect profile{models}",
        ),
        click.option("--base-url", help="An OpenAI-compatible server, as http://localhost:8000/v1."),
    ]
    request = [
        click.option(flag, name, type=kind, default=getattr(DEFAULTS, name), show_default=True, help=text)
        for name, (flag, kind, text) in _REQUEST.items()
    ]

    def decorate(function: _C) -> Callable[..., Any]:
        @functools.wraps(function)
        def command(**values: Any) -> Any:
            options = Options(**{name: values.pop(name) for name in _REQUEST})
            if math.isnan(options.timeout_s):
                raise click.UsageError("--timeout must be a number of seconds")
            from jrdb_avr.agent.simulated.knobs import profile_of
            from jrdb_avr.schema.errors import InputError

            model = values["model"]
            try:
                simulated = profile_of(model) is not None
            except InputError as error:
                raise click.UsageError(str(error)) from None
            if values["base_url"] is None and not simulated and not (optional and model == "none"):
                raise click.UsageError(f"--model {model} needs --base-url, the address of the server that has it")
            return function(**values, options=options)

        return functools.reduce(lambda inner, option: option(inner), reversed(server + request), command)

    return decorate
