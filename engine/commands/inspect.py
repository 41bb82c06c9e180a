"""`jrdb-avr inspect`: questions as a page for a person to judge, and what people decided."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from jrdb_avr.engine.console import json_option, note, print_json, print_rows, progress, store_option


@click.command(
    epilog="Examples: jrdb-avr inspect --sample 20 --store S --out inspect.html   |   "
    "jrdb-avr inspect --import decisions.json --reviewer ada --store S"
)
@click.argument("questions", nargs=-1, metavar="[QUESTION]...")
@store_option
@click.option("--sample", type=click.IntRange(1, 1000), help="Instead of QUESTIONs: so many, drawn at random.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the random draw.")
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("inspect.html"),
    show_default=True,
    help="HTML file to write.",
)
@click.option(
    "--import", "decisions", type=click.Path(dir_okay=False, path_type=Path), help="Store a page's decisions."
)
@click.option("--reviewer", help="Who decided; with --import.")
@json_option
def command(
    questions: tuple[str, ...],
    store: Path,
    sample: int | None,
    seed: int,
    out: Path,
    decisions: Path | None,
    reviewer: str | None,
    as_json: bool,
) -> None:
    """Write a page that shows questions with their answers, plans, proofs and views, or store what was decided on it.

    On the page: a accepts, r rejects, u undoes, j and k go on and back. With --import, prints how far every two
    reviewers agree (Cohen's kappa).
    """
    if (decisions is None) != (reviewer is None):
        raise click.UsageError("--import and --reviewer go together")
    if decisions is not None and reviewer is not None:
        if questions or sample is not None:
            raise click.UsageError("--import takes no QUESTION and no --sample")
        _import(store, decisions, reviewer, as_json)
        return
    if bool(questions) == (sample is not None):
        raise click.UsageError("give QUESTION ids or --sample N")

    from jrdb_avr.engine.observe.observer import Observer
    from jrdb_avr.engine.pages.inspect_data import choose_questions, inspect_questions
    from jrdb_avr.engine.pages.inspect_page import inspect_page
    from jrdb_avr.engine.pages.page import write_page
    from jrdb_avr.engine.run.evaluate import read_sequences
    from jrdb_avr.queries.runs import questions_hash
    from jrdb_avr.queries.store import Store

    opened = Store(store)
    chosen = choose_questions(opened, questions, sample, seed)
    found = inspect_questions(opened, chosen)
    observer = Observer(opened.manifest().image_root, read_sequences(opened).values())
    with progress("inspect", len(found)) as advance:
        write_page(out, inspect_page(found, observer, questions_hash(opened), advance))
    if as_json:
        print_json([{"question_id": name} for name in chosen])
    note(f"wrote {out}: {len(found)} questions")


def _import(store: Path, decisions: Path, reviewer: str, as_json: bool) -> None:
    from jrdb_avr.engine.validate.reviews import agreements, import_decisions, read_decisions
    from jrdb_avr.queries.store import Store

    name = reviewer.strip()
    if not 1 <= len(name) <= 80 or not name.isprintable():
        raise click.UsageError("--reviewer is a name of 1 to 80 printable characters")
    opened = Store(store)
    read = read_decisions(decisions, opened)
    reviews = import_decisions(opened, name, read.decisions)
    rows = [dataclasses.asdict(agreement) for agreement in agreements(reviews.to_pylist())]
    if as_json:
        print_json(rows)
    elif rows:
        print_rows([{**row, "kappa": None if row["kappa"] is None else round(row["kappa"], 3)} for row in rows])
    note(f"{len(read.decisions)} decisions of {name} stored; {reviews.num_rows} reviews in all")
