"""`jrdb-avr generate`: questions with proofs from a store."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from jrdb_avr.engine.console import (
    clean,
    json_option,
    note,
    pairs,
    print_json,
    print_rows,
    progress,
    rule_option,
    store_option,
    workers_option,
)


@click.command(
    short_help="Find questions, prove them and write the benchmark.",
    epilog="Example: jrdb-avr generate --store store --profile paper --workers 2",
)
@store_option
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
    "--candidates",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Also write every proven candidate before selection to this Parquet file.",
)
@click.option("--exclude-rejected", is_flag=True, help="Leave out what a reviewer rejected (see inspect --import).")
@rule_option("Override a rule; may be given often.")
@json_option
def command(
    store: Path,
    profile: str,
    workers: int,
    seed: int,
    candidates: Path | None,
    exclude_rejected: bool,
    rule_texts: tuple[str, ...],
    as_json: bool,
) -> None:
    """Search every sequence of STORE for questions, keep those whose proofs hold, and write them to STORE/questions.

    Prints per template the candidates, how many each rule refused, the questions, why there are few, and what a blind
    guesser scores; with --profile paper also how many of each family were reached. The result is the same for any
    number of workers.
    """
    from jrdb_avr.engine.commands._print import print_blind, print_shortfalls
    from jrdb_avr.engine.generate.diagnostics import fillings
    from jrdb_avr.engine.generate.run import generate
    from jrdb_avr.engine.validate.reviews import rejected
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import Rules, override

    place = Store(store)
    rules = override(Rules(), pairs("--rule", rule_texts))
    excluded = rejected(place) if exclude_rejected else frozenset()
    with progress("searching", len(place.manifest().sequences)) as advance:
        report = generate(
            place,
            rules,
            profile=profile,
            seed=seed,
            workers=workers,
            candidates=candidates,
            excluded=excluded,
            advance=advance,
        )
    if as_json:
        aims = {row["template"]: row["aim"] for row in report.selection}
        print_json(
            [
                {**row, **short, "aim": aims[row["template"]], "blind": _of(row["template"], report.blind)}
                for row, short in zip(report.templates, report.shortfalls, strict=True)
            ]
        )
    else:
        print_rows(_columns(report.templates), title="Candidates, refusals by rule, and questions")
        print_shortfalls(report.shortfalls)
        if families := fillings(report.selection):
            print_rows(families, title="Questions aimed at and reached, and which template fills for which")
        print_blind(report.blind, "Answering without looking: shares of right answers")
    for fault in report.faults[:10]:
        note(f"fault: the second path disagrees: {clean(fault)}")
    if report.faults:
        note(f"{len(report.faults)} candidates were refused by the second path: this is a fault of the program")
        sys.exit(1)


def _of(template: str, rows: tuple[dict[str, Any], ...]) -> list[dict[str, Any]]:
    return [row for row in rows if row["template"] == template]


def _columns(rows: tuple[dict[str, Any], ...]) -> list[dict[str, Any]]:
    """The rows turned round, a column per template: there are more rules than fit on a line."""
    names = [name for name in rows[0] if name not in ("family", "template")]
    return [{"": name, **{row["template"]: row[name] for row in rows}} for name in names]
