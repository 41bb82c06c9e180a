"""What people are and how they relate, from social and reasoning files: both hold the same objects.

`labels_2d_activity_social_stitched/<sequence>.json` and its successors are 2D files with more in every record:
demographics and group information (lists of no or one object of label objects), interactions with people, and in
reasoning files also with things. The first record of a person in a frame counts; its box is not needed for its facts,
and only tells whether the frame numbers are those of the 2D layer. Demographics and group information repeat from frame
to frame; each distinct object is decoded once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.columns import Distinct, Refusals, constant, encoded, mask_of
from jrdb_avr.loaders.labelfiles.expand import Decoded, Facts, Issue, Value, clean_pairs, coded, expand, facts_table
from jrdb_avr.loaders.labelfiles.frames import RecordReader
from jrdb_avr.loaders.labelfiles.gather import Columns, People, gather, keep_people, numbered
from jrdb_avr.loaders.labelfiles.keys import WrittenKeys
from jrdb_avr.loaders.labelfiles.records import record_parts, repaired_box, repaired_label
from jrdb_avr.loaders.layers.boxes_2d import SUFFIXES, box_faults, frames_of, take_boxes
from jrdb_avr.loaders.layers.layer import Reading
from jrdb_avr.loaders.layers.social_entries import (
    MAX_ENTRIES,
    Entry,
    Kind,
    Relations,
    ThingEntry,
    person_of,
    read_lists,
    repaired_list,
    take_lists,
    thing_of,
)
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import DEMOGRAPHICS, GROUP_INFO, INTERACTIONS, VALUES, normal_interaction, normal_values
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.things import VERBS, normal_verb

_NOTHING: Final = msgspec.Raw(b"")

INTERACTING: Final = Kind("interactions", "H-interaction", person_of, ("partner",), "label", normal_interaction)
HANDLING: Final = Kind("handles", "HOI", thing_of, ("object", "category_id"), "verb", normal_verb)


INTERACTION_KEYS: Final = ("H-interaction", "HHI")
"""Two names of one list; the newer comes from the reasoning files."""

_NO_BOX: Final = (math.nan,) * 4


class Record(msgspec.Struct, gc=False):
    """One person in one frame."""

    label_id: str
    box: tuple[float, float, float, float]


class SocialRecord(Record, gc=False):
    """A record of a social file."""

    demographics_info: msgspec.Raw = _NOTHING
    group_info: msgspec.Raw = _NOTHING
    interactions: list[Entry] | None = msgspec.field(default=None, name="H-interaction")
    hhi: list[Entry] | None = msgspec.field(default=None, name="HHI")


class UnreadEntry(msgspec.Struct, gc=False):
    """An entry of a list that is not wanted: it is only counted, as its keys are those of the others."""

    pair: msgspec.Raw
    inter_labels: msgspec.Raw


class HandlingRecord(Record, gc=False):
    """A record of a reasoning file of which only the things are wanted."""

    interactions: list[UnreadEntry] | None = msgspec.field(default=None, name="H-interaction")
    hhi: list[UnreadEntry] | None = msgspec.field(default=None, name="HHI")
    handles: list[ThingEntry] | None = msgspec.field(default=None, name="HOI")


class ReasoningRecord(SocialRecord, gc=False):
    """A record of a reasoning file of which everything is wanted."""

    handles: list[ThingEntry] | None = msgspec.field(default=None, name="HOI")


def read_relations(
    path: Path, sequence: str, record: type[Record], absent_is_empty: bool, problems: Problems
) -> Reading:
    """The tables that a kind of record has facts for, `listed`, and the file's own boxes.

    `absent_is_empty`: a record without a list has no relations, instead of unknown ones. Raises InputError if the file
    as a whole cannot be used.
    """
    raws = _raw_fields(record)
    kinds = _kinds(record)
    codes = {name: Distinct() for name in ("label_id", *raws)}
    codes |= {f"{kind.layer}.{part}": Distinct() for kind in kinds for part in ("pair", "labels")}
    once: tuple[str | tuple[str, ...], ...] = ("label_id", "box", *raws)
    once += tuple(("interactions", "hhi") if kind is INTERACTING else kind.layer for kind in kinds)
    reader = RecordReader(
        record, lambda raw, frame, problems: _repair(raw, record, frame, problems), once, _clean_entries
    )
    gathered = gather(path, SUFFIXES, reader, lambda records: _take(records, raws, kinds, codes), problems)
    columns = gathered.columns()
    everybody = Refusals(columns["frame"], "jpg", problems)
    people = keep_people(columns["frame"], list(codes["label_id"]), columns["label_id"], (), lambda row: "", everybody)
    refusals = Refusals(people.frame, "jpg", problems)
    tables: dict[str, pa.Table] = {}
    frames = {}
    unknown: Counter[tuple[str, str]] = Counter()
    for layer, name, keys in (
        ("demographics", "demographics_info", DEMOGRAPHICS),
        ("group_info", "group_info", GROUP_INFO),
    ):
        if name not in raws:
            continue
        facts = expand(columns[name][people.row], codes[name], _attributes_decoder(name, keys), refusals)
        rows = {"frame": people.frame[facts.row], "track": people.track[facts.row]}
        tables[layer] = facts_table(
            layer, sequence, rows, facts.code, facts.values, ("attribute", "value", "raw", "difficulty")
        )
        frames[layer] = frames_of(people.frame[mask_of(facts.row, len(people.row))])
        unknown += _unknown_values(facts, name, keys)
    listed = []
    for kind in kinds:
        found = read_lists(columns, kind, codes, people, problems)
        tables[kind.layer] = _relations_table(found, kind, sequence, people)
        told = ~found.refused if absent_is_empty else found.there & ~found.refused
        listed.append(_listed_table(told, kind, sequence, people))
        frames[kind.layer] = frames_of(people.frame[told | mask_of(found.person, len(people.row))])
        unknown += _unknown_labels(found, kind)
    tables["listed"] = pa.concat_tables(listed) if listed else ANNOTATIONS["listed"].empty_table()
    return Reading(tables, frames, unknown, _boxes(columns["box"][people.row], people, refusals))


def _raw_fields(record: type[Record]) -> tuple[str, ...]:
    return ("demographics_info", "group_info") if issubclass(record, SocialRecord) else ()


def _kinds(record: type[Record]) -> tuple[Kind, ...]:
    social = (INTERACTING,) if issubclass(record, SocialRecord) else ()
    return social if record is SocialRecord else (*social, HANDLING)


# -- records -----------------------------------------------------------------------------------------------------


def _lists(records: list[Any], kind: Kind) -> list[list[Any] | None]:
    if kind is HANDLING:
        return list(map(attrgetter("handles"), records))
    return [record.hhi if record.interactions is None else record.interactions for record in records]


def _clean_entries(records: list[Any], written: WrittenKeys) -> bool:
    """Whether no list is too long, and no entry repeats a key."""
    if not records:
        return True
    lists = list(chain.from_iterable(filter(None, _lists(records, kind)) for kind in _kinds(type(records[0]))))
    entries = sum(map(len, lists))
    if entries > MAX_ENTRIES and max(map(len, lists)) > MAX_ENTRIES:
        return False
    if isinstance(records[0], HandlingRecord):
        unread = chain.from_iterable(map(attrgetter(name), records) for name in ("interactions", "hhi"))
        entries += sum(map(len, filter(None, unread)))
    return not any(written.exceed(entries, key) for key in (b'"pair"', b'"inter_labels"'))


def _take(records: list[Any], raws: tuple[str, ...], kinds: tuple[Kind, ...], codes: dict[str, Distinct]) -> Columns:
    columns = take_boxes(records, codes["label_id"])
    for name in raws:
        columns[name] = numbered(codes[name], map(bytes, map(attrgetter(name), records)), len(records))
    for kind in kinds:
        columns |= take_lists(_lists(records, kind), kind, codes)
    return columns


def _repair(raw: bytes, record: type[Record], frame: str, problems: Problems) -> Record | None:
    """What can be used of a record that does not decode as it stands; None, with the reason counted, if nothing."""
    parts = record_parts(raw, frame, problems)
    label = None if parts is None else repaired_label(parts, frame, problems)
    if parts is None or label is None:
        return None
    box = repaired_box(parts, frame, problems, "field") or _NO_BOX
    names = [name for name in parts if name in INTERACTION_KEYS and parts[name] != b"null"]
    if len(names) > 1 and issubclass(record, SocialRecord):
        problems.add("field", "key twice, the first is kept", frame=frame, field=names[1])
    parts[INTERACTING.key] = parts[names[0]] if names else b"null"
    values: dict[str, Any] = {name: msgspec.Raw(parts.get(name, b"")) for name in _raw_fields(record)}
    for kind in _kinds(record):
        values[kind.layer] = repaired_list(parts.get(kind.key), kind, frame, problems)
    return record(label, box, **values)


# -- facts -------------------------------------------------------------------------------------------------------


def _attributes_decoder(field: str, keys: Mapping[str, str]) -> Any:
    """Decoder of a list of no or one object `{key: {label: difficulty}}`: (attribute, value, label, difficulty)."""

    def decode(raw: bytes) -> Decoded:
        issues: list[Issue] = []
        values: list[Value] = []
        try:
            listed = fields.loose(raw)
            if not isinstance(listed, list):
                raise ValueError("not a list")
            if len(listed) > 1:
                issues.append(("more than one element, the first is kept", field, raw))
            if not listed:
                return Decoded(values, issues)
            items, again = fields.object_members(listed[0])
        except ValueError as error:
            return Decoded(values, [*issues, (str(error), field, raw)], False)
        issues += [("key twice, the first is kept", f"{field}.{shorten(name)}", "") for name in again]
        for key, labels in items:
            if key in keys and labels is not None:
                values += _attribute(keys[key], labels, f"{field}.{key}", issues)
        return Decoded(values, issues)

    return decode


def _attribute(attribute: str, labels: object, field: str, issues: list[Issue]) -> list[Value]:
    try:
        items, again = fields.object_members(labels)
    except ValueError as error:
        issues.append((str(error), field, labels))
        return []
    named, wrong, _ = clean_pairs(items, again, field)
    issues += wrong
    rows: list[Value] = []
    for written, value in named:
        meant = normal_values(attribute, written)
        if not meant:
            issues.append(("label: no word", field, written))
            continue
        code = coded(value, field, issues)
        rows += [(attribute, word, written, code) for word in meant]
    return rows


def _unknown_values(facts: Facts, field: str, keys: Mapping[str, str]) -> Counter[tuple[str, str]]:
    known: dict[str, set[str | None]] = {name: {None, *VALUES[name]} for name in keys.values()}
    key_of = {name: key for key, name in keys.items()}
    found: Counter[tuple[str, str]] = Counter()
    counts = np.bincount(facts.code, minlength=len(facts.values)).tolist()
    for (attribute, value, _, _), n in zip(facts.values, counts, strict=True):
        if n and value not in known[attribute]:
            found[f"{field}.{key_of[attribute]}", value] += n
    return found


def _unknown_labels(found: Relations, kind: Kind) -> Counter[tuple[str, str]]:
    known = INTERACTIONS if kind is INTERACTING else VERBS
    counts = np.bincount(found.code, minlength=len(found.values)).tolist()
    unknown: Counter[tuple[str, str]] = Counter()
    for (label, _, _), n in zip(found.values, counts, strict=True):
        if n and label not in known:
            unknown[kind.key, label] += n
    return unknown


def _relations_table(found: Relations, kind: Kind, sequence: str, people: People) -> pa.Table:
    rows = {"frame": people.frame[found.person], "track": people.track[found.person]}
    rows |= dict(zip(kind.ends, found.ends, strict=True))
    return facts_table(kind.layer, sequence, rows, found.code, found.values, (kind.label, "raw", "difficulty"))


def _listed_table(told: Bools, kind: Kind, sequence: str, people: People) -> pa.Table:
    n = int(told.sum())
    columns = {"sequence": constant(sequence, n), "layer": constant(kind.layer, n)}
    columns |= {"frame": pa.array(people.frame[told]), "track": pa.array(people.track[told])}
    return encoded(pa.table(columns), ANNOTATIONS["listed"])


def _boxes(box: Any, people: People, refusals: Refusals) -> pa.Table:
    """The usable boxes, as `Reading` has them. A box that could not be read was counted then."""
    usable = ~np.isnan(box[:, 0])
    for fault, reason in box_faults(box):
        refusals.count(usable & fault, "field", reason, "box", lambda row: box[row].tolist())
        usable &= ~fault
    columns = {"frame": people.frame, "track": people.track, **{name: box[:, i] for i, name in enumerate("xywh")}}
    return pa.table(columns).filter(pa.array(usable))
