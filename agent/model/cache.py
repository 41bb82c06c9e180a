"""Store finished calls on disk under the sha256 of the whole request, so that no call is paid for twice.

A file holds the calls of one run, one call per line. Each line is appended by a single write, and readers skip
incomplete lines. If a process is killed, or if processes append at the same time, only the lines that are being written
can be lost. All other calls stay readable. The file is not synced to disk. If the machine loses power, the newest calls
may be lost, and a resumed run makes these calls again. Requests contain no API key, so the file contains no API key.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import threading
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.errors import StoreError


class _Entry(msgspec.Struct):
    request: str
    reply: Reply


# This runs at import, because msgspec crashes if several threads make the first decoder of a type at the same time.
_ENTRY: Final = msgspec.json.Decoder(_Entry)
_UNREADABLE: Final = (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError)


class Calls:
    """A file of finished calls. Many threads may use it at the same time.

    The file is opened when it is first read or written. Lines that other processes wrote before the opening are read
    too. Lines that other processes write later may be missed. If several lines of a request have been read, the newest
    of these lines is used.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file: io.FileIO | None = None
        self._lines: dict[str, tuple[int, int]] = {}
        """The position of the first byte and the number of bytes of each request's line."""
        self._unread: set[str] = set()
        """Requests with lines that this process has appended but not indexed."""
        self._indexed = self._prompt_tokens = self._completion_tokens = 0

    def digest(self, request: Mapping[str, Any]) -> str:
        """Return the key of a call: the sha256 of its request in canonical JSON.

        Args:
            request: The request, with the sha256 of each picture in place of its bytes.

        Returns:
            The sha256 in hexadecimal digits.
        """
        return hashlib.sha256(msgspec.json.encode(request, order="sorted")).hexdigest()

    def read(self, digest: str) -> Reply | None:
        """Return the stored reply to a request.

        Args:
            digest: The key of the call.

        Returns:
            The reply. None if no reply is stored, or if the line of the reply is damaged.
        """
        try:
            file = self._open()
            if digest in self._unread:
                with self._lock:
                    self._index()
            start, size = self._lines[digest]
            entry = _ENTRY.decode(os.pread(file.fileno(), size, start))
            return entry.reply if entry.request == digest else None
        except (KeyError, *_UNREADABLE):
            return None

    def tokens(self) -> tuple[int, int]:
        """Return two sums over all calls that the file held when it was opened: prompt tokens, and reply tokens.

        Raises:
            StoreError: If the file cannot be read.
        """
        try:
            self._open()
        except OSError as error:
            raise StoreError(f"cannot read the finished calls in {self._path}: {error.strerror}") from None
        return self._prompt_tokens, self._completion_tokens

    def append(self, digest: str, reply: Reply) -> None:
        """Append a reply.

        Args:
            digest: The key of the call.
            reply: The reply to the call.

        Raises:
            StoreError: If the file cannot be written.
        """
        # The line begins with a line end, because the last line of the file may be incomplete.
        line = b"\n" + msgspec.json.encode({"request": digest, "reply": reply}) + b"\n"
        try:
            file = self._open()
            # No lock is held, because a thread that waits for the interpreter after its write would delay all others.
            while line:
                line = line[file.write(line) :]
            self._unread.add(digest)
        except OSError as error:
            raise StoreError(f"cannot keep a finished call in {self._path}: {error.strerror}") from None

    def _open(self) -> io.FileIO:
        if self._file is None:
            with self._lock:
                if self._file is None:
                    self._path.parent.mkdir(parents=True, exist_ok=True)
                    self._index()
                    file = io.FileIO(self._path, "a+")
                    # The file is not closed when the interpreter ends, because a thread may still wait for a reply
                    # then.
                    weakref.finalize(self, file.close).atexit = False
                    self._file = file
        return self._file

    def _index(self) -> None:
        """Store the position of each line that was not indexed before, and count its tokens."""
        with contextlib.suppress(FileNotFoundError), self._path.open("rb") as lines:
            lines.seek(self._indexed)
            for line in lines:
                if not line.endswith(b"\n"):
                    break
                with contextlib.suppress(*_UNREADABLE):
                    entry = _ENTRY.decode(line)
                    # The position is stored first, so that a concurrent reader always finds the call in `_lines` or in
                    # `_unread`.
                    self._lines[entry.request] = self._indexed, len(line)
                    self._unread.discard(entry.request)
                    self._prompt_tokens += entry.reply.prompt_tokens
                    self._completion_tokens += entry.reply.completion_tokens
                self._indexed += len(line)
