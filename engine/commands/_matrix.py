"""Read the options of several runs from a TOML file.

    [[run]]
    method = ["react", "agent"]
    model = "Qwen3-VL-8B"
    base-url = "http://localhost:8000/v1"

    [[run]]
    method = "react"
    model = ["gpt-5", "gpt-5-mini"]
    base-url = "https://api.openai.com/v1"
    temperature = "none"

A key is the long name of an option and replaces the value of the command line. A list makes a run per value, unless the
option may be repeated.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import click

from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.engine.commands._declared import build
from jrdb_avr.schema.errors import InputError, did_you_mean

_SHARED: Final = ("store", "matrix", "json", "csv", "help")
"""Options of the whole command, which no run may set."""


def matrix_runs(path: Path, ctx: click.Context, shared: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Read the options of each run.

    Args:
        path: The TOML file.
        ctx: The context of the command, which has the options.
        shared: Values of the command line, by parameter.

    Returns:
        The values of each run, by parameter.

    Raises:
        InputError: The file cannot be read.
        UsageError: An option is unknown or has a wrong value.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("run")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"cannot read {path}: {error}", file=str(path)) from None
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise InputError(f"{path} holds no run: write [[run]] and below it method = and model =", file=str(path))
    runs = []
    for index, table in enumerate(tables, 1):
        try:
            runs += [_run(ctx, shared, values) for values in _crossed(ctx, table)]
        except (click.UsageError, InputError) as error:
            message = error.format_message() if isinstance(error, click.UsageError) else str(error)
            raise click.UsageError(f"{path}, run {index}: {message}") from None
    return runs


def _crossed(ctx: click.Context, table: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the table with one value in place of each list, for all combinations."""
    choices = [
        value if isinstance(value, list) and not _parameter(ctx, key).multiple else [value]
        for key, value in table.items()
    ]
    for values in itertools.product(*choices):
        yield dict(zip(table, values, strict=True))


def _run(ctx: click.Context, shared: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    set_values = {}
    for key, value in values.items():
        parameter = _parameter(ctx, key)
        # Because the types of options parse strings, like those on a command line.
        plain = value if isinstance(value, bool | dict | list) else str(value)
        set_values[str(parameter.name)] = parameter.process_value(ctx, plain)
    merged = {**shared, **set_values}
    # Here, so that the error names the run.
    build(EndpointOptions, merged)
    return merged


def _parameter(ctx: click.Context, key: str) -> click.Option:
    """Return the option with a long name, given without dashes."""
    options = {
        flag.removeprefix("--"): parameter
        for parameter in ctx.command.params
        if isinstance(parameter, click.Option)
        for flag in parameter.opts
        if flag.removeprefix("--") not in _SHARED
    }
    if key not in options:
        raise click.UsageError(f"no option {key!r}{did_you_mean(key, options)}")
    return options[key]
