"""Execution of users' Cypher statements. A statement may only read, and it runs in a child process.

A statement can make the engine read and write files (LOAD FROM, COPY TO, EXPORT, ATTACH), even if the database is open
for reading only. The engine does not report such an access. So there are three safeguards:

- The keywords of the statement are checked. A statement is refused if it has a clause that writes data, loads or
  attaches a file, installs an extension, calls a procedure, or begins or ends a transaction. A second statement is
  also refused.
- The plan of the statement is checked. A statement is refused if the plan has a table function, a write or INTERSECT.
- The database is opened for reading only.

The child process is necessary because some statements crash the engine, and others ignore its timeout.
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
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.queries.graph.parameters import bind, strip_literals
from jrdb_avr.schema import errors
from jrdb_avr.schema.errors import QueryError, StoreError

_TIMEOUT_S: Final = 60.0
MEMORY_BYTES: Final = 2 << 30
"""Maximum memory of the child process, in bytes. The limit of the engine's buffer does not count lists and results."""

_ROWS: Final = "DELETE|DETACH|SET"
"""Keywords of clauses that change rows. CREATE is not listed, because CREATE without a pattern changes tables."""

_REFUSED: Final = (
    "ALTER|ANALYZE|ATTACH|BEGIN|CALL|CHECKPOINT|COMMENT|COMMIT|COPY|DROP|EXPLAIN|EXPORT|EXTENSION|FORCE|FOREACH|IMPORT"
    "|INSERT|INSTALL|LOAD|MACRO|MERGE|PROFILE|PROJECT|REMOVE|RENAME|ROLLBACK|TRANSACTION|TRUNCATE|UNINSTALL|UPDATE|USE"
)


def _match_keywords(keywords: str) -> re.Pattern[str]:
    # The engine accepts a keyword directly after a digit ("= 1SET n.x = 2"), but not after a letter or an underscore.
    return re.compile(rf"(?<![A-Za-z_$])(?:{keywords})(?![A-Za-z0-9_])", re.IGNORECASE | re.ASCII)


_REFUSED_WRITING = _match_keywords(rf"{_REFUSED}|CREATE\b(?!\s*\()")
_REFUSED_READING = _match_keywords(f"{_REFUSED}|CREATE|{_ROWS}")
_QUANTIFIER = re.compile(r"(?<![A-Za-z_])(?:all|any|none|single)\s*\(", re.IGNORECASE | re.ASCII)


def check_cypher(cypher: str, *, writes: bool = False) -> None:
    """Check that the text of a statement has only allowed keywords.

    Args:
        cypher: Statement.
        writes: Whether the statement may create, change and delete nodes and edges.

    Raises:
        QueryError: If the statement has a refused keyword, a second statement, or a quoted text or comment that may
            hide a keyword or a second statement.
    """
    # A keyword could hide in a quoted text if this function and the engine disagree on the end of the text. So refuse
    # backslashes, null characters and bare carriage returns.
    if "\\" in cypher or "\0" in cypher or "\r" in cypher.replace("\r\n", "\n"):
        raise QueryError("a backslash or a bare carriage return is not allowed: pass the text as a parameter ($name)")
    if ";" in cypher.strip().removesuffix(";"):
        raise QueryError("one statement only, without ';' inside: pass a text with ';' as a parameter ($name)")
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
    """Run one statement on a graph file in a child process. The statement may only read.

    Args:
        path: Graph file.
        cypher: Statement.
        params: Values of the parameters, by name.
        timeout_s: Maximum time in seconds, after which the statement is stopped.

    Returns:
        The rows that the statement returns. If the statement has no ORDER BY, the rows are sorted by all columns.

    Raises:
        QueryError: If the statement is refused, fails, takes longer than `timeout_s` or crashes the engine.
        StoreError: If the graph is missing or damaged.
        LockedError: If another process writes the graph.
    """
    check_cypher(cypher)
    values = bind(cypher, params or {})[1]
    request = {"path": str(path.resolve()), "cypher": cypher, "params": values, "timeout_s": timeout_s}
    try:
        # Use the module json, because msgspec can neither write nor read NaN and infinity.
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
            # Arrow cannot read the type of keys that the engine writes for a map.
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
    """Run `serve` in a new process.

    Args:
        request: JSON object with the arguments of `_read`. The process reads the object from stdin.
        timeout_s: Maximum time in seconds, after which the process is killed.

    Returns:
        The ended process. If its exit status is 0, stdout is an Arrow stream of the rows. Otherwise the last line of
        stderr is the error as JSON, unless the engine crashed.

    Raises:
        subprocess.TimeoutExpired: If the process takes longer than `timeout_s`.
    """
    # The option -P prevents the import of modules from the current folder.
    program = [sys.executable, "-P", "-c", "from jrdb_avr.queries.graph.guard import serve; serve()"]
    return subprocess.run(program, input=request, capture_output=True, timeout=timeout_s, check=False)


def serve() -> None:
    """Handle one request in the child process.

    Read the request from stdin. Write the rows to stdout as an Arrow stream, or an error to stderr.
    """
    request = json.loads(sys.stdin.buffer.read())
    threading.Thread(target=_end_beyond_memory, daemon=True).start()
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


def _end_beyond_memory() -> None:
    """Report an error and end the process as soon as its memory exceeds `MEMORY_BYTES`.

    On Linux, this function never returns. On other systems, it returns at once and has no effect.
    """
    statm = Path("/proc/self/statm")
    while statm.exists():
        if int(statm.read_text().split()[1]) * resource.getpagesize() > MEMORY_BYTES:
            _report(QueryError(f"stopped at {MEMORY_BYTES >> 30} GB of memory: narrow the statement"))
            os._exit(1)
        time.sleep(0.02)


def _read(path: str, cypher: str, params: dict[str, Any], timeout_s: float) -> pa.Table:
    """Check the plan of a statement, run the statement, and return its rows."""
    from jrdb_avr.queries.graph.handle import Graph

    with Graph.open(path, read_only=True) as graph:
        plan = graph.explain(cypher, params)
        if plan.functions or plan.writes:
            raise QueryError("the statement reads or writes data outside the graph")
        table = graph.query(cypher, params, ordered=False, timeout_s=timeout_s)
    return table if plan.ordered else _sort(table)


def _sort(table: pa.Table) -> pa.Table:
    """Sort the rows of a statement, because the engine returns rows in a different order each time.

    The rows are sorted by all columns, except columns of lists or structs and columns with equal names.
    """
    keys = [
        (name, "ascending")
        for name, kind in zip(table.column_names, table.schema.types, strict=True)
        if not pa.types.is_nested(kind) and table.column_names.count(name) == 1
    ]
    return table.sort_by(keys) if keys else table
