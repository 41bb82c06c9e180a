"""The commands' own help as a page of the documentation: `python -m jrdb_avr.engine.commands.page > docs/commands.md`.

A test compares the page with the commands, so that neither says what the other does not.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import click

from jrdb_avr.engine.cli import COMMANDS, group

NAME: Final = "jrdb-avr"
_WIDTH: Final = 100


def commands_page() -> str:
    """The page in Markdown: every command, with those inside a group after it."""
    parts = ["# Commands\n", "What `--help` of each command prints. This page is made by them: see the foot of it.\n"]
    top = click.Context(group, info_name=NAME, terminal_width=_WIDTH, max_content_width=_WIDTH)
    for name in COMMANDS:
        command = group.get_command(top, name)
        assert command is not None
        for path, text in _helps(command, name, top):
            parts.append(f"{'#' * len(path.split())} `{path}`\n\n```text\n{text}\n```\n")
    parts.append("Made by `python -m jrdb_avr.engine.commands.page > docs/commands.md`.\n")
    return "\n".join(parts)


def _helps(command: click.Command, name: str, parent: click.Context) -> Iterator[tuple[str, str]]:
    context = click.Context(
        command,
        info_name=name,
        parent=parent,
        terminal_width=_WIDTH,
        max_content_width=_WIDTH,
        help_option_names=["-h", "--help"],
    )
    lines = [line.rstrip() for line in command.get_help(context).splitlines()]
    yield context.command_path, "\n".join(lines).strip()
    if isinstance(command, click.Group):
        for own in command.list_commands(context):
            inner = command.get_command(context, own)
            if inner is not None:
                yield from _helps(inner, own, context)


if __name__ == "__main__":
    click.echo(commands_page(), nl=False)
