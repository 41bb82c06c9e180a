"""`jrdb-avr play`: let a person answer the questions in the browser."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jrdb_avr.engine.commands._options import FOLDER, port_option, store_option
from jrdb_avr.engine.console import note, warnings_as_notes

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store


@click.command(epilog="Example: jrdb-avr play --store S --name ada --per-template 2 --seed 1")
@store_option()
@click.option("--name", default="person", show_default=True, help="Who plays, for the run and its reports.")
@click.option("--run-id", help="Name of the run; human-NAME if left out.")
@click.option(
    "--per-template",
    type=click.IntRange(1),
    metavar="N",
    help="At most N of each template; with --limit the same number of each, as far as there are so many.",
)
@click.option("--limit", type=click.IntRange(1), metavar="N", help="At most N questions.")
@click.option("--seed", type=int, help="Draw the questions at random; without it the first ones are taken.")
@click.option("--resume", is_flag=True, help="Go on with a run: play what it has not answered.")
@click.option("--images", type=FOLDER, help="Folder with a folder of panoramas per sequence; the store's if left out.")
@port_option
def command(store: Store, name: str, run_id: str | None, resume: bool, port: int, **options: Any) -> None:
    """Serve the questions of a store to a person, and keep what they answer as a run of the method 'human'.

    The page allows what ReAct may do: looks, a box in the newest picture, an answer. Prints the address to open, which
    holds a token; ends with Ctrl-C. Give several people the same options, and each a --name: 'report --table people'
    has how far they agree.
    """
    from jrdb_avr.engine.local_server import LocalServer
    from jrdb_avr.engine.pages.page import render
    from jrdb_avr.engine.report.people import HUMAN
    from jrdb_avr.engine.run.evaluate import default_run_id
    from jrdb_avr.engine.run.human import HumanDesk
    from jrdb_avr.engine.run.options import QuestionSelection
    from jrdb_avr.engine.run.playing import played_run

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    run_id = default_run_id(HUMAN, name) if run_id is None else run_id
    images: Path | None = options.pop("images")
    selection = QuestionSelection(**options)
    with (
        warnings_as_notes(),
        played_run(store, HUMAN, name, run_id, questions=selection, resume=resume, images=images) as (bench, run),
        LocalServer(HumanDesk(bench, run, render("play.html", who=name)).respond, port) as server,
    ):
        click.echo(server.url)
        note("open this address in a browser; Ctrl-C ends, and --resume goes on")
        server.serve_forever()
    if run.finished:
        note(f"next: jrdb-avr score --store {store.path} {run_id}")
