"""Selection of the usable records of people, and decoding of the facts in the raw sub-objects of these records.

A fact is one label of a person in a frame, such as an action. A person often has the same labels in many frames, and
the files then repeat the same bytes. Therefore a column stores a code for each raw object, and each distinct raw object
is decoded only once. numpy then copies the decoded facts to all rows with the same code.
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
"""Maximum labels of one kind, such as actions, in a file. JRDB's largest sequence has 1.5 million labels of groups."""

_THING: Final = -1
"""Code that replaces the track if a label id is of a thing."""
_BAD: Final = -2
"""Code that replaces the track if a label id is unreadable."""

Issue = tuple[str, str, object]
"""Reason, field and offending value of a refused part of a record."""

Value = tuple[Any, ...]
"""Content of a fact, such as (label, label as written, difficulty)."""


# -- people --------------------------------------------------------------------------------------------------------


class KeptRecords(NamedTuple):
    """Records that are used. If a frame has several records of a person, the first one without a fault is used."""

    row: Ints
    """Indices of the kept records among all records, sorted by (frame, track)."""
    frame: Ints
    """Frame of each kept record."""
    track: Ints
    """Track of the person of each kept record."""
    partial: set[int]
    """Frames with a refused record that may describe a person."""

    def whole_frames(self, complete: Iterable[int]) -> Ints:
        """Return the frames in `complete`, ascending, but without the frames in `partial`."""
        return np.array(sorted(set(complete) - self.partial), np.int64)

    def frames_of(self, rows: Ints) -> tuple[Ints, Ints]:
        """Return the distinct frames of some kept records, ascending, and the number of these records in each frame.

        The argument `rows` has the indices of the records, ascending. A repeated index counts once.
        """
        frame = self.frame[distinct_of(rows)]
        return known_frames(distinct_of(frame), frame)


def keep_people(
    columns: Columns,
    codes: Mapping[str, Distinct],
    refusals: Refusals,
    faults: Sequence[tuple[Bools, str]] = (),
    box: Callable[[int], object] = lambda row: "",
) -> KeptRecords:
    """Select the records that can be used, and count the refused records.

    Args:
        columns: columns of the records, by name. The column `frame` and the column of codes `label_id` are read.
        codes: codes of the distinct values of each coded column, by name of the column.
        refusals: counter of the refused records.
        faults: pairs of a mask and a reason. The mask is True at each record with a box that is unusable for this
            reason. A record with several faults is counted only for the first of them.
        box: function that is called with the index of a refused record and returns its box for the report.
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
    # If two records have the same track, the second may describe another person under a wrong track.
    return KeptRecords(row, frame[row], track[row], set(frame[refused | again].tolist()))


def _track_or_code(label: str) -> int:
    """Return the track if a label id is of a person, `_THING` if it is of a thing, and `_BAD` if it is unreadable."""
    try:
        return records.read_track(label)
    except records.NotAPersonError:
        return _THING
    except ValueError:
        return _BAD


# -- facts ---------------------------------------------------------------------------------------------------------


@dataclass
class Decoded:
    """Decoded content of one distinct raw value."""

    values: list[Value] = field(default_factory=list)
    issues: list[Issue] = field(default_factory=list)
    whole: bool = True
    """True if no part of the value was refused. In that case each label that the value lacks is known to be false."""

    def refuse(self, reason: str, name: str, value: object) -> None:
        """Add an issue that says that `value` is unusable, and set `whole` to False."""
        self.issues.append((reason, name, value))
        self.whole = False

    def members(self, value: object, name: str) -> dict[str, Any]:
        """Return the members of a JSON object. The argument `value` is the object, either raw or decoded.

        If `value` is not a JSON object, refuse it and return {}.
        """
        try:
            members = records.parse(value) if isinstance(value, bytes) else value
            if not isinstance(members, dict):
                raise ValueError("not an object")
        except ValueError as error:
            self.refuse(str(error), name, value)
            return {}
        return members

    def labels(self, value: object, name: str) -> Iterator[tuple[str, Any]]:
        """Yield each usable label in a JSON object `{label: value, ...}`, with the label's value.

        Unusable labels are refused.
        """
        for label, inner in self.members(value, name).items():
            try:
                usable = records.read_text(label)
            except ValueError as error:
                self.refuse(f"label: {error}", name, label)
            else:
                yield usable, inner

    def read(self, read: Callable[[Any], Any], value: object, name: str, reason: str = "") -> Any:
        """Convert `value` with the converter that is given as the argument `read`, and return the converted value.

        If the converter raises ValueError, add an issue that names the value, and return None.
        """
        try:
            return read(value)
        except ValueError as error:
            self.issues.append((f"{reason}{error}", name, value))
            return None

    def difficulty(self, value: object, name: str) -> int | None:
        """Return the difficulty code that `value` stands for, or None if `value` is unusable.

        If the code of a label is unusable, the fact that the label states is unknown.
        """
        code: int | None = self.read(records.read_difficulty, value, name, "difficulty: ")
        return code


class ColumnFacts(NamedTuple):
    """Facts that were decoded from a column of raw objects. A row of the column may have any number of facts."""

    row: Ints
    """Index of each fact's row in the column, ascending."""
    code: Ints
    """Index of each fact's content in `values`."""
    values: list[Value]
    """Distinct contents of facts."""
    whole: Bools
    """True for each row of the column that has a raw object without a refused part."""

    def tally(self, name: Callable[[Value], tuple[str, str] | None]) -> Counter[tuple[str, str]]:
        """Count the facts with each key. The key of a fact is derived from the content of the fact.

        Args:
            name: function that is called with each distinct content and returns the key of the facts with this content.
                If the function returns None, these facts are not counted.

        Returns:
            The number of facts of each key.
        """
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
    """Decode every distinct raw value of a column, and copy the facts in the value to all rows with this value.

    Args:
        codes: code of the raw value in each row.
        raws: distinct raw values, in the order of their codes.
        decode: function that is called with each distinct raw value and with a new `Decoded`, which the function fills.
            It is not called for raw values in `records.ABSENT`.
        refusals: counter of unusable values. An issue of a raw value is counted once for each row with this value.
        absent: issues that are counted for each row with a raw value in `records.ABSENT`.

    Raises:
        InputError: If there are more than `MAX_FACTS` facts.
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
    """Raise InputError if `facts`, the number of labels of one kind in a file, is larger than `MAX_FACTS`.

    More labels could fill the memory.
    """
    if facts > MAX_FACTS:
        raise InputError(f"more than {MAX_FACTS:,} labels of one kind: is it a file of one sequence?")


def count_issues(codes: Ints, issues: dict[int, list[Issue]], refusals: Refusals) -> None:
    """Count each issue of a raw value once for each row with this value.

    Args:
        codes: code of the raw value in each row.
        issues: issues of each raw value, by the code of the value.
        refusals: counter that receives the issues.
    """
    if not issues:
        return
    distinct, first, counts = np.unique(codes, return_index=True, return_counts=True)
    # The report shows the example that is counted first, so codes are sorted by their first row.
    for begin, code, count in sorted(zip(first.tolist(), distinct.tolist(), counts.tolist(), strict=True)):
        for reason, name, value in issues.get(code, ()):
            refusals.add("field", reason, name, begin, value, count)


def facts_table(
    layer: str, people: KeptRecords, facts: ColumnFacts, names: tuple[str, ...], ends: dict[str, Ints] | None = None
) -> pa.Table:
    """Return an annotation table without its column `sequence`. It has one row per fact.

    Args:
        layer: name of the annotation table.
        people: the kept records.
        facts: facts to write. `facts.row` has, for each fact, the index in `people` of the fact's record.
        names: names of the columns that hold the content of the facts. The content of a fact is a tuple with one
            element per name.
        ends: columns of numbers to add to the table, by name of the column. Each column has one number per fact.

    Returns:
        The table, sorted by frame and track, then by the columns of `ends`, then by content.
    """
    rows = {"frame": people.frame[facts.row], "track": people.track[facts.row], **(ends or {})}
    by_value = sorted(
        range(len(facts.values)), key=lambda i: tuple((part is None, part or 0) for part in facts.values[i])
    )
    rank = np.argsort(np.array(by_value, np.int64))
    order = ascending(facts.row, *(ends or {}).values(), rank[facts.code])
    columns: dict[str, Any] = {name: column[order] for name, column in rows.items()}
    code = facts.code[order]
    for i, name in enumerate(names):
        columns[name] = spread([value[i] for value in facts.values], ANNOTATIONS[layer].field(name).type, code)
    return pa.table(columns)
