"""The mark that people of the sample world carry: a program reads from its pixels what is true of a person.

A mark is a coloured frame along the person's box and, in the middle of the box, a *plate*: a grid of black and white
cells with a white margin of one cell. Its first grid (5 x 16 cells, 63 bits and a 17-bit checksum) holds identity,
gender, age, pose, up to two other actions, group, distance, and the size of the box in half cells; the second (5 x 11,
38 bits and 17 of checksum that cover the first grid too) holds heading, partner and interaction, object and verb. It
stands below the first (tall) or right of it (wide), and is left out where it does not fit at `MIN_CELL` pixels
per cell. A box below 18 x 40 pixels carries a frame alone, and cannot be read.

The plate lies in the middle of the box and says how many cells wide and high the box is, so the whole box follows from
the plate's place and size in the image, also where another person or the image's edge covers the frame. A plate that is
covered in part has no closed margin of the right proportions and is not read.

Nothing else in a picture of the sample world is as bright as a plate's white (`BRIGHT`).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.things import OBJECTS, VERBS

MarkImage = npt.NDArray[np.uint8]
Bits = npt.NDArray[np.uint8]

GRID_COLUMNS: Final = 5
FIRST_ROWS: Final = 16
SECOND_ROWS: Final = 11
CHECK_BITS: Final = 17
MAX_CELL: Final = 4
"""Pixels: cells of near people grow no further, so that the person stays visible behind the plate."""
MIN_CELL: Final = 2
MAX_CELLS: Final = 127
"""A box is at most so many cells wide and high: its size in half cells has eight bits."""
BRIGHT: Final = 205
"""Grey level above which a pixel can belong to a plate's margin; everything else in a picture stays below 190."""

RIM: Final = 2
"""Pixels of the dark rim round a plate, where there is room for it."""
RIM_COLOR: Final = (40, 40, 40)

ALONE: Final = 0
"""Group number of a person in no group of two or more."""
MAX_IDENTITY: Final = 4095
MAX_GROUP: Final = 254
HEADING_STEP: Final = 5
MAX_DISTANCE_DM: Final = 254

FRAME_COLORS: Final = (
    (230, 90, 40),
    (40, 170, 60),
    (40, 150, 230),
    (200, 60, 200),
    (220, 160, 20),
    (20, 180, 180),
    (240, 90, 130),
    (130, 110, 240),
)
"""RGB; a person's is that of the identity modulo their number."""


@dataclass(frozen=True)
class Mark:
    """What a mark says; None or () where it says nothing.

    `identity` 0..4095; `group` `ALONE` or 1..254; `distance_dm` decimetres on the ground from the robot, 0..254;
    `heading_deg` counter-clockwise from the robot's ahead, a multiple of 5 in [0, 360); `partner` is an identity and
    comes with `interaction`, `object` with `verb`. Texts are those of `schema.labels` and `schema.things`.
    """

    identity: int
    gender: str | None = None
    age: str | None = None
    pose: str | None = None
    actions: tuple[str, ...] = ()
    group: int | None = None
    distance_dm: int | None = None
    heading_deg: int | None = None
    partner: int | None = None
    interaction: str | None = None
    object: str | None = None
    verb: str | None = None


class Reading(NamedTuple):
    """A mark found in an image.

    `box` is the person's whole box in pixels of that image (it may reach over the image's edge); `complete` is False
    where the second grid is absent or unreadable: heading, partner, interaction, object and verb are then unknown.
    """

    mark: Mark
    box: Box
    complete: bool


_LAYOUTS: Final = {
    "first": (GRID_COLUMNS, FIRST_ROWS),
    "tall": (GRID_COLUMNS, FIRST_ROWS + SECOND_ROWS),
    "wide": (2 * GRID_COLUMNS, FIRST_ROWS),
}
"""Columns and rows of the cells of a plate, without its margin."""
# Below the second grid of a wide plate: fixed cells, that a reader checks.
_FILLER: Final = (np.indices((FIRST_ROWS - SECOND_ROWS, GRID_COLUMNS)).sum(axis=0) % 2).astype(np.uint8)


# ------------------------------------------------------------------------------------------------ bits


class _Field:
    """A field of a grid: its size in bits, and the code of each value that it can hold."""

    def __init__(self, name: str, bits: int, codes: dict[Any, int]) -> None:
        self.name, self.bits, self.codes = name, bits, codes
        self.values = {code: value for value, code in codes.items()}


def _words(name: str, bits: int, table: tuple[str, ...]) -> _Field:
    return _Field(name, bits, {word: code for code, word in enumerate((None, *table))})


def _numbers(name: str, bits: int, most: int, absent: int, step: int = 1) -> _Field:
    """Multiples of `step` up to `most`; `absent` is the code of None, and of a number too where that cannot be none."""
    return _Field(name, bits, {None: absent} | {number: number // step for number in range(0, most + 1, step)})


_ACTION: Final = _words("actions", 5, OTHER_ACTIONS)
_FIRST: Final = (
    _numbers("identity", 12, MAX_IDENTITY, 0),
    _words("gender", 2, GENDERS),
    _words("age", 3, AGES),
    _words("pose", 4, POSES),
    _ACTION,
    _ACTION,
    _numbers("group", 8, MAX_GROUP, 255),
    _numbers("distance_dm", 8, MAX_DISTANCE_DM, 255),
    _numbers("wide", 8, 255, 0),
    _numbers("high", 8, 255, 0),
)
_SECOND: Final = (
    _numbers("heading_deg", 7, 360 - HEADING_STEP, 127, HEADING_STEP),
    # Absent where there is no interaction.
    _numbers("partner", 12, MAX_IDENTITY, 0),
    _words("interaction", 5, INTERACTIONS),
    _words("object", 7, OBJECTS),
    _words("verb", 7, VERBS),
)
"""The fields of the two grids, the first in the highest bits."""


def _pack(fields: tuple[_Field, ...], *values: Any) -> int:
    packed = 0
    for field, value in zip(fields, values, strict=True):
        if value not in field.codes:
            raise InputError(f"a mark cannot show {field.name} {value!r}", field=field.name)
        packed = packed << field.bits | field.codes[value]
    return packed


def _unpack(fields: tuple[_Field, ...], data: int) -> list[Any] | None:
    """The values of the fields; None where one has a code without a value."""
    values = []
    for field in reversed(fields):
        code = data & ((1 << field.bits) - 1)
        if code not in field.values:
            return None
        values.append(field.values[code])
        data >>= field.bits
    return values[::-1]


def _check(*parts: int) -> int:
    """Checksum of the data of the grids named, first the first."""
    text = b"".join(part.to_bytes(8, "big") for part in parts)
    return zlib.crc32(text) >> (32 - CHECK_BITS)


def _grid(*parts: int) -> Bits:
    """Cells (rows, 5) of the last grid, 1 = white; its checksum covers those before."""
    rows = (FIRST_ROWS, SECOND_ROWS)[len(parts) - 1]
    number = parts[-1] << CHECK_BITS | _check(*parts)
    return np.array([*map(int, f"{number:0{rows * GRID_COLUMNS}b}")], np.uint8).reshape(rows, GRID_COLUMNS)


def _data_of(cells: Bits, *before: int) -> int | None:
    """The data of a grid; None where its checksum, which covers the grids before, is wrong."""
    number = int("".join(map(str, cells.ravel().tolist())), 2)
    data = number >> CHECK_BITS
    return data if number & ((1 << CHECK_BITS) - 1) == _check(*before, data) else None


def encode(mark: Mark, layout: str, wide: int, high: int) -> Bits:
    """The cells (rows, columns) of a plate, 1 = white; the box is `wide` x `high` half cells.

    Raises InputError for a value that a mark cannot show.
    """
    if len(mark.actions) > 2:
        raise InputError("a mark shows at most two actions beside the pose", field="actions")
    if (mark.partner is None) != (mark.interaction is None) or (mark.object is None) != (mark.verb is None):
        raise InputError("a partner comes with an interaction and an object with a verb", field="partner")
    actions = (*sorted(mark.actions, key=lambda action: _ACTION.codes.get(action, 0)), None, None)[:2]
    who = mark.identity, mark.gender, mark.age, mark.pose
    first = _pack(_FIRST, *who, *actions, mark.group, mark.distance_dm, wide, high)
    second = _pack(_SECOND, mark.heading_deg, mark.partner, mark.interaction, mark.object, mark.verb)
    cells, more = _grid(first), _grid(first, second)
    if layout == "first":
        return cells
    return np.vstack([cells, more]) if layout == "tall" else np.hstack([cells, np.vstack([more, _FILLER])])


class Decoded(NamedTuple):
    """A plate's cells read back: the mark, the box's size in half cells, and whether the second grid was read."""

    mark: Mark
    wide: int
    high: int
    complete: bool


def decode(cells: Bits) -> Decoded | None:
    """Read a plate's cells; None unless the first grid's checksum and every field of it are valid."""
    first = _data_of(cells[:FIRST_ROWS, :GRID_COLUMNS])
    values = None if first is None else _unpack(_FIRST, first)
    if first is None or values is None:
        return None
    identity, gender, age, pose, one, two, group, distance, wide, high = values
    actions = tuple(action for action in (one, two) if action is not None)
    mark = Mark(identity, gender, age, pose, actions, group, distance)
    more, filler = cells[FIRST_ROWS:], _FILLER
    if cells.shape[1] > GRID_COLUMNS:
        more, filler = np.split(cells[:, GRID_COLUMNS:], [SECOND_ROWS])
    complete = _with_second(mark, first, more) if len(more) and np.array_equal(filler, _FILLER) else None
    return Decoded(complete or mark, wide, high, complete is not None)


def _with_second(mark: Mark, first: int, cells: Bits) -> Mark | None:
    """The mark with what its second grid holds; None where that is not valid."""
    second = _data_of(cells, first)
    values = None if second is None else _unpack(_SECOND, second)
    if values is None or (values[3] is None) != (values[4] is None):
        return None
    heading, partner, interaction, thing, verb = values
    partner = None if interaction is None else partner
    return replace(mark, heading_deg=heading, partner=partner, interaction=interaction, object=thing, verb=verb)


# ------------------------------------------------------------------------------------------------ pixels


def plate_of(w: int, h: int) -> tuple[str, int] | None:
    """Layout and cell size in pixels of the plate on a box of w x h pixels; None where none fits.

    That is so for boxes that are too small, or far longer one way than the other.
    """
    smallest = -(-max(w, h) // MAX_CELLS)
    cells = {
        layout: min((w - 4) // (columns + 2), (h - 4) // (rows + 2), max(MAX_CELL, smallest))
        for layout, (columns, rows) in _LAYOUTS.items()
    }
    for layout in (max(("tall", "wide"), key=cells.__getitem__), "first"):
        if cells[layout] >= max(MIN_CELL, smallest):
            return layout, cells[layout]
    return None


def frame_thickness(w: int) -> int:
    """Pixels of the frame's line, inside the box."""
    return 3 if w >= 80 else 2


def draw(image: MarkImage, box: Box, mark: Mark) -> None:
    """Draw frame and plate on an RGB image, in place, over the seam if it is a panorama.

    The box is rounded to whole pixels. Raises InputError for a value that a mark cannot show.
    """
    x, y, w, h = round(box.x), round(box.y), round(box.w), round(box.h)
    color = FRAME_COLORS[mark.identity % len(FRAME_COLORS)]
    line = frame_thickness(w)
    plate = None
    fit = plate_of(w, h)
    if fit is not None:
        layout, cell = fit
        cells = encode(mark, layout, round(2 * w / cell), round(2 * h / cell))
        small = np.pad(cells, 1, constant_values=1) * np.uint8(255)
        plate = small.repeat(cell, axis=0).repeat(cell, axis=1)[:, :, None].repeat(3, axis=2)
    shifts = (0,) if image.shape[1] != WIDTH else (-WIDTH, 0, WIDTH)
    for shift in shifts:
        left = x + shift
        if left >= image.shape[1] or left + w <= 0:
            continue
        for strip in ((left, y, w, line), (left, y + h - line, w, line)):
            _fill(image, strip, color)
        for strip in ((left, y, line, h), (left + w - line, y, line, h)):
            _fill(image, strip, color)
        if plate is not None:
            across, down = left + (w - plate.shape[1]) // 2, y + (h - plate.shape[0]) // 2
            # Keeps the plate's white apart from that of a plate farther away; at the least size the frame does.
            rim = max(0, min(RIM, (w - plate.shape[1]) // 2 - line, (h - plate.shape[0]) // 2 - line))
            _fill(image, (across - rim, down - rim, plate.shape[1] + 2 * rim, plate.shape[0] + 2 * rim), RIM_COLOR)
            _paste(image, plate, across, down)


def _fill(image: MarkImage, strip: tuple[int, int, int, int], color: tuple[int, int, int]) -> None:
    x, y, w, h = strip
    if w > 0 and h > 0:
        cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), color, -1)


def _paste(image: MarkImage, plate: MarkImage, x: int, y: int) -> None:
    top, left = max(y, 0), max(x, 0)
    part = plate[top - y : max(image.shape[0] - y, 0), left - x : max(image.shape[1] - x, 0)]
    image[top : top + part.shape[0], left : left + part.shape[1]] = part


def read(image: MarkImage, *, wrap: bool = False) -> list[Reading]:
    """Every readable mark in an RGB image, from left to right.

    `wrap` joins the left edge to the right one, for a whole panorama: boxes may then reach past the width. An image
    scaled down is read as far as its cells stay about two pixels wide. What is covered, cut or too small is left out;
    a mark that is returned is right (each grid has a 17-bit checksum beside the checks on shape and contrast).
    """
    width = image.shape[1]
    # Wider than any plate, so that each one is whole somewhere.
    margin = min(width, 128) if wrap else 0
    if margin:
        image = np.hstack([image, image[:, :margin]])
    gray: MarkImage = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    bright = np.asarray(gray > BRIGHT, np.uint8)
    found: dict[tuple[int, int], Reading] = {}
    for x, y, w, h in _bright_parts(bright):
        reading = _read_plate(gray, x, y, w, h)
        if reading is not None and x < width:
            found.setdefault((x, y), reading)
    return [found[key] for key in sorted(found)]


def _bright_parts(bright: MarkImage) -> Iterator[tuple[int, int, int, int]]:
    """The boxes (x, y, w, h) of the connected bright parts that are large enough for a plate."""
    least = (GRID_COLUMNS + 1) * MIN_CELL * 0.8, (FIRST_ROWS + 1) * MIN_CELL * 0.8
    # No part reaches over a column without a bright pixel, and most of a panorama's columns have none.
    edges = np.flatnonzero(np.diff(bright.any(axis=0), prepend=False, append=False))
    for left, right in edges.reshape(-1, 2)[edges[1::2] - edges[::2] >= least[0]].tolist():
        _, _, stats, _ = cv2.connectedComponentsWithStats(bright[:, left:right], connectivity=4)
        boxes = stats[1:, :4]
        for x, y, w, h in boxes[(boxes[:, 2:] >= least).all(axis=1)].tolist():
            yield left + x, y, w, h


def _read_plate(gray: MarkImage, x: int, y: int, w: int, h: int) -> Reading | None:
    """The mark of the plate that fills the rectangle, if it is one."""
    for inner_columns, inner_rows in _LAYOUTS.values():
        columns, rows = inner_columns + 2, inner_rows + 2
        across, down = w / columns, h / rows
        # Both ways the cell is the same, up to a pixel of blur at the edges.
        if abs(across - down) * columns > 1.5:
            continue
        cells = _sample(gray[y : y + h, x : x + w], columns, rows)
        decoded = None if cells is None else decode(cells)
        if decoded is None:
            continue
        cell = (across * columns + down * rows) / (columns + rows)
        wide, high = decoded.wide * cell / 2, decoded.high * cell / 2
        box = Box(x + w / 2 - wide / 2, y + h / 2 - high / 2, wide, high)
        return Reading(decoded.mark, box, decoded.complete)
    return None


def _sample(patch: MarkImage, columns: int, rows: int) -> Bits | None:
    """Cells of the grid, or None where margin or contrast are not those of a plate."""
    # Area averaging to four samples per cell; the cell's middle two by two decide.
    fine = cv2.resize(patch, (columns * 4, rows * 4), interpolation=cv2.INTER_LINEAR).astype(np.float32)
    values = fine.reshape(rows, 4, columns, 4)[:, 1:3, :, 1:3].mean(axis=(1, 3))
    if min(values[0].min(), values[-1].min(), values[:, 0].min(), values[:, -1].min()) < 180:
        return None
    inner = values[1:-1, 1:-1]
    if bool(np.any(np.abs(inner - 128) < 20)):
        return None
    return np.asarray(inner > 128, np.uint8)
