"""Output of the commands: rows as a table, JSON or CSV, notes, and progress bars.

Rows go to stdout, everything else to stderr. `--json` prints exactly one JSON array of row objects, `--csv` the same
rows under one heading. Text from data files or models is stripped of control characters before it reaches a terminal.
"""

from __future__ import annotations

import csv
import io
import os
import shutil
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, Final, Literal

import click
import msgspec

from jrdb_avr.engine import text_table
from jrdb_avr.engine.text_table import clean
from jrdb_avr.schema.errors import AvrWarning

_FORMULA: Final = ("=", "+", "-", "@", "\t")
"""First characters of a formula in a spreadsheet; a carriage return is removed."""

_WIDTH: Final = 100
"""Characters per line if the output is not a terminal."""

_ROWS: Final = 100
"""Maximum rows of a table on a terminal."""

RowFormat = Literal["", "json", "csv"]
"""How a command prints its rows: tables for people, one JSON array, or CSV."""


def print_json(rows: Iterable[Any]) -> None:
    """Print one JSON array."""
    # NaN and infinity are not JSON: msgspec writes null for them. Sums of whole numbers come as decimals.
    click.echo(msgspec.json.Encoder(enc_hook=str, decimal_format="number").encode(list(rows)))


def csv_text(rows: Iterable[Mapping[str, Any]], columns: Sequence[str] = ()) -> str:
    """Return rows as CSV with a heading.

    An apostrophe precedes a text that a spreadsheet would run as a formula, because model names come from outside.

    Args:
        rows: The rows. An unknown value becomes an empty cell, a list or a node becomes JSON.
        columns: Names of the columns; if empty, the keys of the rows.

    Returns:
        The text, with a newline after each line.
    """
    rows = list(rows)
    names = columns or list(dict.fromkeys(name for row in rows for name in row))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for line in (names, *([row.get(name) for name in names] for row in rows)):
        writer.writerow(map(_in_csv, line))
    return out.getvalue()


def _in_csv(value: object) -> object:
    if isinstance(value, list | dict):
        return msgspec.json.encode(value, enc_hook=str).decode()
    if not isinstance(value, str):
        return value
    text = clean(value)
    return f"'{text}" if text.lstrip(" \n").startswith(_FORMULA) else text


def print_data(rows: Iterable[Mapping[str, Any]], form: RowFormat, columns: Sequence[str] = ()) -> None:
    """Print rows for programs, as JSON or CSV."""
    if form == "csv":
        click.echo(csv_text(rows, columns), nl=False)
    else:
        print_json(rows)


def print_rows(
    rows: Sequence[Mapping[str, Any]], title: str = "", columns: Sequence[str] = (), form: RowFormat = ""
) -> None:
    """Print rows as a table, JSON or CSV.

    A table fits the width of the terminal, else `COLUMNS`, else 100 characters.

    Args:
        rows: The rows. A terminal shows at most 100 of them.
        title: A line above the table.
        columns: Names of the columns, which an empty table shows too; if empty, the keys of the rows.
        form: "json", "csv" or "" for a table.
    """
    if form:
        print_data(rows, form, columns)
        return
    from rich.console import Console

    terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns if terminal else _columns()
    printed = rows[:_ROWS] if terminal else rows
    if title:
        click.echo(clean(title))
    for table in text_table.make_tables(printed, columns, width):
        # The console would split what is wider than itself.
        wide = sum((column.width or 0) + 3 for column in table.columns) + 1
        Console(width=max(width, wide), highlight=False).print(table)
    if len(printed) < len(rows):
        click.echo(f"... {len(rows) - len(printed):,} more: --csv or --json prints all")


def _columns() -> int:
    text = os.environ.get("COLUMNS", "")
    return int(text) if text.isdecimal() and 20 <= int(text) <= 10_000 else _WIDTH


def note(message: object) -> None:
    """Print one line on stderr."""
    click.echo(clean(message), err=True)


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Print the AvrWarnings of the block as notes."""
    with warnings.catch_warnings(action="always", category=AvrWarning):
        warnings.showwarning = lambda message, *where: note(message)
        yield


@contextmanager
def progress_bar(beside: Callable[[], str] = lambda: "") -> Iterator[Callable[[str, int, int], None]]:
    """Show progress bars on stderr if it is a terminal; print the warnings of the block as notes.

    Args:
        beside: Returns the text beside the bars. It is called a few times per second.

    Yields:
        The `Progress` callback, which moves the bars.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.text import Text

    class Beside(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(beside())

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), Beside())
    tasks: dict[str, TaskID] = {}
    bar = Progress(*columns, console=console, disable=not console.is_terminal)
    # A bar that is disabled ends with an empty line in older versions of rich.
    with bar if console.is_terminal else nullcontext(), warnings_as_notes():

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done)

        yield show
