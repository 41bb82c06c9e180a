"""Options of the commands that use a model's server."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable
from typing import Any, Final, TypeVar

import click

from jrdb_avr.agent.model.options import DEFAULTS, RESPONSE_FORMATS, THINKING, TOKEN_PARAMETERS, Options
from jrdb_avr.schema.errors import InputError

_C = TypeVar("_C", bound=Callable[..., Any])


class _Number(click.ParamType[float | None]):
    """A number, or 'none' for None."""

    name = "X|none"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        if value is None or value == "none":
            return None
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor 'none'", param, ctx)


class _Object(click.ParamType[dict[str, Any]]):
    """A JSON object."""

    name = "JSON"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> dict[str, Any]:
        try:
            found = json.loads(value) if isinstance(value, str) else value
        except (ValueError, RecursionError) as error:
            self.fail(f"{value[:80]!r} is no JSON: {error}", param, ctx)
        if not isinstance(found, dict):
            self.fail("it must be a JSON object", param, ctx)
        return found


class _Header(click.ParamType[tuple[str, str]]):
    """The name of a header, and that of the environment variable with its value."""

    name = "NAME=ENV"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        name, equals, variable = value if isinstance(value, tuple) else str(value).partition("=")
        if not (name and equals and variable.isidentifier()):
            self.fail("it must be NAME=ENV, the environment variable that holds the header's value", param, ctx)
        return name, variable


REQUEST: Final[dict[str, tuple[str, click.ParamType[Any], str]]] = {
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
    "temperature": ("--temperature", _Number(), "Sampling temperature; 'none' leaves it to the server."),
    "token_parameter": (
        "--token-parameter",
        click.Choice(TOKEN_PARAMETERS),
        "Name of the reply's limit in a request; 'auto' takes the newer one where the server refuses the older.",
    ),
    "extra_body": ("--extra-body", _Object(), "Further keys of every request, as a JSON object."),
    "headers": (
        "--header",
        _Header(),
        "A header of every request, its value from an environment variable. May be repeated.",
    ),
    "api_key_env": ("--api-key-env", click.STRING, "Environment variable that holds the key."),
    "rpm": ("--rpm", click.IntRange(1), "Most requests a minute."),
    "tpm": ("--tpm", click.IntRange(1), "Most tokens a minute, read and written."),
}
"""Per field of `Options`: its flag, its type and its help."""


def endpoint_options(optional: bool = False) -> Callable[[_C], Callable[..., Any]]:
    """Add the options of a model's server; the command gets `model`, `base_url`, and all others as one `options`.

    A model without an address is a usage error, unless it is the built-in one. Where a model is `optional`, the command
    checks that itself (`check_address`).
    """
    models = ", 'none' for a method of your own without any." if optional else "."
    server = [
        click.option(
            "--model",
            required=not optional,
            help=f"Id of the model; 'simulated:PROFILE' is the built-in one, and 'marker' its perfect profile{models}",
        ),
        click.option("--base-url", help="An OpenAI-compatible server, as http://localhost:8000/v1."),
    ]
    request = [_option(name, flag, kind, text) for name, (flag, kind, text) in REQUEST.items()]

    def decorate(function: _C) -> Callable[..., Any]:
        @functools.wraps(function)
        def command(**values: Any) -> Any:
            settings = {name: values.pop(name) for name in REQUEST}
            try:
                options = Options(**settings | {"headers": dict(settings["headers"])})
            except InputError as error:
                raise click.UsageError(str(error)) from None
            if math.isnan(options.timeout_s):
                raise click.UsageError("--timeout must be a number of seconds")
            if not optional:
                check_address(values["model"], values["base_url"])
            return function(**values, options=options)

        return functools.reduce(lambda inner, option: option(inner), reversed(server + request), command)

    return decorate


def check_address(model: str, base_url: str | None) -> None:
    """Raises UsageError for a model that has no address and is not built in."""
    from jrdb_avr.agent.simulated.knobs import profile_of

    try:
        simulated = profile_of(model) is not None
    except InputError as error:
        raise click.UsageError(str(error)) from None
    if base_url is None and not simulated:
        raise click.UsageError(f"--model {model} needs --base-url, the address of the server that has it")


def _option(name: str, flag: str, kind: click.ParamType[Any], text: str) -> Callable[[_C], _C]:
    if name == "headers":
        return click.option(flag, name, type=kind, multiple=True, help=text)
    default = getattr(DEFAULTS, name)
    return click.option(flag, name, type=kind, default=default, show_default=default not in ({}, None), help=text)
