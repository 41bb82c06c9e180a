"""`jrdb-avr generate` and `jrdb-avr stats`: make the questions of a store, and count them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import click

from jrdb_avr.engine.commands._options import FILE, FOLDER, executor_option, form_option, pairs_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_data, print_rows, progress_bar, warnings_as_notes

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store


_blind_option = click.option(
    "--blind",
    type=click.Choice(["simple", "learned"]),
    default="simple",
    show_default=True,
    help="Guessers of the blind check; 'learned' adds one that learns from the text (pip install 'jrdb-avr[learned]').",
)


@click.command(epilog="Example: jrdb-avr generate --store store --profile paper --workers 2")
@store_option()
@click.option(
    "--profile",
    type=click.Choice(["all", "paper", "train"]),
    default="all",
    show_default=True,
    help="Number of questions per family. 'all': as many as balance allows. 'paper': the numbers of the paper. "
    "'train': a training set, without caps per person and without limits on answers.",
)
@click.option("--n", type=click.IntRange(1), help="With --profile train: maximum number of questions.")
@click.option(
    "--disjoint-from",
    type=FOLDER,
    metavar="STORE",
    help="With --profile train: leave out questions that need a person of a question of STORE at the same time.",
)
@executor_option
@click.option("--seed", type=int, default=0, show_default=True, help="Seed that decides among equal selections.")
@click.option("--candidates", type=FILE, help="Parquet file to which every proven candidate is also written.")
@click.option("--require-occlusion", is_flag=True, help="Skip sequences whose boxes have no occlusion attributes.")
@click.option("--exclude-rejected", is_flag=True, help="Leave out what reviewers rejected (inspect --import).")
@pairs_option("--rule", "overrides", "Override a rule; may be repeated. Caps that --profile train lifts stay lifted.")
@_blind_option
@form_option
def generate(
    store: Store, exclude_rejected: bool, overrides: list[tuple[str, str]], blind: str, form: RowFormat, **options: Any
) -> None:
    """Search every sequence of a store for questions, and write the questions whose proofs hold to STORE/questions.

    The command prints for each template the candidates, the refusals by rule, the questions, the reasons if there are
    few, and the score of a blind guesser. With --profile paper it also prints how many questions each family got. The
    number of workers does not change the result. A training set needs a store of its own.
    """
    from jrdb_avr.engine.generate import run
    from jrdb_avr.engine.generate.diagnostics import fillings
    from jrdb_avr.engine.validate.reviews import rejected
    from jrdb_avr.schema.rules import Rules, override

    rules = override(Rules(), dict(overrides))
    excluded = rejected(store) if exclude_rejected else frozenset()
    with progress_bar() as progress:
        made = run.generate(store, rules, excluded=excluded, learned=blind == "learned", progress=progress, **options)
    if form:
        print_data(made.rows(), form)
    else:
        # A column per template: there are more rules than fit on a line.
        names = [name for name in made.templates[0] if name not in ("family", "template")]
        crossed = [{"": name, **{row["template"]: row[name] for row in made.templates}} for name in names]
        print_rows(crossed, title="Candidates, refusals by rule, and questions")
        _print_reasons(made.shortfalls)
        if families := fillings(made.selection):
            print_rows(families, title="Questions aimed at and reached, and which template fills for which")
        _print_table(made.blind, "Answering without looking: shares of right answers")
    for fault in made.faults[:10]:
        note(f"fault: the second program disagrees: {fault}")
    if made.faults:
        note(f"{len(made.faults)} candidates were refused by the second program: this is a fault of the software")
        sys.exit(1)


@click.command(epilog="Example: jrdb-avr stats --store store")
@store_option()
@_blind_option
@form_option
@click.option(
    "--latex", "as_latex", is_flag=True, help="Print the paper's table of generators, for the package booktabs."
)
def stats(store: Store, blind: str, form: RowFormat, as_latex: bool) -> None:
    """Count the questions of a store by family, template, sequence and answer, and score guessers that see no image.

    For each template the command prints the refusals of its candidates, and the reasons if there are few questions.
    With --json each row object names its table under "table".
    """
    if form and as_latex:
        raise click.UsageError(f"choose one of --{form} and --latex")

    from jrdb_avr.engine.generate.diagnostics import REFUSALS
    from jrdb_avr.engine.generate.learned import learned_guesser
    from jrdb_avr.engine.report.formats import latex
    from jrdb_avr.engine.validate.statistics import TITLES, generator_rows, statistics

    with warnings_as_notes():
        tables = statistics(store, learned_guesser() if blind == "learned" else None)
    if form:
        print_data(({"table": name, **row} for name, rows in tables.items() for row in rows), form)
        return
    if as_latex:
        click.echo(latex(generator_rows(tables)), nl=False)
        return
    for name, rows in tables.items():
        if rows:
            _print_table(_crossed(rows, REFUSALS) if name == "refusal" else rows, TITLES[name])


def _crossed(rows: Sequence[Mapping[str, Any]], rules: Sequence[str]) -> list[dict[str, Any]]:
    """A row per rule and a column per template: a row for each pair would be a long table."""
    templates = dict.fromkeys(sorted({row["template"] for row in rows}), 0)
    crossed = {rule: {"": rule, **templates} for rule in rules}
    for row in rows:
        crossed[row["rule"]][row["template"]] = row["candidates"]
    refusing = {row["rule"] for row in rows}
    return [row for rule, row in crossed.items() if rule in refusing]


_REASONS: Final = ("why", "skipped", "reason")
"""Columns of explanations, which are too long for a cell and are printed as lines below their table."""


def _print_table(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print rows with three decimals at most, and the reasons among them as lines."""
    rounded = [
        {name: round(cell, 3) if isinstance(cell, float) else cell for name, cell in row.items()} for row in rows
    ]
    empty = {name for name in rounded[0] if all(row[name] is None for row in rounded)} if rounded else set()
    left_out = {*_REASONS, *empty}
    print_rows([{name: row[name] for name in row if name not in left_out} for row in rounded], title=title)
    _print_reasons(rows)


def _print_reasons(rows: Iterable[Mapping[str, Any]]) -> None:
    """Print why a template has few questions, and why a blind guesser is above its aim."""
    for row in rows:
        if row.get("why"):
            click.echo(f"{row['template']}: {row['why']}")
        if row.get("reason"):
            click.echo(f"{row['form']} ({row['asks']}): above the aim of {row['aim']:g}; {row['reason']}")
