"""People of label records, and rows of facts from raw sub-objects of their records.

The labels of a person repeat from frame to frame as the same bytes. A column of raw objects is therefore numbered, each
distinct object is decoded once into a few values, and numpy spreads the values over the rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import (
    Columns,
    Distinct,
    Refusals,
    ascending,
    distinct_of,
    first_of_equal,
    known_frames,
    mask_of,
    ragged,
    spread,
)
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

MAX_FACTS: Final = 2_000_000
"""Maximum labels of one kind in a file. JRDB's fullest sequence has about 1.5 million labels of its groups."""

_THING: Final = -1
_BAD: Final = -2

Issue = tuple[str, str, object]
"""Reason, field and offending value."""

Value = tuple[Any, ...]


# -- people --------------------------------------------------------------------------------------------------------


class KeptRecords(NamedTuple):
    """The kept records: people with a usable box, the first record of a person in a frame."""

    row: Ints
    """Their numbers, sorted by (frame, track)."""
    frame: Ints
    track: Ints
    partial: set[int]
    """Frames with a refused record that may be a person."""

    def whole_frames(self, complete: Iterable[int]) -> Ints:
        """Return the frames of `complete`, ascending, that lost no record of a person."""
        return np.array(sorted(set(complete) - self.partial), np.int64)

    def frames_of(self, rows: Ints) -> tuple[Ints, Ints]:
        """Return the frames of some people (ascending rows), as a layer of the `frames` table."""
        frame = self.frame[distinct_of(rows)]
        return known_frames(distinct_of(frame), frame)


def keep_people(
    columns: Columns,
    codes: Mapping[str, Distinct],
    refusals: Refusals,
    faults: Sequence[tuple[Bools, str]] = (),
    box: Callable[[int], object] = lambda row: "",
) -> KeptRecords:
    """Choose the records to keep, and count the others.

    Args:
        columns: columns `frame` and `label_id` (a code) of the records.
        codes: distinct values of the coded columns.
        refusals: counter of the refused records.
        faults: masks of unusable boxes with reasons. A record counts for its first fault.
        box: function that returns the box of a record for the report.
    """
    frame, labels, code = columns["frame"], list(codes["label_id"]), columns["label_id"]
    track = np.array([_track_or_code(label) for label in labels], np.int64)[code]
    thing, refused = track == _THING, track == _BAD
    for wrong, reason in ((thing, "label_id is of a thing"), (refused, "label_id is not pedestrian:N")):
        refusals.count(wrong, "record", reason, "label_id", lambda row: labels[code[row]])
    good = track >= 0
    for fault, reason in faults:
        wrong = good & fault
        refusals.count(wrong, "record", reason, "box", box)
        good &= ~wrong
        refused = refused | wrong
    usable = np.flatnonzero(good)
    order, first = first_of_equal(frame[usable], track[usable])
    again = mask_of(usable[order[~first]], len(frame))
    reason = "same person twice in a frame"
    refusals.count(again, "record", reason, "label_id", lambda row: labels[code[row]])
    row = usable[order[first]]
    # The second of two records may be another person under a wrong number.
    return KeptRecords(row, frame[row], track[row], set(frame[refused | again].tolist()))


def _track_or_code(label: str) -> int:
    try:
        return records.read_track(label)
    except records.NotAPersonError:
        return _THING
    except ValueError:
        return _BAD


# -- facts ---------------------------------------------------------------------------------------------------------


@dataclass
class Decoded:
    """The content of one distinct raw value."""

    values: list[Value] = field(default_factory=list)
    issues: list[Issue] = field(default_factory=list)
    whole: bool = True
    """Whether nothing was refused, so that every missing label is false."""

    def refuse(self, reason: str, name: str, value: object) -> None:
        """Count a value or a part of it as unusable."""
        self.issues.append((reason, name, value))
        self.whole = False

    def members(self, value: object, name: str) -> dict[str, Any]:
        """Return the members of an object, raw or decoded. Anything else is refused."""
        try:
            members = records.parse(value) if isinstance(value, bytes) else value
            if not isinstance(members, dict):
                raise ValueError("not an object")
        except ValueError as error:
            self.refuse(str(error), name, value)
            return {}
        return members

    def labels(self, value: object, name: str) -> Iterator[tuple[str, Any]]:
        """Yield the usable labels of an object `{label: value}` with their values."""
        for label, inner in self.members(value, name).items():
            try:
                usable = records.read_text(label)
            except ValueError as error:
                self.refuse(f"label: {error}", name, label)
            else:
                yield usable, inner

    def read(self, read: Callable[[Any], Any], value: object, name: str, reason: str = "") -> Any:
        """Return `read(value)`. Count the value and return None if it is unusable."""
        try:
            return read(value)
        except ValueError as error:
            self.issues.append((f"{reason}{error}", name, value))
            return None

    def difficulty(self, value: object, name: str) -> int | None:
        """Return a difficulty code. Its label stays as an unknown fact if the code is unusable."""
        code: int | None = self.read(records.read_difficulty, value, name, "difficulty: ")
        return code


class ColumnFacts(NamedTuple):
    """Facts of a column: the row of each fact, ascending, and its number in `values`."""

    row: Ints
    code: Ints
    values: list[Value]
    whole: Bools
    """Per row of the column: a value is present, and nothing of it was refused."""

    def tally(self, name: Callable[[Value], tuple[str, str] | None]) -> Counter[tuple[str, str]]:
        """Count the values that have a name, by name."""
        counts: Counter[tuple[str, str]] = Counter()
        for value, n in zip(self.values, np.bincount(self.code, minlength=len(self.values)).tolist(), strict=True):
            key = name(value)
            if key is not None and n:
                counts[key] += n
        return counts


def expand(
    codes: Ints,
    raws: Iterable[bytes],
    decode: Callable[[bytes, Decoded], None],
    refusals: Refusals,
    absent: Sequence[Issue] = (),
) -> ColumnFacts:
    """Decode every distinct raw value, and spread its content over the rows.

    Args:
        codes: number of the raw value of each row.
        raws: distinct raw values by number.
        decode: function that fills a `Decoded` from a raw value.
        refusals: counter. An issue of a value counts once per row with the value.
        absent: issues of a missing value.

    Raises:
        InputError: there are more than MAX_FACTS facts.
    """
    numbers = Distinct()
    held: list[list[int]] = []
    issues: dict[int, list[Issue]] = {}
    whole: list[bool] = []
    size = 0
    for i, raw in enumerate(raws):
        decoded = Decoded(whole=raw not in records.ABSENT)
        if decoded.whole:
            decode(raw, decoded)
        else:
            decoded.issues += absent
        held.append([numbers[value] for value in decoded.values])
        whole.append(decoded.whole)
        size += len(decoded.values)
        check_size(size)
        if decoded.issues:
            issues[i] = decoded.issues
    count_issues(codes, issues, refusals)
    flat = np.array(list(chain.from_iterable(held)), np.int64)
    lengths = np.array([len(values) for values in held], np.int64)
    counts = lengths[codes]
    check_size(int(counts.sum()))
    row, position = ragged(counts)
    taken = flat[(np.cumsum(lengths) - lengths)[codes[row]] + position]
    return ColumnFacts(row, taken, list(numbers), np.array(whole, np.bool_)[codes])


def check_size(facts: int) -> None:
    """Raise InputError if a file holds more labels than the memory is planned for."""
    if facts > MAX_FACTS:
        raise InputError(f"more than {MAX_FACTS:,} labels of one kind: is it a file of one sequence?")


def count_issues(codes: Ints, issues: dict[int, list[Issue]], refusals: Refusals) -> None:
    """Report the issues of each code, once per row with the code."""
    if not issues:
        return
    distinct, first, counts = np.unique(codes, return_index=True, return_counts=True)
    # Sorted by first row, so that the first example of a problem is the first by frame.
    for begin, code, count in sorted(zip(first.tolist(), distinct.tolist(), counts.tolist(), strict=True)):
        for reason, name, value in issues.get(code, ()):
            refusals.add("field", reason, name, begin, value, count)


def facts_table(
    layer: str, people: KeptRecords, facts: ColumnFacts, names: tuple[str, ...], ends: dict[str, Ints] | None = None
) -> pa.Table:
    """Return the annotation table of a layer without the sequence, sorted by person, then `ends`, then value.

    Args:
        layer: name of the annotation table.
        people: the kept records.
        facts: facts with rows of `people`.
        names: columns of the table that the value tuples fill.
        ends: further columns of numbers, one per fact.
    """
    rows = {"frame": people.frame[facts.row], "track": people.track[facts.row], **(ends or {})}
    by_value = sorted(
        range(len(facts.values)), key=lambda i: tuple((part is None, part or 0) for part in facts.values[i])
    )
    rank = np.empty(len(by_value), np.int64)
    rank[by_value] = np.arange(len(by_value))
    order = ascending(facts.row, *(ends or {}).values(), rank[facts.code])
    columns: dict[str, Any] = {name: column[order] for name, column in rows.items()}
    code = facts.code[order]
    for i, name in enumerate(names):
        columns[name] = spread([value[i] for value in facts.values], ANNOTATIONS[layer].field(name).type, code)
    return pa.table(columns)
