"""`jrdb-avr stats`: what a benchmark holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from jrdb_avr.engine.console import json_option, note, print_json, print_rows, store_option


@click.command(
    short_help="Count questions; show what a blind guesser scores.",
    epilog="Example: jrdb-avr stats --store store --picture stats.svg",
)
@store_option
@click.option(
    "--picture",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Also draw the distributions into this SVG file.",
)
@json_option
def command(store: Path, picture: Path | None, as_json: bool) -> None:
    """Count the questions of STORE by family, template, sequence, answer; score guessers that see no image.

    Says for each template what became of its candidates and, where there are few questions, why. With --json each row
    object names its table under "table".
    """
    from jrdb_avr.engine.commands._print import print_blind, print_shortfalls, rounded
    from jrdb_avr.engine.generate.diagnostics import REFUSALS
    from jrdb_avr.engine.validate.statistics import TITLES, statistics
    from jrdb_avr.queries.store import Store

    tables = statistics(Store(store))
    if picture is not None:
        from jrdb_avr.engine.pages.page import write_page
        from jrdb_avr.engine.pages.stats import stats_svg

        write_page(picture, stats_svg(tables))
        note(f"picture: {picture}")
    if as_json:
        print_json([{"table": name, **row} for name, rows in tables.items() for row in rows])
        return
    for name, rows in tables.items():
        if name == "blind":
            print_blind(rows, TITLES[name])
        elif name == "refusal":
            print_rows(_crossed(rows, REFUSALS), title=TITLES[name])
        elif rows:
            print_rows([_short(row) for row in rounded(rows)], title=TITLES[name])
        if name == "shortfall":
            print_shortfalls(rows)


def _crossed(rows: Sequence[Mapping[str, Any]], rules: Sequence[str]) -> list[dict[str, Any]]:
    """A row per rule and a column per template: a row for each pair would be a long table."""
    counts = {(row["rule"], row["template"]): row["candidates"] for row in rows}
    templates = sorted({template for _, template in counts})
    return [
        {"": rule, **{name: counts.get((rule, name), 0) for name in templates}}
        for rule in rules
        if any(refused == rule for refused, _ in counts)
    ]


def _short(row: dict[str, object]) -> dict[str, object]:
    """Without what is printed below the table."""
    return {name: value for name, value in row.items() if name not in ("why", "skipped")}
