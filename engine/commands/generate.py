"""`jrdb-avr generate` and `jrdb-avr stats`: make the questions of a store, and count them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jrdb_avr.engine.commands._options import FILE, json_option, pairs_option, store_option, workers_option
from jrdb_avr.engine.console import note, print_json, print_rows, progress_bar

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store


@click.command(
    short_help="Find questions, prove them and write the benchmark.",
    epilog="Example: jrdb-avr generate --store store --profile paper --workers 2",
)
@store_option()
@click.option(
    "--profile",
    type=click.Choice(["all", "paper"]),
    default="all",
    show_default=True,
    help="How many questions of each family: all that balance leaves, or the paper's numbers.",
)
@workers_option
@click.option("--seed", type=int, default=0, show_default=True, help="Decides between equally good selections.")
@click.option(
    "--candidates", type=FILE, help="Also write every proven candidate before selection to this Parquet file."
)
@click.option("--exclude-rejected", is_flag=True, help="Leave out what a reviewer rejected (see inspect --import).")
@pairs_option("--rule", "overrides", "Override a rule; may be given often.")
@json_option
def generate(
    store: Store, exclude_rejected: bool, overrides: list[tuple[str, str]], as_json: bool, **options: Any
) -> None:
    """Search every sequence of STORE for questions, keep those whose proofs hold, and write them to STORE/questions.

    Prints per template the candidates, how many each rule refused, the questions, why there are few, and what a blind
    guesser scores; with --profile paper also how many of each family were reached. The result is the same for any
    number of workers.
    """
    from jrdb_avr.engine.generate import run
    from jrdb_avr.engine.generate.diagnostics import fillings
    from jrdb_avr.engine.validate.reviews import rejected
    from jrdb_avr.schema.rules import Rules, override

    rules = override(Rules(), dict(overrides))
    excluded = rejected(store) if exclude_rejected else frozenset()
    with progress_bar() as progress:
        made = run.generate(store, rules, excluded=excluded, progress=progress, **options)
    if as_json:
        aims = {row["template"]: row["aim"] for row in made.selection}
        print_json(
            {
                **row,
                **short,
                "aim": aims[row["template"]],
                "blind": [own for own in made.blind if own["template"] == row["template"]],
            }
            for row, short in zip(made.templates, made.shortfalls, strict=True)
        )
    else:
        # A column per template: there are more rules than fit on a line.
        names = [name for name in made.templates[0] if name not in ("family", "template")]
        crossed = [{"": name, **{row["template"]: row[name] for row in made.templates}} for name in names]
        print_rows(crossed, title="Candidates, refusals by rule, and questions")
        _print_shortfalls(made.shortfalls)
        if families := fillings(made.selection):
            print_rows(families, title="Questions aimed at and reached, and which template fills for which")
        _print_blind(made.blind, "Answering without looking: shares of right answers")
    for fault in made.faults[:10]:
        note(f"fault: the second path disagrees: {fault}")
    if made.faults:
        note(f"{len(made.faults)} candidates were refused by the second path: this is a fault of the program")
        sys.exit(1)


@click.command(
    short_help="Count questions; show what a blind guesser scores.",
    epilog="Example: jrdb-avr stats --store store --picture stats.svg",
)
@store_option()
@click.option("--picture", type=FILE, help="Also draw the distributions into this SVG file.")
@json_option
def stats(store: Store, picture: Path | None, as_json: bool) -> None:
    """Count the questions of STORE by family, template, sequence, answer; score guessers that see no image.

    Says for each template what became of its candidates and, where there are few questions, why. With --json each row
    object names its table under "table".
    """
    from jrdb_avr.engine.generate.diagnostics import REFUSALS
    from jrdb_avr.engine.validate.statistics import TITLES, statistics

    tables = statistics(store)
    if picture is not None:
        from jrdb_avr.engine.pages.page import write_page
        from jrdb_avr.engine.pages.stats import stats_svg

        write_page(picture, stats_svg(tables))
        note(f"picture: {picture}")
    if as_json:
        print_json({"table": name, **row} for name, rows in tables.items() for row in rows)
        return
    for name, rows in tables.items():
        if name == "blind":
            _print_blind(rows, TITLES[name])
        elif name == "refusal":
            print_rows(_crossed(rows, REFUSALS), title=TITLES[name])
        elif rows:
            # Reasons are printed below the table.
            print_rows(_rounded(rows, ("why", "skipped")), title=TITLES[name])
        if name == "shortfall":
            _print_shortfalls(rows)


def _crossed(rows: Sequence[Mapping[str, Any]], rules: Sequence[str]) -> list[dict[str, Any]]:
    """A row per rule and a column per template: a row for each pair would be a long table."""
    counts = {(row["rule"], row["template"]): row["candidates"] for row in rows}
    templates = sorted({template for _, template in counts})
    return [
        {"": rule, **{name: counts.get((rule, name), 0) for name in templates}}
        for rule in rules
        if any(refused == rule for refused, _ in counts)
    ]


def _rounded(rows: Iterable[Mapping[str, Any]], left_out: Sequence[str]) -> list[dict[str, Any]]:
    """The rows without some columns, with three decimals at most."""
    return [
        {key: round(cell, 3) if isinstance(cell, float) else cell for key, cell in row.items() if key not in left_out}
        for row in rows
    ]


def _print_shortfalls(rows: Iterable[Mapping[str, Any]]) -> None:
    for row in rows:
        if row["why"]:
            click.echo(f"{row['template']}: {row['why']}")


def _print_blind(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print the scores of blind guessers, and a line for each aim that is missed."""
    print_rows(_rounded(rows, ["reason"]), title=title)
    for row in rows:
        if row["reason"]:
            click.echo(f"{row['template']} ({row['asks']}): above the aim of {row['aim']:g}; {row['reason']}")
