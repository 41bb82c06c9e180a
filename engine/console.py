"""Output of the commands: rows as a table or JSON, lines for people, and progress bars.

Rows go to stdout, everything else to stderr. `--json` prints exactly one JSON array of row objects. Text from data
files or models is stripped of control characters before it reaches a terminal.
"""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, Final

import click
import msgspec

from jrdb_avr.schema.errors import AvrWarning

_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def clean(value: object) -> str:
    """The value as text that cannot move a terminal's cursor or change its colours."""
    return _CONTROL.sub("", "" if value is None else str(value))


def print_json(rows: Iterable[Any]) -> None:
    """Print one JSON array."""
    # NaN and infinity are not JSON: msgspec writes null for them. Sums of whole numbers come as decimals.
    click.echo(msgspec.json.Encoder(enc_hook=str, decimal_format="number").encode(list(rows)))


def print_rows(
    rows: Sequence[Mapping[str, Any]],
    title: str = "",
    columns: Sequence[str] = (),
    width: int = 200,
    as_json: bool = False,
) -> None:
    """Print rows as JSON, or as a table for people whose `columns` are printed also when there is no row.

    `width`: of the table at most, where the output is no terminal.
    """
    if as_json:
        print_json(rows)
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    names = list(rows[0]) if rows else list(columns)
    table = Table(title=title or None, title_justify="left")
    for name in names:
        values = [row[name] for row in rows if row[name] is not None]
        numeric = bool(values) and all(isinstance(value, int | float) for value in values)
        table.add_column(Text(clean(name)), justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(_cell(row[name])) for name in names))
    Console(width=None if sys.stdout.isatty() else width, highlight=False).print(table)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.0f}" if 1e6 <= abs(value) < 1e15 else f"{value:.6g}"
    return clean(value)


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
    """Progress bars on stderr, silent where stderr is no terminal; yields the `Progress` callback that moves them.

    `beside` returns the text beside the bars, a few times a second. Warnings of the block become notes.
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
