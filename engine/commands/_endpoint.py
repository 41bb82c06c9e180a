"""Options of the commands that use a model's server."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Final, TypeVar

import click

from jrdb_avr.agent.model.conventions import DEFAULTS, RESPONSE_FORMATS, THINKING, Options

_C = TypeVar("_C", bound=Callable[..., Any])

base_url_option = click.option("--base-url", help="An OpenAI-compatible server, as http://localhost:8000/v1.")


def model_option(more: str = ".") -> Callable[[_C], _C]:
    """Add the required option `--model`."""
    return click.option(
        "--model", required=True, help=f"Model id to ask for; 'marker' is the built-in reader of marks{more}"
    )


_ENDPOINT: Final[tuple[tuple[str, str, click.ParamType[Any], str], ...]] = (
    (
        "--response-format",
        "response_format",
        click.Choice(RESPONSE_FORMATS),
        "How replies are made JSON: the schema itself, some JSON object, or the prompt alone.",
    ),
    (
        "--thinking",
        "thinking",
        click.Choice(THINKING),
        "Whether the model thinks before it replies; 'template' leaves it to the server.",
    ),
    ("--max-tokens", "max_tokens", click.IntRange(16, 1 << 20), "Longest reply, thinking included."),
    ("--timeout", "timeout_s", click.FloatRange(1, 86_400), "Seconds to wait for a reply."),
    (
        "--retries",
        "retries",
        click.IntRange(0, 100),
        "How often a call is repeated that the transport or the server broke.",
    ),
)


def endpoint_options(function: _C) -> _C:
    """Add the options of a model's server; the command gets them as one parameter `options`.

    A model without an address is a usage error, unless it is the built-in one or none.
    """

    @functools.wraps(function)
    def command(**values: Any) -> Any:
        options = Options(**{name: values.pop(name) for _, name, _, _ in _ENDPOINT})
        if math.isnan(options.timeout_s):
            raise click.UsageError("--timeout must be a number of seconds")
        if values["base_url"] is None and values["model"] not in ("marker", "none"):
            raise click.UsageError(f"--model {values['model']} needs --base-url, the address of the server that has it")
        return function(**values, options=options)

    decorated: Any = command
    for flag, name, kind, words in reversed(_ENDPOINT):
        default = getattr(DEFAULTS, name)
        decorated = click.option(flag, name, type=kind, default=default, show_default=True, help=words)(decorated)
    result: _C = decorated
    return result
