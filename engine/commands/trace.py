"""`jrdb-avr trace`: what a run did with one question, as a page."""

from __future__ import annotations

from pathlib import Path

import click

from jrdb_avr.engine.console import note, store_option


@click.command(epilog="Example: jrdb-avr trace react-marker 0098303b6414dec4 --store S --out trace.html")
@click.argument("run")
@click.argument("question")
@store_option
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("trace.html"),
    show_default=True,
    help="HTML file to write.",
)
def command(run: str, question: str, store: Path, out: Path) -> None:
    """Write a page that shows how RUN came to its answer to QUESTION (an id), step by step, beside the truth.

    Each look is drawn on the panorama; of an agent the world model is shown as it grew, with the writes that were
    refused.
    """
    from jrdb_avr.engine.observe.observer import Observer
    from jrdb_avr.engine.pages.page import write_page
    from jrdb_avr.engine.pages.trace_page import trace_page
    from jrdb_avr.engine.report.traces import read_trace
    from jrdb_avr.engine.run.evaluate import read_sequences
    from jrdb_avr.queries.store import Store

    opened = Store(store)
    trace = read_trace(opened, run, question)
    observer = Observer(opened.manifest().image_root, read_sequences(opened).values())
    write_page(out, trace_page(trace, observer))
    note(f"wrote {out}: {len(trace.steps)} steps")
