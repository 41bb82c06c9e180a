"""Options that several commands share.

The option `--store` becomes a Store, and each `--rule NAME=VALUE` becomes a pair of texts.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import click

from jrdb_avr.engine.commands._complete import complete_run

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store as Store
else:
    # Commands name this class only in annotations, and its import would slow down the start of each command.
    Store = Any

_C = TypeVar("_C", bound=Callable[..., Any])

STORE_VARIABLE: Final = "JRDB_AVR_STORE"

FILE: Final = click.Path(dir_okay=False, path_type=Path)

FOLDER: Final = click.Path(file_okay=False, path_type=Path)


def open_store(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> Any:
    """Return the store at a path, or None if the path is None. Raise StoreError if a newer program wrote the store."""
    from jrdb_avr.queries.manifest import refuse_newer
    from jrdb_avr.queries.store import Store as Store

    if path is None:
        return None
    # Shell completion reports no errors.
    if not ctx.resilient_parsing:
        refuse_newer(path)
    return Store(path)


def store_option(required: bool = True) -> Callable[[_C], _C]:
    """Add the option `--store`, with the environment variable `JRDB_AVR_STORE` as default. The command gets a Store."""
    return click.option(
        "--store",
        "-s",
        required=required,
        # Click parses this option first, because completing the values of other options needs the store.
        is_eager=True,
        type=FOLDER,
        envvar=STORE_VARIABLE,
        callback=open_store,
        help=f"Folder of the store. Not needed if the environment variable {STORE_VARIABLE} names the folder.",
    )


def given(store: Store | None) -> Store:
    """Return the store of a command that needs none in some forms. Raise UsageError if this form lacks it."""
    if store is None:
        raise click.UsageError("Missing option '--store'.")
    return store


def run_argument(name: str, **options: Any) -> Callable[[_C], _C]:
    """Add an argument for the name of a run, or for the names of several runs."""
    return click.argument(name, shell_complete=complete_run, **options)


def form_option(function: _C) -> Callable[..., Any]:
    """Add the options `--json` and `--csv`. The command gets `form`, which is "json", "csv", or "" for a text table."""

    @functools.wraps(function)
    def command(*, as_json: bool, as_csv: bool, **values: Any) -> Any:
        if as_json and as_csv:
            raise click.UsageError("choose one of --json and --csv")
        return function(**values, form="json" if as_json else "csv" if as_csv else "")

    as_csv = click.option("--csv", "as_csv", is_flag=True, help="Print the rows as CSV.")
    return click.option("--json", "as_json", is_flag=True, help="Print the rows as a JSON array.")(as_csv(command))


workers_option = click.option(
    "--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Number of processes."
)


def executor_option(function: _C) -> Callable[..., Any]:
    """Add the options `--workers` and `--executor`. The command gets both as one argument `workers`, an `Executor`."""

    def check(ctx: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
        if value is None or value == "ray" or value.startswith("ray://"):
            return value
        raise click.BadParameter("write ray, or ray://HOST:PORT")

    @functools.wraps(function)
    def command(*, workers: int, executor: str | None, **values: Any) -> Any:
        return function(**values, workers=executor or workers)

    executor = click.option(
        "--executor",
        metavar="ray[://HOST:PORT]",
        callback=check,
        help="Use a Ray cluster instead of local processes. Each folder must have the same path on all machines.",
    )
    return workers_option(executor(command))


iou_option = click.option(
    "--iou",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    default=0.5,
    show_default=True,
    help="Evidence is right if the IoU of the predicted box and the true box is at least this value.",
)

port_option = click.option(
    "--port", type=click.IntRange(0, 65535), default=0, show_default=True, help="Port on 127.0.0.1. 0: any free port."
)


def page_option(default: str) -> Callable[[_C], _C]:
    """Add the option `--out` for the HTML file of a page."""
    return click.option("--out", type=FILE, default=Path(default), show_default=True, help="HTML file to write.")


def pairs_option(flag: str, parameter: str, help_text: str, metavar: str = "NAME=VALUE") -> Callable[[_C], _C]:
    """Add a repeatable option with values of the form NAME=VALUE. The command gets a list of pairs (name, value)."""

    def split(ctx: click.Context, parameter: click.Parameter, texts: tuple[str, ...]) -> list[tuple[str, str]]:
        for text in texts:
            if "=" not in text:
                raise click.UsageError(f"{flag} {text}: write {metavar}")
        return [(name, value) for name, _, value in (text.partition("=") for text in texts)]

    return click.option(flag, parameter, multiple=True, metavar=metavar, callback=split, help=help_text)
