"""Replace names of sequences and ids of questions by keyed hashes, in runs with hidden names and in what is shared.

A real name shows a method where a recording was made. The id of a question is a hash of its family and template, so a
method could find them by trying all. An opaque name or id is made of the HMAC-SHA256 of the real name or id. The key of
the HMAC is in the file `opaque.key` of the store, so that all runs and exports of a store have the same opaque names.
No module of `agent` opens this file.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from jrdb_avr.queries.files import write_once
from jrdb_avr.queries.questions import sequences_of_questions
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


def opaque_ids(store: Store, ids: Iterable[str]) -> dict[str, str]:
    """Return the opaque id of each question.

    Args:
        store: The store. If it has no key, a new key is written.
        ids: Ids of questions in the store.

    Returns:
        The opaque id of each question, by id in the store.

    Raises:
        StoreError: If the file with the key is damaged, or if this file cannot be read or written.
    """
    key = _key(key_path(store))
    # The name of a sequence has no space, so the hash of an id is never the hash of a name.
    return {name: hmac.digest(key, f"question {name}".encode(), "sha256").hex()[:16] for name in ids}


def stored_ids(store: Store) -> dict[str, str]:
    """Return the id in the store of each question, by opaque id. A store without a key has no opaque ids."""
    if not key_path(store).exists():
        return {}
    return {opaque: name for name, opaque in opaque_ids(store, sequences_of_questions(store)).items()}


def _key(path: Path) -> bytes:
    """Return the key that a file contains. If the file is missing, first write a new key to it, for its owner only."""
    if not path.exists():
        write_once(path, secrets.token_hex(_KEY_BYTES).encode())
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        raise StoreError(
            f"{path} cannot be used: {error}; restore it, or delete it: then runs and exports get new names"
        ) from None
    if len(key) != _KEY_BYTES:
        raise StoreError(f"{path} is damaged: restore it, or delete it: then runs and exports get new names")
    return key
