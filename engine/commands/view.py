"""`jrdb-avr view`: show questions and runs in the browser."""

from __future__ import annotations

from pathlib import Path

import click

from jrdb_avr.engine.commands._declared import field_options
from jrdb_avr.engine.commands._options import Store, iou_option, port_option, store_option
from jrdb_avr.engine.console import note, warnings_as_notes
from jrdb_avr.engine.run.options import RunOptions


@click.command(epilog="Example: jrdb-avr view --store S --answers")
@store_option()
@click.option("--answers", is_flag=True, help="Also show true answers, true boxes, scores, and why boxes are wrong.")
@field_options(RunOptions, "images")
@port_option
@iou_option
def command(store: Store, answers: bool, images: Path | None, port: int, iou: float) -> None:
    """Show the runs and questions of a store in the browser.

    There is an overview of all runs, a page per question with its panoramas and the steps of each run, and a comparison
    of any two runs. The command prints the address to open. The address contains a token. Ctrl-C ends the command. The
    command reads the runs once, when it starts. To see newer runs, start it again.
    """
    from jrdb_avr.engine.local_server import LocalServer
    from jrdb_avr.engine.pages.view import Viewer
    from jrdb_avr.engine.report.comparison import report
    from jrdb_avr.engine.run.bench import find_images
    from jrdb_avr.engine.validate.references import read_references

    with warnings_as_notes():
        comparison = report(store, iou=iou) if answers else None
        if comparison:
            comparison.index.references = read_references(store)
        viewer = Viewer(store, find_images(store, images), comparison)
    with LocalServer(viewer.respond, port) as server:
        click.echo(server.url)
        note(f"open this address in a browser; {'it shows answers; ' if answers else ''}Ctrl-C ends")
        server.serve_forever()
