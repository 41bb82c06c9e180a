"""The manifest of a store. It lists the sequences with their files, and the rules that `load` applied."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final

import msgspec

from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import LoadRules

MANIFEST_NAME: Final = "store.json"
MANIFEST_VERSION: Final = 2
"""Version of the tables and the manifest of a store. The program reads only stores with its own version."""


class SequenceEntry(msgspec.Struct, frozen=True):
    """Entry of a sequence in the manifest.

    Attributes:
        layers: Annotation layers of the sequence.
        tables: The sha256 of each Parquet file of the sequence, by the path of the file in the store.
    """

    layers: tuple[str, ...]
    tables: dict[str, str]


class Manifest(msgspec.Struct, frozen=True):
    """Content of `store.json`.

    Attributes:
        image_root: Folder with one folder of panoramas per sequence, or None if there are no panoramas. If the folder
            is inside the store, `store.json` has its relative path, so that the store can be moved with its panoramas.
        load_rules: Rules that `load` applied.
        load_rules_hash: Hash of `load_rules`.
        sequences: Entry of each sequence, by name.
        graph: Number of rows of each scene table at the time when the graph was built, by the name of the table. The
            additional entry `storage_version` is the version of the graph's tables.
        version: Version of the tables and the manifest, as in `MANIFEST_VERSION`.
    """

    image_root: str | None
    load_rules: LoadRules
    load_rules_hash: str
    sequences: dict[str, SequenceEntry]
    graph: dict[str, int | str]
    version: int = MANIFEST_VERSION


def read_manifest(store: Path) -> Manifest:
    """Read the manifest of a store.

    Args:
        store: Folder of the store.

    Returns:
        The manifest, with an absolute `image_root`.

    Raises:
        StoreError: If the folder has no manifest, or the manifest is broken or has another version.
    """
    refuse_newer(store)
    path = store / MANIFEST_NAME
    try:
        manifest = msgspec.json.decode(path.read_bytes(), type=Manifest)
    except FileNotFoundError:
        raise StoreError(f"{store} is not a store: run 'jrdb-avr load ROOT --store {store}' first") from None
    except (msgspec.DecodeError, UnicodeDecodeError, OSError) as error:
        raise StoreError(f"cannot read {path}: {error}; load the annotations again") from None
    if manifest.version != MANIFEST_VERSION:
        raise StoreError(f"{path} has version {manifest.version}, not {MANIFEST_VERSION}: load again")
    if manifest.image_root is None:
        return manifest
    if ".." in Path(manifest.image_root).parts:
        raise StoreError(f"{path}: image_root {manifest.image_root[:100]!r} leads out of the store: load again")
    return msgspec.structs.replace(manifest, image_root=str(store.absolute() / manifest.image_root))


def is_public(store: Path) -> bool:
    """Return whether a store is public. A public store has questions, but lacks labels and answers.

    The command `export --public` writes such a store.
    """
    with contextlib.suppress(StoreError):
        return (store / "questions" / "questions.parquet").exists() and not read_manifest(store).sequences
    return False


def refuse_public(store: Path, missing: str) -> None:
    """Raise StoreError if the store is public.

    The message of the error ends in `missing`, a text that names the missing data and a remedy.
    """
    if is_public(store):
        raise StoreError(f"{store}: a public store has no {missing}")


class _Version(msgspec.Struct):
    version: int


def refuse_newer(store: Path) -> None:
    """Raise StoreError if a newer version of the program wrote the store. This version could damage such a store."""
    with contextlib.suppress(OSError, UnicodeDecodeError, msgspec.DecodeError):
        version = msgspec.json.decode((store / MANIFEST_NAME).read_bytes(), type=_Version).version
        if version > MANIFEST_VERSION:
            raise StoreError(
                f"{store} was written by a newer jrdb-avr (the store has version {version}, this program reads "
                f"{MANIFEST_VERSION}): update jrdb-avr, or load into another --store"
            )
