"""The manifest of a store: which sequences are loaded, by which rules, and the files of each."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final

import msgspec

from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import LoadRules

MANIFEST_NAME: Final = "store.json"
MANIFEST_VERSION: Final = 1
"""The version of a store's tables and manifest: a program reads stores of its own version alone."""


class SequenceEntry(msgspec.Struct, frozen=True):
    """A sequence in the manifest: its layers, and its files' content hashes by path in the store."""

    layers: tuple[str, ...]
    tables: dict[str, str]


class Manifest(msgspec.Struct, frozen=True):
    """`store.json`. `image_root` is the folder that holds one folder of panoramas per sequence, or None.

    It is relative to the store where it lies inside, so that a store with its panoramas can be moved.
    """

    image_root: str | None
    load_rules: LoadRules
    load_rules_hash: str
    sequences: dict[str, SequenceEntry]
    graph: dict[str, int | str]
    """Rows per table of the scene namespace as built, and its storage version."""
    version: int = MANIFEST_VERSION


def read_manifest(store: Path) -> Manifest:
    """Read the manifest of a store's folder, its `image_root` made absolute.

    Raises StoreError where nothing is loaded, or another version of the program wrote it.
    """
    refuse_newer(store)
    path = store / MANIFEST_NAME
    try:
        manifest = msgspec.json.decode(path.read_bytes(), type=Manifest)
    except FileNotFoundError:
        raise StoreError(f"{store} is no store: run 'jrdb-avr load ROOT --store {store}' first") from None
    except (msgspec.DecodeError, UnicodeDecodeError, OSError) as error:
        raise StoreError(f"cannot read {path}: {error}; load the annotations again") from None
    if manifest.version != MANIFEST_VERSION:
        raise StoreError(f"{path} has version {manifest.version}, not {MANIFEST_VERSION}: load again")
    if manifest.image_root is None:
        return manifest
    if ".." in Path(manifest.image_root).parts:
        raise StoreError(f"{path}: image_root {manifest.image_root[:100]!r} leads upwards: load the annotations again")
    return msgspec.structs.replace(manifest, image_root=str(store.absolute() / manifest.image_root))


class _Version(msgspec.Struct):
    version: int


def refuse_newer(store: Path) -> None:
    """Raise StoreError where a newer version of the program wrote the store, which this one could only spoil."""
    with contextlib.suppress(OSError, UnicodeDecodeError, msgspec.DecodeError):
        found = msgspec.json.decode((store / MANIFEST_NAME).read_bytes(), type=_Version).version
        if found > MANIFEST_VERSION:
            raise StoreError(
                f"{store} was written by a newer jrdb-avr (version {found} of the store, this reads "
                f"{MANIFEST_VERSION}): update jrdb-avr, or load into another --store"
            )
