"""Options that several commands share. `--store` arrives as a Store, `--rule` and its like as pairs of texts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import click

_C = TypeVar("_C", bound=Callable[..., Any])

FILE: Final = click.Path(dir_okay=False, path_type=Path)
FOLDER: Final = click.Path(file_okay=False, path_type=Path)


def open_store(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> Any:
    """The store at a path that an option or argument names."""
    from jrdb_avr.queries.store import Store

    return None if path is None else Store(path)


def store_option(required: bool = True) -> Callable[[_C], _C]:
    """Add the option `--store` as a Store."""
    return click.option("--store", required=required, type=FOLDER, callback=open_store, help="Folder of the store.")


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON array of objects.")

workers_option = click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes.")

iou_option = click.option(
    "--iou", type=click.FloatRange(0.0, 1.0, min_open=True), default=0.5, show_default=True, help="Evidence."
)


def page_option(default: str) -> Callable[[_C], _C]:
    """Add the option `--out` of a page."""
    return click.option("--out", type=FILE, default=Path(default), show_default=True, help="HTML file to write.")


def pairs_option(flag: str, parameter: str, help_text: str, metavar: str = "NAME=VALUE") -> Callable[[_C], _C]:
    """Add an option that may be repeated, as a list of (name, value)."""

    def split(ctx: click.Context, own: click.Parameter, texts: tuple[str, ...]) -> list[tuple[str, str]]:
        for text in texts:
            if "=" not in text:
                raise click.UsageError(f"{flag} {text}: write {metavar}")
        return [(name, value) for name, _, value in (text.partition("=") for text in texts)]

    return click.option(flag, parameter, multiple=True, metavar=metavar, callback=split, help=help_text)
