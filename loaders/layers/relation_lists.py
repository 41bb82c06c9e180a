"""Lists of relations inside a record: `H-interaction` (or `HHI`) with people, `HOI` with things.

An entry is `{"pair": ..., "inter_labels": {label: difficulty}}`; whatever else it holds (a box of the partner, which
can be stale) is not read. Entries change from frame to frame, but their pairs and labels repeat: those are numbered,
and each distinct one is decoded once.

A list is *whole* when nothing of it was refused: then what it does not hold is false. An entry is refused where it is
no object, its pair cannot be read or is the person itself, or its labels are no object. A label "impossible" gives no
fact, and its list is then not whole; nor is one with a label outside the vocabulary, which may be any of the others in
another word. Where a difficulty cannot be read, the label is kept as an unknown fact.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, Refusals, mask_of, numbered, ragged
from jrdb_avr.loaders.labelfiles.facts import Decoded, Issue, KeptRecords, check_size, count_issues, expand
from jrdb_avr.loaders.labelfiles.frames import raw_bytes
from jrdb_avr.loaders.labelfiles.json import ABSENT, NOTHING, MalformedError, elements, parse
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import IMPOSSIBLE, plain

MAX_ENTRIES: Final = 1000
"""Entries of one list: JRDB's fullest frames have about a hundred people."""

_DIGITS: Final = re.compile(r"[0-9]{1,10}")


class Entry(msgspec.Struct, gc=False):
    """A relation to a person: `pair` is "pedestrian:9", "9" or 9."""

    pair: str | int
    inter_labels: msgspec.Raw


class ThingEntry(msgspec.Struct, gc=False):
    """A relation to a thing: `pair` is its track and category in the panoptic layer."""

    pair: tuple[str | int, str | int]
    inter_labels: msgspec.Raw


class UnreadEntry(msgspec.Struct, gc=False):
    """An entry of a list that is only counted."""

    pair: msgspec.Raw
    inter_labels: msgspec.Raw


@dataclass(frozen=True)
class Unusable:
    """Stands for a pair that cannot be read."""

    reason: str
    value: str


def person_of(pair: object) -> tuple[int]:
    """The partner's track. Raises ValueError."""
    if isinstance(pair, str) and not _DIGITS.fullmatch(pair):
        return (records.track_of(pair),)
    return (records.whole(pair, 0, records.MAX_TRACK),)


def thing_of(pair: object) -> tuple[int, int]:
    """The thing's track and category. Raises ValueError."""
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        raise ValueError("not a track and a category")
    return records.whole(pair[0], 0, records.MAX_TRACK), records.whole(pair[1], 0, records.MAX_TRACK)


@dataclass(frozen=True)
class RelationKind:
    """One kind of list of relations in the label files."""

    layer: str
    """Its annotation table, and the field of its records."""
    key: str
    """Its usual key in the files."""
    read_pair: Callable[[object], tuple[int, ...]]
    ends: tuple[str, ...]
    """The table's columns for what a pair holds."""
    label: str
    """The table's column for the label."""
    normal: Callable[[str], str]
    """The vocabulary's spelling of a label."""
    vocabulary: Collection[str]

    def decode(self, raw: bytes, found: Decoded) -> None:
        """Decode the labels of an entry to (label, label as written, difficulty)."""
        for label, code in found.labels(raw, self.key):
            name = self.normal(label)
            found.whole &= name in self.vocabulary
            if plain(label) != IMPOSSIBLE:
                found.values.append((name, label, found.difficulty(code, self.key)))

    def unknown(self, fact: tuple[Any, ...]) -> tuple[str, str] | None:
        """Field and label of a fact whose label is outside the vocabulary."""
        return None if fact[0] in self.vocabulary else (self.key, fact[0])


def repaired_list(raw: bytes | None, kind: RelationKind, frame: str, problems: Problems) -> list[Any] | None:
    """Entries of a list that does not decode as it stands; a single unusable one where it is no list at all."""
    if raw is None or raw in ABSENT:
        return None
    try:
        raws = list(map(bytes, elements(raw)))
    except MalformedError:
        return [_unusable("not a list", raw)]
    if len(raws) > MAX_ENTRIES:
        return [_unusable(f"list with more than {MAX_ENTRIES} entries", b"")]
    return [_repaired_entry(raw, kind, frame, problems) for raw in raws]


def _repaired_entry(raw: bytes, kind: RelationKind, frame: str, problems: Problems) -> Any:
    try:
        parts = records.record_parts(raw, frame, problems, f"{kind.key}.")
    except MalformedError:
        return _unusable("entry is no object", raw)
    if "pair" not in parts:
        return _unusable("pair is missing", raw)
    labels = msgspec.Raw(parts.get("inter_labels", b""))
    try:
        pair = kind.read_pair(parse(parts["pair"]))
    except ValueError as error:
        return _unusable(f"pair: {error}", parts["pair"], labels)
    return Entry(pair if len(pair) > 1 else pair[0], labels)  # type: ignore[arg-type]


def _unusable(reason: str, value: bytes, labels: msgspec.Raw = NOTHING) -> Any:
    return Entry(Unusable(reason, shorten(value)), labels)  # type: ignore[arg-type]


def take_lists(lists: Sequence[list[Any] | None], kind: RelationKind, codes: dict[str, Distinct]) -> Columns:
    """Columns of the lists of records: the size of each list (-1: there is none), and numbers per entry."""
    entries = list(chain.from_iterable(filter(None, lists)))
    labels = raw_bytes([entry.inter_labels for entry in entries])
    return {
        f"{kind.layer}.size": np.array([-1 if listed is None else len(listed) for listed in lists], np.int64),
        f"{kind.layer}.pair": numbered(codes[f"{kind.layer}.pair"], [entry.pair for entry in entries], len(entries)),
        f"{kind.layer}.labels": numbered(codes[f"{kind.layer}.labels"], labels, len(entries)),
    }


class Relations:
    """The relations in the lists of the kept people; what is refused is counted.

    facts: for each the person, a row of `People`, and (label, label as written, difficulty); ends: per fact what the
    pair holds, by column; there: per person whether the record has the list; refused: per person whether something of
    the list was refused or cannot be known.
    """

    def __init__(
        self, columns: Columns, kind: RelationKind, codes: dict[str, Distinct], people: KeptRecords, problems: Problems
    ) -> None:
        size = np.maximum(columns[f"{kind.layer}.size"], 0)
        check_size(int(size.sum()))
        start = np.cumsum(size) - size
        person, place = ragged(size[people.row])
        entry = start[people.row][person] + place
        pair = columns[f"{kind.layer}.pair"][entry]
        ends, issues = _read_pairs(list(codes[f"{kind.layer}.pair"]), kind)
        refusals = Refusals(people.frame[person], problems)
        count_issues(pair, issues, refusals)
        good = ~mask_of(np.array(list(issues), np.int64), len(ends))[pair]
        if len(kind.ends) == 1:
            oneself = good & (ends[pair, 0] == people.track[person])
            refusals.count(oneself, "field", "pair is the person itself", kind.key, lambda row: int(ends[pair[row], 0]))
            good &= ~oneself
        self.refused = mask_of(person[~good], len(people.row))
        person, pair, entry = person[good], pair[good], entry[good]
        facts = expand(
            columns[f"{kind.layer}.labels"][entry],
            codes[f"{kind.layer}.labels"],
            kind.decode,
            Refusals(people.frame[person], problems),
            [("inter_labels is missing", kind.key, "")],
        )
        self.refused[person[~facts.whole]] = True
        self.facts = facts._replace(row=person[facts.row])
        self.ends = dict(zip(kind.ends, ends[pair[facts.row]].T, strict=True))
        self.there: Bools = columns[f"{kind.layer}.size"][people.row] >= 0


def _read_pairs(pairs: list[object], kind: RelationKind) -> tuple[Ints, dict[int, list[Issue]]]:
    """What each distinct pair holds, a column per end, and what is wrong with those that cannot be read."""
    issues: dict[int, list[Issue]] = {}
    ends = np.full((len(pairs), len(kind.ends)), -1, np.int64)
    for i, pair in enumerate(pairs):
        try:
            if isinstance(pair, Unusable):
                issues[i] = [(pair.reason, kind.key, pair.value)]
            else:
                ends[i] = kind.read_pair(pair)
        except ValueError as error:
            issues[i] = [(f"pair: {error}", kind.key, pair)]
    return ends, issues
