"""`jrdb-avr trace`: write a page with the steps of a run for one question."""

from __future__ import annotations

from pathlib import Path

import click

from jrdb_avr.engine.commands._options import Store, page_option, run_argument, store_option
from jrdb_avr.engine.console import note


@click.command(epilog="Example: jrdb-avr trace react-simulated 0098303b6414dec4 --store S --out trace.html")
@run_argument("run")
@click.argument("question")
@store_option()
@page_option("trace.html")
def command(run: str, question: str, store: Store, out: Path) -> None:
    """Write a page with the turns of RUN for QUESTION (an id), and with the true answer.

    The page shows the pictures of all looks. For a method with a world model, the page also shows the plan, the state
    of the graph in each turn, refused writes, and the rows that decided the answer.
    """
    from jrdb_avr.engine.observe.observer import Observer
    from jrdb_avr.engine.pages.page import write_page
    from jrdb_avr.engine.pages.trace import trace_page
    from jrdb_avr.engine.report.traces import Trace

    trace = Trace(store, run, question)
    write_page(out, trace_page(trace, Observer(store)))
    note(f"wrote {out}: {len(trace.steps)} steps")
