"""Whether two layers number their frames alike, judged by the people that both hold.

Train files come in two numberings that are two frames apart, and nothing in them says which. A layer at frame f is
compared with the 2D boxes at f + s. Standing people say nothing, a person's boxes may be off to one side throughout,
and camera and lidar are read up to 40 ms apart. So two tests are used, and only what moves is looked at:

- equal boxes: a layer that repeats the 2D boxes is found out by where it repeats them;
- motion: over each person's frames, the distance between the two columns is regressed on the speed of the column. The
  slope is the shift in frames. Its error is that of independent spells of people, and of stretches of time.

Columns are centres of people in stitched pixels. Of 3D boxes they follow from the azimuth: 3760 * (0.5 - a / 2 pi).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.labelfiles.columns import LayerTables, Rows, ascending, paired, places, whole_numbers
from jrdb_avr.loaders.report import ShiftCheck
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.panorama import WIDTH, angle_of_azimuth, column_of_angle

TRIED: Final = (0, 1, -1, 2, -2)
MAX_GAP: Final = 15
"""Frames between two boxes of a person that are still joined by a straight line."""
MAX_ROWS: Final = 20_000
"""Boxes that are compared; of more, evenly spread ones."""

SAME: Final = 1.0
"""Pixels within which two boxes are the same one."""
MOVED: Final = 3.0
"""Pixels from which on a box is another one."""
MIN_EQUAL: Final = 20
"""Moved boxes that the test of equal boxes needs."""
EQUAL_SHARE: Final = 0.9
UNEQUAL_SHARE: Final = 0.5

REACH: Final = 4
"""Frames to both sides over which the speed of a column is measured."""
MAX_SPEED: Final = 40.0
MAX_APART: Final = 300.0
SPELL: Final = 45
"""Frames of a person, or of everybody, that count as one observation."""
MOST: Final = 0.05
"""Share of all motion that one spell may add."""
MIN_SPELLS: Final = 10.0
MIN_TRACKS: Final = 2.0
CLOCK: Final = 0.7
"""Frames of apparent shift that sensors read at different moments may cause."""
MAX_SHIFT: Final = 3.0
MIN_RESPONSE: Final = 0.5
"""Share of a shift that the slope must show, or agreement is not claimed of it."""
ERRORS_BEYOND: Final = 3.0
ERRORS_AWAY: Final = 6.0
"""Standard errors by which a shift must exceed `CLOCK`, and zero."""

NO_BOXES: Final = "the 2D layer has no boxes to compare with"
NO_COMMON_PERSON: Final = "no person is in both layers"
TOO_STILL: Final = "too few of the people in both layers move enough to tell"
FOREIGN: Final = "the boxes fit the 2D boxes at no shift of up to 2 frames"


@dataclass(frozen=True)
class Tracks(Rows):
    """Where a layer sees people, sorted by track and frame."""

    frame: Ints
    track: Ints
    column: Floats
    box: Floats | None
    """(n, 4), where the layer has boxes in the panorama."""

    def columns_at(self, track: Ints, frame: Ints) -> Floats:
        """Columns of people at any frame, on straight lines between the layer's own frames; NaN beyond them."""
        return self._between(self.column, track, frame)

    def boxes_at(self, track: Ints, frame: Ints) -> Floats:
        """Boxes of people at any frame, interpolated as columns are."""
        assert self.box is not None
        return self._between(self.box, track, frame)

    def _between(self, values: Floats, track: Ints, frame: Ints) -> Floats:
        wanted = paired(track, np.maximum(frame, 0))
        after = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        before = np.where(self._keys[after] == wanted, after, np.maximum(after - 1, 0))
        start, end = self._keys[before], self._keys[after]
        inside = (start <= wanted) & (wanted <= end) & (end - start <= MAX_GAP) & (frame >= 0)
        part = np.where(inside, (wanted - start) / np.maximum(end - start, 1), np.nan)
        step = _difference(values[after], values[before])
        return np.asarray(values[before] + (part * step.T).T)

    @cached_property
    def _keys(self) -> Ints:
        return paired(self.track, self.frame)


class Slope(NamedTuple):
    """The shift in frames, estimated from motion, and its standard error."""

    frames: float
    error: float


def tracks_of(layer: str, reading: LayerTables) -> Tracks | None:
    """The people of a file, for layers that place them; None for the others.

    Poses are left out: the points that can be seen lead or trail a walking person, which looks like a shift.
    """
    if layer == "3d":
        return _of_3d(reading.tables["boxes_3d"])
    table = reading.tables["boxes_2d"] if layer == "2d" else reading.boxes
    return None if table is None else _of_boxes(table)


def check_shift(layer: str, tracks: Tracks, reference: Tracks | None) -> ShiftCheck:
    """Compare a layer's people with those of the 2D boxes."""
    if reference is None or not len(reference.frame):
        return ShiftCheck(layer, "not tested", NO_BOXES)
    shared = np.isin(tracks.track, reference.track)
    if not shared.any():
        return ShiftCheck(layer, "not tested", NO_COMMON_PERSON)
    rows = np.flatnonzero(shared)
    tracks = tracks.at(rows[:: -(-len(rows) // MAX_ROWS)])
    if tracks.box is not None:
        equal = equal_at(tracks, reference)
        if equal is not None:
            return _agrees(layer, None) if equal == 0 else _shifted(layer, equal, None)
    slope = slope_of(tracks, reference)
    if slope is None:
        return ShiftCheck(layer, "not tested", TOO_STILL)
    size = abs(slope.frames)
    if size - CLOCK >= ERRORS_BEYOND * slope.error and size >= ERRORS_AWAY * slope.error:
        nearest = nearest_shift(tracks, reference)
        if size > MAX_SHIFT or nearest * slope.frames <= 0:
            return ShiftCheck(layer, "not tested", FOREIGN, *slope)
        return _shifted(layer, nearest, slope)
    response = response_of(tracks, reference)
    if response >= MIN_RESPONSE and size + ERRORS_BEYOND * slope.error < response:
        return _agrees(layer, slope)
    return ShiftCheck(layer, "not tested", TOO_STILL, *slope)


def equal_at(tracks: Tracks, reference: Tracks) -> int | None:
    """The shift at which a layer's boxes are the reference's own; None where they are not, or too few boxes move."""
    assert tracks.box is not None
    there = {s: reference.boxes_at(tracks.track, tracks.frame + s) for s in TRIED}
    same = {s: _apart(tracks.box, there[s]) <= SAME for s in TRIED}
    usable = np.logical_and.reduce([~np.isnan(box[:, 0]) for box in there.values()])
    found = None
    for s in TRIED[1:]:
        # NaN compares false, so rows without a box there fall out.
        moved = usable & (_apart(there[0], there[s]) >= MOVED)
        if moved.sum() < MIN_EQUAL:
            continue
        if same[0][moved].mean() > UNEQUAL_SHARE:
            return 0
        if same[s][moved].mean() >= EQUAL_SHARE and found is None:
            found = s
    return found


def response_of(tracks: Tracks, reference: Tracks) -> float:
    """By how many frames the slope changes for a layer that is moved by one frame: 1 where all motion is real.

    Where the boxes of people who stand are only drawn a little elsewhere each time, it is near 0: then a slope of zero
    says nothing. (Moved by one frame: by `REACH` less a shift, a layer that repeats the reference's errors would meet
    them in the speed.)
    """
    slopes = [slope_of(tracks, reference, moved) for moved in (-1, 1)]
    if slopes[0] is None or slopes[1] is None:
        return 0.0
    return (slopes[0].frames - slopes[1].frames) / 2


def slope_of(tracks: Tracks, reference: Tracks, moved: int = 0) -> Slope | None:
    """The shift by regression on motion; None where too little moves for an estimate with an error.

    `moved`: frames by which the layer is moved before it is compared.
    """
    here = tracks.frame + moved
    apart = _difference(tracks.column, reference.columns_at(tracks.track, here))
    ahead, behind = (reference.columns_at(tracks.track, here + away) for away in (REACH, -REACH))
    speed = _difference(ahead, behind) / (2 * REACH)
    usable = (np.abs(apart) <= MAX_APART) & (np.abs(speed) <= MAX_SPEED)
    track, frame = tracks.track[usable], tracks.frame[usable]
    if not len(track):
        return None
    speed, apart = _without_means(speed[usable], track), _without_means(apart[usable], track)
    _, spell = places(paired(frame // SPELL, track))
    weight = np.bincount(spell, speed * speed)
    # One person who rushes past must not outweigh everybody else.
    most = float(weight.sum()) * MOST
    if not most > 0:
        return None
    share = (most / np.maximum(weight, most))[spell]
    weighted, product = share * speed * speed, share * speed * apart
    total = float(weighted.sum())
    frames = float(product.sum()) / total
    rest = product - frames * weighted
    groups = (spell, places(track)[1], places(frame // SPELL)[1])
    sizes = [_effective(np.bincount(group, weighted)) for group in groups]
    if sizes[0] < MIN_SPELLS or sizes[1] < MIN_TRACKS:
        return None
    errors = []
    for group in (groups[0], groups[2]):
        sums = np.bincount(group, rest)
        if len(sums) > 1:
            errors.append(float(np.sqrt((sums * sums).sum() * len(sums) / (len(sums) - 1))) / total)
    return Slope(frames, max(errors))


def nearest_shift(tracks: Tracks, reference: Tracks) -> int:
    """Of the shifts tried, the one at which columns lie closest to those of the reference, people's means left out."""
    apart = np.stack([_difference(tracks.column, reference.columns_at(tracks.track, tracks.frame + s)) for s in TRIED])
    usable = (np.abs(apart) <= MAX_APART).all(axis=0)
    if not usable.any():
        return 0
    track = tracks.track[usable]
    misses = [float(np.abs(_without_means(row, track)).mean()) for row in apart[:, usable]]
    return TRIED[int(np.argmin(misses))]


# -- results -----------------------------------------------------------------------------------------------------


def _agrees(layer: str, slope: Slope | None) -> ShiftCheck:
    how = "its boxes are those of the 2D layer" if slope is None else "people move in both layers at the same frames"
    return ShiftCheck(layer, "agrees", how, *(slope or (0.0, 0.0)))


def _shifted(layer: str, frames: int, slope: Slope | None) -> ShiftCheck:
    about = "about " if slope else ""
    reason = f"agrees with the 2D boxes only when moved by {about}{frames:+d} frames: renumber it or load without it"
    return ShiftCheck(layer, "shifted", reason, *(slope or (float(frames), 0.0)))


# -- people ------------------------------------------------------------------------------------------------------


def _of_boxes(table: pa.Table) -> Tracks:
    box = np.stack([table[name].to_numpy() for name in "xywh"], axis=1)
    # A box cut off at the seam has its centre elsewhere than the person.
    whole = (box[:, 0] > SAME) & (box[:, 0] + box[:, 2] < WIDTH - SAME)
    return _sorted(table, box[:, 0] + box[:, 2] / 2, box, whole)


def _of_3d(table: pa.Table) -> Tracks:
    x, y = table["cx"].to_numpy(), table["cy"].to_numpy()
    return _sorted(table, column_of_angle(angle_of_azimuth(np.arctan2(y, x))), None, (x != 0) | (y != 0))


def _sorted(table: pa.Table, column: Floats, box: Floats | None, usable: Bools) -> Tracks:
    tracks = Tracks(whole_numbers(table, "frame"), whole_numbers(table, "track"), column, box)
    order = ascending(tracks.track, tracks.frame)
    return tracks.at(order[usable[order]])


def _difference(a: Floats, b: Floats) -> Floats:
    """By how much columns, or boxes, differ; columns the short way round."""
    difference = a - b
    columns = difference if difference.ndim == 1 else difference[:, 0]
    columns[:] = (columns + WIDTH / 2) % WIDTH - WIDTH / 2
    return difference


def _apart(a: Floats, b: Floats) -> Floats:
    """Largest difference of each pair of boxes."""
    return np.asarray(np.abs(_difference(a, b)).max(axis=1))


def _without_means(values: Floats, track: Ints) -> Floats:
    _, group = places(track)
    return values - (np.bincount(group, values) / np.bincount(group))[group]


def _effective(weights: npt.NDArray[Any]) -> float:
    """How many equal weights would be spread as widely."""
    return float(weights.sum() ** 2 / (weights * weights).sum())
