"""`jrdb-avr demo`: everything once."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(
    short_help="Run everything once on a synthetic world.",
    epilog="Example: jrdb-avr demo --out demo-out",
)
@click.option(
    "--out",
    default="demo-out",
    show_default=True,
    type=click.Path(path_type=Path),
    help="New folder for the world, the store and the run.",
)
def command(out: Path) -> None:
    """Make a synthetic world, load it, generate questions, let the marker model answer them, score and report.

    Every step is printed as the command that you would type. Takes about a minute on two cores.
    """
    from jrdb_avr.engine.commands.demo_run import Size, run_demo

    run_demo(out, Size(), click.echo)
