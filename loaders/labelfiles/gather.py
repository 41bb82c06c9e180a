"""Records of a label file gathered into columns of numbers, chunk by chunk, and which of them are kept.

Decoded records are the largest thing in memory, so they live for a chunk only. What repeats from record to record
(label ids, raw label objects) is numbered; the numbers are the columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.labelfiles.columns import Distinct, Refusals, first_of_equal, mask_of, person_keys
from jrdb_avr.loaders.labelfiles.frames import Frame, RecordReader, read_frames
from jrdb_avr.loaders.labelfiles.records import BAD, OTHER, track_codes
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.errors import InputError

MAX_GATHERED: Final = 400_000
"""Records of one file; twice as many as JRDB's fullest sequence has boxes."""
CHUNK: Final = 20_000
"""Records whose columns are taken at once."""
CHUNK_BYTES: Final = 32 << 20
"""The most text of a chunk: a hostile record may hold thousands of objects."""

BATCH_BYTES: Final = 1 << 19
"""Bytes of text of the frames that are read together."""

Columns = dict[str, npt.NDArray[Any]]
R = TypeVar("R", bound=msgspec.Struct)


class Gathered(Generic[R]):
    """Columns of all usable records of a file, in its order."""

    def __init__(self, take: Callable[[list[R]], Columns]) -> None:
        self.known: list[int] = []
        """Frames that are lists."""
        self.complete: list[int] = []
        """Frames of which every record is usable."""
        self._take = take
        self._parts: list[Columns] = []
        self._records: list[R] = []
        self._frames: list[int] = []
        self._counts: list[int] = []
        self._size = 0

    def add(self, frame: int, records: list[R], complete: bool, size: int) -> None:
        """Add a frame's usable records; `size` is the bytes of its text."""
        self.known.append(frame)
        if complete:
            self.complete.append(frame)
        self._records += records
        self._frames.append(frame)
        self._counts.append(len(records))
        self._size += size
        if len(self._records) >= CHUNK or self._size >= CHUNK_BYTES:
            self._flush()

    def columns(self) -> Columns:
        """All columns, `frame` beside those that `take` makes."""
        self._flush()
        parts, self._parts = self._parts, []
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _flush(self) -> None:
        frame = np.repeat(np.array(self._frames, np.int64), self._counts)
        self._parts.append({"frame": frame, **self._take(self._records)})
        self._records, self._frames, self._counts, self._size = [], [], [], 0


def gather(
    path: Path,
    suffixes: tuple[str, ...],
    reader: RecordReader[R],
    take: Callable[[list[R]], Columns],
    problems: Problems,
) -> Gathered[R]:
    """Read a label file. `take` makes columns of records. Raises InputError if the file as a whole cannot be used."""
    gathered = Gathered(take)
    records = 0
    for frames in _batches(read_frames(path, suffixes, reader.decode, problems)):
        for frame, found in reader.read_frames(frames, problems):
            if found is not None:
                gathered.add(frame.number, *found, len(frame.raw))
                records += len(found[0])
        if records > MAX_GATHERED:
            raise InputError(f"{path.name}: more than {MAX_GATHERED:,} records", file=path.name)
    return gathered


def _batches(frames: Iterable[Frame]) -> Iterator[list[Frame]]:
    """Frames in batches of about BATCH_BYTES, in order."""
    batch: list[Frame] = []
    size = 0
    for frame in frames:
        batch.append(frame)
        size += len(frame.raw)
        if size >= BATCH_BYTES:
            yield batch
            batch, size = [], 0
    yield batch


def numbered(codes: Distinct, values: Iterable[Any], n: int) -> Ints:
    """The numbers of `n` values."""
    return np.fromiter(map(codes.__getitem__, values), np.int64, n)


@dataclass(frozen=True)
class People:
    """The records that are kept: of people with a usable box, the first of a person in a frame."""

    row: Ints
    """Their numbers, sorted by (frame, track)."""
    frame: Ints
    track: Ints
    partial: set[int]
    """Frames with a refused person."""


def keep_people(
    frame: Ints,
    labels: Sequence[str],
    code: Ints,
    faults: Sequence[tuple[Bools, str]],
    box: Callable[[int], object],
    refusals: Refusals,
) -> People:
    """Choose the records to keep, and count the others. `labels[code]` is a record's label id.

    `faults` are boxes that cannot be used and why, a record counting for the first of its faults only; `box` shows the
    box of a record.
    """
    track = track_codes(labels, code)

    def label(row: int) -> object:
        return labels[code[row]]

    refusals.count(track == OTHER, "record", "label_id is not of a tracked person", "label_id", label)
    refusals.count(track == BAD, "record", "label_id is not pedestrian:N", "label_id", label)
    good = track >= 0
    refused = track == BAD
    for fault, reason in faults:
        wrong = good & fault
        refusals.count(wrong, "record", reason, "box", box)
        good &= ~wrong
        refused |= wrong
    usable = np.flatnonzero(good)
    order, first = first_of_equal(person_keys(frame[usable], track[usable]))
    again = mask_of(usable[order[~first]], len(frame))
    refusals.count(again, "record", "same person twice in a frame, the first is kept", "label_id", label)
    row = usable[order[first]]
    return People(row, frame[row], track[row], set(frame[refused].tolist()))
