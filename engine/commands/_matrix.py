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

A key is the long name of an option. Its value replaces the value of the command line. If a value is a list, the table
describes one run per element. If several values are lists, it describes one run per combination of elements. For an
option that may be repeated, the whole list is a single value. If the command line names a model, only runs of this
model are described.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import click

from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.engine.commands._declared import build
from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.schema.errors import InputError, did_you_mean

PAPER: Final = Path("paper")
"""Name in place of a file that selects the runs of the paper."""

_SHARED: Final = ("store", "matrix", "json", "csv", "help")
"""Names of options that belong to the whole command. A run must not set them."""


def matrix_runs(path: Path, ctx: click.Context, shared: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the options of each run that a TOML file describes.

    Args:
        path: The TOML file, or `PAPER`.
        ctx: The click context of the command. Its parameters define the options.
        shared: Values of the command line by name of the parameter. They apply unless a run sets its own value.

    Returns:
        One dictionary per run: the values of all options by name of the parameter.

    Raises:
        InputError: If the file cannot be read, or describes no run or no run of the command line's model.
        UsageError: If an option is unknown or has a wrong value.
    """
    path = Path(str(files("jrdb_avr.engine.run") / "paper.toml")) if path == PAPER else path
    try:
        tables = tomllib.loads(to_utf8(read_input(path), path).decode()).get("run")
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
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
    chosen = [run for run in runs if shared["model"] in (None, run["model"])]
    if not chosen:
        raise InputError(f"{path} has no run of the model {shared['model']}", file=str(path))
    return chosen


def _crossed(ctx: click.Context, table: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield one copy of a table per combination of list elements. A copy has an element in place of each list."""
    if empty := [key for key, value in table.items() if value == []]:
        raise click.UsageError(f"the list of {empty[0]} is empty")
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
        if isinstance(value, bool) > parameter.is_flag or isinstance(value, dict) > (parameter.name == "extra_body"):
            raise click.UsageError(f"{key} cannot be {'a table' if isinstance(value, dict) else 'true or false'}")
        # Click types parse strings, because the values of a command line are strings.
        plain = value if isinstance(value, bool | dict | list) else str(value)
        set_values[str(parameter.name)] = parameter.process_value(ctx, plain)
    merged = {**shared, **set_values}
    # The options are built only to check them here, where an error message can name the run.
    build(EndpointOptions, merged)
    return merged


def _parameter(ctx: click.Context, key: str) -> click.Option:
    """Return the option `--KEY` of the command. Raise UsageError if the command has no such option."""
    options = {
        flag.removeprefix("--"): parameter
        for parameter in ctx.command.params
        if isinstance(parameter, click.Option)
        for flag in parameter.opts
        if flag.startswith("--") and flag.removeprefix("--") not in _SHARED
    }
    if key not in options:
        raise click.UsageError(f"no option {key!r}{did_you_mean(key, options)}")
    return options[key]
