"""Social and reasoning files -> what people are and how they relate.

`labels_2d_activity_social_stitched/<sequence>.json` and its successors are 2D files with more in every record:
demographics and group information (lists of no or one object of label objects), interactions with people, and in
reasoning files also with things. The first record of a person in a frame counts; its box is not needed for its facts,
and only tells whether the frame numbers are those of the 2D layer. Where a record of the frame is lost that may be a
person's, nobody's list is all, and nothing there says what people are. Demographics and group information repeat from
frame to frame; each distinct object is decoded once.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, LayerTables, Refusals, constant, mask_of
from jrdb_avr.loaders.labelfiles.facts import Decoded, KeptRecords, expand, facts_table, keep_people
from jrdb_avr.loaders.labelfiles.frames import gather
from jrdb_avr.loaders.labelfiles.json import NOTHING, parse
from jrdb_avr.loaders.labelfiles.record_reader import Fields, RecordReader
from jrdb_avr.loaders.labelfiles.records import TWICE
from jrdb_avr.loaders.layers.boxes_2d import PERSON, SUFFIXES, take_people, usable_boxes
from jrdb_avr.loaders.layers.relation_lists import (
    MAX_ENTRIES,
    Entry,
    RelationKind,
    Relations,
    ThingEntry,
    UnreadEntry,
    person_of,
    repaired_list,
    take_lists,
    thing_of,
)
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import DEMOGRAPHICS, GROUP_INFO, INTERACTIONS, VALUES, normal_interaction, normal_values
from jrdb_avr.schema.things import VERBS, normal_verb

INTERACTING: Final = RelationKind(
    "interactions", "H-interaction", person_of, ("partner",), "label", normal_interaction, INTERACTIONS
)
HANDLING: Final = RelationKind("handles", "HOI", thing_of, ("object", "category_id"), "verb", normal_verb, VERBS)

INTERACTION_KEYS: Final = ("H-interaction", "HHI")
"""Two names of one list; the newer comes from the reasoning files."""

ATTRIBUTES: Final = (("demographics", "demographics_info", DEMOGRAPHICS), ("group_info", "group_info", GROUP_INFO))
"""Layers of attributes, the fields they come from, and the attributes by their keys there."""

_NO_BOX: Final = (math.nan,) * 4


class Record(msgspec.Struct, gc=False):
    """One person in one frame."""

    label_id: str
    box: tuple[float, float, float, float]
    handles: list[ThingEntry] | None = msgspec.field(default=None, name="HOI")


class SocialRecord(Record, gc=False):
    """A record of the social or reasoning layer with all fields."""

    demographics_info: msgspec.Raw = NOTHING
    group_info: msgspec.Raw = NOTHING
    interactions: list[Entry] | None = msgspec.field(default=None, name="H-interaction")
    hhi: list[Entry] | None = msgspec.field(default=None, name="HHI")


class HandlingRecord(Record, gc=False):
    """The same record with only the fields about objects; decoding the rest would take half of the time."""

    interactions: list[UnreadEntry] | None = msgspec.field(default=None, name="H-interaction")
    hhi: list[UnreadEntry] | None = msgspec.field(default=None, name="HHI")


def load_social(path: Path, problems: Problems) -> LayerTables:
    """Demographics, interactions and group information of a social file.

    A record without `H-interaction` (or `HHI`) leaves its interactions unknown; an empty list says that there are none.
    Raises InputError if the file as a whole cannot be used.
    """
    return _load(path, problems, (INTERACTING,), False)


def load_reasoning(path: Path, problems: Problems, social: bool) -> LayerTables:
    """What people do with things; with `social` also demographics, interactions and group information.

    A record without `HOI` or `HHI` (or `H-interaction`) has no such relation: in these files a missing list is an empty
    one. Raises InputError if the file as a whole cannot be used.
    """
    return _load(path, problems, (INTERACTING, HANDLING) if social else (HANDLING,), True)


def _load(path: Path, problems: Problems, kinds: tuple[RelationKind, ...], absent_is_empty: bool) -> LayerTables:
    """The tables of kinds of relations and, beside interactions, of attributes; `listed`; and the file's own boxes.

    `absent_is_empty`: a record without a list has no relations, instead of unknown ones.
    """
    reader, layers = (_SOCIAL, ATTRIBUTES) if INTERACTING in kinds else (_HANDLING, ())
    codes: dict[str, Distinct] = defaultdict(Distinct)
    coded = ("label_id", *(name for _, name, _ in layers))

    def take(fields: Fields) -> Columns:
        columns = take_people(fields, coded, codes)
        for kind in kinds:
            columns |= take_lists(_lists(fields, kind), kind, codes)
        return columns

    columns, _, complete = gather(path, SUFFIXES, reader, take, problems)
    people = keep_people(columns, codes, Refusals(columns["frame"], problems))
    in_whole = np.isin(people.frame, people.whole_frames(complete))
    refusals = Refusals(people.frame, problems)
    tables: dict[str, pa.Table] = {}
    frames = {}
    unknown: Counter[tuple[str, str]] = Counter()
    for layer, name, keys in layers:
        decode = _AttributeDecoder(name, keys)
        facts = expand(columns[name][people.row], codes[name], decode, refusals)
        unknown += facts.tally(decode.unknown)
        facts = facts._replace(row=facts.row[in_whole[facts.row]], code=facts.code[in_whole[facts.row]])
        tables[layer] = facts_table(layer, people, facts, ("attribute", "value", "raw", "difficulty"))
        frames[layer] = people.frames_of(facts.row)
    listed = []
    for kind in kinds:
        found = Relations(columns, kind, codes, people, problems)
        names = (kind.label, "raw", "difficulty")
        tables[kind.layer] = facts_table(kind.layer, people, found.facts, names, found.ends)
        whole = in_whole & ~found.refused & (found.there | absent_is_empty)
        listed.append(_listed_table(whole, kind, people))
        frames[kind.layer] = people.frames_of(np.flatnonzero(whole | mask_of(found.facts.row, len(people.row))))
        unknown += found.facts.tally(kind.unknown)
    tables["listed"] = pa.concat_tables(listed)
    return LayerTables(tables, frames, unknown, _boxes(columns["box"][people.row], people, refusals))


def _listed_table(whole: Bools, kind: RelationKind, people: KeptRecords) -> pa.Table:
    columns = {"frame": people.frame[whole], "track": people.track[whole]}
    return pa.table({"layer": constant(kind.layer, int(whole.sum())), **columns})


def _boxes(box: Any, people: KeptRecords, refusals: Refusals) -> pa.Table:
    """The usable boxes, as `LayerTables` has them. A box that could not be read was counted then."""
    usable = usable_boxes(box, refusals, "box")
    columns = {"frame": people.frame, "track": people.track, **{name: box[:, i] for i, name in enumerate("xywh")}}
    return pa.table(columns).filter(pa.array(usable))


# -- records -------------------------------------------------------------------------------------------------------


def _lists(fields: Fields, kind: RelationKind) -> Sequence[list[Any] | None]:
    if kind is HANDLING:
        return fields["handles"]
    return [hhi if older is None else older for older, hhi in zip(fields["interactions"], fields["hhi"], strict=True)]


def _entry_keys(fields: Fields) -> list[tuple[int, tuple[bytes, ...]]] | None:
    """The keys of entries, with their number; None where a list is too long or a record has one under both names."""
    older, newer = fields["interactions"], fields["hhi"]
    if [1 for one, other in zip(older, newer, strict=True) if one is not None and other is not None]:
        return None
    lists = [*filter(None, chain(older, newer, fields["handles"]))]
    entries = sum(map(len, lists))
    if entries > MAX_ENTRIES and max(map(len, lists)) > MAX_ENTRIES:
        return None
    return [(entries, (b'"pair"',)), (entries, (b'"inter_labels"',))]


def _repaired_lists(parts: dict[str, bytes], frame: str, problems: Problems) -> dict[str, Any]:
    """The lists of a record that does not decode, and the box that it has if its own cannot be read."""
    names = [name for name in parts if name in INTERACTION_KEYS and parts[name] != b"null"]
    if len(names) > 1:
        problems.add("field", TWICE, frame=frame, field=names[1])
    raws = ((INTERACTING, parts[names[0]] if names else None), (HANDLING, parts.get(HANDLING.key)))
    return {"box": _NO_BOX} | {kind.layer: repaired_list(raw, kind, frame, problems) for kind, raw in raws}


def _reader(record: type[Any], *raws: str) -> RecordReader[Any]:
    return RecordReader(
        record,
        PERSON | {"box": PERSON["box"]._replace(costs="field")},
        once=("label_id", "box", *raws, ("interactions", "hhi"), "handles"),
        inner_keys=_entry_keys,
        more=_repaired_lists,
    )


_SOCIAL: Final = _reader(SocialRecord, "demographics_info", "group_info")
_HANDLING: Final = _reader(HandlingRecord)


# -- attributes ----------------------------------------------------------------------------------------------------


class _AttributeDecoder:
    """Decodes a list of no or one object `{key: {label: difficulty}}` to (attribute, value, label, difficulty)."""

    def __init__(self, field: str, keys: Mapping[str, str]) -> None:
        self._field, self._keys = field, keys
        self._key_of = {name: key for key, name in keys.items()}

    def __call__(self, raw: bytes, found: Decoded) -> None:
        try:
            objects = parse(raw)
        except ValueError as error:
            return found.refuse(str(error), self._field, raw)
        if not isinstance(objects, list):
            return found.refuse("not a list", self._field, raw)
        if len(objects) > 1:
            found.issues.append(("more than one element, the first is kept", self._field, raw))
        for item in objects[:1]:
            for key, labels in (found.members(item, self._field) or {}).items():
                if key in self._keys and labels is not None:
                    self._attribute(self._keys[key], labels, f"{self._field}.{key}", found)

    def _attribute(self, attribute: str, labels: object, field: str, found: Decoded) -> None:
        for label, code in found.labels(labels, field):
            values = normal_values(attribute, label)
            if not values:
                found.refuse("label: no word", field, label)
                continue
            difficulty = found.difficulty(code, field)
            found.values += [(attribute, value, label, difficulty) for value in values]

    def unknown(self, fact: tuple[Any, ...]) -> tuple[str, str] | None:
        """Field and value of a fact whose value is outside the vocabulary."""
        attribute, value = fact[:2]
        known = value is None or value in VALUES[attribute]
        return None if known else (f"{self._field}.{self._key_of[attribute]}", value)
