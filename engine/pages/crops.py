"""Crops of the people that rows of a query name, and the contact sheet of crops."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.observe.overlay import draw_people
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, ObserveError
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import CROP, center_angle

_SHEET: Final = 60
"""Maximum number of crops of a contact sheet."""


def crops_of_rows(
    store: Store, rows: Iterable[Mapping[str, Any]], params: Mapping[str, Any]
) -> Iterator[tuple[str, Image]]:
    """Yield a crop of each row that names a person in a frame, with the box drawn.

    Args:
        store: The store, with panoramas.
        rows: Rows with `sequence`, `frame`, and `track` or the box `x`, `y`, `w` and `h` in stitched pixels.
        params: Values for columns that the rows lack.

    Yields:
        A name for a file, with the number of the row from 1, and the crop. A row without a box, or without a panorama
        at its frame, has none.

    Raises:
        InputError: If a row lacks a column, or names a sequence that is not loaded.
    """
    observer, loaded = Observer(store), [*store.manifest().sequences]

    @functools.cache
    def boxes(sequence: str) -> dict[tuple[int, int], dict[str, Any]]:
        return {(row["frame"], row["track"]): row for row in store.interval("sightings", sequence).to_pylist()}

    for n, row in enumerate(({**params, **row} for row in rows), 1):
        boxed = {*"xywh"} <= row.keys()
        if not {"sequence", "frame"} <= row.keys() or not (boxed or "track" in row):
            raise InputError("crops need rows with sequence, frame, and track or x, y, w, h: return these columns")
        box = {"track": n, "clear": True, "pose": None, "cluster": None, **row}
        keys = row["frame"], row.get("track", n)
        if row["sequence"] is None or not all(isinstance(key, int | float) for key in keys):
            continue
        if row["sequence"] not in loaded:
            raise InputError(f"sequence {row['sequence']!a} of row {n} is not loaded")
        if not boxed:
            box |= boxes(row["sequence"]).get(keys, dict.fromkeys("xywh"))
        sides: list[Any] = [box[side] for side in "xywh"]
        if (
            all(isinstance(side, int | float | Decimal) and math.isfinite(side) for side in sides)
            and min(sides[2:]) > 0
        ):
            box |= zip("xywh", map(float, sides), strict=True)
            with contextlib.suppress(ObserveError):
                seen = observer(row["sequence"], row["frame"], center_angle(box["x"], box["w"]))
                name = f"{n:04d}-{seen.sequence}-{seen.frame_index:06d}.png"
                yield name, draw_people(seen.image, [box], left=seen.left)


def contact_sheet(crops: Sequence[Image]) -> Image:
    """Return the first 60 crops at half size, six in a row. Raise InputError if there are no crops."""
    import cv2

    if not crops:
        raise InputError("no row names a person with a box at a frame that has a panorama")
    halves = [cv2.resize(crop, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for crop in crops[:_SHEET]]
    halves += [np.zeros((CROP // 2, CROP // 2, 3), np.uint8)] * (-len(halves) % 6)
    return np.vstack([np.hstack(halves[at : at + 6]) for at in range(0, len(halves), 6)])


def png(image: Image) -> bytes:
    """Return an RGB image as a PNG file."""
    import cv2

    return bytes(cv2.imencode(".png", image[..., ::-1])[1])
