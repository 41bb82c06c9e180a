"""Files in the COCO style: lists of images, annotations and categories, joined by numbers of the file.

The frame of an image comes from the base name of its `file_name` only: image numbers follow the frames by rules that
differ between releases, and `width` and `height` belong to another camera. An image of another sequence, or with the
number of another image, is refused together with its annotations. Category numbers also belong to the file, so
categories are known by name. A name outside the vocabulary of `schema/things.py` stays as written and is reported.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.frames import RecordReader, decode_file
from jrdb_avr.loaders.labelfiles.records import BROKEN, NOTHING
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.things import OBJECTS, normal_category

MAX_LISTED: Final = 400_000
"""Maximum images or annotations of a file, twice the boxes of people in JRDB's fullest sequence."""
CHUNK: Final = 1000
"""Records that are decoded together. Their numbers fit into the processor's cache."""

Number = Annotated[int, msgspec.Meta(ge=-(2**62), le=2**62)]
"""A number of the file for an image."""
Index = Annotated[int, msgspec.Meta(ge=0, le=records.MAX_TRACK)]
"""A number that is stored in 32 bits: a track or a category."""

_FRAME: Final = re.compile(r"([0-9]{6})\.(?:jpg|jpeg|png)")
_SEQUENCE: Final = re.compile(r".+-[0-9]{4}-[0-9]{2}-[0-9]{2}_[0-9]+")
"""The names of JRDB's sequences: place, date and number."""

_R = TypeVar("_R", bound=msgspec.Struct)


class CocoFile(msgspec.Struct):
    """A whole file: its raw records by list."""

    images: list[msgspec.Raw]
    annotations: list[msgspec.Raw]
    categories: list[msgspec.Raw] | None = None


class Image(msgspec.Struct, gc=False):
    """One image of a file."""

    id: Number
    file_name: str


class Category(msgspec.Struct, gc=False):
    """One entry of the list of categories of a file."""

    id: Index
    name: str


class _Named(msgspec.Struct):
    id: msgspec.Raw = NOTHING


_IMAGES: Final = RecordReader(Image)
_CATEGORIES: Final = RecordReader(Category)


def open_coco(path: Path) -> CocoFile:
    """Read a file.

    Raises:
        InputError: the file is not JSON, has no images or annotations, or too many.
    """
    file = decode_file(path, CocoFile)
    for section in ("images", "annotations", "categories"):
        if len(getattr(file, section) or ()) > MAX_LISTED:
            raise InputError(f"{path.name}: more than {MAX_LISTED:,} {section}", file=path.name)
    return file


def read_chunks(raws: list[msgspec.Raw], kind: str, reader: RecordReader[_R], problems: Problems) -> Iterator[list[_R]]:
    """Yield the usable records of a list in chunks, at least one. `kind` and the id name a refused record."""
    for i in range(0, max(1, len(raws)), CHUNK):
        text = b"[" + b",".join(raws[i : i + CHUNK]) + b"]"
        yield reader.read(text, problems, lambda raw: f"{kind} {_id_of(raw)}")[0]


def _id_of(raw: msgspec.Raw) -> str:
    try:
        return shorten(bytes(msgspec.json.decode(raw, type=_Named).id) or b"without id", 30)
    except BROKEN:
        return "without id"


# -- images --------------------------------------------------------------------------------------------------------


class Images:
    """The frame of each image number, for images that are frames of the sequence.

    ids: ascending image numbers. frame: the frame of each number, all different.
    """

    def __init__(self, file: CocoFile, sequence: str, problems: Problems) -> None:
        """Refuse images that are not frames of `sequence`."""
        images = [image for chunk in read_chunks(file.images, "image", _IMAGES, problems) for image in chunk]
        frames: dict[int, set[int | None]] = {}
        for image in images:
            frames.setdefault(image.id, set()).add(_frame_of(image.file_name, sequence)[0])
        number_of: dict[int, int] = {}
        for image in images:
            (frame, reason), field = _frame_of(image.file_name, sequence), "images.file_name"
            if frame is not None and len(frames[image.id]) > 1:
                # The annotations of the number may belong to either image.
                reason, field = "image number of two files, neither is kept", "images.id"
            elif frame is not None and frame in number_of:
                reason = "frame listed twice, the first is kept"
            if reason:
                name = shorten(image.file_name)
                problems.add("frame", reason, frame=name, field=field, value=image.id)
            elif frame is not None:
                number_of[frame] = image.id
        pairs = np.array(sorted((image_id, frame) for frame, image_id in number_of.items()), np.int64).reshape(-1, 2)
        self.ids, self.frame = np.ascontiguousarray(pairs.T)

    def frames_of(self, annotations: list[Any], problems: Problems) -> Ints:
        """Return the frame per annotation by its `image_id`. It is -1, and counted, without a usable image."""
        image_id = np.fromiter(map(attrgetter("image_id"), annotations), np.int64, len(annotations))
        frame = np.full(len(image_id), -1, np.int64)
        if len(self.ids):
            row = np.minimum(np.searchsorted(self.ids, image_id), len(self.ids) - 1)
            frame = np.where(self.ids[row] == image_id, self.frame[row], -1)
        if len(lost := np.flatnonzero(frame < 0)):
            first = annotations[lost[0]]
            reason, name = "its image is not in the file, or was refused", f"annotation {shorten(bytes(first.id), 30)}"
            problems.add("record", reason, frame=name, field="image_id", value=first.image_id, count=len(lost))
        return frame


def _frame_of(file_name: str, sequence: str) -> tuple[int | None, str]:
    """Return the frame number of an image by its base name, or the reason why it is not a frame of the sequence."""
    *folders, name = file_name.replace("\\", "/").split("/")
    match = _FRAME.fullmatch(name)
    if match is None:
        return None, "file name is not six digits and jpg/jpeg/png"
    if any(_SEQUENCE.fullmatch(folder) and folder != sequence for folder in folders):
        return None, "image of another sequence"
    return int(match[1]), ""


# -- categories ----------------------------------------------------------------------------------------------------

Categories = dict[int, tuple[str, str | None]]
"""Per category number of the file: the name as written, and its usual name (None outside the vocabulary)."""


def read_categories(file: CocoFile, problems: Problems) -> tuple[Categories, Counter[tuple[str, str]]]:
    """Return the categories of a file by number, and the names outside the vocabulary."""
    names: Categories = {}
    ambiguous: set[int] = set()
    if file.categories is None:
        problems.add("file", "there is no list of categories: what things are is unknown", field="categories")
    for chunk in read_chunks(file.categories or [], "category", _CATEGORIES, problems):
        for category in chunk:
            try:
                raw = records.read_text(category.name)
            except ValueError as error:
                problems.add("record", str(error), field="categories", value=category.name)
                continue
            usual = normal_category(raw)
            if names.setdefault(category.id, (raw, usual if usual in OBJECTS else None))[0] == raw:
                continue
            if normal_category(names[category.id][0]) != usual:
                # The annotations of the number may belong to either name.
                ambiguous.add(category.id)
                problems.add("record", "category number of two names, neither is kept", field="categories", value=raw)
    kept = {category_id: names[category_id] for category_id in sorted(names) if category_id not in ambiguous}
    return kept, Counter(("categories", normal_category(raw)) for raw, name in kept.values() if name is None)


def categories_table(categories: Categories) -> pa.Table:
    """Return the columns of the annotation table `categories`, by number."""
    usual, raw = [name for _, name in categories.values()], [raw for raw, _ in categories.values()]
    types = {name: ANNOTATIONS["categories"].field(name).type for name in ("category_id", "category", "raw")}
    columns = zip(types.items(), (list(categories), usual, raw), strict=True)
    return pa.table({name: pa.array(values, kind) for (name, kind), values in columns})
