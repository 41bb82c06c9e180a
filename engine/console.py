"""How commands talk: rows as table, CSV, JSON or Parquet, progress bars, and the options they share.

Rows go to stdout, everything else to stderr. `--json` prints exactly one JSON array of row objects. Text from data
files or models is stripped of control characters before it reaches a terminal.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click
import msgspec

C = TypeVar("C", bound=Callable[..., Any])

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def clean(value: object) -> str:
    """The value as text that cannot move a terminal's cursor or change its colours."""
    return _CONTROL.sub("", "" if value is None else str(value))


def store_option(function: C) -> C:
    """Add the required option `--store`."""
    return click.option(
        "--store", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder of the store."
    )(function)


def workers_option(function: C) -> C:
    """Add the option `--workers`: processes that share the sequences; the result does not depend on it."""
    return click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes.")(
        function
    )


def json_option(function: C) -> C:
    """Add the flag `--json` as the parameter `as_json`."""
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON array of objects.")(function)


def rule_option(help_text: str) -> Callable[[C], C]:
    """Add the option `--rule`, to be given often, as the parameter `rule_texts`; `pairs` reads it."""
    return click.option("--rule", "rule_texts", multiple=True, metavar="NAME=VALUE", help=help_text)


def pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Values of a repeated option NAME=VALUE by name. Raises UsageError where there is no "="."""
    found = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise click.UsageError(f"{option} {text}: write NAME=VALUE")
        found[name] = value
    return found


def print_json(rows: Sequence[Any]) -> None:
    """Print one JSON array."""
    # NaN and infinity are not JSON: msgspec writes null for them. Sums of whole numbers come as decimals.
    click.echo(msgspec.json.Encoder(enc_hook=str, decimal_format="number").encode(list(rows)))


def print_rows(rows: Sequence[dict[str, Any]], title: str = "", columns: Sequence[str] = (), width: int = 200) -> None:
    """Print rows as a table for people; `columns` are printed also when there is no row.

    `width`: of the table at most, where the output is no terminal.
    """
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


def note(message: str) -> None:
    """One line on stderr."""
    click.echo(clean(message), err=True)


@contextmanager
def progress(what: str, total: int | None, beside: Callable[[], str] = lambda: "") -> Iterator[Callable[[int], None]]:
    """A progress bar on stderr, silent where stderr is no terminal; yields a function that advances it.

    `beside` is asked for the text that stands beside the bar, a few times a second.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeElapsedColumn
    from rich.text import Text

    class Beside(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(beside())

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), Beside())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=total)

        def advance(steps: int = 1) -> None:
            bar.advance(task, steps)

        yield advance
