"""Command-line options that are made from the declared options of the library (`schema/option.py`)."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, Final, TypeVar

import click

from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.engine.commands._complete import complete_sequence
from jrdb_avr.engine.commands._options import FILE
from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.schema.errors import InputError

FILTERS: Final = ("families", "templates", "sequences")
"""Fields of `QuestionSelection` that keep only questions with certain values."""

_C = TypeVar("_C", bound=Callable[..., Any])


class _Number(click.ParamType[float | None]):
    """Option type for a number. The word 'none' stands for None."""

    name = "X|none"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        if value is None or value == "none":
            return None
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor 'none'", param, ctx)


class _Object(click.ParamType[dict[str, Any]]):
    """Option type for a JSON object."""

    name = "JSON"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> dict[str, Any]:
        try:
            decoded = json.loads(value) if isinstance(value, str) else value
        except (ValueError, RecursionError) as error:
            self.fail(f"{value[:80]!r} is not JSON: {error}", param, ctx)
        if not isinstance(decoded, dict):
            self.fail("it must be a JSON object", param, ctx)
        return decoded


class _Header(click.ParamType[tuple[str, str]]):
    """Option type for the name of a header and the name of the environment variable that holds the header's value."""

    name = "NAME=ENV"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        name, equals, variable = value if isinstance(value, tuple) else str(value).partition("=")
        if not (name and equals and variable.isidentifier()):
            self.fail("it must be NAME=ENV, the environment variable that holds the header's value", param, ctx)
        return name, variable


class _Shard(click.ParamType[tuple[int, int]]):
    """Option type for the index of a shard, which begins at 1, and the number of shards."""

    name = "I/N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"([1-9][0-9]{0,5})/([1-9][0-9]{0,5})", str(value))
        if match is None or int(match[1]) > int(match[2]):
            self.fail("it must be I/N, with I from 1 to N", param, ctx)
        return int(match[1]), int(match[2])


class _Ids(click.ParamType[tuple[str, ...]]):
    """Option type for ids that are separated by commas, or for the path of a file with one id per line."""

    name = "TEXT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        text = value
        if not re.fullmatch(r"[0-9a-f]{16}(,[0-9a-f]{16})*,?", value):
            try:
                path = Path(value)
                text = to_utf8(read_input(path), path).decode() if path.exists() else value
            except (OSError, ValueError) as error:
                raise InputError(f"--questions: cannot read {value[:80]}: {error}", file=value) from None
        ids = [part.strip() for part in re.split(r"[,\n]", text) if part.strip()]
        if not ids:
            raise InputError("--questions names no question", field="questions")
        return tuple(dict.fromkeys(ids))


_FOLDER: Final = click.Path(file_okay=False, exists=True, path_type=Path)
_KINDS: Final[dict[str, click.ParamType[Any]]] = {
    "questions": _Ids(),
    "images": _FOLDER,
    "price": FILE,
    "temperature": _Number(),
    "extra_body": _Object(),
    "headers": _Header(),
    "shard": _Shard(),
}
"""Click types by name of the field. Other fields have the click type that their annotation and limits imply."""

_REPEATED: Final = ("delimiters", "headers", "simulate", "families", "templates", "sequences")
"""Options that may be repeated."""


def field_options(kind: Any, *names: str) -> Callable[[_C], _C]:
    """Add the declared options of an options class to a command.

    Args:
        kind: The options class.
        names: Names of the fields to add. If no name is given, all fields are added.

    Returns:
        A decorator. The command gets one value per field. `build` makes the options object from these values.
    """
    options = [_click_option(declared) for declared in _declared(kind) if declared.name in names or not names]
    return lambda function: functools.reduce(lambda inner, add: add(inner), reversed(options), function)


def build(kind: Any, values: Mapping[str, Any]) -> Any:
    """Make an options object from the values of a command line.

    Args:
        kind: The options class.
        values: Values by name of the field. Missing fields keep their defaults.

    Returns:
        An instance of the class.

    Raises:
        UsageError: If the class refuses a value.
    """
    arguments = {declared.name: values[declared.name] for declared in _declared(kind) if declared.name in values}
    if "headers" in arguments:
        arguments["headers"] = dict(arguments["headers"])
    try:
        return kind(**arguments)
    except InputError as error:
        raise click.UsageError(str(error)) from None


def _declared(kind: Any) -> list[Field[Any]]:
    return [field for field in fields(kind) if "flag" in field.metadata]


def _click_option(declared: Field[Any]) -> Callable[[_C], _C]:
    name, about = declared.name, declared.metadata
    default = {} if declared.default is MISSING else declared.default
    repeated = name in _REPEATED
    return click.option(
        f"--{about['flag'] or name.replace('_', '-')}",
        *(("--question",) if name == "questions" else ()),
        name,
        type=_kind(declared),
        is_flag=declared.type == "bool",
        multiple=repeated,
        default=None if repeated else default,
        show_default=declared.type != "bool" and default not in (None, {}, ()),
        metavar=about["metavar"],
        shell_complete=complete_sequence if name == "sequences" else None,
        help=about["text"],
    )


def _kind(declared: Field[Any]) -> click.ParamType[Any]:
    """Return the click type that parses the values of a declared option."""
    about, annotation = declared.metadata, str(declared.type).removesuffix(" | None")
    limits = about["minimum"], about["maximum"]
    if declared.name in _KINDS:
        return _KINDS[declared.name]
    if about["choices"]:
        return click.Choice(about["choices"])
    if annotation == "int":
        return click.INT if limits == (None, None) else click.IntRange(*limits)
    if annotation == "float":
        return click.FloatRange(*limits)
    return {"Path": FILE, "bool": click.BOOL}.get(annotation, click.STRING)


# -- the server of a model --------------------------------------------------------------------------------------------

_REQUEST: Final = tuple(field.name for field in _declared(EndpointOptions) if field.name not in ("price", "max_cost"))


def model_option(text: str = "", required: bool = True) -> Callable[[_C], _C]:
    """Add the option `--model`.

    Args:
        text: A sentence to append to the help text. It must begin with a space.
        required: Whether click refuses a call without `--model`.

    Returns:
        A decorator.
    """
    about = "Id of the model. Simulated models, which read annotations: simulated, simulated:PROFILE (docs/models.md)."
    return click.option("--model", required=required, help=about + text)


def endpoint_options(function: _C) -> Callable[..., Any]:
    """Add `--model` and the options of the model's server. The command gets the arguments `model` and `endpoint`."""

    @functools.wraps(function)
    def command(*, model: str, **values: Any) -> Any:
        endpoint = build(EndpointOptions, values)
        check_address(model, endpoint.base_url)
        others = {name: value for name, value in values.items() if name not in _REQUEST}
        return function(model=model, endpoint=endpoint, **others)

    return model_option()(field_options(EndpointOptions, *_REQUEST)(command))


def check_address(model: str, base_url: str | None) -> None:
    """Raise UsageError if a model needs the address of a server and `base_url` is None."""
    from jrdb_avr.agent.simulated.profiles import profile_of

    try:
        simulated = profile_of(model) is not None
    except InputError as error:
        raise click.UsageError(str(error)) from None
    if base_url is None and not simulated:
        raise click.UsageError(f"--model {model} needs --base-url, the address of the server that has it")
