"""`observe`: crops of the stitched panorama, by sequence, frame and angle.

An `Observer` is made from public data only, the image folder and the sequences' frames, and returns pixels and where
they were taken. A caller's words never become a path: a sequence is looked up by name and a frame in its list before
anything is read.
"""

from __future__ import annotations

import contextlib
import math
import operator
import os
import threading
from collections import OrderedDict
from collections.abc import Iterable
from concurrent.futures import Future
from pathlib import Path
from typing import Final

import numpy as np

from jrdb_avr.queries.store import safe_sequence
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.method import Image, Observation, Panorama, SequenceInfo
from jrdb_avr.schema.panorama import CROP, FOV_DEG, HEIGHT, WIDTH, crop_left

CACHED_PANORAMAS: Final = 16
"""Decoded panoramas kept by default, 5.4 MB each."""

CACHED_FILES: Final = 128
"""Files of panoramas kept as they are, about half a megabyte each."""

_TILE: Final = 235
"""Columns of a tile; sixteen of them are the panorama."""

_START = b"\xff\xd8"
_END = b"\xff\xd9"
_SIZE_MARKERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


class Observer:
    """Serves observations of `sequences`, whose panoramas lie in `image_root/<sequence>/<six digits>.jpg`.

    May be called from several threads. Memory stays bounded: at most `cached` decoded panoramas and `CACHED_FILES`
    files are kept, the least recently used goes first.
    """

    def __init__(
        self, image_root: str | Path | None, sequences: Iterable[SequenceInfo], *, cached: int = CACHED_PANORAMAS
    ) -> None:
        self._root = None if image_root is None else Path(image_root)
        self._sequences = {safe_sequence(info.sequence): info for info in sequences}
        self._frames = {name: frozenset(info.frames) for name, info in self._sequences.items()}
        self._cached = max(1, cached)
        self._panoramas: OrderedDict[tuple[str, int], Future[_Strip]] = OrderedDict()
        self._files: OrderedDict[tuple[str, int], bytes] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, sequence: str, frame_index: int, angle_deg: float) -> Observation:
        """The 480 x 480 RGB crop centred on an angle in degrees: 180 ahead, 90 the robot's left, 0 behind, 270 right.

        Any finite angle is wrapped. The image is the caller's own and read-only. Raises ObserveError, saying what is
        allowed, for an unknown sequence, a frame without an image, an angle that is no number, or a broken image file.
        """
        frame = self._check(sequence, frame_index)
        angle = _angle(angle_deg)
        left = int(crop_left(angle))
        return Observation(
            sequence=sequence,
            frame_index=frame,
            frame_id=f"{frame:06d}",
            timestamp=frame / self._sequences[sequence].fps,
            angle_deg=angle,
            fov_deg=round(FOV_DEG, 2),
            left=left,
            image=self._strip(sequence, frame).crop(left),
        )

    def panorama(self, sequence: str, frame_index: int) -> Image:
        """The whole panorama, 480 x 3760 x 3 RGB, read-only. Raises ObserveError as a call does."""
        return self._strip(sequence, self._check(sequence, frame_index)).whole()

    def stored(self, sequence: str, frame_index: int) -> Panorama:
        """The whole panorama as its file's bytes, which are found to be a whole picture. Raises ObserveError."""
        frame = self._check(sequence, frame_index)
        key = (sequence, frame)
        with self._lock:
            data = self._files.get(key)
            if data is not None:
                self._files.move_to_end(key)
        if data is None:
            data, path = self._read(sequence, frame)
            decode_panorama(data, path)
            with self._lock:
                self._files[key] = data
                while len(self._files) > CACHED_FILES:
                    self._files.popitem(last=False)
        return Panorama(sequence, frame, f"{frame:06d}", frame / self._sequences[sequence].fps, data)

    def _check(self, sequence: str, frame_index: int) -> int:
        if not isinstance(sequence, str) or sequence not in self._sequences:
            raise ObserveError(f"no sequence {_shown(sequence)!r}; there are: {_some(sorted(self._sequences))}")
        try:
            frame = operator.index(frame_index)
        except TypeError:
            frame = -1
        if isinstance(frame_index, bool | np.bool_) or frame not in self._frames[sequence]:
            frames = self._sequences[sequence].frames
            raise ObserveError(
                f"{sequence} has no image at frame {_shown(frame_index)}; frames with an image: "
                + (_near(frames, frame) if frames else "none")
            )
        return frame

    def _strip(self, sequence: str, frame: int) -> _Strip:
        key = (sequence, frame)
        with self._lock:
            future = self._panoramas.get(key)
            if future is not None:
                self._panoramas.move_to_end(key)
        if future is not None:
            return future.result()
        mine: Future[_Strip] = Future()
        with self._lock:
            future = self._panoramas.setdefault(key, mine)
            if len(self._panoramas) > self._cached:
                self._panoramas.popitem(last=False)
        if future is mine:
            try:
                mine.set_result(_Strip(decode_panorama(*self._read(sequence, frame))))
            except BaseException as error:
                # A failure is not remembered: the file may be there on the next call.
                with self._lock:
                    if self._panoramas.get(key) is mine:
                        del self._panoramas[key]
                mine.set_exception(error)
        return future.result()

    def _read(self, sequence: str, frame: int) -> tuple[bytes, str]:
        """A panorama's file, and its name for messages."""
        if self._root is None:
            raise ObserveError("there are no images: load a root that holds images/image_stitched")
        path = self._root / sequence / f"{frame:06d}.jpg"
        try:
            # Reading a pipe or a device might never end.
            data = path.read_bytes() if path.is_file() or not path.exists() else b""
        except OSError as error:
            raise ObserveError(f"cannot read {path}: {os.strerror(error.errno or 0)}") from None
        return data, str(path)


class _Strip:
    """A decoded panorama that hands out crops, as copies: no crop keeps a panorama alive.

    The first crop is cut from the rows as decoded. A panorama looked at again is laid out in tiles, each contiguous: a
    crop of rows jumps 11 KB for every row of 1.4 KB, which the processor cannot fetch ahead (6,000 crops/s over many
    panoramas, against 10,000 from tiles).
    """

    def __init__(self, image: Image) -> None:
        self._image: Image | None = image
        self._tiles: Image | None = None
        self._looked_at = False

    def crop(self, left: int) -> Image:
        """Columns [left, left + 480), over the seam where need be; read-only."""
        tiles, image = self._tiles, self._image
        if tiles is None and image is not None:
            if not self._looked_at:
                self._looked_at = True
                return _join(image[None], WIDTH, left)
            # Two threads may both do this once; the tiles are set before the rows go.
            self._tiles = _to_tiles(image)
            self._image = None
        tiles = self._tiles
        assert tiles is not None
        return _join(tiles, _TILE, left)

    def whole(self) -> Image:
        """The panorama, read-only."""
        image = self._image
        if image is None:
            assert self._tiles is not None
            image = np.ascontiguousarray(self._tiles.transpose(1, 0, 2, 3)).reshape(HEIGHT, WIDTH, 3)
            image.flags.writeable = False
        return image


def _to_tiles(image: Image) -> Image:
    """16 x 480 x 235 x 3."""
    return np.ascontiguousarray(image.reshape(HEIGHT, WIDTH // _TILE, _TILE, 3).transpose(1, 0, 2, 3))


def _join(tiles: Image, width: int, left: int) -> Image:
    """480 columns from `left` on, out of tiles `width` columns wide that go round in a circle."""
    crop = np.empty((HEIGHT, CROP, 3), np.uint8)
    # Rows of bytes copy faster than rows of pixels.
    rows = crop.reshape(HEIGHT, CROP * 3)
    number, first = divmod(left, width)
    done = 0
    while done < CROP:
        columns = min(width - first, CROP - done)
        tile = tiles[number % len(tiles)].reshape(HEIGHT, width * 3)
        rows[:, done * 3 : (done + columns) * 3] = tile[:, first * 3 : (first + columns) * 3]
        done, number, first = done + columns, number + 1, 0
    crop.flags.writeable = False
    return crop


def decode_panorama(data: bytes, name: str) -> Image:
    """A stitched panorama's JPEG as a read-only 480 x 3760 x 3 RGB array; `name` is for messages.

    Raises ObserveError for what is no whole JPEG, or one of another size (which is not decoded).
    """
    import cv2

    # The decoder would fill a file that is cut short with grey and say nothing.
    if not data.startswith(_START) or _END not in data[-64:]:
        raise ObserveError(f"{name} is no whole JPEG: replace the file")
    size = _jpeg_size(data)
    if size != (WIDTH, HEIGHT):
        shown = "without a size" if size is None else f"{size[0]} x {size[1]}"
        raise ObserveError(f"{name} is {shown}, a stitched panorama is {WIDTH} x {HEIGHT}")
    image: Image | None = None
    with contextlib.suppress(cv2.error):
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None or image.shape != (HEIGHT, WIDTH, 3):
        raise ObserveError(f"{name} cannot be decoded: replace the file")
    image.flags.writeable = False
    return image


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height from the frame header, or None where there is none before the image data."""
    at = 2
    while at + 9 <= len(data):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
        elif marker in _SIZE_MARKERS:
            return int.from_bytes(data[at + 7 : at + 9]), int.from_bytes(data[at + 5 : at + 7])
        elif marker == 0xDA:
            return None
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4])
    return None


def _angle(angle_deg: float) -> float:
    """The angle in [0, 360). Raises ObserveError for what is no finite number."""
    try:
        angle = math.nan if isinstance(angle_deg, str | bytes | bool) else float(angle_deg)
    except (TypeError, ValueError, OverflowError):
        angle = math.nan
    if not math.isfinite(angle):
        raise ObserveError(f"angle {_shown(angle_deg)} is no finite number of degrees (180 is ahead, 90 left)")
    # The second modulo catches a tiny negative angle, whose first rounds to 360.
    return angle % 360.0 % 360.0


def _shown(value: object) -> str:
    """What a caller gave, in a message."""
    try:
        return str(value)[:100]
    except ValueError:
        # Python writes no integer of more than 4,300 digits.
        return "of thousands of digits"


def _some(names: list[str]) -> str:
    """Names in a message, the first thirty of many."""
    shown = ", ".join(names[:30]) or "none"
    return shown if len(names) <= 30 else f"{shown} and {len(names) - 30} more"


def _near(frames: tuple[int, ...], wanted: int) -> str:
    nearest = min(frames, key=lambda frame: (abs(frame - wanted), frame))
    return f"{len(frames)} from {frames[0]} to {frames[-1]}, the nearest is {nearest}"
