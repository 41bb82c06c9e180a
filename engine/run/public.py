"""Write a public store: the questions and panoramas of a store, without its answers and labels.

DIR/store.json                                        the manifest
DIR/questions/questions.parquet, sequences.parquet    the columns that a method may see
DIR/images/<sequence>/<frame>.jpg                     the frames that can be observed, without metadata
DIR/runs/                                             an empty folder for the runs of `evaluate`
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pyarrow as pa

from jrdb_avr.engine.run.bench import find_images
from jrdb_avr.queries.files import new_folder
from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.opaque import opaque_ids, opaque_names
from jrdb_avr.queries.questions import HIDDEN
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.errors import StoreError, warn
from jrdb_avr.schema.rules import LoadRules, rules_hash
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS

_IMAGES: Final = "images"
_SCAN, _END = 0xDA, 0xD9
_KEPT: Final = (0xC0, 0xC1, 0xC2, 0xC4, _SCAN, 0xDB, 0xDD)
"""Markers of segments that decoders need: size, Huffman tables, scan, quantisation tables and restart interval."""
_JFIF: Final = b"\xff\xe0\x00\x10JFIF\0\1\1\0\0\1\0\1\0\0"
_ADOBE: Final = b"\xff\xee\x00\x0eAdobe\0\x64\0\0\0\0"
"""Segments that say how colours are stored, without free text. The last byte of `_ADOBE` comes from the file."""
_MARKER: Final = re.compile(rb"\xff+([\xc0-\xc2\xc4\xd9-\xdd\xe0-\xef\xfe])")
"""Pattern of a marker outside the data of a scan. Further bytes 0xFF before the marker are padding."""
_NEXT_MARKER: Final = re.compile(rb"(?<!\xff)\xff+[^\x00\xd0-\xd7\xff]")
"""Pattern of the marker that ends a scan. Inside a scan, only a zero or a restart marker may follow 0xFF."""


def export_public(store: Store | str | Path, folder: str | Path, opaque: bool = False) -> int:
    """Write a public store. Its questions have opaque ids.

    Args:
        store: The store, or its folder.
        folder: The folder of the public store. It must be missing or empty.
        opaque: Whether to replace the names of sequences by hashes.

    Returns:
        The number of questions in the public store.

    Raises:
        InputError: If the folder is not empty.
        StoreError: If the store has no questions or panoramas, if it has a training set, or if a picture is not a JPEG.
    """
    store = Store.of(store)
    store.refuse_training()
    questions, sequences = store.question_tables("questions", "sequences")
    root = find_images(store, None)
    if root is None:
        raise StoreError(f"{store.path} was loaded without panoramas: a public store needs them")
    real = sequences["sequence"].to_pylist()
    names = opaque_names(store, real) if opaque else dict(zip(real, real, strict=True))
    questions = rename(questions, "question_id", opaque_ids(store, questions["question_id"].to_pylist()))
    metadata = {"canary": CANARY}
    if generation := (questions.schema.metadata or {}).get(GENERATION_KEY.encode()):
        metadata[GENERATION_KEY] = generation.decode()
    with new_folder(Path(folder)) as made:
        public = Store(made)
        for name, table in (("questions", questions), ("sequences", sequences)):
            schema = pa.schema([field for field in QUESTIONS[name] if field.name not in HIDDEN])
            # The rows are sorted anew, because the order of the real names and ids would help to guess them.
            renamed = rename(table.select(schema.names), "sequence", names).sort_by(schema.names[0])
            write_table(public.question_path(name), renamed, schema, metadata)
        frames = dict(zip(real, sequences["frames"].to_pylist(), strict=True))
        copied = sum(_copy_pictures(Path(root, name), made / _IMAGES / names[name], frames[name]) for name in real)
        if not copied:
            raise StoreError(f"{root} has no panorama of a sequence of {store.path}: a public store needs them")
        (made / "runs").mkdir()
        rules = LoadRules()
        public.write_manifest(Manifest(_IMAGES, rules, rules_hash(rules), {}, {}))
    if copied < len(real):
        warn(f"{len(real) - copied} of {len(real)} sequences have no panorama")
    return len(questions)


def rename(table: pa.Table, column: str, names: Mapping[str, str]) -> pa.Table:
    """Return a copy of a table. In the copy, a column has new names.

    Args:
        table: A table that has the column.
        column: The name of the column. Its values are names, ids or null.
        names: The new name for each old name.

    Returns:
        The copy. Its rows and columns are in the same order as in the given table.
    """
    renamed = pa.array([name and names[name] for name in table[column].to_pylist()], pa.string())
    return table.set_column(table.column_names.index(column), table.schema.field(column), renamed)


def _copy_pictures(source: Path, target: Path, frames: list[int]) -> bool:
    """Copy those pictures of a sequence that exist, without their metadata. Return whether at least one exists."""
    target.mkdir(parents=True)
    paths = [path for frame in frames if (path := source / f"{frame:06d}.jpg").is_file()]
    for path in paths:
        (target / path.name).write_bytes(strip_metadata(path.read_bytes(), path))
    return bool(paths)


def strip_metadata(data: bytes, path: Path) -> bytes:
    """Remove the metadata of a JPEG file.

    Only the segments that decoders need are kept. Of JFIF and Adobe segments, only the facts about colours are kept.

    Args:
        data: The bytes of the file.
        path: The path of the file, for messages.

    Returns:
        The bytes of a JPEG file that has the same pixels and no metadata.

    Raises:
        StoreError: If the file is not a JPEG, if its end is missing, or if it has an unusual segment.
    """
    kept, at = [data[:2]], 2 if data.startswith(b"\xff\xd8") else len(data)
    while match := _MARKER.match(data, at):
        marker, start = match[1][0], match.end()
        if marker == _END:
            return b"".join([*kept, bytes([0xFF, _END])])
        at = start + int.from_bytes(data[start : start + 2], "big")
        name, size = data[start + 2 : start + 7], at - start
        if marker == _SCAN:
            at = next((match.start() for match in _NEXT_MARKER.finditer(data, at)), len(data))
        if marker in _KEPT:
            kept.append(bytes([0xFF, marker]) + data[start:at])
        elif marker == 0xE0 and name == b"JFIF\0" and size >= len(_JFIF) - 2:
            kept.append(_JFIF)
        elif marker == 0xEE and name == b"Adobe" and size >= len(_ADOBE) - 1:
            kept.append(_ADOBE + data[start + 13 : start + 14])
    raise StoreError(f"{path} is not a whole JPEG of a usual kind")
