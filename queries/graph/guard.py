"""Ad-hoc Cypher: reading only, in a process of its own.

The engine opened read-only still reads and writes files on request (LOAD FROM, COPY TO, EXPORT, ATTACH), and does not
report the kind of a statement. So a statement passes three checks: its words (no clause that writes, loads, attaches,
installs, calls or controls transactions, no second statement), its plan (no table function, no write, no INTERSECT),
and a database opened read-only. It runs in a child process, because some statements crash the engine and
others run on past its own timeout.
"""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.queries.graph.parameters import bind, strip_literals
from jrdb_avr.schema import errors
from jrdb_avr.schema.errors import QueryError, StoreError

_TIMEOUT_S: Final = 60.0
_BUFFER_BYTES: Final = 256 << 20
MEMORY_BYTES: Final = 2 << 30
"""Limit of the child's memory in all: lists and results lie outside of the engine's buffer."""

_ROWS: Final = "DELETE|DETACH|SET"
"""Keywords that change rows only, as CREATE does before a pattern; before anything else it makes tables."""

_REFUSED: Final = (
    "ALTER|ANALYZE|ATTACH|BEGIN|CALL|CHECKPOINT|COMMENT|COMMIT|COPY|DROP|EXPLAIN|EXPORT|EXTENSION|FORCE|FOREACH|IMPORT"
    "|INSERT|INSTALL|LOAD|MACRO|MERGE|PROFILE|PROJECT|REMOVE|RENAME|ROLLBACK|TRANSACTION|TRUNCATE|UNINSTALL|UPDATE|USE"
)


def _keywords(words: str) -> re.Pattern[str]:
    # Digits may stand right before a keyword ("= 1SET n.x = 2"), letters and the underscore may not.
    return re.compile(rf"(?<![A-Za-z_$])(?:{words})(?![A-Za-z0-9_])", re.IGNORECASE | re.ASCII)


_REFUSED_WRITING = _keywords(rf"{_REFUSED}|CREATE\b(?!\s*\()")
_REFUSED_READING = _keywords(f"{_REFUSED}|CREATE|{_ROWS}")
_QUANTIFIER = re.compile(r"(?<![A-Za-z_])(?:all|any|none|single)\s*\(", re.IGNORECASE | re.ASCII)


def check_cypher(cypher: str, *, writes: bool = False) -> None:
    """Refuse a statement by its words; `writes`: it may make, change and delete nodes and edges. Raises QueryError."""
    # Where quoting is read differently than the engine reads it, a keyword could hide: escapes go by parameter.
    if "\\" in cypher or "\0" in cypher or "\r" in cypher.replace("\r\n", "\n"):
        raise QueryError("a backslash or a bare carriage return is not allowed: pass the text as a parameter ($name)")
    if ";" in cypher.strip().removesuffix(";"):
        raise QueryError("one statement, without ';' inside: pass texts that hold one as a parameter ($name)")
    bare = strip_literals(cypher)
    if any(quote in bare for quote in "'\"`") or "/*" in bare:
        raise QueryError("a quote or comment is not closed")
    if found := (_REFUSED_WRITING if writes else _REFUSED_READING).search(bare):
        allowed = "this changes rows only" if writes else "this reads the graph only (MATCH ... RETURN ...)"
        raise QueryError(f"{found[0].upper()} is not allowed: {allowed}")
    if found := _QUANTIFIER.search(bare):
        name = found[0].rstrip("( \t\n")
        raise QueryError(f"{name}(...) crashes the engine on long lists: write size(list_filter(list, x -> ...)) = 0")


def query_graph(
    path: Path, cypher: str, params: Mapping[str, Any] | None = None, *, timeout_s: float = _TIMEOUT_S
) -> pa.Table:
    """Run one reading statement on the graph file at `path`; rows without ORDER BY come sorted by their columns.

    Raises QueryError (refused, failed, too slow, crashed), StoreError and LockedError (no graph to read).
    """
    check_cypher(cypher)
    values = bind(cypher, params or {})[1]
    request = {"path": str(path.resolve()), "cypher": cypher, "params": values, "timeout_s": timeout_s}
    try:
        # By json, which unlike msgspec writes and reads NaN and infinity.
        payload = json.dumps(request, ensure_ascii=False).encode()
    except (TypeError, UnicodeEncodeError):
        raise QueryError("parameters are numbers, UTF-8 text, and lists and dicts of these") from None
    try:
        done = run_child(payload, timeout_s + 10.0)
    except subprocess.TimeoutExpired:
        raise QueryError(f"stopped after {timeout_s:g} s: narrow the statement, or raise the timeout") from None
    if done.returncode == 0:
        try:
            with pa.ipc.open_stream(done.stdout) as reader:
                return reader.read_all()
        except pa.ArrowException:
            # The engine gives the keys of maps a type that Arrow does not take back.
            raise QueryError("the result holds a map: return map_keys(...) and map_values(...) of it") from None
    try:
        kind, message = msgspec.json.decode(done.stderr.splitlines()[-1], type=tuple[str, str])
    except (IndexError, msgspec.DecodeError):
        raise QueryError(
            f"the engine crashed on this statement: simplify it, or see whether the graph is damaged by "
            f"'jrdb-avr load --verify --store {path.parent}'"
        ) from None
    raise getattr(errors, kind)(message)


def run_child(request: bytes, timeout_s: float) -> subprocess.CompletedProcess[bytes]:
    """Run `serve` on a request in a new process. Raises TimeoutExpired after `timeout_s` seconds."""
    # -P: modules in the current folder are not imported.
    program = [sys.executable, "-P", "-c", "from jrdb_avr.queries.graph.guard import serve; serve()"]
    return subprocess.run(program, input=request, capture_output=True, timeout=timeout_s, check=False)


def serve() -> None:
    """The child: one request on stdin, an Arrow stream on stdout or an error as JSON on stderr."""
    request = json.loads(sys.stdin.buffer.read())
    threading.Thread(target=end_beyond_memory, args=(_too_much,), daemon=True).start()
    try:
        table = _read(**request)
    except (QueryError, StoreError) as error:
        _report(error)
        sys.exit(1)
    with pa.ipc.new_stream(sys.stdout.buffer, table.schema) as writer:
        writer.write_table(table)


def _report(error: Exception) -> None:
    sys.stderr.buffer.write(b"\n" + msgspec.json.encode((type(error).__name__, str(error))) + b"\n")
    sys.stderr.buffer.flush()


def end_beyond_memory(report: Callable[[], None]) -> None:
    """Watch this process, where the kernel reports its memory (Linux); beyond the limit, call `report` and end it."""
    place = Path("/proc/self/statm")
    while place.exists():
        if int(place.read_text().split()[1]) * resource.getpagesize() > MEMORY_BYTES:
            report()
            os._exit(1)
        time.sleep(0.02)


def _too_much() -> None:
    _report(QueryError(f"stopped at {MEMORY_BYTES >> 30} GB of memory: narrow the statement"))


def _read(path: str, cypher: str, params: dict[str, Any], timeout_s: float) -> pa.Table:
    """Check the plan of a statement and run it."""
    from jrdb_avr.queries.graph.handle import Graph

    with Graph.open(path, read_only=True, buffer_bytes=_BUFFER_BYTES) as graph:
        plan = graph.explain(cypher, params)
        if plan.functions or plan.writes:
            raise QueryError("this reads or writes something else than the graph")
        table = graph.query(cypher, params, ordered=False, timeout_s=timeout_s)
    return table if plan.ordered else _sorted(table)


def _sorted(table: pa.Table) -> pa.Table:
    """Rows sorted by every column that can be compared, left to right: the engine's order is not repeatable."""
    keys = [
        (name, "ascending")
        for name, kind in zip(table.column_names, table.schema.types, strict=True)
        if not pa.types.is_nested(kind) and table.column_names.count(name) == 1
    ]
    return table.sort_by(keys) if keys else table
