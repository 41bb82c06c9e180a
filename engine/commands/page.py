"""Pages of the documentation that are made from the code: commands, Python API, and tables.

    python -m jrdb_avr.engine.commands.page commands > docs/commands.md
    python -m jrdb_avr.engine.commands.page api > docs/api.md
    python -m jrdb_avr.engine.commands.page tables > docs/tables.md

Tests check that the stored pages equal the pages that these commands print.
"""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from typing import Any, Final

import click
import pyarrow as pa

import jrdb_avr
from jrdb_avr.engine.cli import COMMANDS, group
from jrdb_avr.schema.tables import ABOUT, column, views

NAME: Final = "jrdb-avr"
_HOW: Final[dict[str, Any]] = {"terminal_width": 100, "max_content_width": 100, "help_option_names": ["-h", "--help"]}


def commands_page() -> str:
    """Return a Markdown page with the help of all commands. The subcommands of a group follow the group."""
    parts = ["# Commands\n", "The output of `--help` of each command.\n"]
    top = click.Context(group, info_name=NAME, **_HOW)
    for name in COMMANDS:
        for path, text in _helps(group, name, top):
            parts.append(f"{'#' * len(path.split())} `{path}`\n\n```text\n{text}\n```\n")
    parts.append("Made by `python -m jrdb_avr.engine.commands.page commands > docs/commands.md`.\n")
    return "\n".join(parts)


def _helps(parent: click.Group, name: str, above: click.Context) -> Iterator[tuple[str, str]]:
    command = parent.get_command(above, name)
    assert command is not None
    context = click.Context(command, info_name=name, parent=above, **_HOW)
    lines = [line.rstrip() for line in command.get_help(context).splitlines()]
    yield context.command_path, "\n".join(lines).strip()
    if isinstance(command, click.Group):
        for subcommand in command.list_commands(context):
            yield from _helps(command, subcommand, context)


def api_page() -> str:
    """Return the page of the Python API in Markdown: the signature and the docstring of each public name."""
    values = {name: getattr(jrdb_avr, name) for name in jrdb_avr.__all__}
    functions = {name: value for name, value in values.items() if inspect.isfunction(value)}
    errors = {name: value for name, value in values.items() if isinstance(value, type) and issubclass(value, Exception)}
    classes = {name: value for name, value in values.items() if isinstance(value, type) and name not in errors}
    parts = ["# Python API\n", "The public names of `import jrdb_avr`. The first use of a name imports its module.\n"]
    for title, members in (("Functions", functions), ("Classes", classes), ("Errors and warnings", errors)):
        parts.append(f"## {title}\n")
        for name, value in members.items():
            parts.append(f"### `{name}`\n\n{_signature(name, value)}{_doc(value)}\n{_members(value)}")
    parts.append("Made by `python -m jrdb_avr.engine.commands.page api > docs/api.md`.\n")
    return "\n".join(parts)


def _signature(name: str, value: Any) -> str:
    if isinstance(value, type) and (issubclass(value, Exception) or getattr(value, "_is_protocol", False)):
        return ""
    signature = inspect.signature(value)
    parameters = [_short(parameter) for parameter in signature.parameters.values()]
    # Annotations are stored as strings, so they are printed with quotes. Remove the quotes.
    lines = [re.sub(r": '([^']*)'", r": \1", f"    {parameter},\n") for parameter in parameters]
    star = next((i for i, parameter in enumerate(parameters) if parameter.kind is parameter.KEYWORD_ONLY), None)
    if star is not None:
        lines.insert(star, "    *,\n")
    end = f" -> {signature.return_annotation}" if inspect.isfunction(value) else ""
    inside = f"\n{''.join(lines)}" if lines else ""
    return f"```python\n{name}({inside}){end}\n```\n\n"


def _short(parameter: inspect.Parameter) -> inspect.Parameter:
    """Return a parameter for a printed signature.

    If the default of the parameter is an options object with default values only, the default prints as `Class()`.
    """
    kind = type(parameter.default)
    if not kind.__name__.endswith("Options") or parameter.default != kind():
        return parameter
    return parameter.replace(default=_Text(f"{kind.__name__}()"))


class _Text(str):
    """A string that prints without quotes in a signature."""

    __slots__ = ()

    __repr__ = str.__str__


def _doc(value: Any) -> str:
    """Return the docstring of an object as Markdown.

    Google sections become lists. Other indented lines become code blocks.
    """
    blocks = re.split(
        r"(?m)^((?:Args|Attributes|Returns|Raises|Yields):\n(?:(?: {4}.*)?\n?)+)", inspect.getdoc(value) or ""
    )
    for at in range(1, len(blocks), 2):
        title, *lines = blocks[at].rstrip().splitlines()
        items = "\n".join(line.removeprefix("    ") for line in lines)
        items = re.sub(r"(?m)^(?=\S)", "- ", re.sub(r"(?m)^(\w+): ", r"`\1`: ", items)).replace("\n    ", "\n  ")
        blocks[at] = f"**{title}**\n\n{items}\n\n"
    for at in range(0, len(blocks), 2):
        blocks[at] = re.sub(
            r"(?m)((?:^ {4}.*\n?)+)", lambda code: f"```python\n{textwrap.dedent(code[1]).rstrip()}\n```\n", blocks[at]
        )
    return "".join(blocks).rstrip() + "\n" * (len(blocks) > 1)


def _members(value: Any) -> str:
    """Return a list of the public methods and properties of a class, each with the first line of its docstring."""
    if not isinstance(value, type):
        return ""
    # The public Store adds members to a class of the same name.
    kinds = [kind for kind in reversed(value.__mro__) if kind.__name__ == value.__name__]
    members = {name: member for kind in kinds for name, member in vars(kind).items()}
    lines = [
        f"- `{name}`: {(inspect.getdoc(member) or '').splitlines()[0]}\n"
        for name, member in members.items()
        if not name.startswith("_") and (inspect.isroutine(member) or isinstance(member, property)) and member.__doc__
    ]
    return "".join([*lines, "\n"] if lines else [])


def tables_page() -> str:
    """Return the reference page of all tables, in Markdown."""
    lines = [
        "# Tables of a store",
        "",
        "In `jrdb-avr sql`, every table is a view. A table that is not written yet is an empty view. `SHOW TABLES`",
        "lists the views, and `DESCRIBE intervals_actions` lists the columns of one view.",
        "",
        "The view `sightings_keypoints` adds the column `keypoints` to `intervals_sightings`. Its values come from",
        "`annotations_poses` at the same frame. They are null if that table has no row for the person and frame.",
        "",
        "Tables `annotations_...` hold the content of the label files: one row per fact, with raw values. Tables",
        "`intervals_...` hold facts derived from the annotations. An interval includes its first and last frame. `load",
        "--rebuild` derives the intervals again. `intervals_actions`, `_memberships`, `_interactions` and `_handles`",
        "come from labels. `intervals_possible_...` hold facts that have no label but may be true.",
        "",
    ]
    for name, schema, private in views():
        secret = " Private: never opened by the process that talks to a model." if private else ""
        lines += [f"## `{name}`", "", f"{ABOUT[name]}{secret}", "", "| column | type | meaning |", "|--|--|--|"]
        lines += [f"| `{field.name}` | {_type(field)} | {column(name, field.name)[1]} |" for field in schema]
        lines.append("")
    lines.append("Made by `python -m jrdb_avr.engine.commands.page tables > docs/tables.md`.\n")
    return "\n".join(lines)


def _type(field: pa.Field) -> str:
    return f"{field.type}".replace(" not null", "").replace("item: ", "") + (" or null" if field.nullable else "")


if __name__ == "__main__":
    click.echo({"commands": commands_page, "api": api_page, "tables": tables_page}[sys.argv[1]](), nl=False)
