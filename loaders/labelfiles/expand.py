"""Raw sub-objects of label records -> rows of facts, each distinct sub-object decoded once.

A person's labels repeat from frame to frame as the same bytes. So a column of raw objects is numbered first (see
`gather`), each distinct one is decoded into a few values, and numpy spreads the values over the rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.columns import Distinct, Refusals, constant, encoded, ragged
from jrdb_avr.loaders.problems import shorten
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

MAX_FACTS: Final = 2_000_000
"""The most labels of one kind in a file; JRDB's fullest sequence has about 1.5 million labels of its groups."""

KEY_BITS: Final = 63

Issue = tuple[str, str, object]
"""Reason, field and offending value."""

Value = tuple[Any, ...]


class Decoded(NamedTuple):
    """What one distinct raw value holds. `whole`: nothing of it was refused, so that what it lacks is not there."""

    values: list[Value]
    issues: list[Issue]
    whole: bool = True


class Facts(NamedTuple):
    """Facts of a column: for each the row that it is of, ascending, and its number in `values`."""

    row: Ints
    code: Ints
    values: list[Value]
    whole: Bools
    """Per row of the column: something was written, and none of it was refused."""

    def labels(self) -> Counter[Any]:
        """How often each label occurs: the first of the value tuples."""
        found: Counter[Any] = Counter()
        for code, n in enumerate(np.bincount(self.code, minlength=len(self.values)).tolist()):
            found[self.values[code][0]] += n
        return +found


NOTHING: Final = Decoded([], [], False)


def expand(
    codes: Ints,
    raws: Iterable[bytes],
    decode: Callable[[bytes], Decoded],
    refusals: Refusals,
    absent: Decoded = NOTHING,
) -> Facts:
    """Decode every distinct raw value (`raws[code]`) and spread what it holds over the rows of `codes`.

    What was wrong with a value is counted once per row that has it. `absent` is what a missing value holds. Raises
    InputError beyond MAX_FACTS.
    """
    numbers = Distinct()
    held: list[list[int]] = []
    issues: dict[int, list[Issue]] = {}
    whole: list[bool] = []
    size = 0
    for i, raw in enumerate(raws):
        decoded = absent if raw in fields.ABSENT else decode(raw)
        held.append([numbers[value] for value in decoded.values])
        whole.append(decoded.whole)
        size += len(decoded.values)
        bounded(size)
        if decoded.issues:
            issues[i] = decoded.issues
    count_issues(codes, issues, refusals)
    flat = np.array(list(chain.from_iterable(held)), np.int64)
    lengths = np.array([len(values) for values in held], np.int64)
    starts = np.cumsum(lengths) - lengths
    counts = lengths[codes] if len(codes) else codes
    bounded(int(counts.sum()))
    row, place = ragged(counts)
    taken = flat[starts[codes[row]] + place] if len(row) else row
    every = np.array(whole, np.bool_)[codes] if len(codes) else np.empty(0, np.bool_)
    return Facts(row, taken, list(numbers), every)


def bounded(facts: int) -> None:
    """Raise InputError where a file holds more labels than there is memory for."""
    if facts > MAX_FACTS:
        raise InputError(f"more than {MAX_FACTS:,} labels of one kind: is it a file of one sequence?")


def count_issues(codes: Ints, issues: dict[int, list[Issue]], refusals: Refusals) -> None:
    """Report the issues of each code, once per row that has the code."""
    if not issues:
        return
    found, first, counts = np.unique(codes, return_index=True, return_counts=True)
    # By first row, so that the first example of a problem is the first by frame.
    places = sorted(zip(found.tolist(), first.tolist(), counts.tolist(), strict=True), key=itemgetter(1))
    for code, begin, count in places:
        for reason, name, value in issues.get(code, ()):
            refusals.add("field", reason, name, begin, value, count)


def facts_table(
    layer: str,
    sequence: str,
    rows: dict[str, Ints],
    code: Ints,
    values: Sequence[Value],
    names: tuple[str, ...],
) -> pa.Table:
    """The annotation table of a layer, sorted by `rows` (frame, track, ...: numbers per fact), then by value.

    `names` are the columns that the value tuples fill. Texts are numbered (dictionaries).
    """
    rank = np.empty(len(values), np.int64)
    rank[sorted(range(len(values)), key=lambda i: tuple((v is None, v or 0) for v in values[i]))] = np.arange(
        len(values)
    )
    order = _order((*rows.values(), rank[code] if len(values) else code))
    schema = ANNOTATIONS[layer]
    columns: dict[str, Any] = {"sequence": constant(sequence, len(order))}
    columns |= {name: column[order] for name, column in rows.items()}
    taken = pa.array(code[order])
    for i, name in enumerate(names):
        column = pa.array([value[i] for value in values], schema.field(name).type)
        if pa.types.is_string(column.type):
            column = column.dictionary_encode()
            columns[name] = pa.DictionaryArray.from_arrays(column.indices.take(taken), column.dictionary)
        else:
            columns[name] = column.take(taken)
    return encoded(pa.table(columns), schema)


def _order(columns: tuple[Ints, ...]) -> Ints:
    """A stable ascending order by the first column, then the next, ...; all are of numbers from 0."""
    bits = [int(column.max(initial=0)).bit_length() for column in columns]
    if sum(bits) > KEY_BITS:
        return np.lexsort(columns[::-1])
    # As one number, facts that come sorted by person are nearly in order, which a stable sort is fast for.
    key = np.zeros(len(columns[0]), np.int64)
    for column, width in zip(columns, bits, strict=True):
        key = (key << width) | column
    return np.argsort(key, kind="stable")


def label_pairs(raw: bytes, field: str) -> tuple[list[tuple[str, Any]], list[Issue], bool]:
    """Members of a label object as (label, value), what is wrong with it, and whether every member could be kept."""
    try:
        items, again = fields.pairs(raw)
    except ValueError as error:
        return [], [(str(error), field, raw)], False
    return clean_pairs(items, again, field)


def clean_pairs(
    items: list[tuple[str, Any]], again: list[str], field: str
) -> tuple[list[tuple[str, Any]], list[Issue], bool]:
    """As `label_pairs`, of members already decoded and keys that stood there again."""
    issues: list[Issue] = [("key twice, the first is kept", f"{field}.{shorten(name)}", "") for name in again]
    kept, whole = [], True
    for name, value in items:
        try:
            kept.append((fields.text(name), value))
        except ValueError as error:
            issues.append((f"label: {error}", field, name))
            whole = False
    return kept, issues, whole


def coded(value: object, field: str, issues: list[Issue]) -> int | None:
    """A difficulty code; None, with an issue added, where it cannot be read."""
    try:
        return fields.difficulty(value)
    except ValueError as error:
        issues.append((f"difficulty: {error}", field, value))
        return None
