"""`jrdb-avr generate` and `jrdb-avr stats`: generate the questions of a store, and count them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import click

from jrdb_avr.engine.commands._options import (
    FOLDER,
    Store,
    executor_option,
    form_option,
    open_store,
    pairs_option,
    store_option,
)
from jrdb_avr.engine.console import RowFormat, note, print_data, print_rows, progress_bar, warnings_as_notes
from jrdb_avr.schema.errors import StoreError


@click.command(epilog="Example: jrdb-avr generate --store store --profile paper --workers 2")
@store_option()
@click.option(
    "--profile",
    type=click.Choice(["all", "paper", "lite", "train"]),
    default="all",
    show_default=True,
    help="'all': as many questions as caps permit. 'paper': at most as many per family as in the paper. "
    "'lite': 240 of the questions of 'paper'. "
    "'train': a training set, without caps per person.",
)
@click.option("--n", type=click.IntRange(1), help="With --profile train: maximum number of questions.")
@click.option(
    "--disjoint-from",
    type=FOLDER,
    metavar="STORE",
    help="With --profile train: leave out a person at the times when a question of STORE needs this person.",
)
@executor_option
@click.option("--require-occlusion", is_flag=True, help="Skip sequences that have no occlusion labels.")
@click.option("--exclude-rejected", is_flag=True, help="Exclude questions that a reviewer rejected (see 'inspect').")
@pairs_option("--rule", "overrides", "Change a rule (see 'rules list'). May be repeated.")
@form_option
def generate(
    store: Store, exclude_rejected: bool, overrides: list[tuple[str, str]], form: RowFormat, **options: Any
) -> None:
    """Find questions in all sequences of a store, prove these questions, and write them into the store.

    For each template, the command prints the number of candidates, the number of candidates that each rule refused, and
    the number of questions. If a template has few questions, the command prints the reason. For each template, it also
    prints the quota, the number of time twins, and the shares of right answers of guessers that bound the number.

    The questions do not depend on the number of workers. A training set needs a store of its own. --profile train
    ignores the rules max_per_person and max_per_person_in_all.
    """
    from jrdb_avr.engine.generate import run
    from jrdb_avr.engine.pages.reviews import rejected
    from jrdb_avr.schema.rules import Rules, override

    rules = override(Rules(), dict(overrides))
    excluded = rejected(store) if exclude_rejected else frozenset()
    with progress_bar() as progress:
        made = run.generate(store, rules, excluded=excluded, progress=progress, **options)
    if form:
        print_data(made.rows(), form)
    else:
        # Templates are the columns, because there are more rules than columns that fit on a line.
        names = [name for name in made.templates[0] if name not in ("family", "template", "why")]
        crossed = [{"": name, **{row["template"]: row[name] for row in made.templates}} for name in names]
        print_rows(crossed, title="Candidates, refusals by rule, and questions")
        _print_reasons(made.templates)
        _print_table(
            [_with_guessers(row) for row in made.selection], "Selection, and shares of right answers of guessers"
        )
    for fault in made.faults[:10]:
        note(f"fault: another program gives another result: {fault}")
    if made.faults:
        note(f"{len(made.faults)} candidates were not confirmed by another program: this is a fault of the software")
        sys.exit(1)
    if (held_out := options["disjoint_from"]) and not any(row["reached"] for row in made.selection):
        raise StoreError(
            f"no question is left that is disjoint from {held_out}: hold out fewer questions or load more sequences"
        )


def _with_guessers(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row of a template's selection with its guessers as a text."""
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in row["guessers"].items())
    return {**row, "guessers": shares or None, "shortage": None}


@click.command(epilog="Example: jrdb-avr stats --store store")
@store_option()
@click.option(
    "--blind-from",
    metavar="STORE",
    type=FOLDER,
    callback=open_store,
    help="Add a guesser that learns from the questions of another store (pip install 'jrdb-avr[learned]').",
)
@click.option("--hash", "only_hash", is_flag=True, help="Print one line that is equal for equal questions and answers.")
@form_option
@click.option(
    "--latex", "as_latex", is_flag=True, help="Print the paper's table of question families in LaTeX (booktabs)."
)
def stats(store: Store, blind_from: Store | None, only_hash: bool, form: RowFormat, as_latex: bool) -> None:
    """Count the questions of a store by family, template, sequence and answer, and score guessers that see no image.

    The command also prints why a template has few questions.
    With --json and --csv, the column "table" holds the name of the table that contains the row.
    """
    if only_hash:
        from jrdb_avr.schema.tables import GENERATION_KEY

        table = store.questions("questions", ["question_id"])
        mark = (table.schema.metadata or {}).get(GENERATION_KEY.encode(), b"unknown").decode()
        click.echo(f"{len(table)} questions, generation {mark}")
        return
    if form and as_latex:
        raise click.UsageError(f"choose one of --{form} and --latex")

    from jrdb_avr.engine.report.formats import latex
    from jrdb_avr.engine.validate.statistics import TITLES, generator_rows, statistics

    with warnings_as_notes():
        tables = statistics(store, blind_from)
    if form:
        print_data(({"table": name, **row} for name, rows in tables.items() for row in rows), form)
        return
    if as_latex:
        click.echo(latex(generator_rows(tables)), nl=False)
        return
    for name, rows in tables.items():
        if rows:
            _print_table(rows, TITLES[name])


_REASONS: Final = ("why", "reason")
"""Columns with explanations. Explanations are too long for cells, so they are printed as lines below the table."""


def _print_table(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print rows as a table with at most three decimals. Print the reasons in the rows as lines below the table."""
    rounded = [
        {name: round(cell, 3) if isinstance(cell, float) else cell for name, cell in row.items()} for row in rows
    ]
    empty = {name for name in rounded[0] if all(row[name] is None for row in rounded)} if rounded else set()
    left_out = {*_REASONS, *empty}
    print_rows([{name: row[name] for name in row if name not in left_out} for row in rounded], title=title)
    _print_reasons(rows)


def _print_reasons(rows: Iterable[Mapping[str, Any]]) -> None:
    """Print why templates have few questions, and why guessers score more than allowed although they see no image."""
    for row in rows:
        if row.get("why"):
            click.echo(f"{row['template']}: {row['why']}")
        if row.get("reason"):
            click.echo(f"{row['form']} ({row['asks']}): above the aim of {row['aim']:g}; {row['reason']}")
