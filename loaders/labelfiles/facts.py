"""The people of label records, and raw sub-objects of their records -> rows of facts.

A person's labels repeat from frame to frame as the same bytes. So a column of raw objects is numbered first (see
`frames.gather`), each distinct one is decoded once into a few values, and numpy spreads the values over the rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import (
    Columns,
    Distinct,
    Refusals,
    distinct_of,
    first_of_equal,
    known_frames,
    mask_of,
    ragged,
    spread,
)
from jrdb_avr.loaders.labelfiles.json import ABSENT, first_members, parse_members
from jrdb_avr.loaders.problems import shorten
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

MAX_FACTS: Final = 2_000_000
"""The most labels of one kind in a file; JRDB's fullest sequence has about 1.5 million labels of its groups."""

KEY_BITS: Final = 63

_OTHER: Final = -1
_BAD: Final = -2

Issue = tuple[str, str, object]
"""Reason, field and offending value."""

Value = tuple[Any, ...]


# -- people --------------------------------------------------------------------------------------------------------


class KeptRecords(NamedTuple):
    """The records that are kept: of people with a usable box, the first of a person in a frame."""

    row: Ints
    """Their numbers, sorted by (frame, track)."""
    frame: Ints
    track: Ints
    partial: set[int]
    """Frames with a record that is not kept and may be a person's."""

    def whole_frames(self, complete: Iterable[int]) -> Ints:
        """The frames of which every record of a person was decoded and kept; `complete`: those that decoded."""
        return np.array(sorted(set(complete) - self.partial), np.int64)

    def frames_of(self, rows: Ints) -> tuple[Ints, Ints]:
        """The frames of some of the people (ascending rows), as a layer of the `frames` table."""
        frame = self.frame[distinct_of(rows)]
        return known_frames(distinct_of(frame), frame)


def keep_people(
    columns: Columns,
    codes: Mapping[str, Distinct],
    refusals: Refusals,
    faults: Sequence[tuple[Bools, str]] = (),
    box: Callable[[int], object] = lambda row: "",
) -> KeptRecords:
    """Choose the records to keep by their columns `frame` and `label_id`, and count the others.

    `faults` are boxes that cannot be used and why, a record counting for the first of its faults only; `box` gives the
    box of a record.
    """
    frame, labels, code = columns["frame"], list(codes["label_id"]), columns["label_id"]
    track = np.array([_track_or_code(label) for label in labels], np.int64)[code]
    other, refused = track == _OTHER, track == _BAD
    for wrong, reason in ((other, "label_id is of a thing"), (refused, "label_id is not pedestrian:N")):
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
    # The second of two may be somebody else under a wrong number.
    return KeptRecords(row, frame[row], track[row], set(frame[refused | again].tolist()))


def _track_or_code(label: str) -> int:
    try:
        return records.track_of(label)
    except records.NotAPersonError:
        return _OTHER
    except ValueError:
        return _BAD


# -- facts ---------------------------------------------------------------------------------------------------------


@dataclass
class Decoded:
    """What one distinct raw value holds."""

    values: list[Value] = field(default_factory=list)
    issues: list[Issue] = field(default_factory=list)
    whole: bool = True
    """Nothing of it was refused, so that what it lacks is not there."""

    def refuse(self, reason: str, name: str, value: object) -> None:
        """Count a value or a part of it as unusable."""
        self.issues.append((reason, name, value))
        self.whole = False

    def members(self, value: object, name: str) -> dict[str, Any] | None:
        """The members of an object, raw or parsed, first of equal keys; None, counted, for anything else."""
        try:
            found, again = parse_members(value) if isinstance(value, bytes) else first_members(value)
        except ValueError as error:
            self.refuse(str(error), name, value)
            return None
        self.issues += [(records.TWICE, f"{name}.{shorten(key)}", "") for key in again]
        return found

    def labels(self, value: object, name: str) -> Iterator[tuple[str, Any]]:
        """The usable labels of an object `{label: ...}`, each with what stands under it."""
        for label, inner in (self.members(value, name) or {}).items():
            try:
                usable = records.text(label)
            except ValueError as error:
                self.refuse(f"label: {error}", name, label)
            else:
                yield usable, inner

    def read(self, read: Callable[[Any], Any], value: object, name: str, reason: str = "") -> Any:
        """A value as `read` reads it; None, counted, where it cannot be read."""
        try:
            return read(value)
        except ValueError as error:
            self.issues.append((f"{reason}{error}", name, value))
            return None

    def difficulty(self, value: object, name: str) -> int | None:
        """A difficulty code; where it cannot be read, its label stays as an unknown fact."""
        code: int | None = self.read(records.difficulty, value, name, "difficulty: ")
        return code


class ColumnFacts(NamedTuple):
    """Facts of a column: for each the row that it is of, ascending, and its number in `values`."""

    row: Ints
    code: Ints
    values: list[Value]
    whole: Bools
    """Per row of the column: something was written, and none of it was refused."""

    def tally(self, name: Callable[[Value], tuple[str, str] | None]) -> Counter[tuple[str, str]]:
        """How often values occur that have a name, by name."""
        found: Counter[tuple[str, str]] = Counter()
        for value, n in zip(self.values, np.bincount(self.code, minlength=len(self.values)).tolist(), strict=True):
            key = name(value)
            if key is not None and n:
                found[key] += n
        return found


def expand(
    codes: Ints,
    raws: Iterable[bytes],
    decode: Callable[[bytes, Decoded], None],
    refusals: Refusals,
    absent: Sequence[Issue] = (),
) -> ColumnFacts:
    """Decode every distinct raw value (`raws[code]`) and spread what it holds over the rows of `codes`.

    What was wrong with a value is counted once per row that has it; `absent` is what is wrong where there is none.
    Raises InputError beyond MAX_FACTS.
    """
    numbers = Distinct()
    held: list[list[int]] = []
    issues: dict[int, list[Issue]] = {}
    whole: list[bool] = []
    size = 0
    for i, raw in enumerate(raws):
        decoded = Decoded(whole=raw not in ABSENT)
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
    row, place = ragged(counts)
    taken = flat[(np.cumsum(lengths) - lengths)[codes[row]] + place]
    return ColumnFacts(row, taken, list(numbers), np.array(whole, np.bool_)[codes])


def check_size(facts: int) -> None:
    """Raise InputError where a file holds more labels than there is memory for."""
    if facts > MAX_FACTS:
        raise InputError(f"more than {MAX_FACTS:,} labels of one kind: is it a file of one sequence?")


def count_issues(codes: Ints, issues: dict[int, list[Issue]], refusals: Refusals) -> None:
    """Report the issues of each code, once per row that has the code."""
    if not issues:
        return
    found, first, counts = np.unique(codes, return_index=True, return_counts=True)
    # By first row, so that the first example of a problem is the first by frame.
    places = zip(found.tolist(), first.tolist(), counts.tolist(), strict=True)
    for code, begin, count in sorted(places, key=itemgetter(1)):
        for reason, name, value in issues.get(code, ()):
            refusals.add("field", reason, name, begin, value, count)


def facts_table(
    layer: str, people: KeptRecords, facts: ColumnFacts, names: tuple[str, ...], ends: dict[str, Ints] | None = None
) -> pa.Table:
    """The columns of a layer's annotation table, sorted by person, then by `ends` (numbers per fact), then by value.

    `names` are the columns that the value tuples fill. Texts are numbered (dictionaries).
    """
    rows = {"frame": people.frame[facts.row], "track": people.track[facts.row], **(ends or {})}
    ascending = sorted(
        range(len(facts.values)), key=lambda i: tuple((part is None, part or 0) for part in facts.values[i])
    )
    rank = np.empty(len(ascending), np.int64)
    rank[ascending] = np.arange(len(ascending))
    order = _order((facts.row, *(ends or {}).values(), rank[facts.code]))
    columns: dict[str, Any] = {name: column[order] for name, column in rows.items()}
    code = facts.code[order]
    for i, name in enumerate(names):
        columns[name] = spread([value[i] for value in facts.values], ANNOTATIONS[layer].field(name).type, code)
    return pa.table(columns)


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
