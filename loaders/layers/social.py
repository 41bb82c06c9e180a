"""Loaders of social and reasoning files: attributes of people and groups, and relations to people and things.

Social files, such as `labels_2d_activity_social_stitched/<sequence>.json`, are 2D files with further members in every
record: demographics, group information and interactions with people. Reasoning files also have relations to things.
Demographics and group information are lists of at most one object `{key: {label: difficulty}}`. These objects repeat
between frames, and each distinct object is decoded once.

If a person has two records in a frame, the first is used. A record does not need a box to give facts. The boxes are
used only to check whether the file numbers its frames like the 2D layer. If a refused record may describe a
person, no list in the record's frame is whole (see `relation_lists`), and the attributes in the frame are not used.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, LayerTables, Refusals, constant, mask_of
from jrdb_avr.loaders.labelfiles.facts import Decoded, KeptRecords, expand, facts_table, keep_people
from jrdb_avr.loaders.labelfiles.frames import Fields, RecordReader, gather
from jrdb_avr.loaders.labelfiles.records import NOTHING
from jrdb_avr.loaders.layers.boxes_2d import NO_BOX, SUFFIXES, StitchedBox, take_people, usable_boxes
from jrdb_avr.loaders.layers.relation_lists import Entry, RelationKind, Relations, person_of, take_lists, thing_of
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.labels import DEMOGRAPHICS, GROUP_INFO, INTERACTIONS, VALUES, normal_interaction, normal_values
from jrdb_avr.schema.things import VERBS, normal_verb

INTERACTING: Final = RelationKind(
    "interactions", "H-interaction", person_of, ("partner",), "label", normal_interaction, INTERACTIONS
)
"""Relations between two people."""
HANDLING: Final = RelationKind("handles", "HOI", thing_of, ("object", "category_id"), "verb", normal_verb, VERBS)
"""Relations of a person to a thing."""

ATTRIBUTES: Final = (("demographics", "demographics_info", DEMOGRAPHICS), ("group_info", "group_info", GROUP_INFO))
"""Layers of attributes: name, key of the layer's list in a record, and the attributes by their key in this list."""


class HandlingRecord(msgspec.Struct, gc=False):
    """Record of one person in one frame. Of the record's lists, only the list of relations to things is decoded."""

    label_id: str
    box: StitchedBox | None = None
    handles: list[Entry] | None = msgspec.field(default=None, name="HOI")


class SocialRecord(HandlingRecord, gc=False):
    """Record of one person in one frame, with attributes and relations to people in addition to relations to things."""

    demographics_info: msgspec.Raw = NOTHING
    group_info: msgspec.Raw = NOTHING
    interactions: list[Entry] | None = msgspec.field(default=None, name="H-interaction")
    hhi: list[Entry] | None = msgspec.field(default=None, name="HHI")


_SOCIAL: Final[RecordReader[Any]] = RecordReader(SocialRecord)
_HANDLING: Final[RecordReader[Any]] = RecordReader(HandlingRecord)


def load_social(path: Path, problems: Problems) -> LayerTables:
    """Read demographics, interactions and group information of a social file.

    If a record has neither the list `H-interaction` nor the list `HHI`, the interactions of the person in the frame are
    unknown. If the record has one of the lists and it is empty, the person has no interaction in the frame.

    Args:
        path: label file.
        problems: counter of refused parts.

    Returns:
        The tables of attributes and interactions, the table `listed` of whole lists, the frames of each layer, and the
        boxes of the file.

    Raises:
        InputError: If the file as a whole cannot be used.
    """
    return _load(path, problems, (INTERACTING,), False)


def load_reasoning(path: Path, problems: Problems, social: bool) -> LayerTables:
    """Read a reasoning file.

    Reasoning files leave out empty lists. If a record lacks the list of a kind of relation, the person therefore has no
    such relation in the frame.

    Args:
        path: label file.
        problems: counter of refused parts.
        social: True to read demographics, interactions and group information in addition to the relations to things.

    Returns:
        The tables of relations and attributes, the table `listed` of whole lists, the frames of each layer, and the
        boxes of the file.

    Raises:
        InputError: If the file as a whole cannot be used.
    """
    return _load(path, problems, (INTERACTING, HANDLING) if social else (HANDLING,), True)


def _load(path: Path, problems: Problems, kinds: tuple[RelationKind, ...], absent_is_empty: bool) -> LayerTables:
    """Read the relations of the given kinds from a file. If INTERACTING is one of `kinds`, also read the attributes.

    If `absent_is_empty` is true, a record that lacks the list of a kind counts as a record with an empty list.
    """
    reader, layers = (_SOCIAL, ATTRIBUTES) if INTERACTING in kinds else (_HANDLING, ())
    codes: dict[str, Distinct] = defaultdict(Distinct)
    coded = ("label_id", *(name for _, name, _ in layers))

    def take(fields: Fields) -> Columns:
        boxes = tuple(box or NO_BOX for box in fields["box"])
        columns = take_people(fields | {"box": boxes}, coded, codes)
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
        relations = Relations(columns, kind, codes, people, problems)
        names = (kind.label, "raw", "difficulty")
        tables[kind.layer] = facts_table(kind.layer, people, relations.facts, names, relations.ends)
        whole = in_whole & ~relations.refused & (relations.present | absent_is_empty)
        columns_of = {"frame": people.frame[whole], "track": people.track[whole]}
        listed.append(pa.table({"layer": constant(kind.layer, int(whole.sum())), **columns_of}))
        frames[kind.layer] = people.frames_of(np.flatnonzero(whole | mask_of(relations.facts.row, len(people.row))))
        unknown += relations.facts.tally(kind.unknown)
    tables["listed"] = pa.concat_tables(listed)
    return LayerTables(tables, frames, unknown, _box_table(columns["box"][people.row], people, refusals))


def _lists(fields: Fields, kind: RelationKind) -> Sequence[list[Entry] | None]:
    """Return each record's list of relations of a kind, or None if the record has no list.

    Interactions are written under two keys. If a record has both keys, the two lists are joined.
    """
    if kind is HANDLING:
        return fields["handles"]
    return [
        older if newer is None else newer if older is None else older + newer
        for older, newer in zip(fields["interactions"], fields["hhi"], strict=True)
    ]


def _box_table(box: npt.NDArray[np.float64], people: KeptRecords, refusals: Refusals) -> pa.Table:
    """Return the table `LayerTables.boxes`, which has the usable boxes of the kept records."""
    usable = usable_boxes(box, refusals, "box")
    columns = {"frame": people.frame, "track": people.track, **{name: box[:, i] for i, name in enumerate("xywh")}}
    return pa.table(columns).filter(pa.array(usable))


# -- attributes ----------------------------------------------------------------------------------------------------


class _AttributeDecoder:
    """Decoder of the JSON lists `[{key: {label: difficulty}}]` of attributes.

    The content of a decoded fact is (attribute, value, label, difficulty).
    """

    def __init__(self, field: str, keys: Mapping[str, str]) -> None:
        self._field, self._keys = field, keys
        self._key_of = {name: key for key, name in keys.items()}

    def __call__(self, raw: bytes, decoded: Decoded) -> None:
        try:
            objects = records.parse(raw)
            if not isinstance(objects, list):
                raise ValueError("not a list")
        except ValueError as error:
            return decoded.refuse(str(error), self._field, raw)
        if len(objects) > 1:
            decoded.issues.append(("more than one element, the first is kept", self._field, raw))
        for item in objects[:1]:
            for key, labels in decoded.members(item, self._field).items():
                if key in self._keys and labels is not None:
                    self._attribute(self._keys[key], labels, f"{self._field}.{key}", decoded)

    def _attribute(self, attribute: str, labels: object, field: str, decoded: Decoded) -> None:
        for label, code in decoded.labels(labels, field):
            values = normal_values(attribute, label)
            if not values:
                decoded.refuse("label: no word", field, label)
                continue
            difficulty = decoded.difficulty(code, field)
            decoded.values += [(attribute, value, label, difficulty) for value in values]

    def unknown(self, fact: tuple[Any, ...]) -> tuple[str, str] | None:
        """Return the field and the value of a fact if the value is outside the vocabulary, otherwise None."""
        attribute, value = fact[:2]
        listed = value is None or value in VALUES[attribute]
        return None if listed else (f"{self._field}.{self._key_of[attribute]}", value)
