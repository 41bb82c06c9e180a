"""Reader of the lists of relations in a person's record.

The lists `H-interaction` and `HHI` hold relations to people, and the list `HOI` holds relations to things. An entry of
a list is `{"pair": ..., "inter_labels": {label: difficulty}}`. Further members of an entry are ignored. One of them is
the partner's box, which may be from an earlier frame. Entries differ between frames, but their pairs and labels repeat.
Therefore each distinct pair and each distinct object of labels gets a code and is decoded once.

A list is *whole* if no part of the list was refused. Every relation that a whole list lacks is known to be false. An
entry is refused if its pair cannot be read or names the person of the record, or if its labels are not a JSON
object. The label "impossible" gives no fact, and a list with this label is not whole. A list with a label outside the
vocabulary is not whole either, because the label may be a synonym of any relation. If a difficulty cannot be read, the
label is kept as an unknown fact.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, Refusals, mask_of, numbered, ragged
from jrdb_avr.loaders.labelfiles.facts import Decoded, Issue, KeptRecords, check_size, count_issues, expand
from jrdb_avr.loaders.labelfiles.records import ABSENT, NOTHING
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import IMPOSSIBLE, plain

_DIGITS: Final = re.compile(r"[0-9]{1,10}")


class Entry(msgspec.Struct, gc=False):
    """Entry of a list of relations, as written."""

    pair: msgspec.Raw = NOTHING
    inter_labels: msgspec.Raw = NOTHING


def person_of(pair: object) -> tuple[int]:
    """Return the track of the partner, as a tuple of one number. `pair` is "pedestrian:9", "9" or 9, for example.

    Raises:
        ValueError: If `pair` does not name a person.
    """
    if isinstance(pair, str) and not _DIGITS.fullmatch(pair):
        return (records.read_track(pair),)
    return (records.read_whole(pair, 0, records.MAX_TRACK),)


def thing_of(pair: object) -> tuple[int, int]:
    """Return the track and the category id that a thing has in the panoptic layer. `pair` is [track, category id].

    Raises:
        ValueError: If `pair` is not a list of two ids.
    """
    if not isinstance(pair, list) or len(pair) != 2:
        raise ValueError("not a track and a category")
    return records.read_whole(pair[0], 0, records.MAX_TRACK), records.read_whole(pair[1], 0, records.MAX_TRACK)


@dataclass(frozen=True)
class RelationKind:
    """Description of one kind of relation: the form of its lists in the files, and its annotation table."""

    layer: str
    """Name of the annotation table."""
    key: str
    """Key of the list in a record. Problems are reported under this key."""
    read_pair: Callable[[object], tuple[int, ...]]
    """Function that returns the values of `ends` from a decoded pair, or raises ValueError."""
    ends: tuple[str, ...]
    """Columns of the table that identify the partner or the thing."""
    label: str
    """Column of the table that holds the label."""
    normal: Callable[[str], str]
    """Function that returns the vocabulary's spelling of a label."""
    vocabulary: Collection[str]
    """Known labels."""

    def decode(self, raw: bytes, decoded: Decoded) -> None:
        """Decode the labels of an entry, and add a fact to `decoded` for each label except "impossible".

        The content of a fact is (label, label as written, difficulty code).

        Args:
            raw: JSON object `inter_labels` of the entry.
            decoded: object to fill.
        """
        for label, code in decoded.labels(raw, self.key):
            name = self.normal(label)
            decoded.whole &= name in self.vocabulary
            if plain(label) != IMPOSSIBLE:
                decoded.values.append((name, label, decoded.difficulty(code, self.key)))

    def unknown(self, fact: tuple[Any, ...]) -> tuple[str, str] | None:
        """Return the pair of `key` and the fact's label if the label is outside the vocabulary, otherwise None."""
        return None if fact[0] in self.vocabulary else (self.key, fact[0])


def take_lists(lists: Sequence[list[Entry] | None], kind: RelationKind, codes: dict[str, Distinct]) -> Columns:
    """Return the columns of the lists of a batch of records.

    Args:
        lists: list of each record, or None if the record has no list.
        kind: kind of the relations.
        codes: codes of the distinct raw values by column. New values are added.

    Returns:
        The column `<layer>.size` has the length of each record's list, or -1 if the list is missing. The columns
        `<layer>.pair` and `<layer>.labels` have one code per entry, first the entries of the first record, and so on.
    """
    entries = list(chain.from_iterable(filter(None, lists)))
    pairs, labels = (bytes(entry.pair) for entry in entries), (bytes(entry.inter_labels) for entry in entries)
    return {
        f"{kind.layer}.size": np.array([-1 if entries is None else len(entries) for entries in lists], np.int64),
        f"{kind.layer}.pair": numbered(codes[f"{kind.layer}.pair"], pairs, len(entries)),
        f"{kind.layer}.labels": numbered(codes[f"{kind.layer}.labels"], labels, len(entries)),
    }


class Relations:
    """Decoded relations of one kind, from the lists of the kept records. Refused parts are counted.

    facts: facts with the content (label, label as written, difficulty code). `facts.row` has the index in `people` of
        each fact's record.
    ends: dictionary from each column in `RelationKind.ends` to an array with one number per fact. The number is the
        partner's track, the thing's track or the thing's category id, as the name of the column says.
    present: mask of the kept records that have a list.
    refused: mask of the kept records with a list that is not whole.
    """

    def __init__(
        self, columns: Columns, kind: RelationKind, codes: dict[str, Distinct], people: KeptRecords, problems: Problems
    ) -> None:
        size = np.maximum(columns[f"{kind.layer}.size"], 0)
        check_size(int(size.sum()))
        start = np.cumsum(size) - size
        person, position = ragged(size[people.row])
        entry = start[people.row][person] + position
        pair = columns[f"{kind.layer}.pair"][entry]
        ends, issues = _read_pairs(codes[f"{kind.layer}.pair"], kind)
        refusals = Refusals(people.frame[person], problems)
        count_issues(pair, issues, refusals)
        good = ~mask_of(np.array(list(issues), np.int64), len(ends))[pair]
        if len(kind.ends) == 1:
            reflexive = good & (ends[pair, 0] == people.track[person])
            reason = "pair is the person itself"
            refusals.count(reflexive, "field", reason, kind.key, lambda row: int(ends[pair[row], 0]))
            good &= ~reflexive
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
        self.present: Bools = columns[f"{kind.layer}.size"][people.row] >= 0


def _read_pairs(pairs: Iterable[bytes], kind: RelationKind) -> tuple[Ints, dict[int, list[Issue]]]:
    """Return an array of the ends of the distinct pairs, and a dictionary of the issues of the unreadable pairs.

    The array has one row per pair and one column per end. The row of an unreadable pair holds -1 in each column. The
    keys of the dictionary are the codes of the unreadable pairs.
    """
    issues: dict[int, list[Issue]] = {}
    ends = []
    for i, raw in enumerate(pairs):
        try:
            if raw in ABSENT:
                raise ValueError("missing")
            ends.append(kind.read_pair(records.parse(raw)))
        except ValueError as error:
            ends.append((-1,) * len(kind.ends))
            issues[i] = [(f"pair: {error}", kind.key, raw)]
    return np.array(ends, np.int64).reshape(-1, len(kind.ends)), issues
