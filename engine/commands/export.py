"""`jrdb-avr export` and `jrdb-avr submit`: questions and predictions in the forms of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from jrdb_avr.engine.commands._options import FILE, FOLDER, open_store
from jrdb_avr.engine.console import note

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store

_EXAMPLE: Final = """\b
Examples:
  jrdb-avr export S react-marker --jsonl predictions.jsonl   predictions of a run
"""

store_argument = click.argument("store", type=FOLDER, callback=open_store)


@click.command(epilog=_EXAMPLE)
@store_argument
@click.argument("run", required=False)
@click.option("--jsonl", type=FILE, help="Write the predictions of RUN, a line each; 'score --jsonl' reads them.")
def export(store: Store, run: str | None, jsonl: Path | None) -> None:
    """Write what STORE holds in the forms of other tools."""
    if jsonl is None:
        raise click.UsageError("say what to write: --jsonl")
    if run is None:
        raise click.UsageError("--jsonl writes the predictions of a run: name the RUN")
    from jrdb_avr.engine.report.prediction_lines import write_lines
    from jrdb_avr.engine.report.scoring import read_predictions
    from jrdb_avr.queries.store import write_bytes

    _, predictions = read_predictions(store, run)
    write_bytes(jsonl, b"".join(write_lines(predictions)))
    note(f"wrote {jsonl}: {len(predictions)} predictions")


@click.command(
    epilog="Example: jrdb-avr submit S react-marker bundle   (then: jrdb-avr score --store S --bundle bundle)"
)
@store_argument
@click.argument("run")
@click.argument("folder", metavar="DIR", type=FOLDER)
def submit(store: Store, run: str, folder: Path) -> None:
    """Write RUN as a bundle into the new folder DIR, to be scored by whoever has the answers.

    The bundle holds predictions, manifest with settings, and hashes. It needs no answers, and tells nothing of the
    address of the model's server.
    """
    from jrdb_avr.engine.report.bundle import write_bundle

    bundle = write_bundle(store, run, folder)
    note(f"wrote {folder}: {len(bundle.run.question_ids)} questions, set {bundle.question_set}")
