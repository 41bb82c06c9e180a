"""The world tables of a graph file, kept by a process of their own.

A run's threads take turns at Python's interpreter, so that an engine in their process would wait for them after each
statement: several times as long as the statement takes. Requests and replies go through pipes, one at a time, as a
length and MessagePack; tables as Arrow's stream. The process ends with its parent, however that ends and whatever is
asked at the time: what was not checkpointed is replayed by the next opening. A request that fails in any way is an
error of its caller, and the next one is answered.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Final, NoReturn

import msgspec
import pyarrow as pa

from jrdb_avr.queries.beliefs.tables import Statement, WorldTables
from jrdb_avr.queries.graph.file import WORLD_PROCESS
from jrdb_avr.queries.graph.parameters import scalar
from jrdb_avr.schema.errors import AvrError, LockedError, QueryError, StoreError

_LENGTH: Final = struct.Struct("<Q")

_LOOK_S: Final = 0.2
"""Between looks at whether the parent is there."""


_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
"""Numbers of the C library (mallopt(3)), where it has them."""

_KEPT_BYTES: Final = 256 << 20
"""Of free memory at the end of the heap."""

_LARGEST_KEPT: Final = 32 << 20
"""Of one piece; the C library takes no larger one."""


class _Read(msgspec.Struct, tag="read", frozen=True):
    cypher: str
    params: dict[str, Any]
    ordered: bool
    timeout_s: float | None


class _Write(msgspec.Struct, tag="write", frozen=True):
    transactions: list[list[tuple[str, dict[str, Any]]]]


class _Prepare(msgspec.Struct, tag="prepare", frozen=True):
    statements: list[tuple[str, dict[str, Any]]]
    writes: bool


class _Close(msgspec.Struct, tag="close", frozen=True):
    """Give the graph back, and end."""


class _Done(msgspec.Struct, tag="done", frozen=True):
    """table: what was read, as Arrow's stream."""

    table: bytes = b""


class _Failed(msgspec.Struct, tag="failed", frozen=True):
    """An error of the tree, by the name of its class."""

    kind: str
    message: str
    holder: str = ""


def _bound(value: Any) -> Any:
    """A parameter that MessagePack does not know. Raises TypeError where it is no number or text of numpy's either."""
    if (plain := scalar(value)) is value:
        raise TypeError(f"a {type(value).__name__} is no value")
    return plain


# Made at import: threads that meet a type first at the same time crash the decoder.
_REQUEST: Final = msgspec.msgpack.Decoder(_Read | _Write | _Prepare | _Close)
_REPLY: Final = msgspec.msgpack.Decoder(_Done | _Failed)
_ENCODER: Final = msgspec.msgpack.Encoder(enc_hook=_bound)


class WorldProcess:
    """The world tables of a graph file, as `WorldTables` has them, in a process of their own. For one thread."""

    def __init__(self, path: Path) -> None:
        """Raises StoreError and LockedError as `WorldTables.open`."""
        # Modules are looked for where this process finds them, and nowhere else: not in the working directory.
        modules = os.pathsep.join(place or "." for place in sys.path)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", WORLD_PROCESS, str(path), str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": modules},
                # An interrupt at the terminal is this process's to take.
                process_group=0,
            )
        except (OSError, ValueError) as error:
            raise StoreError(f"cannot start the process of the world model of {str(path)!a}: {error}") from None
        try:
            self._reply()
        except BaseException:
            self._end()
            raise

    def prepare(self, statements: Sequence[Statement], writes: bool) -> None:
        """As `WorldTables.prepare`. Raises QueryError, StoreError where the process has ended."""
        self._ask(_Prepare([(cypher, dict(params)) for cypher, params in statements], writes))

    def query(self, cypher: str, params: Mapping[str, Any], ordered: bool, timeout_s: float | None) -> pa.Table:
        """Run one reading statement. Raises QueryError, StoreError where the process has ended."""
        data = self._ask(_Read(cypher, dict(params), ordered, timeout_s))
        with pa.ipc.open_stream(data) as stream:
            return stream.read_all()

    def write(self, transactions: Sequence[Sequence[Statement]]) -> None:
        """Run writing statements, each list as one transaction. Raises QueryError, StoreError also where the process
        has ended.
        """
        self._ask(_Write([[(cypher, dict(params)) for cypher, params in some] for some in transactions]))

    def close(self) -> None:
        """Give the graph back."""
        try:
            self._ask(_Close())
        finally:
            self._end()

    def _ask(self, request: _Read | _Write | _Prepare | _Close) -> bytes:
        try:
            data = _ENCODER.encode(request)
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            raise QueryError(f"a parameter cannot be bound: {error}") from None
        assert self._process.stdin is not None
        try:
            _send(self._process.stdin, data)
        except OSError:
            raise _gone() from None
        return self._reply()

    def _reply(self) -> bytes:
        assert self._process.stdout is not None
        data = _receive(self._process.stdout)
        if data is None:
            raise _gone()
        reply = _REPLY.decode(data)
        if isinstance(reply, _Done):
            return reply.table
        if reply.kind == LockedError.__name__:
            raise LockedError(reply.message, holder=reply.holder)
        raise (QueryError if reply.kind == QueryError.__name__ else StoreError)(reply.message)

    def _end(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            # What a process that has ended did not take is still to be written.
            with contextlib.suppress(OSError):
                pipe.close()
        self._process.wait()


def _gone() -> StoreError:
    return StoreError("the process of the world model has ended: run again (evaluate with --resume)")


def _send(pipe: IO[bytes], data: bytes) -> None:
    pipe.write(_LENGTH.pack(len(data)) + data)
    pipe.flush()


def _receive(pipe: IO[bytes]) -> bytes | None:
    """The next message, None where the other side has ended."""
    head = pipe.read(_LENGTH.size)
    data = pipe.read(_LENGTH.unpack(head)[0]) if len(head) == _LENGTH.size else b""
    return data if len(head) == _LENGTH.size and len(data) == _LENGTH.unpack(head)[0] else None


# -- in the process ---------------------------------------------------------------------------------------------------


def serve(path: Path, requests: IO[bytes], replies: IO[bytes]) -> None:
    """Open the tables and answer requests until one says to close them. Does not return where the parent has ended."""
    tables = _opened(path, replies)
    while tables is not None:
        data = _receive(requests)
        if data is None:
            _end()
        reply: _Done | _Failed = _Done()
        try:
            match _REQUEST.decode(data):
                case _Read(cypher, params, ordered, timeout_s):
                    reply = _Done(_stream(tables.query(cypher, params, ordered, timeout_s)))
                case _Write(transactions):
                    tables.write(transactions)
                case _Prepare(statements, writes):
                    tables.prepare(statements, writes)
                case _Close():
                    tables.close()
                    tables = None
        except Exception as error:
            reply = _failed(error, QueryError)
        _answer(replies, reply)


def _opened(path: Path, replies: IO[bytes]) -> WorldTables | None:
    try:
        tables = WorldTables.open(path)
    except Exception as error:
        _answer(replies, _failed(error, StoreError))
        return None
    _answer(replies, _Done())
    return tables


def _failed(error: Exception, other: type[AvrError]) -> _Failed:
    """The error as a reply; `other`: what one is that is not of the tree."""
    message = " ".join(str(error).encode("utf-8", "backslashreplace").decode().split())
    if isinstance(error, AvrError):
        return _Failed(type(error).__name__, message, getattr(error, "holder", ""))
    return _Failed(other.__name__, f"{type(error).__name__}: {message[:300]}")


def _answer(replies: IO[bytes], reply: _Done | _Failed) -> None:
    try:
        _send(replies, _ENCODER.encode(reply))
    except OSError:
        _end()


def _end() -> NoReturn:
    """End where the parent has: nobody waits for a checkpoint, and whoever runs again needs the file at once."""
    os._exit(1)


def _follow(parent: int) -> None:
    """End with the parent, also in the middle of a statement."""
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    _end()


def _stay() -> None:
    """Stay on one processor. The engine hands each step of a statement to its other thread and waits for it: to wake a
    processor that rests takes longer than most of these steps.
    """
    if hasattr(os, "sched_setaffinity"):
        # A sandbox may refuse it.
        with contextlib.suppress(OSError):
            processors = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, {processors[os.getpid() % len(processors)]})


def _keep_memory() -> None:
    """Keep what is freed. Each statement takes a few megabytes and frees them; to give them back to the kernel and be
    given pages of zeros for the next one takes, as the heap happens to lie, nothing or a third of a read's time.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT)


def _stream(table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as stream:
        stream.write_table(table)
    data: bytes = sink.getvalue().to_pybytes()
    return data


def main() -> None:
    """Serve the graph file that the command line names."""
    _stay()
    _keep_memory()
    threading.Thread(target=_follow, args=(int(sys.argv[2]),), daemon=True).start()
    replies = os.fdopen(os.dup(1), "wb")
    # Whatever else writes to standard output would break the messages.
    os.dup2(2, 1)
    serve(Path(sys.argv[1]), sys.stdin.buffer, replies)


if __name__ == "__main__":
    main()
