"""Several runs in one command: the options of each, from a TOML file.

    [[run]]
    method = ["react", "agent"]
    model = "Qwen3-VL-8B"
    base-url = "http://localhost:8000/v1"

    [[run]]
    method = "react"
    model = ["gpt-5", "gpt-5-mini"]
    base-url = "https://api.openai.com/v1"
    temperature = "none"

A key is an option's long name, and stands in place of that of the command line. A list is a run for each value, unless
the option may be repeated.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import click

from jrdb_avr.engine.commands._endpoint import REQUEST
from jrdb_avr.schema.errors import InputError, did_you_mean

_SHARED: Final = ("store", "matrix", "json", "csv", "help")
"""Options of the command as a whole."""


def matrix_runs(path: Path, ctx: click.Context, shared: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The options of each run, by the names of the command's parameters. `shared`: those of the command line.

    Raises InputError where the file cannot be read, UsageError for an option that is none or has a wrong value.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("run")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"cannot read {path}: {error}", file=str(path)) from None
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise InputError(f"{path} holds no run: write [[run]] and below it method = and model =", file=str(path))
    runs = []
    for number, table in enumerate(tables, 1):
        try:
            runs += [_run(ctx, shared, values) for values in _crossed(ctx, table)]
        except (click.UsageError, InputError) as error:
            message = error.format_message() if isinstance(error, click.UsageError) else str(error)
            raise click.UsageError(f"{path}, run {number}: {message}") from None
    return runs


def _crossed(ctx: click.Context, table: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """A table with one value in place of each list, for all combinations."""
    choices = [
        value if isinstance(value, list) and not _parameter(ctx, key).multiple else [value]
        for key, value in table.items()
    ]
    for values in itertools.product(*choices):
        yield dict(zip(table, values, strict=True))


def _run(ctx: click.Context, shared: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    found = {}
    for key, value in values.items():
        parameter = _parameter(ctx, key)
        # Like the texts of a command line.
        plain = value if isinstance(value, bool | dict | list) else str(value)
        found[str(parameter.name)] = parameter.process_value(ctx, plain)
    request = {name: found.pop(name) for name in REQUEST if name in found}
    if "headers" in request:
        request["headers"] = dict(request["headers"])
    return {**shared, **found, "options": replace(shared["options"], **request)}


def _parameter(ctx: click.Context, key: str) -> click.Option:
    """The parameter of an option's long name without dashes."""
    options = {
        flag.removeprefix("--"): one
        for one in ctx.command.params
        if isinstance(one, click.Option)
        for flag in one.opts
        if flag.removeprefix("--") not in _SHARED
    }
    if key not in options:
        raise click.UsageError(f"no option {key!r}{did_you_mean(key, options)}")
    return options[key]
