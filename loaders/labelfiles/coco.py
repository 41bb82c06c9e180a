"""A file in the COCO style: lists of images, annotations and categories, joined by numbers of the file's own.

Frames come from the base name of an image's `file_name` and from nothing else: image numbers follow the frames by
rules that differ from release to release, and `width` and `height` are those of another camera. What names another
sequence, or shares its number with another image, is refused together with its annotations. Category numbers are the
file's own too, so categories are known by name: `schema/labels.py` lists them, and a name outside its vocabulary stays
as written and is reported.

Memory is bounded by the file's size: long values stay raw until a chunk of records is turned into columns.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, TypeVar

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import Refusals
from jrdb_avr.loaders.labelfiles.frames import byte_batches, read_file, scanned_sections
from jrdb_avr.loaders.labelfiles.json import BROKEN, NOTHING, MalformedError, elements
from jrdb_avr.loaders.labelfiles.record_reader import MAX_RECORDS, Frame, RecordReader
from jrdb_avr.loaders.labelfiles.records import Rule
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.things import OBJECTS, normal_category

MAX_LISTED: Final = 400_000
"""The most images or annotations of one file: twice the boxes of people in JRDB's fullest sequence."""
CHUNK: Final = 1000
"""Records that are handed on at once: so few that their numbers stay in the processor's cache."""
SCAN_FROM: Final = 64 << 20
"""Lists of this many bytes or more are cut by the scanner, whose memory does not depend on the number of members."""
MAX_OUTSIDE: Final = 64 << 10
"""Bytes outside the lists of a file that is not cut by the scanner."""
NUMBER_LIMIT: Final = 2**62
MAX_CATEGORY: Final = 2**31 - 2

Number = Annotated[int, msgspec.Meta(ge=-NUMBER_LIMIT, le=NUMBER_LIMIT)]
"""A number of the file's own, for images or annotations."""

_FRAME: Final = re.compile(r"([0-9]{6})\.(?:jpg|jpeg|png)")
_SEQUENCE: Final = re.compile(r".+-[0-9]{4}-[0-9]{2}-[0-9]{2}_[0-9]+")
"""How JRDB names its sequences: place, date and number."""

_R = TypeVar("_R", bound=msgspec.Struct)


class _Sections(msgspec.Struct, gc=False):
    images: msgspec.Raw = NOTHING
    annotations: msgspec.Raw = NOTHING
    categories: msgspec.Raw = NOTHING


_MAPPING: Final = msgspec.json.Decoder(dict[str, msgspec.Raw])
_MEMBER: Final = re.compile(rb'_[{,]_"([^"\\]*)"_:_'.replace(b"_", rb"[ \t\r\n]*"))


class CocoFile(NamedTuple):
    """The raw lists of a file."""

    name: str
    sequence: str
    """As the file's name has it."""
    sections: dict[str, memoryview]

    def has_list(self, section: str) -> bool:
        """Whether the file has a list of that name."""
        return section in self.sections and bytes(self.sections[section][:1]) == b"["


def open_coco(path: Path, problems: Problems) -> CocoFile:
    """Read a file and find its lists; the first of equal keys. Raises InputError where it has no images or annotations
    or is no JSON on the outside."""
    name, data = path.name, read_file(path)
    try:
        sections = _strict_sections(data) or scanned_sections(data, _Sections.__struct_fields__, problems)
        file = CocoFile(name, path.stem, sections)
    except MalformedError as error:
        raise InputError(f"{name}: not JSON: {error}", file=name) from None
    for section in ("images", "annotations"):
        if not file.has_list(section):
            raise InputError(f'{name}: there is no list "{section}"', file=name)
    return file


def _strict_sections(data: bytes) -> dict[str, memoryview] | None:
    """The lists of a file; None where it is not strict JSON or repeats a key, so that decoding loses a member."""
    try:
        sections = msgspec.json.decode(data, type=_Sections)
    except BROKEN:
        return None
    inside = sum(len(memoryview(getattr(sections, name))) for name in _Sections.__struct_fields__)
    if len(data) - inside >= MAX_OUTSIDE:
        return None
    text, end = memoryview(data), 0
    found: dict[str, memoryview] = {}
    for key, raw in _MAPPING.decode(data).items():
        mark, value = _MEMBER.match(text, end), memoryview(raw)
        if mark is None or mark[1] != key.encode() or not data.startswith(value, mark.end()):
            return None
        end = mark.end() + len(value)
        found[key] = text[mark.end() : end]
    # After the last member there is only the closing bracket, unless a member is lost.
    return found if not found or bytes(text[end : end + 100]).strip() == b"}" else None


def read_list(file: CocoFile, section: str, reader: RecordReader[_R], problems: Problems) -> Iterator[list[_R]]:
    """Usable records of a list, in chunks, at least one. Raises InputError where the list is no JSON or endless."""
    raw = file.sections[section]
    records = reader.decode(bytes(raw), MAX_LISTED) if len(raw) < SCAN_FROM else None
    if records is not None:
        for i in range(0, max(1, len(records)), CHUNK):
            yield records[i : i + CHUNK]
        return
    listed = 0
    try:
        for batch in byte_batches(elements(raw), len, MAX_RECORDS):
            listed += len(batch)
            if listed > MAX_LISTED:
                raise InputError(f"{file.name}: more than {MAX_LISTED:,} {section}", file=file.name)
            text = b"[" + b",".join(batch) + b"]"
            frame = Frame(-1, "", text, reader.decode_quickly(text))
            for _, found, _ in reader.read([frame], problems):
                yield found
    except MalformedError as error:
        raise InputError(f"{file.name}: not JSON in {section}: {error}", file=file.name) from None


def _file_number(value: object) -> int:
    return records.whole(value, -NUMBER_LIMIT, NUMBER_LIMIT)


NUMBER: Final = Rule(_file_number, "record")


# -- images --------------------------------------------------------------------------------------------------------


class Image(msgspec.Struct, gc=False):
    """One image of the file."""

    id: Number
    file_name: str


_IMAGES: Final = RecordReader(
    Image,
    {"id": NUMBER, "file_name": Rule(records.string, "record", "file_name: ")},
    once=("id", "file_name"),
    place=lambda parts, frame: shorten(parts.get("file_name", b"")),
    within="images.",
)


class Images:
    """Which frame each image number stands for: the images of the file that are frames of its sequence.

    ids: ascending; frame: per id, all different.
    """

    def __init__(self, file: CocoFile, problems: Problems) -> None:
        """Refuses what else is listed. Raises InputError."""
        listed: list[tuple[Image, int | None]] = []

        def refuse(image: Image, reason: str, field: str) -> None:
            value = getattr(image, field)
            problems.add("frame", reason, frame=shorten(image.file_name), field=f"images.{field}", value=value)

        for images in read_list(file, "images", _IMAGES, problems):
            for image in images:
                try:
                    listed.append((image, _frame_of(image.file_name, file.sequence)))
                except ValueError as error:
                    listed.append((image, None))
                    refuse(image, str(error), "file_name")
        first: dict[int, int | None] = {}
        # Nobody can tell to which of two images with one number its annotations belong.
        ambiguous = {image.id for image, frame in listed if first.setdefault(image.id, frame) != frame}
        number_of: dict[int, int] = {}
        for image, frame in listed:
            if frame is None:
                continue
            if image.id in ambiguous:
                refuse(image, "image number of two files, neither is kept", "id")
            elif frame in number_of:
                refuse(image, "frame listed twice, the first is kept", "file_name")
            else:
                number_of[frame] = image.id
        pairs = np.array(sorted((number, frame) for frame, number in number_of.items()), np.int64).reshape(-1, 2)
        self.ids, self.frame = np.ascontiguousarray(pairs.T)

    def rows(self, image_id: Ints) -> Ints:
        """Frame of each image number, -1 where the file has no usable image of it."""
        if not len(self.ids):
            return np.full(len(image_id), -1, np.int64)
        place = np.minimum(np.searchsorted(self.ids, image_id), len(self.ids) - 1)
        return np.where(self.ids[place] == image_id, self.frame[place], -1)


def _frame_of(file_name: str, sequence: str) -> int:
    """Frame number of an image by its base name. Raises ValueError where it is none of the sequence."""
    *folders, name = file_name.replace("\\", "/").split("/")
    match = _FRAME.fullmatch(name)
    if match is None:
        raise ValueError("file name is not six digits and jpg/jpeg/png")
    if any(_SEQUENCE.fullmatch(folder) and folder != sequence for folder in folders):
        raise ValueError("image of another sequence")
    return int(match[1])


# -- annotations ---------------------------------------------------------------------------------------------------


def annotation_reader(record: type[_R], rules: records.Rules, once: Any, inner_keys: Any = None) -> RecordReader[_R]:
    """A reader of annotations, which a report calls by their id as long as their frame is not known."""
    more = {"inner_keys": inner_keys} if inner_keys else {}
    return RecordReader(record, rules, once, place=lambda parts, frame: _place(parts.get("id", b"")), **more)


def _place(number: bytes) -> str:
    return f"annotation {shorten(number or b'without id', 30)}"


def annotation_frames(annotations: list[Any], images: Images, problems: Problems) -> Ints:
    """Frame per annotation (which has `image_id` and a raw `id`); -1, counted, for those of no usable image."""
    image_id = np.fromiter(map(attrgetter("image_id"), annotations), np.int64, len(annotations))
    frame = images.rows(image_id)
    lost = np.flatnonzero(frame < 0)
    for row in islice(lost.tolist(), 1):
        reason, place = "its image is not in the file, or was refused", _place(bytes(annotations[row].id))
        value = int(image_id[row])
        problems.add("record", reason, frame=place, field="image_id", value=value, count=len(lost))
    return frame


def crowded(frame: Ints, refusals: Refusals) -> Bools:
    """Which records belong to frames with too many of them; the frames are counted."""
    full: Bools = (np.bincount(frame) > MAX_RECORDS)[frame]
    if full.any():
        frames = len(np.unique(frame[full]))
        reason = f"frame with more than {MAX_RECORDS} records"
        refusals.add("frame", reason, "image_id", int(full.argmax()), "", frames)
    return full


# -- categories ----------------------------------------------------------------------------------------------------


class Category(msgspec.Struct, gc=False):
    """One entry of the file's list of categories."""

    id: Number
    name: str


_CATEGORIES: Final = RecordReader(
    Category,
    {"id": NUMBER, "name": Rule(records.text, "record", "name: ")},
    once=("id", "name"),
    place=lambda parts, frame: "",
    within="categories.",
)

Categories = dict[int, tuple[str, str | None]]
"""For each number of the file's: the name as written, and its usual name, None outside the vocabulary."""


def read_categories(file: CocoFile, problems: Problems) -> tuple[Categories, Counter[tuple[str, str]]]:
    """The list of categories, and names outside the vocabulary. Without a list every category is unknown."""
    names: Categories = {}
    ambiguous: set[int] = set()
    if not file.has_list("categories"):
        problems.add("file", "there is no list of categories: what things are is unknown", field="categories")
        return names, Counter()
    for chunk in read_list(file, "categories", _CATEGORIES, problems):
        for category in chunk:
            try:
                raw = records.text(category.name)
                number = records.whole(category.id, 0, MAX_CATEGORY)
            except ValueError as error:
                problems.add("record", str(error), field="categories", value=(category.id, category.name))
                continue
            usual = normal_category(raw)
            if number not in names:
                names[number] = (raw, usual if usual in OBJECTS else None)
            elif normal_category(names[number][0]) == usual:
                problems.add("record", "category twice, the first is kept", field="categories", value=raw)
            else:
                # Nobody can tell which of the two its annotations are of.
                ambiguous.add(number)
                problems.add("record", "category number of two names, neither is kept", field="categories", value=raw)
    kept = {number: names[number] for number in sorted(names) if number not in ambiguous}
    return kept, Counter(("categories", normal_category(raw)) for raw, name in kept.values() if name is None)


def categories_table(categories: Categories) -> pa.Table:
    """The columns of the annotation table `categories`, by number."""
    usual, raw = [name for _, name in categories.values()], [raw for raw, _ in categories.values()]
    types = {name: ANNOTATIONS["categories"].field(name).type for name in ("category_id", "category", "raw")}
    columns = zip(types.items(), (list(categories), usual, raw), strict=True)
    return pa.table({name: pa.array(values, kind) for (name, kind), values in columns})
