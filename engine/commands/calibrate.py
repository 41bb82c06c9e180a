"""`jrdb-avr calibrate`: how does this model write boxes?"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from jrdb_avr.agent.model.options import Options
from jrdb_avr.engine.commands._endpoint import endpoint_options, need_address
from jrdb_avr.engine.console import json_option, note, print_json, print_rows, progress, store_option


@click.command(
    epilog="Example: jrdb-avr calibrate --store S --model google/gemma-4-E4B-it --base-url http://localhost:8000/v1"
)
@store_option
@click.option("--model", required=True, help="Model id to ask for; 'marker' is the built-in reader of marks.")
@click.option("--base-url", help="An OpenAI-compatible server, as http://localhost:8000/v1.")
@endpoint_options
@json_option
def command(store: Path, model: str, base_url: str | None, options: Options, as_json: bool) -> None:
    """Find out in which order and scale a model writes boxes, from 50 drawn rectangles that belong to no question.

    What is found is stored, and taken by every later run of the model with the same response format and thinking. Exit
    code 1, and nothing is stored, where no reading of the boxes is clearly the best.
    """
    import msgspec

    from jrdb_avr.agent.model.calibrate import PICTURES, calibrate
    from jrdb_avr.agent.model.client import Client
    from jrdb_avr.agent.model.conventions import convention_of
    from jrdb_avr.agent.model.preflight import preflight, require
    from jrdb_avr.engine.run.endpoint import serving, write_calibration
    from jrdb_avr.queries.store import Store

    need_address(model, base_url)
    place = Store(store)
    if not place.question_path("questions").exists():
        # A machine without labels has questions and no manifest; what has neither is a slip of the pen.
        place.manifest()
    with serving(model, base_url) as url, progress(f"calibrate {model}", PICTURES) as advance:
        client = Client(url, model, options, convention=convention_of(model))
        # One picture at a time is shown: what only methods need may be lacking.
        for warning in require(preflight(client), "calibrate"):
            note(f"warning: {warning}")
        found = calibrate(client, advance=advance)
    rows = [msgspec.structs.asdict(score) for score in found.scores]
    if as_json:
        print_json(rows)
    else:
        title = f"Readings of {found.readable} boxes by {model} (overlap with {found.asked} drawn rectangles)"
        print_rows(rows, title=title, columns=("key", "order", "scale", "n", "median_iou", "share", "chosen"))
    if found.reason:
        note(f"jrdb-avr: nothing is stored: {found.reason}")
        sys.exit(1)
    note(f"stored in {write_calibration(place, found)}")
