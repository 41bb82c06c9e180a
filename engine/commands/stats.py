"""`jrdb-avr stats`: what a benchmark holds."""

from __future__ import annotations

from pathlib import Path

import click

from jrdb_avr.engine.output import json_option, print_json, print_rows, store_option


@click.command(
    short_help="Count questions; show what a blind guesser scores.",
    epilog="Example: jrdb-avr stats --store store --json",
)
@store_option
@json_option
def command(store: Path, as_json: bool) -> None:
    """Count the questions of STORE by family, template, sequence, answer; score guessers that see no image.

    With --json each row object names its table under "table".
    """
    from jrdb_avr.engine.stats import TITLES, statistics
    from jrdb_avr.queries.store import Store

    tables = statistics(Store(store))
    if as_json:
        print_json([{"table": name, **row} for name, rows in tables.items() for row in rows])
        return
    for name, rows in tables.items():
        if rows:
            print_rows(rows, title=TITLES[name])
