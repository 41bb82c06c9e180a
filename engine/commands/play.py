"""`jrdb-avr play`: let a person answer the questions in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from jrdb_avr.engine.commands._declared import FILTERS, build, field_options
from jrdb_avr.engine.commands._next import scoring_steps
from jrdb_avr.engine.commands._options import Store, port_option, store_option
from jrdb_avr.engine.console import note, warnings_as_notes
from jrdb_avr.engine.run.options import QuestionSelection, RunOptions


@click.command(epilog="Example: jrdb-avr play --store S --name ada --per-template 2 --seed 1")
@store_option()
@click.option("--name", default="person", show_default=True, help="Name of the person in the run and in reports.")
@field_options(RunOptions, "run_id", "resume", "images")
@field_options(QuestionSelection, "questions", *FILTERS, "per_template", "limit", "seed")
@port_option
def command(store: Store, name: str, run_id: str | None, resume: bool, port: int, **options: Any) -> None:
    """Let a person answer the questions of a store in the browser, and record the answers as a run of method 'human'.

    The person can do what the method react can do: look at an angle of a frame, draw a box in the newest picture, and
    answer. The command prints the address of the page. The address contains a token. Ctrl-C ends the command.

    To measure how well people agree, start the command once per person, each time with a different --name and otherwise
    with the same options. 'report --table people' then shows the agreement.
    """
    from jrdb_avr.engine.local_server import LocalServer
    from jrdb_avr.engine.pages.page import render
    from jrdb_avr.engine.report.people import HUMAN
    from jrdb_avr.engine.run.human import HumanDesk
    from jrdb_avr.engine.run.playing import played_run

    images: Path | None = options.pop("images")
    selection = build(QuestionSelection, {**options, "questions": options["questions"] or ()})
    with (
        warnings_as_notes(),
        played_run(store, HUMAN, name, run_id, questions=selection, resume=resume, images=images) as (bench, run),
        LocalServer(HumanDesk(bench, run, render("play.html", who=name)).respond, port) as server,
    ):
        click.echo(server.url)
        note("open this address in a browser; Ctrl-C ends the command, and --resume continues the run")
        server.serve_forever()
    if run.finished:
        note(f"next: {scoring_steps(store.path, run.run_id)}")
