"""Finished calls on disk: each under the sha256 of its whole request, so that none is paid for twice.

A file is written beside its place and renamed in: whoever reads sees a whole reply or none, after a kill at any point,
and with several processes writing the same call. It is not synced: a machine that loses power may lose its newest
calls, and makes them again. Nothing of a key is in a request, so none is in a file.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.schema.errors import StoreError

from .replies import Reply

# Made at import: threads that meet a type first at the same time crash the decoder.
_REPLY: Final = msgspec.json.Decoder(Reply)


class Calls:
    """A folder of finished calls; used by many threads and processes at once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def place(self, request: Mapping[str, Any]) -> Path:
        """Where the reply to a request lies: the request with each picture as its sha256, in canonical JSON."""
        key = hashlib.sha256(msgspec.json.encode(request, order="sorted")).hexdigest()
        return self._folder / key[:2] / f"{key}.json"

    def read(self, place: Path) -> Reply | None:
        """The reply kept there; None where there is none, or the machine broke it: then the call is made again."""
        try:
            return _REPLY.decode(place.read_bytes())
        except (OSError, msgspec.DecodeError, UnicodeDecodeError):
            return None

    def keep(self, place: Path, reply: Reply) -> None:
        """Write a reply. Raises StoreError where the disk refuses."""
        temporary = place.with_name(f".{place.stem}.{os.getpid()}.{threading.get_ident()}.tmp")
        try:
            data = msgspec.json.encode(reply)
            try:
                temporary.write_bytes(data)
            except FileNotFoundError:
                place.parent.mkdir(parents=True, exist_ok=True)
                temporary.write_bytes(data)
            temporary.replace(place)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise StoreError(f"cannot keep a finished call in {self._folder}: {error.strerror}") from None
