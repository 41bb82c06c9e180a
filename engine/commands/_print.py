"""What `generate` and `stats` print alike: shares a person can read, few questions and why, the blind check."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import click

from jrdb_avr.engine.console import print_rows


def rounded(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows with three decimals at most."""
    return [
        {name: round(value, 3) if isinstance(value, float) else value for name, value in row.items()} for row in rows
    ]


def print_shortfalls(rows: Iterable[dict[str, Any]]) -> None:
    """A line for each template of which there are few questions, or none."""
    for row in rows:
        if row["why"]:
            click.echo(f"{row['template']}: {row['why']}")


def print_blind(rows: Sequence[dict[str, Any]], title: str) -> None:
    """The blind check, and below it a line for each aim that is missed."""
    print_rows([{name: row[name] for name in row if name != "reason"} for row in rounded(rows)], title=title)
    for row in rows:
        if row["reason"]:
            click.echo(f"{row['template']} ({row['asks']}): above the aim of {row['aim']:g}; {row['reason']}")
