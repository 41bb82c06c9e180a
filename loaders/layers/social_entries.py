"""Lists of relations inside a record: `H-interaction` (or `HHI`) with people, `HOI` with things.

An entry is `{"pair": ..., "inter_labels": {label: difficulty}}`; whatever else it holds (a box of the partner, which
can be stale) is not read. Entries change from frame to frame, but their pairs and labels repeat: those are numbered,
and each distinct one is decoded once.

A list is *whole* when nothing of it was refused: then what it does not hold is false. An entry is refused where it is
no object, its pair cannot be read or is the person itself, or its labels are no object. A label "impossible" gives no
fact, and its list is then not whole. Where a difficulty cannot be read, the label is kept as an unknown fact.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.columns import Distinct, Refusals, mask_of, ragged
from jrdb_avr.loaders.labelfiles.expand import Decoded, Issue, Value, bounded, coded, count_issues, expand, label_pairs
from jrdb_avr.loaders.labelfiles.gather import Columns, People, numbered
from jrdb_avr.loaders.labelfiles.jsonscan import MalformedError, elements, members
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


@dataclass(frozen=True)
class Unusable:
    """Stands for a pair that cannot be read."""

    reason: str
    value: str


def person_of(pair: object) -> tuple[int]:
    """The partner's track. Raises ValueError."""
    if isinstance(pair, str) and not _DIGITS.fullmatch(pair):
        return (fields.track_of(pair),)
    return (fields.whole(pair, 0, fields.MAX_TRACK),)


def thing_of(pair: object) -> tuple[int, int]:
    """The thing's track and category. Raises ValueError."""
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        raise ValueError("not a track and a category")
    return fields.whole(pair[0], 0, fields.MAX_TRACK), fields.whole(pair[1], 0, fields.MAX_TRACK)


@dataclass(frozen=True)
class Kind:
    """One kind of list."""

    layer: str
    """Its annotation table."""
    key: str
    """Its usual key in the files."""
    read_pair: Callable[[object], tuple[int, ...]]
    ends: tuple[str, ...]
    """The table's columns for what a pair holds."""
    label: str
    """The table's column for the label."""
    normal: Callable[[str], str]
    """The vocabulary's spelling of a label."""


def repaired_list(raw: bytes | None, kind: Kind, frame: str, problems: Problems) -> list[Any] | None:
    """Entries of a list that does not decode as it stands; a single unusable one where it is no list at all."""
    if raw is None or raw == b"null":
        return None
    try:
        spans = list(elements(raw))
    except MalformedError:
        return [_unusable("not a list", raw)]
    if len(spans) > MAX_ENTRIES:
        return [_unusable(f"list with more than {MAX_ENTRIES} entries", b"")]
    return [_repaired_entry(raw[begin:end], kind, frame, problems) for begin, end in spans]


def _repaired_entry(raw: bytes, kind: Kind, frame: str, problems: Problems) -> Any:
    parts: dict[str, bytes] = {}
    try:
        for key, begin, end in members(raw):
            name = fields.loose(key)
            if name in parts:
                problems.add("field", "key twice, the first is kept", frame=frame, field=f"{kind.key}.{shorten(name)}")
            else:
                parts[name] = raw[begin:end]
    except (MalformedError, ValueError):
        return _unusable("entry is no object", raw)
    if "pair" not in parts:
        return _unusable("pair is missing", raw)
    labels = msgspec.Raw(parts.get("inter_labels", b""))
    try:
        pair = kind.read_pair(fields.loose(parts["pair"]))
    except ValueError as error:
        return Entry(Unusable(f"pair: {error}", shorten(parts["pair"])), labels)  # type: ignore[arg-type]
    return Entry(pair if len(pair) > 1 else pair[0], labels)  # type: ignore[arg-type]


def _unusable(reason: str, value: bytes) -> Any:
    return Entry(Unusable(reason, shorten(value)), msgspec.Raw(b""))  # type: ignore[arg-type]


def take_lists(lists: list[list[Any] | None], kind: Kind, codes: dict[str, Distinct]) -> Columns:
    """Columns of the lists of records: the size of each list (-1: there is none), and numbers per entry."""
    pair, labels = f"{kind.layer}.pair", f"{kind.layer}.labels"
    entries = list(chain.from_iterable(filter(None, lists)))
    return {
        f"{kind.layer}.size": np.array([-1 if listed is None else len(listed) for listed in lists], np.int64),
        pair: numbered(codes[pair], map(attrgetter("pair"), entries), len(entries)),
        labels: numbered(codes[labels], map(bytes, map(attrgetter("inter_labels"), entries)), len(entries)),
    }


@dataclass(frozen=True)
class Relations:
    """Facts of lists of one kind: for each the person (a row of `People`), what the pair holds, and the label."""

    person: Ints
    ends: tuple[Ints, ...]
    code: Ints
    values: list[Value]
    """(label, label as written, difficulty)."""
    there: Bools
    """Per person: the record has the list."""
    refused: Bools
    """Per person: something of the list was refused or not told."""


def read_lists(
    columns: Columns, kind: Kind, codes: dict[str, Distinct], people: People, problems: Problems
) -> Relations:
    """What the lists of the kept people say; what is refused is counted."""
    size = np.maximum(columns[f"{kind.layer}.size"], 0)
    bounded(int(size.sum()))
    start = np.cumsum(size) - size
    person, place = ragged(size[people.row])
    entry = start[people.row][person] + place
    pair = columns[f"{kind.layer}.pair"][entry]
    ends, issues = _read_pairs(list(codes[f"{kind.layer}.pair"]), kind)
    refusals = Refusals(people.frame[person], "jpg", problems)
    count_issues(pair, issues, refusals)
    readable = np.ones(len(ends[0]), np.bool_)
    readable[list(issues)] = False
    good = readable[pair] if len(pair) else np.empty(0, np.bool_)
    if len(kind.ends) == 1 and len(pair):
        oneself = good & (ends[0][pair] == people.track[person])
        track = people.track[person]
        refusals.count(oneself, "field", "pair is the person itself", kind.key, lambda row: int(track[row]))
        good &= ~oneself
    refused = mask_of(person[~good], len(people.row))
    person, pair, entry = person[good], pair[good], entry[good]
    missing = Decoded([], [("inter_labels is missing", kind.key, "")], False)
    facts = expand(
        columns[f"{kind.layer}.labels"][entry],
        codes[f"{kind.layer}.labels"],
        lambda raw: _labels(raw, kind),
        Refusals(people.frame[person], "jpg", problems),
        missing,
    )
    refused[person[~facts.whole]] = True
    told = pair[facts.row]
    return Relations(
        person[facts.row],
        tuple(end[told] if len(told) else told for end in ends),
        facts.code,
        facts.values,
        columns[f"{kind.layer}.size"][people.row] >= 0,
        refused,
    )


def _read_pairs(pairs: list[object], kind: Kind) -> tuple[tuple[Ints, ...], dict[int, list[Issue]]]:
    """What each distinct pair holds, one array per end, and what is wrong with those that cannot be read."""
    issues: dict[int, list[Issue]] = {}
    nobody: tuple[int, ...] = (-1,) * len(kind.ends)
    read: list[tuple[int, ...]] = []
    for i, pair in enumerate(pairs):
        ends = nobody
        if isinstance(pair, Unusable):
            issues[i] = [(pair.reason, kind.key, pair.value)]
        else:
            try:
                ends = kind.read_pair(pair)
            except ValueError as error:
                issues[i] = [(f"pair: {error}", kind.key, pair)]
        read.append(ends)
    columns = np.array(read, np.int64).reshape(len(read), len(kind.ends))
    return tuple(columns.T), issues


def _labels(raw: bytes, kind: Kind) -> Decoded:
    named, issues, whole = label_pairs(raw, kind.key)
    values: list[Value] = []
    for written, value in named:
        if plain(written) == IMPOSSIBLE:
            whole = False
        else:
            values.append((kind.normal(written), written, coded(value, kind.key, issues)))
    return Decoded(values, issues, whole)
