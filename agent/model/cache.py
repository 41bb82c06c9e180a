"""Finished calls on disk, each under the sha256 of its whole request, so that none is paid for twice.

One file holds a line per call of a run, because creating a file per call takes longer than most of a call. One write
appends a line, and a line counts only if it is whole: a kill at any point, and several processes that append at once,
leave nothing but lines that nobody reads. The file is not synced: a machine that loses power may lose its newest calls,
and makes them again. Requests hold no key, so the file holds none.

Workers on several machines write a file each, `calls-<number>.jsonl`: a network file system does not keep whole what
two machines append to one file. Whoever opens a file also reads those beside it.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.errors import StoreError


class _Line(msgspec.Struct):
    request: str


class _Entry(msgspec.Struct):
    request: str
    reply: Reply


# Made at import: threads that meet a type first at the same time crash the decoder.
_LINE: Final = msgspec.json.Decoder(_Line)
_ENTRY: Final = msgspec.json.Decoder(_Entry)
_UNREADABLE: Final = (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError)


def call_files(folder: Path) -> list[Path]:
    """The files of finished calls in a run's folder."""
    return sorted(folder.glob("calls*.jsonl"))


def merge_calls(path: Path) -> None:
    """Append the files beside a file of finished calls to it, and delete them. Raises StoreError where that fails."""
    try:
        for other in call_files(path.parent):
            if other != path:
                with path.open("ab") as file:
                    # The last line of either may have been cut short.
                    file.write(b"\n" + other.read_bytes())
                other.unlink()
    except OSError as error:
        raise StoreError(f"cannot merge the finished calls in {path.parent}: {error.strerror}") from None


class Calls:
    """A file of finished calls; used by many threads at once. The last line of a request counts.

    What other processes append is found when the file is opened, by the first call.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file: int | None = None
        self._places: dict[str, tuple[int, int, int]] = {}
        """The file, first byte and length of each request's line."""
        self._read_to = 0
        self._others_read = False
        self._unread: set[str] = set()
        """Requests whose lines this process has appended behind what was read."""

    def digest(self, request: Mapping[str, Any]) -> str:
        """The key of a call: the sha256 of its request in canonical JSON, each picture replaced by its own sha256."""
        return hashlib.sha256(msgspec.json.encode(request, order="sorted")).hexdigest()

    def read(self, digest: str) -> Reply | None:
        """The stored reply to a request; None where there is none, or its line is damaged: the call is made again."""
        try:
            if not self._others_read:
                self._read_others()
            with contextlib.suppress(FileNotFoundError):
                own = self._opened()
                if digest in self._unread:
                    with self._lock:
                        self._read_to = self._index(self._path, own, self._read_to)
            if (place := self._places.get(digest)) is None:
                return None
            file, at, size = place
            entry = _ENTRY.decode(os.pread(file, size, at))
            return entry.reply if entry.request == digest else None
        except _UNREADABLE:
            return None

    def tokens(self) -> tuple[int, int]:
        """The prompt and completion tokens of all calls in the file and those beside it."""
        prompt = completion = 0
        for path in {*call_files(self._path.parent), self._path}:
            with contextlib.suppress(OSError), path.open("rb") as lines:
                for line in lines:
                    with contextlib.suppress(*_UNREADABLE):
                        reply = _ENTRY.decode(line).reply
                        prompt, completion = prompt + reply.prompt_tokens, completion + reply.completion_tokens
        return prompt, completion

    def append(self, digest: str, reply: Reply) -> None:
        """Append a reply. Raises StoreError where the disk refuses."""
        # A line end before the line, too: the last line may have been cut short.
        line = b"\n" + msgspec.json.encode({"request": digest, "reply": reply}) + b"\n"
        try:
            file = self._opened(make=True)
            while line:
                line = line[os.write(file, line) :]
        except OSError as error:
            raise StoreError(f"cannot keep a finished call in {self._path}: {error.strerror}") from None
        self._unread.add(digest)

    def _opened(self, *, make: bool = False) -> int:
        if self._file is None:
            with self._lock:
                if self._file is None:
                    if make:
                        self._path.parent.mkdir(parents=True, exist_ok=True)
                    how = os.O_RDWR | os.O_APPEND | (os.O_CREAT if make else 0)
                    self._file, self._read_to = self._open(self._path, how)
        return self._file

    def _read_others(self) -> None:
        with self._lock:
            for path in call_files(self._path.parent):
                if path != self._path and not self._others_read:
                    with contextlib.suppress(OSError):
                        self._open(path, os.O_RDONLY)
            self._others_read = True

    def _open(self, path: Path, how: int) -> tuple[int, int]:
        """Open a file and note its places; returns it, and the byte behind them."""
        file = os.open(path, how, 0o666)
        try:
            end = self._index(path, file, 0)
        except BaseException:
            os.close(file)
            raise
        # Not at the interpreter's end: a thread that still waits for a server would then write elsewhere.
        weakref.finalize(self, os.close, file).atexit = False
        return file, end

    def _index(self, path: Path, file: int, start: int) -> int:
        """Note the places of a file's whole lines from a byte on; returns the byte behind them."""
        # Not by the descriptor that is written to: a write would move the place where the other reads.
        with path.open("rb") as lines:
            lines.seek(start)
            for line in lines:
                if not line.endswith(b"\n"):
                    break
                try:
                    request = _LINE.decode(line).request
                except _UNREADABLE:
                    pass
                else:
                    # In this order: whoever no longer finds it unread finds its place.
                    self._places[request] = file, start, len(line)
                    self._unread.discard(request)
                start += len(line)
        return start
