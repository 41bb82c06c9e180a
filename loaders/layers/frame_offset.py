"""Check whether a layer numbers its frames like the 2D layer, by comparing the people in both layers.

Files of the train sequences use two numberings that are two frames apart, and no file states its numbering. The check
compares the people of a layer at frame f with the 2D boxes at frame f + s, and looks for the shift s that makes both
fit. There are two tests:

- Equal boxes, for layers that repeat the 2D boxes. The shift is the s that makes the largest number of boxes equal.
- Motion, for 3D boxes. A 3D box cannot equal a 2D box, and a fixed distance may separate the 3D box and the 2D box of
  a person in every frame. A shift of frames adds a distance that is proportional to the person's speed. Therefore a
  linear regression explains the horizontal distance between a person's 3D box and 2D box by the person's horizontal
  speed. The intercept, one per person, is the fixed distance. The slope is the shift in frames. The standard error
  of the slope is estimated twice: from blocks of frames of each person, and from blocks of frames of all people. The
  larger estimate is used. The camera and the lidar are read up to 40 ms apart, so a slope of up to 40 ms does not show
  a shift.

The column of a person is the horizontal centre of the person in pixels of the panorama. The column of a 3D box at the
azimuth a is 3760 * (0.5 - a / 2 pi).
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
"""Shifts in frames that the tests can find."""
MAX_ROWS: Final = 20_000
"""Maximum number of boxes that are compared. If there are more, every nth box is taken."""

SAME: Final = 1.0
"""Maximum difference in pixels between the coordinates of equal boxes."""
MIN_LEAD: Final = 20
"""Minimum lead of the best shift over the second best shift, in the number of equal boxes."""
SHIFTED_SHARE: Final = 0.9
"""Minimum share of equal boxes among the compared boxes for the result "shifted"."""
AGREEING_SHARE: Final = 0.5
"""Minimum share of equal boxes among the compared boxes for the result "agrees"."""

MAX_GAP: Final = 15
"""Maximum distance in frames between two boxes of a person for interpolation between them."""
REACH: Final = 4
"""Number of frames before and after a frame. The columns at these two frames give the person's speed at the frame."""
MAX_SPEED: Final = 40.0
"""Maximum speed of a person's column in pixels per frame. Faster observations are ignored."""
MAX_APART: Final = 300.0
"""Maximum distance in pixels between a person's columns in two layers. Larger distances are ignored."""
SPELL: Final = 45
"""Length of a block in frames. The standard error treats each block as one independent observation."""
MAX_SPELL_SHARE: Final = 0.05
"""Maximum weight of one block, as a share of all motion, so that one fast person does not outweigh all others."""
MIN_SPELLS: Final = 10.0
"""Minimum effective number of blocks with motion."""
MIN_TRACKS: Final = 2.0
"""Minimum effective number of people with motion."""
CLOCK: Final = 0.7
"""Maximum apparent shift in frames that arises because camera and lidar are read at different moments."""
MIN_RESPONSE: Final = 0.5
"""Minimum value of `response_of` for the result "agrees"."""
ERRORS_BEYOND: Final = 3.0
"""Minimum margin in standard errors.

For the result "shifted", a shift must exceed `CLOCK` by the margin. For the result "agrees", the shift must stay below
the value of `response_of` by the margin.
"""
ERRORS_AWAY: Final = 6.0
"""Minimum size of a shift in standard errors for the result "shifted"."""

TOO_STILL: Final = "too few of the people in both layers move enough to tell"


@dataclass(frozen=True)
class Tracks(Rows):
    """Positions of the people of a layer, with one row per person and frame, sorted by track and frame."""

    frame: Ints
    track: Ints
    column: Floats
    """Horizontal centres of the people, in pixels of the panorama."""
    box: Floats | None
    """Boxes x, y, width, height in pixels of the panorama, shape (n, 4). None for 3D boxes."""

    def columns_at(self, track: Ints, frame: Ints) -> Floats:
        """Return the columns of people at given frames, by linear interpolation between the frames of each person.

        Args:
            track: track of the person, for each requested column.
            frame: frame, for each requested column.

        Returns:
            The columns of the panorama in pixels. A column is NaN before the person's first frame, after the
            person's last frame, and in gaps longer than `MAX_GAP` frames.
        """
        key, after = self._rows_from(track, frame)
        before = np.where(self._keys[after] == key, after, np.maximum(after - 1, 0))
        start, end = self._keys[before], self._keys[after]
        inside = (start <= key) & (key <= end) & (end - start <= MAX_GAP) & (frame >= 0)
        part = np.where(inside, (key - start) / np.maximum(end - start, 1), np.nan)
        return np.asarray(self.column[before] + part * _difference(self.column[after], self.column[before]))

    def boxes_at(self, track: Ints, frame: Ints) -> Floats:
        """Return the box for each pair of a track and a frame, as an array of shape (n, 4). A missing box is NaN."""
        assert self.box is not None
        key, row = self._rows_from(track, frame)
        present = (self._keys[row] == key) & (frame >= 0)
        return np.where(present[:, None], self.box[row], np.nan)

    def _rows_from(self, track: Ints, frame: Ints) -> tuple[Ints, Ints]:
        """Return two arrays with one element for each pair of a track and a frame: the pair's key, and a row index.

        The rows of this object are sorted by key. The row index points to the first row with a key that is not smaller
        than the key of the pair. If all rows have smaller keys, the row index points to the last row.
        """
        key = paired(track, np.maximum(frame, 0))
        return key, np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)

    @cached_property
    def _keys(self) -> Ints:
        return paired(self.track, self.frame)


class Slope(NamedTuple):
    """Shift in frames that is estimated from motion, and its standard error in frames."""

    frames: float
    error: float


def tracks_of(layer: str, reading: LayerTables) -> Tracks | None:
    """Return the positions of the people in a file, or None for a layer without boxes.

    Key points of poses are not used as positions. The visible key points of a walking person may be ahead of the
    person's centre or behind it, and this distance would look like a shift of frames.

    Args:
        layer: name of the layer.
        reading: tables of the file.
    """
    if layer == "3d":
        return _tracks_3d(reading.tables["boxes_3d"])
    table = reading.tables["boxes_2d"] if layer == "2d" else reading.boxes
    return None if table is None else _tracks_2d(table)


def check_shift(layer: str, tracks: Tracks, reference: Tracks | None) -> ShiftCheck:
    """Check whether a layer numbers its frames like the 2D layer.

    Args:
        layer: name of the layer.
        tracks: people of the layer.
        reference: people of the 2D layer, or None if the sequence has no usable 2D file.

    Returns:
        The result `agrees`, `shifted` or `not tested`, with the reason.
    """
    if reference is None or not len(reference.frame):
        return ShiftCheck(layer, "not tested", "the 2D layer has no boxes to compare with")
    shared = np.isin(tracks.track, reference.track)
    if not shared.any():
        return ShiftCheck(layer, "not tested", "no person is in both layers")
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
            reason = "no shift of up to 2 frames makes the boxes fit the 2D boxes"
            return ShiftCheck(layer, "not tested", reason, *slope)
        return _check(layer, round(slope.frames), slope)
    response = response_of(tracks, reference)
    if response >= MIN_RESPONSE and size + ERRORS_BEYOND * slope.error < response:
        return _check(layer, 0, slope)
    return ShiftCheck(layer, "not tested", TOO_STILL, *slope)


def equal_at(tracks: Tracks, reference: Tracks) -> int | None:
    """Return the shift in frames that makes the largest number of boxes equal, or None if no shift is clearly best."""
    assert tracks.box is not None
    apart = [_difference(tracks.box, reference.boxes_at(tracks.track, tracks.frame + s)) for s in TRIED]
    compared = [int((~np.isnan(difference[:, 0])).sum()) for difference in apart]
    equal = [int((np.abs(difference).max(axis=1) <= SAME).sum()) for difference in apart]
    best, second = sorted(range(len(TRIED)), key=lambda i: -equal[i])[:2]
    share = SHIFTED_SHARE if TRIED[best] else AGREEING_SHARE
    clear = equal[best] - equal[second] >= MIN_LEAD and equal[best] >= share * compared[best]
    return TRIED[best] if clear else None


def response_of(tracks: Tracks, reference: Tracks) -> float:
    """Return by how much the estimate of `slope_of` changes if the frames of the layer are moved by one on purpose.

    The result is 1 if all motion is real. The result is near 0 if people stand still and only the annotated positions
    of their boxes vary. If the result is near 0, a slope of zero does not prove that the layers agree.
    """
    slopes = [slope_of(tracks, reference, moved) for moved in (-1, 1)]
    if slopes[0] is None or slopes[1] is None:
        return 0.0
    return (slopes[0].frames - slopes[1].frames) / 2


def slope_of(tracks: Tracks, reference: Tracks, moved: int = 0) -> Slope | None:
    """Estimate the shift of a layer by a regression of distances on speeds.

    Args:
        tracks: people of the layer.
        reference: people of the 2D layer.
        moved: number of frames to add to the frames of the layer before the comparison.

    Returns:
        The shift and its standard error, or None if too few people move to estimate both.
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
    """Return the result of `check_shift` for a shift that was found.

    `slope` is the estimate from motion, or None if the shift was found by equal boxes.
    """
    if shift:
        about = "about " if slope else ""
        reason = f"agrees with the 2D boxes only when moved by {about}{shift:+d} frames: renumber it or load without it"
        return ShiftCheck(layer, "shifted", reason, *(slope or (float(shift), 0.0)))
    reason = "people move in both layers at the same frames" if slope else "its boxes are those of the 2D layer"
    return ShiftCheck(layer, "agrees", reason, *(slope or (0.0, 0.0)))


# -- people ------------------------------------------------------------------------------------------------------


def _tracks_2d(table: pa.Table) -> Tracks:
    box = np.stack([table[name].to_numpy() for name in "xywh"], axis=1)
    # The edges of the panorama cut some boxes off. These boxes are left out, because they are not centred on people.
    whole = (box[:, 0] > SAME) & (box[:, 0] + box[:, 2] < WIDTH - SAME)
    return _sorted(table, box[:, 0] + box[:, 2] / 2, box, whole)


def _tracks_3d(table: pa.Table) -> Tracks:
    x, y = table["cx"].to_numpy(), table["cy"].to_numpy()
    return _sorted(table, column_of_angle(angle_of_azimuth(np.arctan2(y, x))), None, (x != 0) | (y != 0))


def _sorted(table: pa.Table, column: Floats, box: Floats | None, usable: Bools) -> Tracks:
    """Return the positions in the rows that `usable` marks, sorted by track and frame."""
    tracks = Tracks(whole_numbers(table, "frame"), whole_numbers(table, "track"), column, box)
    order = ascending(tracks.track, tracks.frame)
    return tracks.at(order[usable[order]])


def _difference(a: Floats, b: Floats) -> Floats:
    """Return `a - b`. Both arguments are columns of the panorama, or both are boxes of shape (n, 4).

    The panorama is a full circle. Therefore the difference of two columns, or of the left edges of two boxes, is taken
    in the shorter direction around the circle.
    """
    difference = a - b
    columns = difference if difference.ndim == 1 else difference[:, 0]
    columns[:] = (columns + WIDTH / 2) % WIDTH - WIDTH / 2
    return difference


def _without_means(values: Floats, track: Ints) -> Floats:
    """Return each value minus the mean of all values of the same track."""
    _, group = rank_values(track)
    return values - (np.bincount(group, values) / np.bincount(group))[group]


def _effective(weights: npt.NDArray[Any]) -> float:
    """Return the effective number of weights: the square of their sum, divided by the sum of their squares."""
    return float(weights.sum() ** 2 / (weights * weights).sum())
