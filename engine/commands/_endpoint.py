"""Options of the commands that ask a model."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import click

from jrdb_avr.agent.model.options import DEFAULTS, RESPONSE_FORMATS, THINKING, Options

C = TypeVar("C", bound=Callable[..., Any])

_OPTIONS = (
    click.option(
        "--response-format",
        type=click.Choice(RESPONSE_FORMATS),
        default=DEFAULTS.response_format,
        show_default=True,
        help="How replies are made JSON: the schema itself, some JSON object, or the prompt alone.",
    ),
    click.option(
        "--thinking",
        type=click.Choice(THINKING),
        default=DEFAULTS.thinking,
        show_default=True,
        help="Whether the model thinks before it replies; 'template' leaves it to the server.",
    ),
    click.option(
        "--max-tokens",
        type=click.IntRange(16, 1 << 20),
        default=DEFAULTS.max_tokens,
        show_default=True,
        help="Longest reply, thinking included.",
    ),
    click.option(
        "--timeout",
        "timeout_s",
        type=click.FloatRange(1, 86_400),
        default=DEFAULTS.timeout_s,
        show_default=True,
        help="Seconds to wait for a reply.",
    ),
    click.option(
        "--retries",
        type=click.IntRange(0, 100),
        default=DEFAULTS.retries,
        show_default=True,
        help="How often a call is repeated that the transport or the server broke.",
    ),
)


def need_address(model: str, base_url: str | None) -> None:
    """Raises UsageError for a model without an address, unless it is the built-in one."""
    from jrdb_avr.engine.run.endpoint import MARKER

    if base_url is None and model != MARKER:
        raise click.UsageError(f"--model {model} needs --base-url, the address of the server that has it")


def endpoint_options(function: C) -> C:
    """Add the options of an endpoint; the command gets them as one parameter `options`."""
    names = ("response_format", "thinking", "max_tokens", "timeout_s", "retries")

    @functools.wraps(function)
    def command(**given: Any) -> Any:
        options = Options(**{name: given.pop(name) for name in names})
        if math.isnan(options.timeout_s):
            raise click.UsageError("--timeout must be a number of seconds")
        return function(**given, options=options)

    decorated: Any = command
    for option in reversed(_OPTIONS):
        decorated = option(decorated)
    result: C = decorated
    return result
