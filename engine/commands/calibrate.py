"""`jrdb-avr calibrate`: find out how a model writes the coordinates of a box."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from jrdb_avr.engine.commands._declared import endpoint_options
from jrdb_avr.engine.commands._options import form_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_rows, progress_bar

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store


@click.command()
@store_option()
@endpoint_options
@form_option
def command(store: Store, model: str, endpoint: Any, form: RowFormat) -> None:
    """Find out how a model writes the four coordinates of a box: their order and their unit.

    The command asks the model for the boxes of 50 drawn rectangles. It interprets the replies in each combination of
    order and unit, and compares the resulting boxes with the rectangles. It stores the best combination. Later runs of
    the model on this store use this combination if they have the same --response-format and --thinking. If no
    combination is clearly the best, the command stores nothing, and the exit code is 1.

    Example:
      jrdb-avr calibrate --store S --model M --base-url http://localhost:8000/v1
    """
    import msgspec

    from jrdb_avr.agent.model.calibrate import PICTURES, calibrate
    from jrdb_avr.agent.model.client import Client
    from jrdb_avr.agent.model.conventions import convention_of
    from jrdb_avr.agent.preflight import preflight
    from jrdb_avr.engine.run.endpoint import declared, serving, write_calibration
    from jrdb_avr.queries.display import step_counter

    if not store.question_path("questions").exists():
        # A folder that has neither questions nor a manifest is not a store: `manifest` raises the error that says so.
        store.manifest()
    with serving(model, endpoint.base_url) as url, progress_bar() as progress:
        client = Client(url, model, declared(model, endpoint), convention=convention_of(model))
        for check in preflight(client):
            if not check.passed:
                note(f"warning: {check.line}")
        calibration = calibrate(client, advance=step_counter(progress, f"calibrate {model}", PICTURES))
    rows = [msgspec.structs.asdict(score) for score in calibration.scores]
    title = f"Readings of {calibration.readable} boxes by {model} (overlap with {calibration.asked} drawn rectangles)"
    columns = ("key", "order", "scale", "n", "median_iou", "share", "chosen")
    print_rows(rows, title=title, columns=columns, form=form)
    if calibration.reason:
        note(f"jrdb-avr: nothing is stored: {calibration.reason}")
        sys.exit(1)
    note(f"stored in {write_calibration(store, calibration)}")
