"""Ad-hoc Cypher statements that only read, in a child process.

A read-only database still reads and writes files on request (LOAD FROM, COPY TO, EXPORT, ATTACH), and the engine does
not report the kind of a statement. So a statement passes three checks:

- Keywords: no clause that writes, loads, attaches, installs, calls or controls transactions, and no second statement.
- Plan: no table function, no write, no INTERSECT.
- Database: open for reading only.

The child process is necessary because some statements crash the engine and others ignore its timeout.
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
"""Maximum memory of the child process, in bytes. The engine's buffer does not include lists and results."""

_ROWS: Final = "DELETE|DETACH|SET"
"""Keywords that change only rows. CREATE changes rows if a pattern follows, and otherwise makes tables."""

_REFUSED: Final = (
    "ALTER|ANALYZE|ATTACH|BEGIN|CALL|CHECKPOINT|COMMENT|COMMIT|COPY|DROP|EXPLAIN|EXPORT|EXTENSION|FORCE|FOREACH|IMPORT"
    "|INSERT|INSTALL|LOAD|MACRO|MERGE|PROFILE|PROJECT|REMOVE|RENAME|ROLLBACK|TRANSACTION|TRUNCATE|UNINSTALL|UPDATE|USE"
)


def _match_keywords(keywords: str) -> re.Pattern[str]:
    # A digit may directly precede a keyword ("= 1SET n.x = 2"); a letter or an underscore may not.
    return re.compile(rf"(?<![A-Za-z_$])(?:{keywords})(?![A-Za-z0-9_])", re.IGNORECASE | re.ASCII)


_REFUSED_WRITING = _match_keywords(rf"{_REFUSED}|CREATE\b(?!\s*\()")
_REFUSED_READING = _match_keywords(f"{_REFUSED}|CREATE|{_ROWS}")
_QUANTIFIER = re.compile(r"(?<![A-Za-z_])(?:all|any|none|single)\s*\(", re.IGNORECASE | re.ASCII)


def check_cypher(cypher: str, *, writes: bool = False) -> None:
    """Check the keywords of a statement.

    Args:
        cypher: Statement.
        writes: Whether the statement may make, change and delete nodes and edges.

    Raises:
        QueryError: The statement is refused.
    """
    # If this function and the engine parse a quoted text differently, a keyword could hide in it. So refuse escapes.
    if "\\" in cypher or "\0" in cypher or "\r" in cypher.replace("\r\n", "\n"):
        raise QueryError("a backslash or a bare carriage return is not allowed: pass the text as a parameter ($name)")
    if ";" in cypher.strip().removesuffix(";"):
        raise QueryError("one statement, without ';' inside: pass texts that hold one as a parameter ($name)")
    bare = strip_literals(cypher)
    if any(quote in bare for quote in "'\"`") or "/*" in bare:
        raise QueryError("a quote or comment is not closed")
    if match := (_REFUSED_WRITING if writes else _REFUSED_READING).search(bare):
        allowed = "this changes rows only" if writes else "this reads the graph only (MATCH ... RETURN ...)"
        raise QueryError(f"{match[0].upper()} is not allowed: {allowed}")
    if match := _QUANTIFIER.search(bare):
        name = match[0].rstrip("( \t\n")
        raise QueryError(f"{name}(...) crashes the engine on long lists: write size(list_filter(list, x -> ...)) = 0")


def query_graph(
    path: Path, cypher: str, params: Mapping[str, Any] | None = None, *, timeout_s: float = _TIMEOUT_S
) -> pa.Table:
    """Run one reading statement on a graph file in a child process.

    Args:
        path: Graph file.
        cypher: Statement.
        params: Values of parameters.
        timeout_s: Seconds after which the statement is stopped.

    Returns:
        The rows, sorted by all columns if the statement has no ORDER BY.

    Raises:
        QueryError: The statement is refused, fails, takes too long or crashes the engine.
        StoreError: The graph is missing or damaged.
        LockedError: Another process writes the graph.
    """
    check_cypher(cypher)
    values = bind(cypher, params or {})[1]
    request = {"path": str(path.resolve()), "cypher": cypher, "params": values, "timeout_s": timeout_s}
    try:
        # Unlike msgspec, json writes and reads NaN and infinity.
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
            # The engine gives the keys of maps a type that Arrow cannot read back.
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
    """Serve one request in the child: read it from stdin, write an Arrow stream to stdout or an error to stderr."""
    request = json.loads(sys.stdin.buffer.read())
    threading.Thread(target=end_beyond_memory, args=(_report_memory,), daemon=True).start()
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
    """End this process after a call of `report` if it exceeds the limit of memory (on Linux only)."""
    statm = Path("/proc/self/statm")
    while statm.exists():
        if int(statm.read_text().split()[1]) * resource.getpagesize() > MEMORY_BYTES:
            report()
            os._exit(1)
        time.sleep(0.02)


def _report_memory() -> None:
    _report(QueryError(f"stopped at {MEMORY_BYTES >> 30} GB of memory: narrow the statement"))


def _read(path: str, cypher: str, params: dict[str, Any], timeout_s: float) -> pa.Table:
    """Check the plan of a statement and run it."""
    from jrdb_avr.queries.graph.handle import Graph

    with Graph.open(path, read_only=True, buffer_bytes=_BUFFER_BYTES) as graph:
        plan = graph.explain(cypher, params)
        if plan.functions or plan.writes:
            raise QueryError("the statement reads or writes data outside the graph")
        table = graph.query(cypher, params, ordered=False, timeout_s=timeout_s)
    return table if plan.ordered else _sort(table)


def _sort(table: pa.Table) -> pa.Table:
    """Sort rows by all columns that can be compared, because the engine's order is not repeatable."""
    keys = [
        (name, "ascending")
        for name, kind in zip(table.column_names, table.schema.types, strict=True)
        if not pa.types.is_nested(kind) and table.column_names.count(name) == 1
    ]
    return table.sort_by(keys) if keys else table
