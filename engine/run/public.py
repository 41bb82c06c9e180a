"""Write a public store: the questions and panoramas of a store, without its answers and labels.

DIR/store.json                                        the manifest
DIR/questions/questions.parquet, sequences.parquet    the columns that a method may see
DIR/images/<sequence>/<frame>.jpg                     the frames that can be observed
DIR/runs/                                             an empty folder for the runs of `evaluate`
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import Final

import pyarrow as pa

from jrdb_avr.engine.run.bench import find_images
from jrdb_avr.engine.run.opaque import opaque_names, rename_sequences
from jrdb_avr.queries.files import new_folder, write_bytes
from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.questions import HIDDEN
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import LoadRules, rules_hash
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS

_IMAGES: Final = "images"
_START, _SCAN, _END = 0xD8, 0xDA, 0xD9
_KEPT: Final = (0xE0, 0xEE)
"""Markers of the application segments that decoders need: JFIF and Adobe."""
_NEXT_MARKER: Final = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
"""Pattern of the marker that ends a scan. In the scan, 0xFF is followed only by a zero or by a restart marker."""


def export_public(store: Store | str | Path, folder: str | Path, opaque: bool = False) -> int:
    """Write a public store.

    Args:
        store: The store, or its folder.
        folder: The folder of the public store. It must be missing or empty.
        opaque: Whether to replace the names of sequences by hashes, and to remove the metadata of the pictures.

    Returns:
        The number of questions in the public store.

    Raises:
        InputError: If the folder is not empty.
        StoreError: If the store has no questions or no panoramas, if it has a training set, or if a picture is damaged.
    """
    store = Store.of(store)
    store.refuse_training()
    questions, sequences = store.question_tables("questions", "sequences")
    root = find_images(store, None)
    if root is None:
        raise StoreError(f"{store.path} was loaded without panoramas: a public store needs them")
    real = sequences["sequence"].to_pylist()
    names = opaque_names(store, real) if opaque else dict(zip(real, real, strict=True))
    metadata = {"canary": CANARY}
    if generation := (questions.schema.metadata or {}).get(GENERATION_KEY.encode()):
        metadata[GENERATION_KEY] = generation.decode()
    with new_folder(Path(folder)) as made:
        public = Store(made)
        for name, table in (("questions", questions), ("sequences", sequences)):
            schema = pa.schema([field for field in QUESTIONS[name] if field.name not in HIDDEN])
            renamed = rename_sequences(table.select(schema.names), names)
            if opaque:
                # Sorted anew, because the order of the real names would reveal which sequence is which.
                renamed = renamed.sort_by(schema.names[0])
            write_table(public.question_path(name), renamed, schema, metadata)
        for row in sequences.to_pylist():
            _write_pictures(Path(root, row["sequence"]), made / _IMAGES / names[row["sequence"]], row["frames"], opaque)
        (made / "runs").mkdir()
        rules = LoadRules()
        public.write_manifest(Manifest(_IMAGES, rules, rules_hash(rules), {}, {}))
    return len(questions)


def _write_pictures(source: Path, target: Path, frames: list[int], strip: bool) -> None:
    """Write the pictures of a sequence that exist. Make hard links of unchanged files if possible, else copies."""
    target.mkdir(parents=True)
    for name in (f"{frame:06d}.jpg" for frame in frames):
        path = source / name
        if not path.exists():
            continue
        if strip and (data := path.read_bytes()) != (stripped := strip_metadata(data, path)):
            write_bytes(target / name, stripped)
            continue
        try:
            os.link(path.resolve(), target / name)
        except OSError:
            shutil.copyfile(path, target / name)


def strip_metadata(data: bytes, path: Path) -> bytes:
    """Remove the metadata of a JPEG file.

    Metadata are comments, application segments that decoders do not need, and bytes after the end of the picture.

    Args:
        data: The bytes of the file.
        path: The path of the file, for messages.

    Returns:
        The bytes of a file that has the same pixels.

    Raises:
        StoreError: If the file is not a JPEG, or if its end is missing.
    """
    kept, at = [data[:2]], 2
    if data[:2] != bytes([0xFF, _START]):
        raise StoreError(f"{path} is not a JPEG")
    while data[at : at + 1] == b"\xff" and len(data) > at + 3:
        marker, end = data[at + 1], at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == _SCAN:
            following = _NEXT_MARKER.search(data, end)
            end = len(data) if following is None else following.start()
        is_metadata = marker == 0xFE or (0xE0 <= marker <= 0xEF and marker not in _KEPT)
        kept += [] if is_metadata else [data[at:end]]
        if data[end : end + 2] == bytes([0xFF, _END]):
            return b"".join([*kept, data[end : end + 2]])
        at = end
    raise StoreError(f"{path} is not a whole JPEG")
