"""Opaque names of sequences for methods: a real name tells the place of a recording.

The name is the HMAC-SHA256 of the real one under a key that is made once per store and stays in `opaque.key`: equal in
every run of the store, and not to be guessed without the file, which nothing of `agent` opens.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from jrdb_avr.queries.files import write_once
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

_KEY_BYTES: Final = 32


def key_path(store: Store) -> Path:
    """Where a store's key lies."""
    return store.path / "opaque.key"


def opaque_names(store: Store, sequences: Iterable[str]) -> dict[str, str]:
    """The opaque name of each sequence. Raises StoreError where the key cannot be written or is damaged."""
    key = _key(key_path(store))
    return {name: "sequence-" + hmac.digest(key, name.encode(), "sha256").hex()[:16] for name in sequences}


def key_fingerprint(store: Store) -> str:
    """A text that changes with the key and does not reveal it. Raises StoreError as `opaque_names` does."""
    # No sequence has an empty name.
    return opaque_names(store, [""])[""].removeprefix("sequence-")


def _key(path: Path) -> bytes:
    """Read the key, or make it where there is none yet; nobody but the owner may read it."""
    if not path.exists():
        write_once(path, secrets.token_hex(_KEY_BYTES).encode())
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be used: {error}; delete it, and runs get new opaque names") from None
    if len(key) != _KEY_BYTES:
        raise StoreError(f"{path} is damaged: delete it, and runs get new opaque names")
    return key
