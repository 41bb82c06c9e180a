"""`jrdb-avr trace`: what a run did with one question, as a page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from jrdb_avr.engine.commands._options import page_option, run_argument, store_option
from jrdb_avr.engine.console import note

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store


@click.command(epilog="Example: jrdb-avr trace react-marker 0098303b6414dec4 --store S --out trace.html")
@run_argument("run")
@click.argument("question")
@store_option()
@page_option("trace.html")
def command(run: str, question: str, store: Store, out: Path) -> None:
    """Write a page that shows the steps of RUN for QUESTION (an id), with the true answer.

    The page draws each look on the panorama. For an agent it shows the world model and the refused writes at each step.
    """
    from jrdb_avr.engine.observe.observer import Observer
    from jrdb_avr.engine.pages.page import write_page
    from jrdb_avr.engine.pages.trace import trace_page
    from jrdb_avr.engine.report.traces import Trace

    trace = Trace(store, run, question)
    write_page(out, trace_page(trace, Observer.of(store)))
    note(f"wrote {out}: {len(trace.steps)} steps")
