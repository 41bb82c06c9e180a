"""Columns of numbers and of Arrow values: row keys, runs of equal rows, coded texts, and counts of refusals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.problems import Problems
from jrdb_avr.queries.store import with_numbered
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

PAIR_BITS: Final = 31
_DIGITS: Final = 16
MAX_DISTINCT: Final = 100_000
"""Maximum distinct values of one field in a file. Labels repeat from frame to frame, and ids are a few hundred."""

Columns = dict[str, npt.NDArray[Any]]
"""Columns of records by name."""


def paired(high: Ints, low: Ints) -> Ints:
    """Return one number per pair of numbers below 2**31, such as (frame, track). It sorts like the pair."""
    return (high << PAIR_BITS) | low


def unpaired(pairs: Ints) -> tuple[Ints, Ints]:
    """Return the two numbers of each pair from `paired`."""
    return pairs >> PAIR_BITS, pairs & ((1 << PAIR_BITS) - 1)


def whole_numbers(table: pa.Table, name: str) -> Ints:
    """Return a column of whole numbers without nulls as 64 bits."""
    return np.asarray(table[name].to_numpy(), np.int64)


def texts(values: Sequence[str], codes: Ints) -> pa.Array:
    """Return the strings `values[code]`, null for negative codes."""
    dictionary = pa.array(values, pa.string())
    return dictionary.take(pa.array(codes, pa.int64(), mask=codes < 0))


def spread(values: Sequence[Any], kind: pa.DataType, codes: Ints) -> pa.Array:
    """Return the column `values[code]` of a type. Texts are coded (an Arrow dictionary)."""
    column, taken = pa.array(values, kind), pa.array(codes)
    if not pa.types.is_string(kind):
        return column.take(taken)
    column = column.dictionary_encode()
    return pa.DictionaryArray.from_arrays(column.indices.take(taken), column.dictionary)


def ranked(column: pa.ChunkedArray) -> tuple[list[str], Ints]:
    """Return the distinct texts of a column, ascending, and the index of each row's text, -1 for null."""
    written = column.combine_chunks().dictionary_encode()
    spelled = written.dictionary.to_pylist()
    names = sorted(spelled)
    index = {name: i for i, name in enumerate(names)}
    rank = np.array([index[name] for name in spelled] + [-1], np.int64)
    return names, rank[written.indices.fill_null(len(names)).to_numpy()]


def rank_values(values: Ints) -> tuple[Ints, Ints]:
    """Return the distinct numbers, ascending, and the index of each value. Takes a fifth of the time of a sort."""
    coded = pa.array(values).dictionary_encode()
    distinct = coded.dictionary.to_numpy()
    order = np.argsort(distinct)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return distinct[order], rank[coded.indices.to_numpy()]


def constant(value: str, n: int) -> pa.Array:
    """Return a coded column of `n` equal strings."""
    return pa.DictionaryArray.from_arrays(np.zeros(n, np.int32), pa.array([value], pa.string()))


def annotation_table(name: str, sequence: str, table: pa.Table) -> pa.Table:
    """Return an annotation table with the column of the sequence, cast to its schema.

    Coded texts stay coded: written out they would take most of the memory of a load.
    """
    table = table.add_column(0, "sequence", constant(sequence, len(table)))
    return table.cast(with_numbered(ANNOTATIONS[name], table))


def nullable(values: npt.NDArray[Any], missing: Bools, kind: pa.DataType) -> pa.Array:
    """Return values as an Arrow array with nulls at `missing`."""
    return pa.array(values, mask=missing).cast(kind)


class Distinct(dict[Any, int]):
    """Codes of distinct values by first occurrence: `codes[value]` adds a new value.

    Raises InputError beyond MAX_DISTINCT, which bounds the memory.
    """

    def __missing__(self, value: Any) -> int:
        if len(self) == MAX_DISTINCT:
            raise InputError(f"more than {MAX_DISTINCT:,} different values of one field: is it a file of labels?")
        self[value] = code = len(self)
        return code


def numbered(codes: Distinct, values: Iterable[Any], n: int) -> Ints:
    """Return the codes of `n` values."""
    return np.fromiter(map(codes.__getitem__, values), np.int64, n)


class Refusals:
    """Counter of refused records or fields. It names the frame of the first one."""

    def __init__(self, frame: Ints, problems: Problems, suffix: str = "jpg") -> None:
        self._frame, self._problems, self._suffix = frame, problems, suffix

    def count(
        self, mask: Bools, kind: str, reason: str, field: str, value: Callable[[int], object] = lambda row: ""
    ) -> None:
        """Add the rows of a mask as one problem. `value` returns the offending value of a row."""
        n = int(mask.sum())
        if n:
            row = int(mask.argmax())
            self.add(kind, reason, field, row, value(row), n)

    def add(self, kind: str, reason: str, field: str, row: int, value: object, count: int) -> None:
        """Add a problem of `count` rows. `row` is the first of them."""
        frame = f"{int(self._frame[row]):06d}.{self._suffix}"
        self._problems.add(kind, reason, frame=frame, field=field, value=value, count=count)


@dataclass(frozen=True)
class LayerTables:
    """The tables of one layer of one sequence."""

    tables: dict[str, pa.Table]
    """Annotation tables by name, without the column of the sequence."""
    frames: dict[str, tuple[Ints, Ints]]
    """Per layer of the `frames` table: its frames, ascending, and the number of records in each."""
    unknown: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Labels outside the vocabulary: count per (field, label)."""
    boxes: pa.Table | None = None
    """2D boxes of a file of another layer: columns frame, track, x, y, w, h. They show whether the frame numbers of the
    file agree with the 2D layer."""

    def of(self, sequence: str) -> LayerTables:
        """Return the same with complete annotation tables of a sequence."""
        return replace(self, tables={name: annotation_table(name, sequence, t) for name, t in self.tables.items()})


class Rows:
    """Base of dataclasses of parallel arrays, with one value per row in each array."""

    def at(self, rows: npt.NDArray[Any]) -> Self:
        """Return some rows of every array, by index or mask."""
        return self._with({name: getattr(self, name)[rows] for name in self._arrays()})

    def joined(self, others: Sequence[Self]) -> Self:
        """Return these rows, followed by the rows of others."""
        parts = (self, *others)
        return self._with({name: np.concatenate([getattr(x, name) for x in parts]) for name in self._arrays()})

    def _arrays(self) -> list[str]:
        return [
            name for name in getattr(self, "__dataclass_fields__", ()) if isinstance(getattr(self, name), np.ndarray)
        ]

    def _with(self, arrays: dict[str, npt.NDArray[Any]]) -> Self:
        return replace(self, **arrays)  # type: ignore[type-var]


def mask_of(rows: Ints, n: int) -> Bools:
    """Return a mask over `n` rows, True at `rows`."""
    mask = np.zeros(n, np.bool_)
    mask[rows] = True
    return mask


def ascending(*columns: npt.NDArray[Any]) -> Ints:
    """Return a stable order of rows by the first column of whole numbers, then the next, ..."""
    # numpy sorts numbers of 16 bits by digits, which takes a fifth of the time of comparisons.
    return np.asarray(np.lexsort([part for column in reversed(columns) for part in _narrow(column)]))


def _narrow(column: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Return columns of 16 bits that sort like a column, the lowest digits first; the column itself if it is wide."""
    low = int(column.min(initial=0))
    width = (int(column.max(initial=0)) - low).bit_length()
    if width > 2 * _DIGITS:
        return [column]
    above = column - low if low else column
    return [(above >> shift).astype(np.uint16) for shift in range(0, max(width, 1), _DIGITS)]


def first_of_equal(*columns: Ints) -> tuple[Ints, Bools]:
    """Return a stable ascending order of rows, and a mask over it: True at the first of each run of equal rows."""
    order = ascending(*columns)
    return order, begins(*(column[order] for column in columns))


def distinct_of(ascending: Ints) -> Ints:
    """Return the distinct values of an ascending array, without another sort."""
    return ascending[begins(ascending)]


def begins(*columns: Ints) -> Bools:
    """Return the mask of the rows that differ from the row before in any column. The first row counts."""
    new = np.ones(len(columns[0]), np.bool_)
    new[1:] = np.logical_or.reduce([column[1:] != column[:-1] for column in columns])
    return new


def ragged(counts: Ints) -> tuple[Ints, Ints]:
    """Return the group of each member, and its position in the group, for groups of `counts` members."""
    group = np.repeat(np.arange(len(counts)), counts)
    start = np.cumsum(counts) - counts
    return group, np.arange(len(group)) - np.repeat(start, counts)


def known_frames(frames: Ints, rows: Ints) -> tuple[Ints, Ints]:
    """Return ascending frames with the number of `rows` (one frame number each) in each."""
    rows = np.sort(rows)
    return frames, np.searchsorted(rows, frames, "right") - np.searchsorted(rows, frames, "left")
