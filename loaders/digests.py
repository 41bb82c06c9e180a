"""Digests of tables: per sequence the rows, and a sum of row hashes that no order can change.

Two tables of the same content have the same digests, whether they are in memory, in files, or read out of the graph.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

if TYPE_CHECKING:
    import duckdb

Digest = tuple[int, int]
"""Rows, and the sum of their 64-bit hashes."""
Digests = dict[str, Digest]
"""Per sequence; under "" for rows without one."""


def digests_of(rows: pa.Table) -> Digests:
    """Per sequence: rows, and the sum of the hashes of their other columns."""
    with _database().cursor() as connection:
        connection.register("rows", rows)
        by = "coalesce(sequence, '')" if "sequence" in rows.column_names else "''"
        return _digests(connection, rows.column_names, by, "rows")


def staged_digests(folder: Path) -> Digests:
    """The same of a folder with a Parquet file per sequence, which is the process's working folder meanwhile."""
    names = pq.read_schema(next(folder.iterdir())).names
    with _database().cursor() as connection, contextlib.chdir(folder):
        return _digests(connection, names, "left(filename, -8)", "read_parquet('*.parquet', filename = true)")


def _digests(connection: duckdb.DuckDBPyConnection, names: Sequence[str], by: str, source: str) -> Digests:
    # Equal whole numbers hash alike whatever their width.
    listed = ", ".join(f'"{name}"' for name in names if name != "sequence")
    found = connection.execute(f"SELECT {by}, count(*), sum(hash({listed})) FROM {source} GROUP BY 1").fetchall()  # noqa: S608
    return {sequence: (rows, int(total)) for sequence, rows, total in found}


@functools.cache
def _database() -> duckdb.DuckDBPyConnection:
    """To open one takes longer than to hash most tables."""
    import duckdb

    return duckdb.connect(":memory:")


def add_digests(to: Digests, more: Mapping[str, Digest]) -> None:
    """Add the digests of further rows of a table."""
    for sequence, (rows, total) in more.items():
        before = to.get(sequence, (0, 0))
        to[sequence] = (before[0] + rows, before[1] + total)
