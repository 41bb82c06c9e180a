"""The world tables of a graph file, kept by a process of their own.

A run's threads take turns at Python's interpreter, so that an engine in their process would wait for them after each
statement: several times as long as the statement takes. Requests and replies go through pipes, one at a time, as a
length and MessagePack; tables as Arrow's stream. The process ends with its parent, however that ends: what was not
checkpointed is replayed by the next opening.
"""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.schema.errors import AvrError, LockedError, QueryError, StoreError

from .binding import scalar
from .graph_lock import WORLD_PROCESS
from .world_tables import Statement, WorldTables

_LENGTH: Final = struct.Struct("<Q")


class _Read(msgspec.Struct, tag="read", frozen=True):
    cypher: str
    params: dict[str, Any]
    ordered: bool
    timeout_s: float | None


class _Write(msgspec.Struct, tag="write", frozen=True):
    transactions: list[list[tuple[str, dict[str, Any]]]]


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


# Made at import: threads that meet a type first at the same time crash the decoder.
_REQUEST: Final = msgspec.msgpack.Decoder(_Read | _Write | _Close)
_REPLY: Final = msgspec.msgpack.Decoder(_Done | _Failed)
_ENCODER: Final = msgspec.msgpack.Encoder(enc_hook=scalar)


class WorldProcess:
    """The world tables of a graph file, as `WorldTables` has them, in a process of their own. For one thread."""

    def __init__(self, path: Path) -> None:
        """Raises StoreError and LockedError as `WorldTables.open`."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", WORLD_PROCESS, str(path), str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        try:
            self._reply()
        except BaseException:
            self._end()
            raise

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

    def _ask(self, request: _Read | _Write | _Close) -> bytes:
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
    """Open the tables and answer requests until one says to close them, or the parent has ended."""
    asked: _Read | _Write | _Close | None = None
    tables: WorldTables | None = None
    while not isinstance(asked, _Close):
        reply: _Done | _Failed = _Done()
        try:
            match asked:
                case None:
                    tables = WorldTables.open(path)
                case _Read(cypher, params, ordered, timeout_s):
                    assert tables is not None
                    reply = _Done(_stream(tables.query(cypher, params, ordered, timeout_s)))
                case _Write(transactions):
                    assert tables is not None
                    tables.write(transactions)
        except AvrError as error:
            reply = _Failed(type(error).__name__, str(error), getattr(error, "holder", ""))
        _send(replies, _ENCODER.encode(reply))
        data = _receive(requests)
        if data is None:
            # Nobody waits for a checkpoint, and whoever runs again needs the file at once.
            os._exit(1)
        asked = _REQUEST.decode(data)
    if tables is not None:
        tables.close()
    _send(replies, _ENCODER.encode(_Done()))


def _stream(table: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as stream:
        stream.write_table(table)
    data: bytes = sink.getvalue().to_pybytes()
    return data


def main() -> None:
    """Serve the graph file that the command line names."""
    # An interrupt is the parent's to take; what it does not close ends with its pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    replies = os.fdopen(os.dup(1), "wb")
    # Whatever else writes to standard output would break the messages.
    os.dup2(2, 1)
    serve(Path(sys.argv[1]), sys.stdin.buffer, replies)


if __name__ == "__main__":
    main()
