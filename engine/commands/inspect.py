"""`jrdb-avr inspect`: write a page on which a reviewer judges questions, and store the decisions of reviewers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from jrdb_avr.engine.commands._declared import FILTERS, build, field_options
from jrdb_avr.engine.commands._options import FILE, Store, form_option, page_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_data, print_rows, progress_bar
from jrdb_avr.engine.run.options import QuestionSelection


@click.command()
@click.argument("ids", nargs=-1, metavar="[QUESTION]...")
@store_option()
@field_options(QuestionSelection, "questions", *FILTERS)
@click.option("--sample", type=click.IntRange(1, 1000), help="Show only this many random ones of the questions.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random questions.")
@page_option("inspect.html")
@click.option("--import", "decisions", type=FILE, help="Store the decisions from a file that the page saved.")
@click.option("--reviewer", help="With --import: name of the reviewer.")
@form_option
def command(
    ids: tuple[str, ...], store: Store, sample: int | None, seed: int, out: Path, form: RowFormat, **review: Any
) -> None:
    """Write a page on which a reviewer accepts or rejects questions, or store the decisions of a reviewer.

    The page shows the answer, plan, proofs and pictures of each QUESTION (an id), or of the questions that --questions,
    --family, --template, --sequence and --sample select. On the page, the key 'a' accepts a question, the key 'r'
    rejects the question, and the key 'u' undoes the decision. The keys 'j' and 'k' go to the next and the previous
    question. The keys ',' and '.' go one second back and forward in time. The page saves the decisions as a file for
    --import.

    With --import, the command prints how well each pair of reviewers agrees (Cohen's kappa).

    Examples:
      jrdb-avr inspect --sample 20 --store S --out inspect.html
      jrdb-avr inspect --import decisions.json --reviewer ada --store S
    """
    decisions, reviewer = review["decisions"], review["reviewer"]
    selection = build(QuestionSelection, {**review, "questions": ids + (review["questions"] or ())})
    if (decisions is None) != (reviewer is None):
        raise click.UsageError("--import and --reviewer go together")
    if decisions is not None:
        if selection.record() or sample is not None:
            raise click.UsageError("--import selects no questions")
        _import(store, decisions, reviewer.strip(), form)
        return
    if not selection.record() and sample is None:
        raise click.UsageError("say which questions: --questions, --family, --template, --sequence or --sample N")

    from jrdb_avr.engine.observe.observer import Observer
    from jrdb_avr.engine.pages.inspect import choose_questions, inspect_page, inspect_questions
    from jrdb_avr.engine.pages.page import write_page
    from jrdb_avr.engine.run.selection import matching
    from jrdb_avr.queries.display import step_counter
    from jrdb_avr.queries.questions import read_question_rows
    from jrdb_avr.queries.runs import questions_hash

    chosen = [question.question_id for question in matching(read_question_rows(store), selection)]
    if sample is not None:
        chosen = choose_questions(chosen, sample, seed)
    inspected = inspect_questions(store, chosen)
    with progress_bar() as progress:
        advance = step_counter(progress, "inspect", len(inspected))
        write_page(out, inspect_page(inspected, Observer(store), questions_hash(store), advance))
    if form:
        print_data([{"question_id": name} for name in chosen], form)
    note(f"wrote {out}: {len(inspected)} questions")


def _import(store: Store, decisions: Path, reviewer: str, form: RowFormat) -> None:
    from jrdb_avr.engine.pages.reviews import import_decisions, read_decisions
    from jrdb_avr.queries.statements import read_statement

    if not 1 <= len(reviewer) <= 80 or not reviewer.isprintable():
        raise click.UsageError("--reviewer is a name of 1 to 80 printable characters")
    read = read_decisions(decisions, store)
    reviews = import_decisions(store, reviewer, read.decisions)
    rows = store.sql(read_statement("stats/agreements.sql")).to_pylist()
    rounded = [{**row, "kappa": None if row["kappa"] is None else round(row["kappa"], 3)} for row in rows]
    if rows or form:
        print_rows(rows if form else rounded, form=form)
    note(f"{len(read.decisions)} decisions of {reviewer} stored; {reviews.num_rows} reviews in all")
