"""Operations on columns of numbers and of Arrow values, and the class `LayerTables`.

The functions make sort keys of rows, find neighbouring rows that are equal, and replace repeated values by codes.
`Refusals` counts rows that cannot be used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
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
"""Number of bits that `paired` reserves for the low number of a pair."""
_DIGITS: Final = 16
"""Maximum bits of whole numbers that numpy sorts by digits (radix sort)."""
MAX_DISTINCT: Final = 100_000
"""Maximum distinct values of one field in a file. JRDB's files have far fewer, because labels repeat between frames."""
_BLOCK: Final = 1_000_000
"""Approximate maximum of pairs in a block of `pairs_of_equal`."""

Columns = dict[str, npt.NDArray[Any]]
"""Columns by name, with one element per record."""


def paired(high: Ints, low: Ints) -> Ints:
    """Combine each pair of numbers, such as (frame, track), into one number.

    The results have the sort order of the pairs. The numbers of each pair must be less than 2**31.
    """
    return (high << PAIR_BITS) | low


def unpaired(pairs: Ints) -> tuple[Ints, Ints]:
    """Split numbers that `paired` made. Return the array of all first numbers, and the array of all second numbers."""
    return pairs >> PAIR_BITS, pairs & ((1 << PAIR_BITS) - 1)


def whole_numbers(table: pa.Table, name: str) -> Ints:
    """Return the column `name` of a table as 64-bit integers. The column must have whole numbers and no nulls."""
    return np.asarray(table[name].to_numpy(), np.int64)


def texts(values: Sequence[str], codes: Ints) -> pa.Array:
    """Return an Arrow array with the string `values[code]` for each code in `codes`. A negative code gives null."""
    dictionary = pa.array(values, pa.string())
    return dictionary.take(pa.array(codes, pa.int64(), mask=codes < 0))


def spread(values: Sequence[Any], kind: pa.DataType, codes: Ints) -> pa.Array:
    """Return an Arrow array with the element `values[code]` for each code in `codes`.

    The array has the type `kind`. If `kind` is string, the result is a dictionary array of strings.
    """
    column, taken = pa.array(values, kind), pa.array(codes)
    if not pa.types.is_string(kind):
        return column.take(taken)
    column = column.dictionary_encode()
    return pa.DictionaryArray.from_arrays(column.indices.take(taken), column.dictionary)


def ranked(column: pa.ChunkedArray) -> tuple[list[str], Ints]:
    """Return the distinct strings of a column, ascending, and for each row the index of the row's string among them.

    The index is -1 if the row is null.
    """
    written = column.combine_chunks().dictionary_encode()
    spelled = written.dictionary.to_pylist()
    names = sorted(spelled)
    index = {name: i for i, name in enumerate(names)}
    rank = np.array([index[name] for name in spelled] + [-1], np.int64)
    return names, rank[written.indices.fill_null(len(names)).to_numpy()]


def rank_values(values: Ints) -> tuple[Ints, Ints]:
    """Return the distinct values of an array, ascending, and for each element its index among the distinct values."""
    # `np.unique` would sort all values, which takes five times as long.
    coded = pa.array(values).dictionary_encode()
    distinct = coded.dictionary.to_numpy()
    order = np.argsort(distinct)
    return distinct[order], np.argsort(order)[coded.indices.to_numpy()]


def constant(value: str, n: int) -> pa.Array:
    """Return a dictionary array that repeats the string `value` `n` times."""
    return pa.DictionaryArray.from_arrays(np.zeros(n, np.int32), pa.array([value], pa.string()))


def annotation_table(name: str, sequence: str, table: pa.Table) -> pa.Table:
    """Add the column `sequence` to an annotation table, and cast the result to the schema `ANNOTATIONS[name]`.

    Dictionary arrays of strings are kept, because plain strings would take most of the memory of a load.
    """
    table = table.add_column(0, "sequence", constant(sequence, len(table)))
    return table.cast(with_numbered(ANNOTATIONS[name], table))


def nullable(values: npt.NDArray[Any], missing: Bools, kind: pa.DataType) -> pa.Array:
    """Return `values` as an Arrow array of the type `kind`, with null in the rows of the mask `missing`."""
    return pa.array(values, mask=missing).cast(kind)


class Distinct(dict[Any, int]):
    """Dictionary from distinct values to codes 0, 1, 2, ... in the order of the first look-ups.

    A lookup of an unknown value adds the value. If there are `MAX_DISTINCT` values already, such a lookup raises
    InputError. Because of this limit, a broken file cannot fill the memory.
    """

    def __missing__(self, value: Any) -> int:
        if len(self) == MAX_DISTINCT:
            raise InputError(f"more than {MAX_DISTINCT:,} different values of one field: is it a file of labels?")
        self[value] = code = len(self)
        return code


def numbered(codes: Distinct, values: Iterable[Any], n: int) -> Ints:
    """Return the codes of the `n` elements of `values`. The dictionary `codes` gives each unknown value a new code."""
    return np.fromiter(map(codes.__getitem__, values), np.int64, n)


class Refusals:
    """Counter of refused records and fields. Each problem is reported with the frame of the first refused row."""

    def __init__(self, frame: Ints, problems: Problems, suffix: str = "jpg") -> None:
        self._frame, self._problems, self._suffix = frame, problems, suffix

    def count(
        self, mask: Bools, kind: str, reason: str, field: str, value: Callable[[int], object] = lambda row: ""
    ) -> None:
        """Count all rows that are refused for the same reason, as one problem.

        Args:
            mask: mask of the refused rows. If it is False everywhere, nothing is counted.
            kind: "record" or "field".
            reason: reason of the refusal.
            field: name of the field.
            value: function that is called with the index of the first refused row, and returns the unusable value of
                this row.
        """
        n = int(mask.sum())
        if n:
            row = int(mask.argmax())
            self.add(kind, reason, field, row, value(row), n)

    def add(self, kind: str, reason: str, field: str, row: int, value: object, count: int) -> None:
        """Count a problem that occurs in several rows.

        The argument `count` is the number of these rows, and `row` is the index of the first one.
        """
        frame = f"{int(self._frame[row]):06d}.{self._suffix}"
        self._problems.add(kind, reason, frame=frame, field=field, value=value, count=count)


@dataclass(frozen=True)
class LayerTables:
    """Tables that were made from one label file, which has the labels of one layer for one sequence."""

    tables: dict[str, pa.Table]
    """Annotation tables by name, without the column `sequence` unless `of` has added it."""
    frames: dict[str, tuple[Ints, Ints]]
    """Content of the table `frames` by layer: the frames, ascending, and the number of records in each frame."""
    unknown: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Number of occurrences of each (field, label) with a label outside the vocabulary."""
    boxes: pa.Table | None = None
    """2D boxes in the file of another layer than `2d`, or None. The columns are frame, track, x, y, w, h.

    A comparison of these boxes with the 2D layer shows whether both files number their frames alike."""

    def of(self, sequence: str) -> LayerTables:
        """Return a copy. Every annotation table in it has the column `sequence` and the types of its schema."""
        return replace(self, tables={name: annotation_table(name, sequence, t) for name, t in self.tables.items()})


class Rows:
    """Base class of dataclasses with arrays of equal length. The elements of all arrays at one index form a row."""

    def at(self, rows: npt.NDArray[Any]) -> Self:
        """Return a copy with the selected rows only. The argument `rows` is an array of row indices, or a mask."""
        return self._with(lambda name: getattr(self, name)[rows])

    def joined(self, others: Sequence[Self]) -> Self:
        """Return a copy that has the rows of this object, followed by the rows of each object in `others`."""
        return self._with(lambda name: np.concatenate([getattr(part, name) for part in (self, *others)]))

    def _with(self, array: Callable[[str], npt.NDArray[Any]]) -> Self:
        names = [item.name for item in fields(self)]  # type: ignore[arg-type]
        arrays = {name: array(name) for name in names if isinstance(getattr(self, name), np.ndarray)}
        return replace(self, **arrays)  # type: ignore[type-var]


def mask_of(rows: Ints, n: int) -> Bools:
    """Return a mask of length `n` that is True at each index in `rows` and False at all other indices."""
    mask = np.zeros(n, np.bool_)
    mask[rows] = True
    return mask


def ascending(*columns: npt.NDArray[Any]) -> Ints:
    """Return the row indices in sorted order. Rows are sorted by the first column, then by the second, and so on.

    The columns have whole numbers.
    """
    # numpy sorts 16-bit numbers by digits, which takes a fifth of the time of a sort by comparisons.
    return np.asarray(np.lexsort([part for column in reversed(columns) for part in _narrow(column)]))


def _narrow(column: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Split the numbers of a column into 16-bit parts, and return one column per part, lowest bits first.

    If the range of the numbers exceeds 32 bits, return only the column itself.
    """
    low = int(column.min(initial=0))
    width = (int(column.max(initial=0)) - low).bit_length()
    if width > 2 * _DIGITS:
        return [column]
    above = column - low if low else column
    return [(above >> shift).astype(np.uint16) for shift in range(0, max(width, 1), _DIGITS)]


def first_of_equal(*columns: Ints) -> tuple[Ints, Bools]:
    """Sort rows by their columns, and find the first one of each group of equal rows.

    Returns:
        The row indices in sorted order, and a mask in the same order: True at the first row of each group of equal
        rows. Equal rows keep their order.
    """
    order = ascending(*columns)
    return order, begins(*(column[order] for column in columns))


def group_rows(*columns: Ints) -> tuple[Ints, Ints]:
    """Assign the numbers 0, 1, 2, ... to the distinct rows of columns, in sorted order.

    Returns:
        The number of each row, and for each number the index of the first row that has it.
    """
    order, first = first_of_equal(*columns)
    group = np.empty_like(order)
    group[order] = np.cumsum(first) - 1
    return group, order[first]


def rows_of(keys: Ints, values: Ints) -> Ints:
    """Return for each element of `values` its index in the ascending `keys`, or -1 if `keys` lacks it."""
    if not len(keys):
        return np.full(len(values), -1, np.int64)
    row = np.minimum(np.searchsorted(keys, values), len(keys) - 1)
    return np.where(keys[row] == values, row, -1)


def distinct_of(ascending: Ints) -> Ints:
    """Return the distinct values of an array. The array must be sorted."""
    return ascending[begins(ascending)]


def begins(*columns: Ints) -> Bools:
    """Return a mask that is True at each row that differs from the previous row in at least one column.

    The mask is also True at the first row.
    """
    new = np.ones(len(columns[0]), np.bool_)
    new[1:] = np.logical_or.reduce([column[1:] != column[:-1] for column in columns])
    return new


def ragged(counts: Ints) -> tuple[Ints, Ints]:
    """Return two arrays with one element per member: the index of the member's group, and the index within the group.

    Group i has `counts[i]` members. The members of group 0 come first, then the members of group 1, and so on.
    """
    group = np.repeat(np.arange(len(counts)), counts)
    start = np.cumsum(counts) - counts
    return group, np.arange(len(group)) - np.repeat(start, counts)


def pairs_of_equal(frame: Ints, rows: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Yield the ordered pairs of different rows with equal frames, in blocks.

    Args:
        frame: frame of every row, ascending.
        rows: indices of the rows that form pairs, ascending.

    Yields:
        The first and the second row of each pair. Pairs with the same first row are next to each other in one block.
    """
    _, first, counts = np.unique(frame[rows], return_index=True, return_counts=True)
    size = np.repeat(counts, counts)
    start = np.repeat(first, counts)
    block = (np.cumsum(size) - size) // _BLOCK
    for index in np.unique(block):
        of = np.flatnonzero((block == index) & (size > 1))
        group, member = ragged(size[of])
        a, b = rows[of[group]], rows[start[of][group] + member]
        different = a != b
        if different.any():
            yield a[different], b[different]


def known_frames(frames: Ints, rows: Ints) -> tuple[Ints, Ints]:
    """Return `frames` unchanged, and the number of records in each of these frames.

    The argument `rows` has the frame of each record.
    """
    rows = np.sort(rows)
    return frames, np.searchsorted(rows, frames, "right") - np.searchsorted(rows, frames, "left")
