"""Reader of label files in the COCO format: lists of images, annotations and categories.

Each annotation names the id of its image and the id of its category. These ids have a meaning only inside one file.
The frame of an image is read from the base name of its `file_name`. It is not computed from the image id, because
releases number their images differently. `width` and `height` are not read, because they describe another camera. An
image and its annotations are refused if the image belongs to another sequence, or if another image has the same id.
Categories are identified by name. A name outside the vocabulary of `schema/things.py` is kept as written and reported.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
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
"""Maximum records in each list of a file. JRDB's largest sequence has half as many boxes of people."""
CHUNK: Final = 1000
"""Number of records that are decoded together. A decoded chunk fits into the processor's cache."""

ImageId = Annotated[int, msgspec.Meta(ge=-(2**62), le=2**62)]
"""Id of an image, unique within its file."""
ShortId = Annotated[int, msgspec.Meta(ge=0, le=records.MAX_TRACK)]
"""Id of a track or of a category. The tables store it in 32 bits."""

_FRAME: Final = re.compile(r"([0-9]{6})\.(?:jpg|jpeg|png)")
_SEQUENCE: Final = re.compile(r".+-[0-9]{4}-[0-9]{2}-[0-9]{2}_[0-9]+")
"""Pattern of the names of JRDB's sequences, which consist of a location, a date and an index."""

_R = TypeVar("_R", bound=msgspec.Struct)


class CocoFile(msgspec.Struct):
    """Content of a whole file: three lists of raw records. Each record is decoded later."""

    images: list[msgspec.Raw]
    annotations: list[msgspec.Raw]
    categories: list[msgspec.Raw] | None = None


class Image(msgspec.Struct, gc=False):
    """One record of the list `images`."""

    id: ImageId
    file_name: str


class Category(msgspec.Struct, gc=False):
    """One record of the list `categories`."""

    id: ShortId
    name: str


class _Named(msgspec.Struct):
    id: msgspec.Raw = NOTHING


_IMAGES: Final = RecordReader(Image)
_CATEGORIES: Final = RecordReader(Category)


def open_coco(path: Path) -> CocoFile:
    """Read a file and split it into its raw records.

    Raises:
        InputError: If the file is unreadable, is not JSON, or lacks `images` or `annotations`, or if a list has more
            than `MAX_LISTED` records.
    """
    file = decode_file(path, CocoFile)
    for section in ("images", "annotations", "categories"):
        if len(getattr(file, section) or ()) > MAX_LISTED:
            raise InputError(f"{path.name}: more than {MAX_LISTED:,} {section}", file=path.name)
    return file


def read_chunks(raws: list[msgspec.Raw], kind: str, reader: RecordReader[_R], problems: Problems) -> Iterator[list[_R]]:
    """Decode a list of raw records in chunks. An empty list gives one empty chunk.

    Args:
        raws: raw records.
        kind: word for a record, such as "annotation". The report names a refused record by this word and the record's
            id.
        reader: decoder of the records.
        problems: counter of refused records.

    Yields:
        The usable records of each chunk of `CHUNK` raw records.
    """
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
    """Map from image ids to frames, for the images that are frames of the sequence.

    frame: frames of the images, ascending. No two images have the same frame.
    """

    def __init__(self, file: CocoFile, sequence: str, problems: Problems) -> None:
        """Map the ids of a file's usable images to frames. Refuse all other images, and count them as problems."""
        images = [image for chunk in read_chunks(file.images, "image", _IMAGES, problems) for image in chunk]
        frames: dict[int, set[int | None]] = {}
        for image in images:
            frames.setdefault(image.id, set()).add(_frame_of(image.file_name, sequence)[0])
        number_of: dict[int, int] = {}
        for image in images:
            (frame, reason), field = _frame_of(image.file_name, sequence), "images.file_name"
            if frame is not None and len(frames[image.id]) > 1:
                # An annotation that refers to this image id may belong to either image.
                reason, field = "two images with this id, neither is kept", "images.id"
            elif frame is not None and frame in number_of:
                reason = "frame has two images, the first is kept"
            if reason:
                name = shorten(image.file_name)
                problems.add("frame", reason, frame=name, field=field, value=image.id)
            elif frame is not None:
                number_of[frame] = image.id
        self.frame = np.array(sorted(number_of), np.int64)
        self._frame_of = {image_id: frame for frame, image_id in number_of.items()}

    def frames_of(self, annotations: list[Any], problems: Problems) -> Ints:
        """Return the frame of each annotation's image, or -1 if the image is missing or was refused.

        Annotations without a frame are counted as problems.
        """
        frame = np.array([self._frame_of.get(annotation.image_id, -1) for annotation in annotations], np.int64)
        if len(lost := np.flatnonzero(frame < 0)):
            first = annotations[lost[0]]
            reason, name = "image of the annotation is missing or refused", f"annotation {shorten(bytes(first.id), 30)}"
            problems.add("record", reason, frame=name, field="image_id", value=first.image_id, count=len(lost))
        return frame


def _frame_of(file_name: str, sequence: str) -> tuple[int | None, str]:
    """Return the frame of an image, and "". If the image is not a frame of the sequence, return None and the reason.

    The reason is a text for the load report.
    """
    *folders, name = file_name.replace("\\", "/").split("/")
    match = _FRAME.fullmatch(name)
    if match is None:
        return None, "file name is not six digits with the suffix jpg/jpeg/png"
    if any(_SEQUENCE.fullmatch(folder) and folder != sequence for folder in folders):
        return None, "image of another sequence"
    return int(match[1]), ""


# -- categories ----------------------------------------------------------------------------------------------------

Categories = dict[int, tuple[str, str | None]]
"""By category id: the name as written, and the name in the vocabulary (None if the vocabulary lacks the name)."""


def read_categories(file: CocoFile, problems: Problems) -> tuple[Categories, Counter[tuple[str, str]]]:
    """Decode the categories of a file. If two different categories have the same id, both are refused.

    Returns:
        The categories by id, and a counter of the categories with names outside the vocabulary. A key of the counter
        is ("categories", name).
    """
    names: Categories = {}
    ambiguous: set[int] = set()
    if file.categories is None:
        problems.add("file", "there is no list of categories, so things have no category", field="categories")
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
                # An annotation that refers to this category id may belong to either category.
                ambiguous.add(category.id)
                problems.add("record", "two categories with this id, neither is kept", field="categories", value=raw)
    kept = {category_id: names[category_id] for category_id in sorted(names) if category_id not in ambiguous}
    return kept, Counter(("categories", normal_category(raw)) for raw, name in kept.values() if name is None)


def categories_table(categories: Categories) -> pa.Table:
    """Return the annotation table `categories` without its column `sequence`.

    The rows are in the order of the argument `categories`.
    """
    usual, raw = [name for _, name in categories.values()], [raw for raw, _ in categories.values()]
    types = {name: ANNOTATIONS["categories"].field(name).type for name in ("category_id", "category", "raw")}
    columns = zip(types.items(), (list(categories), usual, raw), strict=True)
    return pa.table({name: pa.array(values, kind) for (name, kind), values in columns})
