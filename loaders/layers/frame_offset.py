"""Check whether two layers number their frames alike, by the people in both.

Train files come in two numberings that are two frames apart, and no file states its numbering. A layer at frame f is
compared with the 2D boxes at frame f + s. There are two tests:

- Equal boxes, for layers that repeat the 2D boxes: the shift is the s with the most equal boxes.
- Motion, for 3D boxes: a person's 3D box may be off to one side throughout, camera and lidar are read up to 40 ms
  apart, and standing people show nothing. Therefore the distance between the two columns of a person is regressed on
  the speed of the column. The slope is the shift in frames. Its error comes from independent spells of people and time.

Columns are centres of people in stitched pixels. For 3D boxes they follow from the azimuth a: 3760 * (0.5 - a / 2 pi).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.labelfiles.columns import LayerTables, Rows, ascending, paired, rank_values, whole_numbers
from jrdb_avr.loaders.report import ShiftCheck
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.panorama import WIDTH, angle_of_azimuth, column_of_angle

TRIED: Final = (0, 1, -1, 2, -2)
"""Shifts in frames that are tried."""
MAX_ROWS: Final = 20_000
"""Maximum boxes that are compared. Of more boxes, evenly spread ones are taken."""

SAME: Final = 1.0
"""Maximum distance of equal boxes in pixels."""
MIN_LEAD: Final = 20
"""Minimum number of equal boxes that a shift has more than any other shift."""
SHIFTED_SHARE: Final = 0.9
"""Minimum share of equal boxes for the claim that a layer is shifted."""
AGREEING_SHARE: Final = 0.5
"""Minimum share of equal boxes for the claim that a layer is not shifted."""

MAX_GAP: Final = 15
"""Maximum frames between two boxes of a person that are joined by a straight line."""
REACH: Final = 4
"""Frames to both sides for the speed of a column."""
MAX_SPEED: Final = 40.0
"""Maximum speed of a column in pixels per frame."""
MAX_APART: Final = 300.0
"""Maximum distance of two columns of a person in pixels."""
SPELL: Final = 45
"""Frames of a person, or of all people, that count as one observation."""
MAX_SPELL_SHARE: Final = 0.05
"""Maximum share of all motion that one spell adds. One fast person must not outweigh all others."""
MIN_SPELLS: Final = 10.0
MIN_TRACKS: Final = 2.0
CLOCK: Final = 0.7
"""Maximum apparent shift in frames between sensors that are read at different moments."""
MIN_RESPONSE: Final = 0.5
"""Minimum share of a planted shift that the slope must show, or agreement is not claimed."""
ERRORS_BEYOND: Final = 3.0
"""Standard errors by which a shift must exceed `CLOCK`."""
ERRORS_AWAY: Final = 6.0
"""Standard errors by which a shift must exceed zero."""

NO_BOXES: Final = "the 2D layer has no boxes to compare with"
NO_COMMON_PERSON: Final = "no person is in both layers"
TOO_STILL: Final = "too few of the people in both layers move enough to tell"
FOREIGN: Final = "the boxes fit the 2D boxes at no shift of up to 2 frames"


@dataclass(frozen=True)
class Tracks(Rows):
    """Positions of the people of a layer, sorted by track and frame."""

    frame: Ints
    track: Ints
    column: Floats
    box: Floats | None
    """Boxes in the panorama, shape (n, 4), or None for a layer without boxes there."""

    def columns_at(self, track: Ints, frame: Ints) -> Floats:
        """Return columns of people at any frame, on straight lines between the layer's frames, NaN beyond them."""
        key, after = self._rows_from(track, frame)
        before = np.where(self._keys[after] == key, after, np.maximum(after - 1, 0))
        start, end = self._keys[before], self._keys[after]
        inside = (start <= key) & (key <= end) & (end - start <= MAX_GAP) & (frame >= 0)
        part = np.where(inside, (key - start) / np.maximum(end - start, 1), np.nan)
        return np.asarray(self.column[before] + part * _difference(self.column[after], self.column[before]))

    def boxes_at(self, track: Ints, frame: Ints) -> Floats:
        """Return boxes of people at frames of the layer, shape (n, 4), NaN for a missing box."""
        assert self.box is not None
        key, row = self._rows_from(track, frame)
        present = (self._keys[row] == key) & (frame >= 0)
        return np.where(present[:, None], self.box[row], np.nan)

    def _rows_from(self, track: Ints, frame: Ints) -> tuple[Ints, Ints]:
        """Return the key of each person and frame, and the first row at or after the key."""
        key = paired(track, np.maximum(frame, 0))
        return key, np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)

    @cached_property
    def _keys(self) -> Ints:
        return paired(self.track, self.frame)


class Slope(NamedTuple):
    """A shift in frames, estimated from motion, and its standard error."""

    frames: float
    error: float


def tracks_of(layer: str, reading: LayerTables) -> Tracks | None:
    """Return the people of a file, or None for a layer without positions.

    Poses are left out: the visible points lead or trail a walking person, which looks like a shift.
    """
    if layer == "3d":
        return _tracks_3d(reading.tables["boxes_3d"])
    table = reading.tables["boxes_2d"] if layer == "2d" else reading.boxes
    return None if table is None else _tracks_2d(table)


def check_shift(layer: str, tracks: Tracks, reference: Tracks | None) -> ShiftCheck:
    """Compare the people of a layer with the 2D boxes."""
    if reference is None or not len(reference.frame):
        return ShiftCheck(layer, "not tested", NO_BOXES)
    shared = np.isin(tracks.track, reference.track)
    if not shared.any():
        return ShiftCheck(layer, "not tested", NO_COMMON_PERSON)
    rows = np.flatnonzero(shared)
    tracks = tracks.at(rows[:: -(-len(rows) // MAX_ROWS)])
    if tracks.box is not None:
        shift = equal_at(tracks, reference)
        return ShiftCheck(layer, "not tested", TOO_STILL) if shift is None else _check(layer, shift, None)
    slope = slope_of(tracks, reference)
    if slope is None:
        return ShiftCheck(layer, "not tested", TOO_STILL)
    size = abs(slope.frames)
    if size - CLOCK >= ERRORS_BEYOND * slope.error and size >= ERRORS_AWAY * slope.error:
        if round(size) > max(TRIED):
            return ShiftCheck(layer, "not tested", FOREIGN, *slope)
        return _check(layer, round(slope.frames), slope)
    response = response_of(tracks, reference)
    if response >= MIN_RESPONSE and size + ERRORS_BEYOND * slope.error < response:
        return _check(layer, 0, slope)
    return ShiftCheck(layer, "not tested", TOO_STILL, *slope)


def equal_at(tracks: Tracks, reference: Tracks) -> int | None:
    """Return the shift with the most boxes equal to the reference, or None if no shift is clearly best."""
    assert tracks.box is not None
    apart = [_difference(tracks.box, reference.boxes_at(tracks.track, tracks.frame + s)) for s in TRIED]
    compared = [int((~np.isnan(difference[:, 0])).sum()) for difference in apart]
    equal = [int((np.abs(difference).max(axis=1) <= SAME).sum()) for difference in apart]
    best, second = sorted(range(len(TRIED)), key=lambda i: -equal[i])[:2]
    share = SHIFTED_SHARE if TRIED[best] else AGREEING_SHARE
    clear = equal[best] - equal[second] >= MIN_LEAD and equal[best] >= share * compared[best]
    return TRIED[best] if clear else None


def response_of(tracks: Tracks, reference: Tracks) -> float:
    """Return the change of the slope for a layer that is moved by one frame: 1 if all motion is real.

    It is near 0 if the boxes of standing people are only drawn a little elsewhere each time. Then a slope of zero does
    not prove agreement.
    """
    slopes = [slope_of(tracks, reference, moved) for moved in (-1, 1)]
    if slopes[0] is None or slopes[1] is None:
        return 0.0
    return (slopes[0].frames - slopes[1].frames) / 2


def slope_of(tracks: Tracks, reference: Tracks, moved: int = 0) -> Slope | None:
    """Estimate the shift by regression on motion.

    Args:
        tracks: people of the layer.
        reference: people of the 2D layer.
        moved: frames by which the layer is moved before the comparison.

    Returns:
        The shift, or None if too little moves for an estimate with an error.
    """
    frame = tracks.frame + moved
    apart = _difference(tracks.column, reference.columns_at(tracks.track, frame))
    ahead, behind = (reference.columns_at(tracks.track, frame + offset) for offset in (REACH, -REACH))
    speed = _difference(ahead, behind) / (2 * REACH)
    usable = (np.abs(apart) <= MAX_APART) & (np.abs(speed) <= MAX_SPEED)
    track, frame = tracks.track[usable], tracks.frame[usable]
    if not len(track):
        return None
    speed, apart = _without_means(speed[usable], track), _without_means(apart[usable], track)
    _, spell = rank_values(paired(frame // SPELL, track))
    weight = np.bincount(spell, speed * speed)
    most = float(weight.sum()) * MAX_SPELL_SHARE
    if not most > 0:
        return None
    share = (most / np.maximum(weight, most))[spell]
    weighted, product = share * speed * speed, share * speed * apart
    total = float(weighted.sum())
    frames = float(product.sum()) / total
    rest = product - frames * weighted
    if (
        _effective(np.bincount(spell, weighted)) < MIN_SPELLS
        or _effective(np.bincount(rank_values(track)[1], weighted)) < MIN_TRACKS
    ):
        return None
    errors = []
    for group in (spell, rank_values(frame // SPELL)[1]):
        sums = np.bincount(group, rest)
        if len(sums) > 1:
            errors.append(float(np.sqrt((sums * sums).sum() * len(sums) / (len(sums) - 1))) / total)
    return Slope(frames, max(errors))


def _check(layer: str, shift: int, slope: Slope | None) -> ShiftCheck:
    if shift:
        about = "about " if slope else ""
        reason = f"agrees with the 2D boxes only when moved by {about}{shift:+d} frames: renumber it or load without it"
        return ShiftCheck(layer, "shifted", reason, *(slope or (float(shift), 0.0)))
    reason = "people move in both layers at the same frames" if slope else "its boxes are those of the 2D layer"
    return ShiftCheck(layer, "agrees", reason, *(slope or (0.0, 0.0)))


# -- people ------------------------------------------------------------------------------------------------------


def _tracks_2d(table: pa.Table) -> Tracks:
    box = np.stack([table[name].to_numpy() for name in "xywh"], axis=1)
    # The centre of a box that is cut off at the seam is not the centre of the person.
    whole = (box[:, 0] > SAME) & (box[:, 0] + box[:, 2] < WIDTH - SAME)
    return _sorted(table, box[:, 0] + box[:, 2] / 2, box, whole)


def _tracks_3d(table: pa.Table) -> Tracks:
    x, y = table["cx"].to_numpy(), table["cy"].to_numpy()
    return _sorted(table, column_of_angle(angle_of_azimuth(np.arctan2(y, x))), None, (x != 0) | (y != 0))


def _sorted(table: pa.Table, column: Floats, box: Floats | None, usable: Bools) -> Tracks:
    tracks = Tracks(whole_numbers(table, "frame"), whole_numbers(table, "track"), column, box)
    order = ascending(tracks.track, tracks.frame)
    return tracks.at(order[usable[order]])


def _difference(a: Floats, b: Floats) -> Floats:
    """Return the differences of columns, or of boxes with shape (n, 4). Columns differ by the short way round."""
    difference = a - b
    columns = difference if difference.ndim == 1 else difference[:, 0]
    columns[:] = (columns + WIDTH / 2) % WIDTH - WIDTH / 2
    return difference


def _without_means(values: Floats, track: Ints) -> Floats:
    _, group = rank_values(track)
    return values - (np.bincount(group, values) / np.bincount(group))[group]


def _effective(weights: npt.NDArray[Any]) -> float:
    """Return the number of equal weights with the same spread."""
    return float(weights.sum() ** 2 / (weights * weights).sum())
