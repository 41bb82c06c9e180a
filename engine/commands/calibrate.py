"""`jrdb-avr calibrate`: find out how a model writes the coordinates of a box, and how its errors repeat."""

from __future__ import annotations

import sys
from typing import Any

import click

from jrdb_avr.engine.commands._declared import endpoint_options
from jrdb_avr.engine.commands._options import Store, form_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_rows, progress_bar


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

    If the store has annotations and panoramas, the command also asks for the labels of 50 people, each in two crops of
    a frame and a second later. The correlation of the errors gives the weight of a repeated reading in later runs.

    Example:
      jrdb-avr calibrate --store S --model M --base-url http://localhost:8000/v1
    """
    import msgspec

    from jrdb_avr.agent.model.calibrate import PICTURES, calibrate
    from jrdb_avr.agent.model.client import Client
    from jrdb_avr.agent.model.conventions import convention_of
    from jrdb_avr.agent.preflight import preflight
    from jrdb_avr.engine.commands._people import labelled_people
    from jrdb_avr.engine.run.endpoint import declared, serving, write_calibration
    from jrdb_avr.queries.display import step_counter

    if not store.question_path("questions").exists():
        # A folder that has neither questions nor a manifest is not a store: `manifest` raises the error that says so.
        store.manifest()
    people = labelled_people(store) if store.path.joinpath("annotations").exists() else []
    with serving(model, endpoint.base_url, store if people else None) as url, progress_bar() as progress:
        client = Client(url, model, declared(model, endpoint), convention=convention_of(model))
        for check in preflight(client):
            if not check.passed:
                note(f"warning: {check.line}")
        steps = step_counter(progress, f"calibrate {model}", PICTURES + 3 * len(people))
        calibration = calibrate(client, advance=steps, people=people)
    rows = [msgspec.structs.asdict(score) for score in calibration.scores]
    title = f"Readings of {calibration.readable} boxes by {model} (overlap with {calibration.asked} drawn rectangles)"
    columns = ("key", "order", "scale", "n", "median_iou", "share", "chosen")
    print_rows(rows, title=title, columns=columns, form=form)
    note(f"weight of a repeated reading in a frame: {calibration.repeats.frame:.2f} ({calibration.frame_errors.words})")
    note(f"weight of another frame's reading: {calibration.repeats.person:.2f} ({calibration.person_errors.words})")
    if calibration.reason:
        note(f"jrdb-avr: nothing is stored: {calibration.reason}")
        sys.exit(1)
    note(f"stored in {write_calibration(store, calibration)}")
