"""The mark that people of the sample world carry: a program reads from its pixels what is true of a person.

A mark is a coloured frame along the person's box and, in the middle of the box, a *plate*: a grid of black and white
cells with a white margin of one cell. Its first grid (5 x 16 cells, 63 bits and a 17-bit checksum) holds identity,
gender, age, pose, up to two other actions, group, distance, and the size of the box in half cells; the second (5 x 11,
38 bits and 17 of checksum that cover the first grid too) holds heading, partner and interaction, object and verb. It
stands below the first (tall) or right of it (wide), and is left out where it does not fit at `SECOND_CELL` pixels
per cell. A box below `MIN_WIDTH` x `MIN_HEIGHT` carries a frame alone, and cannot be read.

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
SECOND_CELL: Final = 2
MAX_CELLS: Final = 127
"""A box is at most so many cells wide and high: its size in half cells has eight bits."""
MIN_WIDTH: Final = (GRID_COLUMNS + 2) * MIN_CELL + 4
MIN_HEIGHT: Final = (FIRST_ROWS + 2) * MIN_CELL + 4
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


class _Layout(NamedTuple):
    name: str
    columns: int
    rows: int


_FIRST = _Layout("first", GRID_COLUMNS, FIRST_ROWS)
_TALL = _Layout("tall", GRID_COLUMNS, FIRST_ROWS + SECOND_ROWS)
_WIDE = _Layout("wide", 2 * GRID_COLUMNS, FIRST_ROWS)
_LAYOUTS: Final = (_FIRST, _TALL, _WIDE)
# Below the second grid of a wide plate: fixed cells, that a reader checks.
_FILLER: Final = (np.indices((FIRST_ROWS - SECOND_ROWS, GRID_COLUMNS)).sum(axis=0) % 2).astype(np.uint8)


# ------------------------------------------------------------------------------------------------ bits


def _code(field: str, value: str | None, table: tuple[str, ...]) -> int:
    """0 for None, else one more than the place in the table."""
    if value is None:
        return 0
    if value not in table:
        raise InputError(f"a mark cannot show {field} {value!r}", field=field)
    return table.index(value) + 1


def _number(field: str, value: int | None, most: int, absent: int) -> int:
    if value is None:
        return absent
    if not 0 <= value <= most:
        raise InputError(f"a mark cannot show {field} {value}: it goes from 0 to {most}", field=field)
    return value


def _pack(fields: list[tuple[int, int]]) -> int:
    """(value, bits) pairs as one number, first field in the highest bits."""
    packed = 0
    for value, bits in fields:
        packed = packed << bits | value
    return packed


def _first_data(mark: Mark, wide: int, high: int) -> int:
    if len(mark.actions) > 2:
        raise InputError("a mark shows at most two actions beside the pose", field="actions")
    codes = sorted(_code("actions", action, OTHER_ACTIONS) for action in mark.actions)
    first, second = ([*codes, 0, 0])[:2]
    return _pack(
        [
            (_number("identity", mark.identity, MAX_IDENTITY, 0), 12),
            (_code("gender", mark.gender, GENDERS), 2),
            (_code("age", mark.age, AGES), 3),
            (_code("pose", mark.pose, POSES), 4),
            (first, 5),
            (second, 5),
            (_number("group", mark.group, MAX_GROUP, 255), 8),
            (_number("distance_dm", mark.distance_dm, MAX_DISTANCE_DM, 255), 8),
            (_number("wide", wide, 255, 0), 8),
            (_number("high", high, 255, 0), 8),
        ]
    )


def _second_data(mark: Mark) -> int:
    if (mark.partner is None) != (mark.interaction is None) or (mark.object is None) != (mark.verb is None):
        raise InputError("a partner comes with an interaction and an object with a verb", field="partner")
    if mark.heading_deg is not None and mark.heading_deg % HEADING_STEP:
        raise InputError(f"a mark cannot show heading {mark.heading_deg}: multiples of 5 only", field="heading_deg")
    turn = None if mark.heading_deg is None else mark.heading_deg // HEADING_STEP
    return _pack(
        [
            (_number("heading_deg", turn, 360 // HEADING_STEP - 1, 127), 7),
            (_number("partner", mark.partner, MAX_IDENTITY, 0), 12),
            (_code("interaction", mark.interaction, INTERACTIONS), 5),
            (_code("object", mark.object, OBJECTS), 7),
            (_code("verb", mark.verb, VERBS), 7),
        ]
    )


def _check(*parts: int) -> int:
    """Checksum of the data of the grids named, first the first."""
    text = b"".join(part.to_bytes(8, "big") for part in parts)
    return zlib.crc32(text) >> (32 - CHECK_BITS)


def _grid(data: int, check: int, rows: int) -> Bits:
    """Cells (rows, 5), 1 = white."""
    number = data << CHECK_BITS | check
    count = rows * GRID_COLUMNS
    bits = [number >> (count - 1 - i) & 1 for i in range(count)]
    return np.array(bits, np.uint8).reshape(rows, GRID_COLUMNS)


def _number_of(cells: Bits) -> tuple[int, int]:
    """Data and checksum of a grid."""
    number = int("".join(map(str, cells.ravel().tolist())), 2)
    return number >> CHECK_BITS, number & ((1 << CHECK_BITS) - 1)


def encode(mark: Mark, layout: str, wide: int, high: int) -> Bits:
    """The cells (rows, columns) of a plate, 1 = white; the box is `wide` x `high` half cells.

    Raises InputError for a value that a mark cannot show.
    """
    first = _first_data(mark, wide, high)
    cells = _grid(first, _check(first), FIRST_ROWS)
    second = _second_data(mark)
    if layout == "first":
        return cells
    more = _grid(second, _check(first, second), SECOND_ROWS)
    if layout == "tall":
        return np.vstack([cells, more])
    return np.hstack([cells, np.vstack([more, _FILLER])])


class Decoded(NamedTuple):
    """A plate's cells read back: the mark, the box's size in half cells, and whether the second grid was read."""

    mark: Mark
    wide: int
    high: int
    complete: bool


def decode(cells: Bits) -> Decoded | None:
    """Read a plate's cells; None unless the first grid's checksum and every field of it are valid."""
    first, check = _number_of(cells[:FIRST_ROWS, :GRID_COLUMNS])
    if check != _check(first):
        return None
    mark_and_size = _first_mark(first)
    if mark_and_size is None:
        return None
    mark, wide, high = mark_and_size
    if cells.shape[1] > GRID_COLUMNS:
        more = cells[:SECOND_ROWS, GRID_COLUMNS:]
        if not np.array_equal(cells[SECOND_ROWS:, GRID_COLUMNS:], _FILLER):
            return Decoded(mark, wide, high, False)
    elif cells.shape[0] > FIRST_ROWS:
        more = cells[FIRST_ROWS:]
    else:
        return Decoded(mark, wide, high, False)
    second, check = _number_of(more)
    complete = _second_mark(mark, second) if check == _check(first, second) else None
    return Decoded(complete or mark, wide, high, complete is not None)


def _unpack(data: int, widths: tuple[int, ...]) -> list[int]:
    values = []
    for bits in reversed(widths):
        values.append(data & ((1 << bits) - 1))
        data >>= bits
    return values[::-1]


def _first_mark(data: int) -> tuple[Mark, int, int] | None:
    identity, gender, age, pose, one, two, group, distance, wide, high = _unpack(data, (12, 2, 3, 4, 5, 5, 8, 8, 8, 8))
    if gender > len(GENDERS) or age > len(AGES) or pose > len(POSES) or max(one, two) > len(OTHER_ACTIONS):
        return None
    mark = Mark(
        identity,
        gender=_name(gender, GENDERS),
        age=_name(age, AGES),
        pose=_name(pose, POSES),
        actions=tuple(OTHER_ACTIONS[code - 1] for code in (one, two) if code),
        group=None if group == 255 else group,
        distance_dm=None if distance == 255 else distance,
    )
    return mark, wide, high


def _second_mark(mark: Mark, data: int) -> Mark | None:
    turn, partner, interaction, thing, verb = _unpack(data, (7, 12, 5, 7, 7))
    if (turn >= 360 // HEADING_STEP and turn != 127) or interaction > len(INTERACTIONS):
        return None
    if thing > len(OBJECTS) or verb > len(VERBS) or (thing == 0) != (verb == 0):
        return None
    return replace(
        mark,
        heading_deg=None if turn == 127 else turn * HEADING_STEP,
        partner=partner if interaction else None,
        interaction=_name(interaction, INTERACTIONS),
        object=_name(thing, OBJECTS),
        verb=_name(verb, VERBS),
    )


def _name(code: int, table: tuple[str, ...]) -> str | None:
    return table[code - 1] if code else None


# ------------------------------------------------------------------------------------------------ pixels


def plate_of(w: int, h: int) -> tuple[str, int] | None:
    """Layout and cell size in pixels of the plate on a box of w x h pixels; None where none fits.

    That is so for boxes that are too small, or far longer one way than the other.
    """
    best: tuple[str, int] | None = None
    most = max(MAX_CELL, -(-max(w, h) // MAX_CELLS))
    for layout in (_TALL, _WIDE, _FIRST):
        cell = min((w - 4) // (layout.columns + 2), (h - 4) // (layout.rows + 2), most)
        if layout is _FIRST and best is not None:
            break
        least = max(MIN_CELL if layout is _FIRST else SECOND_CELL, -(-max(w, h) // MAX_CELLS))
        if cell >= least and (best is None or cell > best[1]):
            best = (layout.name, cell)
    return best


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
    for x, y, w, h in _bright_rectangles(bright):
        reading = _read_plate(gray, x, y, w, h)
        if reading is not None and x < width:
            found.setdefault((x, y), reading)
    return [found[key] for key in sorted(found)]


def _bright_rectangles(bright: MarkImage) -> Iterator[tuple[int, int, int, int]]:
    count, _, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    boxes: npt.NDArray[Any] = stats[1:count, :4]
    least = np.array([(GRID_COLUMNS + 1) * MIN_CELL * 0.8, (FIRST_ROWS + 1) * MIN_CELL * 0.8])
    large = boxes[(boxes[:, 2] >= least[0]) & (boxes[:, 3] >= least[1])]
    for row in large.tolist():
        yield row[0], row[1], row[2], row[3]


def _read_plate(gray: MarkImage, x: int, y: int, w: int, h: int) -> Reading | None:
    """The mark of the plate that fills the rectangle, if it is one."""
    for layout in _LAYOUTS:
        across, down = w / (layout.columns + 2), h / (layout.rows + 2)
        # Both ways the cell is the same, up to a pixel of blur at the edges.
        if abs(across - down) * (layout.columns + 2) > 1.5:
            continue
        cells = _sample(gray, layout, x, y, w, h)
        if cells is None:
            continue
        decoded = decode(cells)
        if decoded is None:
            continue
        cell = (across * (layout.columns + 2) + down * (layout.rows + 2)) / (layout.columns + layout.rows + 4)
        wide, high = decoded.wide * cell / 2, decoded.high * cell / 2
        box = Box(x + w / 2 - wide / 2, y + h / 2 - high / 2, wide, high)
        return Reading(decoded.mark, box, decoded.complete)
    return None


def _sample(gray: MarkImage, layout: _Layout, x: int, y: int, w: int, h: int) -> Bits | None:
    """Cells of the grid, or None where margin or contrast are not those of a plate."""
    columns, rows = layout.columns + 2, layout.rows + 2
    patch = gray[y : y + h, x : x + w]
    # Area averaging to four samples per cell; the cell's middle two by two decide.
    fine = cv2.resize(patch, (columns * 4, rows * 4), interpolation=cv2.INTER_LINEAR).astype(np.float32)
    values = fine.reshape(rows, 4, columns, 4)[:, 1:3, :, 1:3].mean(axis=(1, 3))
    if min(values[0].min(), values[-1].min(), values[:, 0].min(), values[:, -1].min()) < 180:
        return None
    inner = values[1:-1, 1:-1]
    if bool(np.any(np.abs(inner - 128) < 20)):
        return None
    return np.asarray(inner > 128, np.uint8)
