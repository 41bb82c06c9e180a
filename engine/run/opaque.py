"""Replace names of sequences by opaque names for methods, because a real name tells the place of a recording.

An opaque name is the HMAC-SHA256 of the real name under a key of the store, the file `opaque.key`. The names are equal
in all runs of a store. Nothing of `agent` opens the file of the key.
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
    """Return the file of the key of a store."""
    return store.path / "opaque.key"


def opaque_names(store: Store, sequences: Iterable[str]) -> dict[str, str]:
    """Return the opaque name of each sequence.

    Args:
        store: The store, which gets a key if it has none.
        sequences: Real names.

    Returns:
        Opaque names by real name.

    Raises:
        StoreError: The key is damaged, or cannot be written.
    """
    key = _key(key_path(store))
    return {name: "sequence-" + hmac.digest(key, name.encode(), "sha256").hex()[:16] for name in sequences}


def rename_sequences(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return a table with other names of sequences.

    Args:
        table: A table with the column `sequence`.
        names: New names by old name.

    Returns:
        The table, with the rows and columns in the same order.
    """
    renamed = pa.array([names[name] for name in table["sequence"].to_pylist()], pa.string())
    return table.set_column(table.column_names.index("sequence"), table.schema.field("sequence"), renamed)


def key_fingerprint(store: Store) -> str:
    """Return a text that identifies the key and does not reveal it. Raises StoreError as `opaque_names` does."""
    # The empty name belongs to no sequence.
    return opaque_names(store, [""])[""].removeprefix("sequence-")


def _key(path: Path) -> bytes:
    """Return the key; make it first if it is missing, for the owner alone to read."""
    if not path.exists():
        write_once(path, secrets.token_hex(_KEY_BYTES).encode())
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be used: {error}; delete it, and runs get new opaque names") from None
    if len(key) != _KEY_BYTES:
        raise StoreError(f"{path} is damaged: delete it, and runs get new opaque names")
    return key
