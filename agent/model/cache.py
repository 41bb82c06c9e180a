"""Finished calls on disk, each under the sha256 of its whole request, so that none is paid for twice.

One file holds a line per call of a run. One write appends a line, and a line counts only if it is whole: a process that
is killed, or several processes that append at once, leave at worst lines that are skipped. The file is not synced: a
machine that loses power may lose its newest calls, and makes them again. Requests hold no key, so the file holds none.
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


# Made at import: threads that meet a type first at the same time crash the decoder.
_ENTRY: Final = msgspec.json.Decoder(_Entry)
_UNREADABLE: Final = (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError)


class Calls:
    """A file of finished calls, for many threads at once.

    If a request has several lines, the newest that this process knows counts. Lines of other processes are read when
    the file is opened, by the first call.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file: io.FileIO | None = None
        self._lines: dict[str, tuple[int, int]] = {}
        """The first byte and the length of each request's line."""
        self._unread: set[str] = set()
        """Requests with lines that this process has appended and not yet indexed."""
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
            The reply; None if none is stored, or its line is damaged.
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
        """Return the prompt and completion tokens of the calls in the file when it was opened.

        Raises:
            StoreError: The file cannot be read.
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
            reply: Its reply.

        Raises:
            StoreError: The file cannot be written.
        """
        # The line begins with a line end, because the last line may have been cut short.
        line = b"\n" + msgspec.json.encode({"request": digest, "reply": reply}) + b"\n"
        try:
            file = self._open()
            # Without a lock, because a thread that waits for the interpreter after its write would hold up all others.
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
                    # Not at the interpreter's end, because a thread may still wait for its reply then.
                    weakref.finalize(self, file.close).atexit = False
                    self._file = file
        return self._file

    def _index(self) -> None:
        """Note the position and the tokens of each line that was not indexed before."""
        with contextlib.suppress(FileNotFoundError), self._path.open("rb") as lines:
            lines.seek(self._indexed)
            for line in lines:
                if not line.endswith(b"\n"):
                    break
                with contextlib.suppress(*_UNREADABLE):
                    entry = _ENTRY.decode(line)
                    # The position comes first, so that concurrent readers never miss it.
                    self._lines[entry.request] = self._indexed, len(line)
                    self._unread.discard(entry.request)
                    self._prompt_tokens += entry.reply.prompt_tokens
                    self._completion_tokens += entry.reply.completion_tokens
                self._indexed += len(line)
