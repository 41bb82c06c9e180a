"""Replace the names of sequences by opaque names, because a real name tells a method where a recording was made.

An opaque name is made of the HMAC-SHA256 of the real name. The key of the HMAC is in the file `opaque.key` of the
store, so that a sequence has the same opaque name in all runs of the store. No module of `agent` opens this file.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

import pyarrow as pa

from jrdb_avr.queries.files import write_once
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

_KEY_BYTES: Final = 32


def key_path(store: Store) -> Path:
    """Return the path of the file that holds the store's key."""
    return store.path / "opaque.key"


def opaque_names(store: Store, sequences: Iterable[str]) -> dict[str, str]:
    """Return the opaque name of each sequence.

    Args:
        store: The store. If it has no key, a new key is written.
        sequences: The real names.

    Returns:
        The opaque name of each sequence, by real name.

    Raises:
        StoreError: If the file with the key is damaged, or if this file cannot be read or written.
    """
    key = _key(key_path(store))
    return {name: "sequence-" + hmac.digest(key, name.encode(), "sha256").hex()[:16] for name in sequences}


def rename_sequences(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return a copy of a table. In the copy, the sequences have new names.

    Args:
        table: A table that has the column `sequence`.
        names: The new name for each old name.

    Returns:
        The copy. Its rows and columns are in the same order as in the given table.
    """
    renamed = pa.array([names[name] for name in table["sequence"].to_pylist()], pa.string())
    return table.set_column(table.column_names.index("sequence"), table.schema.field("sequence"), renamed)


def key_fingerprint(store: Store) -> str:
    """Return a text that identifies the store's key without revealing the key.

    If the store has no key, write a new key. Raise StoreError if the file with the key is damaged, or if this file
    cannot be read or written.
    """
    # The opaque name of "" depends only on the key. No run uses this name, because no sequence has an empty name.
    return opaque_names(store, [""])[""].removeprefix("sequence-")


def _key(path: Path) -> bytes:
    """Return the key that a file contains. If the file is missing, first write a new key to it, for its owner only."""
    if not path.exists():
        write_once(path, secrets.token_hex(_KEY_BYTES).encode())
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be used: {error}; delete it, then runs get new opaque names") from None
    if len(key) != _KEY_BYTES:
        raise StoreError(f"{path} is damaged: delete it, then runs get new opaque names")
    return key
