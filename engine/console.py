"""Output of the commands: rows (as a table, as JSON or as CSV), notes, and progress bars.

Rows are printed on stdout, everything else on stderr. `--json` prints exactly one JSON array with an object per row.
`--csv` prints the same rows. Text from files or models loses its control characters before it reaches a terminal.
"""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, Final, Literal

import click
import msgspec

from jrdb_avr.engine import text_table
from jrdb_avr.engine.text_table import clean
from jrdb_avr.schema.errors import AvrWarning

_FORMULA: Final = re.compile(r"(^[ \n]*|[;\t\n] *)(?=[=+\-@\t\uff1d\uff0b\uff0d\uff20])")
"""Position before a formula of a spreadsheet, which may also split texts at semicolons and begin with wide characters.

The carriage return is not listed, because `clean` removes it.
"""

_WIDTH: Final = 100
"""Characters per line if stdout is not a terminal and `COLUMNS` is not set."""

_ROWS: Final = 100
"""Maximum number of rows of a table on a terminal."""

_LOG_EVERY_S: Final = 60.0
"""Seconds between two printed lines of progress if stderr is not a terminal."""

RowFormat = Literal["", "json", "csv"]
"""Format of printed rows: "" for text tables, "json" for one JSON array, or "csv"."""


def print_json(rows: Iterable[Any]) -> None:
    """Print rows as one JSON array."""
    # msgspec writes NaN and infinity as null. DuckDB returns sums of integers as decimals, which become numbers.
    click.echo(msgspec.json.Encoder(enc_hook=str, decimal_format="number").encode(list(rows)))


def csv_text(rows: Iterable[Mapping[str, Any]], columns: Sequence[str] = ()) -> str:
    """Return rows as CSV with a header line.

    Texts may come from models. If a spreadsheet would run a text as a formula, an apostrophe is put before the text.

    Args:
        rows: The rows. None becomes an empty cell. Lists and dictionaries become JSON.
        columns: Names of the columns. If empty, all keys of the rows.

    Returns:
        The CSV text, with a newline after each line.
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
        value = msgspec.json.encode(value, enc_hook=str).decode()
    return _FORMULA.sub(r"\1'", clean(value)) if isinstance(value, str) else value


def print_data(rows: Iterable[Mapping[str, Any]], form: RowFormat, columns: Sequence[str] = ()) -> None:
    """Print rows as CSV if `form` is "csv", otherwise as one JSON array."""
    if form == "csv":
        click.echo(csv_text(rows, columns), nl=False)
    else:
        print_json(rows)


def print_rows(
    rows: Sequence[Mapping[str, Any]], title: str = "", columns: Sequence[str] = (), form: RowFormat = ""
) -> None:
    """Print rows as a table, JSON or CSV.

    A table is as wide as the terminal. If stdout is not a terminal, the environment variable COLUMNS sets the width of
    the table in characters. Without this variable, the width is 100 characters.

    Args:
        rows: The rows. A table on a terminal shows at most 100 rows.
        title: A line above the table. It is not printed if the rows are printed as JSON or CSV.
        columns: Names of the columns. If empty, all keys of the rows. A table without rows shows only these names.
        form: "json", "csv", or "" for a text table.
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
        # Because rich splits a table that is wider than its console.
        wide = sum((column.width or 0) + 3 for column in table.columns) + 1
        Console(width=max(width, wide), highlight=False).print(table)
    if len(printed) < len(rows):
        click.echo(f"... {len(rows) - len(printed):,} more: --csv or --json prints all")


def _columns() -> int:
    text = os.environ.get("COLUMNS", "")
    return int(text) if text.isdecimal() and 20 <= int(text) <= 10_000 else _WIDTH


def note(message: object) -> None:
    """Print a message on stderr, without control characters."""
    click.echo(clean(message), err=True)


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Print the AvrWarnings that occur in the `with` block as notes on stderr."""
    with warnings.catch_warnings(action="always", category=AvrWarning):
        warnings.showwarning = lambda message, *where: note(message)
        yield


@contextmanager
def progress_bar(below: Callable[[], str] = lambda: "") -> Iterator[Callable[[str, int, int], None]]:
    """Show progress bars with the time left on stderr. Print AvrWarnings of the `with` block as notes.

    If stderr is not a terminal, a line is printed each minute instead.

    Args:
        below: Function that returns the text below the bars. It is called several times per second.

    Yields:
        A function that advances the progress bar of a step. Its arguments are the step's name, the finished count and
        the total count.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Bars(Progress):
        def get_renderables(self) -> Iterator[Any]:
            yield from super().get_renderables()
            yield Text(below())

    console = Console(stderr=True)
    left = TimeRemainingColumn(elapsed_when_finished=True)
    columns = (TextColumn("{task.description}"), BarColumn(20), MofNCompleteColumn(), left, TextColumn("left"))
    tasks: dict[str, TaskID] = {}
    # The time left comes from the last hour, because one step may take minutes.
    bar = Bars(*columns, console=console, disable=not console.is_terminal, speed_estimate_period=3600)
    ended = threading.Event()

    def log() -> None:
        while not ended.wait(_LOG_EVERY_S):
            for task in bar.tasks:
                if not task.finished:
                    text = f"{task.description}: {task.completed:,.0f} of {task.total:,.0f}, {left.render(task)} left"
                    note("; ".join(filter(None, [text, below()])))

    if not console.is_terminal:
        threading.Thread(target=log, daemon=True).start()
    try:
        # Older versions of rich print an empty line at the end of a disabled bar, so the bar is not entered.
        with bar if console.is_terminal else nullcontext(), warnings_as_notes():

            def show(what: str, done: int, total: int) -> None:
                if what not in tasks:
                    tasks[what] = bar.add_task(what, total=total)
                bar.update(tasks[what], completed=done)

            yield show
    finally:
        ended.set()
