"""`jrdb-avr observe`: write a crop or a whole panorama as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from jrdb_avr.engine.commands._complete import complete_sequence
from jrdb_avr.engine.commands._options import FILE, Store, store_option
from jrdb_avr.engine.console import note


# A negative ANGLE, such as -90, looks like an option.
@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("sequence", shell_complete=complete_sequence)
@click.argument("frame", type=int)
@click.argument("angle", type=float, required=False)
@store_option()
@click.option("--out", required=True, type=FILE, help="PNG file to write.")
@click.option("--panorama", is_flag=True, help="Write the whole panorama instead of a crop at ANGLE.")
@click.option("--boxes", is_flag=True, help="Draw the box, track, pose, group and skeleton of each annotated person.")
def command(
    sequence: str, frame: int, angle: float | None, store: Store, out: Path, panorama: bool, boxes: bool
) -> None:
    """Write a crop of a panorama as a PNG file: 480 x 480 pixels around ANGLE, in frame FRAME of SEQUENCE.

    ANGLE is in degrees: 0 is behind the robot, 90 to its left, 180 straight ahead, and 270 to its right.

    Example:
      jrdb-avr observe gates-ai-lab-2019-02-08_0 15 180 --store S --out look.png
    """
    if panorama == (angle is not None):
        raise click.UsageError("give either an ANGLE or --panorama")

    import cv2

    from jrdb_avr.engine.observe.observer import Observer
    from jrdb_avr.engine.observe.overlay import draw_people
    from jrdb_avr.queries.files import write_bytes
    from jrdb_avr.queries.questions import read_loaded_sequence

    observer = Observer(store.manifest().image_root, [read_loaded_sequence(store, sequence)])
    if angle is None:
        image, left = observer.panorama(sequence, frame), 0
        note(f"{sequence} frame {frame:06d}: whole panorama -> {out}")
    else:
        observation = observer(sequence, frame, angle)
        image, left = observation.image, observation.left
        note(
            f"{sequence} frame {frame:06d}, {observation.timestamp:.2f} s, angle {observation.angle_deg:g}, "
            f"left column {observation.left}, {observation.fov_deg} degrees wide -> {out}"
        )
    if boxes:
        image = draw_people(image, *_annotated(store, sequence, frame), left)
    write_bytes(out, cv2.imencode(".png", image[:, :, ::-1])[1].tobytes())


def _annotated(store: Store, sequence: str, frame: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of the tables `sightings` and `poses` for one frame."""
    import pyarrow.compute as pc

    tables = store.interval("sightings", sequence), store.annotation("poses", sequence)
    people, poses = (table.filter(pc.equal(table["frame"], frame)).to_pylist() for table in tables)
    # Wide boxes come first, so that small boxes are drawn over wide boxes.
    return sorted(people, key=lambda row: (-row["w"], row["track"])), poses
