"""A file in the COCO style: lists of images, annotations and categories, joined by numbers of the file's own.

Frames come from the base name of an image's `file_name` and from nothing else: image numbers follow the frames by
rules that differ from release to release, and `width` and `height` are those of another camera. What names another
sequence, or shares its number with another image, is refused together with its annotations.

Memory is bounded by the file's size: long values stay raw until a chunk of records is turned into columns.

The categories of a file in the COCO style: their numbers are the file's own, so they are known by name.

What a name stands for is told by `schema/labels.py`; a name outside its vocabulary is kept as written and reported.
"""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Generic, TypeVar

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.columns import Refusals
from jrdb_avr.loaders.labelfiles.frames import BROKEN, MAX_RECORDS, SCAN_FROM, RecordReader, key_text, read_file
from jrdb_avr.loaders.labelfiles.jsonscan import MalformedError, elements, end_of_text, members
from jrdb_avr.loaders.labelfiles.keys import WrittenKeys
from jrdb_avr.loaders.labelfiles.records import record_parts
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.things import OBJECTS, normal_category

SECTIONS: Final = ("images", "annotations", "categories")
MAX_KEYS: Final = 1000
"""Members of the outermost object."""
MAX_LISTED: Final = 400_000
"""The most images or annotations of one file: twice the boxes of people in JRDB's fullest sequence."""
CHUNK: Final = 10_000
"""Records that are handed on at once."""
MAX_BATCH: Final = 4 << 20
"""Bytes of text that are decoded at once where a list is not clean."""
NUMBER_LIMIT: Final = 2**62

Number = Annotated[int, msgspec.Meta(ge=-NUMBER_LIMIT, le=NUMBER_LIMIT)]
"""A number of the file's own, for images or annotations."""

_NOTHING: Final = msgspec.Raw(b"")
_COLON: Final = re.compile(rb"[ \t\r\n]*:[ \t\r\n]*")
_FRAME: Final = re.compile(r"([0-9]{6})\.(?:jpg|jpeg|png)")
_SEQUENCE: Final = re.compile(r".+-[0-9]{4}-[0-9]{2}-[0-9]{2}_[0-9]+")
"""How JRDB names its sequences: place, date and number."""

R = TypeVar("R", bound=msgspec.Struct)


class _File(msgspec.Struct, gc=False):
    images: msgspec.Raw = _NOTHING
    annotations: msgspec.Raw = _NOTHING
    categories: msgspec.Raw = _NOTHING


@dataclass(frozen=True)
class CocoFile:
    """The bytes of a file, and where in them its lists stand."""

    name: str
    data: bytes
    spans: dict[str, tuple[int, int]]
    """Start and end of each of SECTIONS that the file has."""


def open_coco(path: Path, problems: Problems) -> CocoFile:
    """Read a file and find its lists; the first of equal keys. Raises InputError where it has no images or annotations
    or is no JSON on the outside."""
    data = read_file(path).removeprefix(codecs.BOM_UTF8)
    name = path.name
    spans = _quick_spans(data) if len(data) < SCAN_FROM else None
    if spans is None:
        spans = _scanned_spans(data, name, problems)
    for section in SECTIONS[:2]:
        begin, _ = spans.get(section, (len(data), 0))
        if data[begin : begin + 1] != b"[":
            raise InputError(f'{name}: there is no list "{section}"', file=name)
    return CocoFile(name, data, spans)


def _quick_spans(data: bytes) -> dict[str, tuple[int, int]] | None:
    """Spans found by decoding; None where the file is not clean and must be scanned."""
    try:
        file = msgspec.json.decode(data, type=_File)
    except BROKEN:
        return None
    spans = {}
    rest, end = [], 0
    for section in SECTIONS:
        raw = bytes(getattr(file, section))
        if raw:
            quoted = f'"{section}"'.encode()
            value = _COLON.match(data, data.find(quoted) + len(quoted))
            if value is None or not data.startswith(raw, value.end()):
                return None
            spans[section] = (value.end(), value.end() + len(raw))
    for begin, stop in sorted(spans.values()):
        rest.append(data[end:begin])
        end = stop
    outside = b"".join([*rest, data[end:]])
    # Of a repeated key, decoding keeps the last only.
    return spans if all(outside.count(f'"{name}"'.encode()) == (name in spans) for name in SECTIONS) else None


def _scanned_spans(data: bytes, name: str, problems: Problems) -> dict[str, tuple[int, int]]:
    spans: dict[str, tuple[int, int]] = {}
    try:
        last = keys = 0
        for key, begin, end in members(data):
            last, keys = end, keys + 1
            if keys > MAX_KEYS:
                raise InputError(f"{name}: more than {MAX_KEYS} keys", file=name)
            section = key_text(key)
            if section in spans:
                problems.add("file", "key twice, the first is kept", field=section)
            elif section in SECTIONS:
                spans[section] = (begin, end)
        if not end_of_text(data, last):
            raise InputError(f"{name}: not JSON: there is text after its end", file=name)
    except MalformedError as error:
        raise InputError(f"{name}: not JSON: {error}", file=name) from None
    return spans


class ListReader(Generic[R]):
    """Decodes the records of a list, as `RecordReader` does those of a frame, whose arguments it takes: all at once
    where they are clean, else in batches, else one by one. `repair` gets the record, an empty place and the problems.
    """

    def __init__(
        self,
        record: type[R],
        repair: Callable[[bytes, str, Problems], R | None],
        once: tuple[str, ...],
        clean: Callable[[list[R], WrittenKeys], bool] = lambda records, written: True,
    ) -> None:
        self._all = msgspec.json.Decoder(list[record])  # type: ignore[valid-type]
        self._batch = RecordReader(record, repair, once, clean)

    def read(self, file: CocoFile, section: str, problems: Problems) -> Iterator[list[R]]:
        """Usable records of a list, in chunks, at least one. Raises InputError where the list is no JSON or endless."""
        begin, end = file.spans[section]
        records = self._clean(file.data[begin:end]) if end - begin < SCAN_FROM else None
        if records is not None:
            _bounded(file, section, len(records))
            for i in range(0, max(1, len(records)), CHUNK):
                yield records[i : i + CHUNK]
            return
        for batch in _batches(file, section):
            found = self._batch.read(b"[" + b",".join(batch) + b"]", "", problems)
            yield found[0] if found else []

    def _clean(self, raw: bytes) -> list[R] | None:
        """All records, where decoding loses nothing."""
        try:
            records: list[R] = self._all.decode(raw)
        except BROKEN:
            return None
        return records if self._batch.plain(records, raw) else None


def _batches(file: CocoFile, section: str) -> Iterator[list[bytes]]:
    """The raw records of a list, cut by the scanner."""
    batch: list[bytes] = []
    size = listed = 0
    try:
        for begin, end in elements(file.data, file.spans[section][0]):
            batch.append(file.data[begin:end])
            size += end - begin
            if len(batch) == MAX_RECORDS or size > MAX_BATCH:
                listed += len(batch)
                _bounded(file, section, listed)
                yield batch
                batch, size = [], 0
    except MalformedError as error:
        raise InputError(f"{file.name}: not JSON in {section}: {error}", file=file.name) from None
    yield batch


def _bounded(file: CocoFile, section: str, listed: int) -> None:
    if listed > MAX_LISTED:
        raise InputError(f"{file.name}: more than {MAX_LISTED:,} {section}", file=file.name)


# -- images --------------------------------------------------------------------------------------------------------


class Image(msgspec.Struct, gc=False):
    """One image of the file."""

    id: Number
    file_name: str


@dataclass(frozen=True)
class Images:
    """Which frame each image number stands for."""

    ids: Ints
    """Ascending."""
    frame: Ints
    """Per id; all different."""

    def rows(self, image_id: Ints) -> Ints:
        """Frame of each image number, -1 where the file has no usable image of it."""
        if not len(self.ids):
            return np.full(len(image_id), -1, np.int64)
        place = np.minimum(np.searchsorted(self.ids, image_id), len(self.ids) - 1)
        return np.where(self.ids[place] == image_id, self.frame[place], -1)


def read_images(file: CocoFile, sequence: str, problems: Problems) -> Images:
    """The images of the file that are frames of `sequence`; what else is listed is refused. Raises InputError."""
    listed: list[tuple[Image, int | None]] = []
    for images in _IMAGES.read(file, "images", problems):
        for image in images:
            try:
                listed.append((image, _frame_of(image.file_name, sequence)))
            except ValueError as error:
                listed.append((image, None))
                _refuse_image(image, str(error), "file_name", problems)
    first: dict[int, int | None] = {}
    # Nobody can tell to which of two images with one number its annotations belong.
    ambiguous = {image.id for image, frame in listed if first.setdefault(image.id, frame) != frame}
    number_of: dict[int, int] = {}
    for image, frame in listed:
        if frame is None:
            continue
        if image.id in ambiguous:
            _refuse_image(image, "image number of two files, neither is kept", "id", problems)
        elif frame in number_of:
            _refuse_image(image, "frame listed twice, the first is kept", "file_name", problems)
        else:
            number_of[frame] = image.id
    kept = sorted((number, frame) for frame, number in number_of.items())
    pairs = np.array(kept, np.int64).reshape(-1, 2)
    return Images(np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1]))


def _frame_of(file_name: str, sequence: str) -> int:
    """Frame number of an image by its base name. Raises ValueError where it is none of the sequence."""
    *folders, name = file_name.replace("\\", "/").split("/")
    match = _FRAME.fullmatch(name)
    if match is None:
        raise ValueError("file name is not six digits and jpg/jpeg/png")
    if any(_SEQUENCE.fullmatch(folder) and folder != sequence for folder in folders):
        raise ValueError("image of another sequence")
    return int(match[1])


def _refuse_image(image: Image, reason: str, field: str, problems: Problems) -> None:
    value = image.id if field == "id" else image.file_name
    problems.add("frame", reason, frame=shorten(image.file_name), field=f"images.{field}", value=value)


def _repair_image(raw: bytes, frame: str, problems: Problems) -> Image | None:
    parts = record_parts(raw, frame, problems)
    if parts is None:
        return None
    where = shorten(parts.get("file_name", b""))
    number = repaired_number(parts, "id", where, problems, "images.id")
    if number is None:
        return None
    try:
        name = fields.loose(parts.get("file_name", b"null"))
        if not isinstance(name, str):
            raise ValueError("not a text")
    except ValueError as error:
        problems.add(
            "record", f"file_name: {error}", frame=where, field="images.file_name", value=parts.get("file_name")
        )
        return None
    return Image(number, name)


_IMAGES: Final = ListReader(Image, _repair_image, ("id", "file_name"))


# -- annotations ---------------------------------------------------------------------------------------------------


def place_of(parts: dict[str, bytes]) -> str:
    """What a report calls an annotation whose frame is not known."""
    return f"annotation {shorten(parts.get('id', b'without id'), 30)}"


def repaired_number(
    parts: dict[str, bytes], key: str, where: str, problems: Problems, field: str | None = None
) -> int | None:
    """A whole number of a record, also as 7.0 or "7"; None, with the reason counted, if there is none.

    `field` is what a report calls the key, where it is not the key.
    """
    try:
        if key not in parts:
            raise ValueError("missing")
        return fields.whole(fields.loose(parts[key]), -NUMBER_LIMIT, NUMBER_LIMIT)
    except ValueError as error:
        problems.add("record", f"{key}: {error}", frame=where, field=field or key, value=parts.get(key, b""))
        return None


def known_images(images: Images, image_id: Ints, names: Callable[[int], object], problems: Problems) -> Ints:
    """Frame per annotation, -1 for those of no usable image, which are counted; `names` gives their numbers."""
    frame = images.rows(image_id)
    lost = frame < 0
    if lost.any():
        row = int(lost.argmax())
        problems.add(
            "record",
            "its image is not in the file, or was refused",
            frame=f"annotation {shorten(str(names(row)), 30)}",
            field="image_id",
            value=int(image_id[row]),
            count=int(lost.sum()),
        )
    return frame


def crowded(frame: Ints, refusals: Refusals) -> Bools:
    """Which records belong to frames with too many of them; the frames are counted."""
    full: Bools = (np.bincount(frame) > MAX_RECORDS)[frame]
    if full.any():
        frames = len(np.unique(frame[full]))
        reason = f"frame with more than {MAX_RECORDS} records"
        refusals.add("frame", reason, "image_id", int(full.argmax()), "", frames)
    return full


MAX_CATEGORY: Final = 2**31 - 2


class Category(msgspec.Struct, gc=False):
    """One entry of the file's list of categories."""

    id: Number
    name: str


Categories = dict[int, tuple[str, str | None]]
"""For each number of the file's: the name as written, and its usual name, None outside the vocabulary."""


def read_categories(file: CocoFile, problems: Problems) -> tuple[Categories, Counter[tuple[str, str]]]:
    """The list of categories, and names outside the vocabulary. Without a list every category is unknown."""
    names: Categories = {}
    ambiguous: set[int] = set()
    begin, _ = file.spans.get("categories", (len(file.data), 0))
    if file.data[begin : begin + 1] != b"[":
        problems.add("file", "there is no list of categories: what things are is unknown", field="categories")
        return names, Counter()
    for chunk in _CATEGORIES.read(file, "categories", problems):
        for category in chunk:
            try:
                raw = fields.text(category.name)
                if not 0 <= category.id <= MAX_CATEGORY:
                    raise ValueError("number out of range")
            except ValueError as error:
                problems.add("record", str(error), field="categories", value=(category.id, category.name))
                continue
            usual = normal_category(raw)
            name = usual if usual in OBJECTS else None
            if category.id not in names:
                names[category.id] = (raw, name)
            elif normal_category(names[category.id][0]) == usual:
                problems.add("record", "category twice, the first is kept", field="categories", value=raw)
            else:
                # Nobody can tell which of the two its annotations are of.
                ambiguous.add(category.id)
                problems.add("record", "category number of two names, neither is kept", field="categories", value=raw)
    kept = {number: names[number] for number in sorted(names) if number not in ambiguous}
    return kept, Counter(("categories", normal_category(raw)) for raw, name in kept.values() if name is None)


def categories_table(sequence: str, categories: Categories) -> pa.Table:
    """The annotation table `categories`, by number."""
    rows = [
        {"sequence": sequence, "category_id": number, "category": name, "raw": raw}
        for number, (raw, name) in categories.items()
    ]
    return pa.Table.from_pylist(rows, ANNOTATIONS["categories"])


def _repair_category(raw: bytes, frame: str, problems: Problems) -> Category | None:
    parts = record_parts(raw, frame, problems)
    number = None if parts is None else repaired_number(parts, "id", "", problems, "categories.id")
    if parts is None or number is None:
        return None
    try:
        return Category(number, fields.text(fields.loose(parts.get("name", b"null"))))
    except ValueError as error:
        problems.add("record", f"name: {error}", field="categories.name", value=parts.get("name", b"missing"))
        return None


_CATEGORIES: Final = ListReader(Category, _repair_category, ("id", "name"))
