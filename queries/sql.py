"""Read-only SQL statements on the Parquet files of a store. DuckDB runs the statements on one view per table.

There are views for all annotation tables (`annotations_<layer>`), interval tables (`intervals_<kind>`) and tables of
`questions/`. The view `runs` has a row for each run, and each table of the runs has one view with the rows of all runs.
`JOINED` defines further views. If a table has not been written yet, its view is empty. A statement can open only the
files of these views.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from jrdb_avr.queries.graph.parameters import unwrap_scalar
from jrdb_avr.queries.manifest import MANIFEST_NAME, read_manifest
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.errors import QueryError, StoreError
from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS, QUESTIONS, RUNS

_TIMEOUT_S: Final = 60.0

JOINED: Final[dict[str, str]] = {
    "sightings_keypoints": (
        "SELECT s.*, p.keypoints FROM intervals_sightings s"
        " LEFT JOIN annotations_poses p USING (sequence, frame, track)"
    )
}
"""Statements of the views that join two tables, by the name of the view.

`sightings_keypoints` adds the key points to the sightings. The graph does not contain key points, because they are 51
numbers per person and frame and would take two thirds of the graph file.
"""


_RUN_COLUMNS: Final = ", ".join(f"{name}: '{'BOOL' if name == 'synthetic' else 'TEXT'}'" for name in RUNS["runs"].names)


def views(folder: Path, runs: Collection[str] | None = None) -> Iterator[tuple[str, pa.Schema, list[Path]]]:
    """Yield each view of a store's tables with the files of the view.

    The manifest says which files of annotations and intervals there are. So a missing file causes an error. Otherwise
    the view would have fewer rows without a warning.

    Args:
        folder: Folder of the store.
        runs: Ids of the runs to include, or None for all runs.

    Yields:
        The name of the view, its schema, and its files in alphabetical order.

    Raises:
        StoreError: If the manifest is broken or has another version.
    """
    listed: dict[Path, list[Path]] = {}
    if loaded := (folder / MANIFEST_NAME).exists():
        entries = read_manifest(folder).sequences.values()
        for path in sorted(folder / path for entry in entries for path in entry.tables):
            listed.setdefault(path.parent, []).append(path)
    for part, tables in (("annotations", ANNOTATIONS), ("intervals", INTERVALS)):
        for name, schema in tables.items():
            files_in = folder / part / name
            yield f"{part}_{name}", schema, listed.get(files_in, []) if loaded else sorted(files_in.glob("*.parquet"))
    for name, schema in QUESTIONS.items():
        yield name, schema, sorted((folder / "questions").glob(f"{name}.parquet"))
    for name, schema in RUNS.items():
        files = sorted((folder / "runs").glob("*/run.json" if name == "runs" else f"*/{name}.parquet"))
        yield name, schema, [path for path in files if runs is None or path.parent.name in runs]


def query_tables(
    folder: Path,
    sql: str,
    params: Mapping[str, Any] | None = None,
    *,
    timeout_s: float = _TIMEOUT_S,
    tables: Mapping[str, pa.Table] | None = None,
) -> pa.Table:
    """Run one SELECT statement over the views of a store.

    Args:
        folder: Folder of the store.
        sql: Statement. `$name` stands for the value of the parameter `name`.
        params: Values of the parameters, by name.
        timeout_s: Maximum time in seconds, after which the statement is stopped.
        tables: Tables in memory that the statement can also read, by name. A table replaces the view of the same name.

    Returns:
        The rows that the statement selects.

    Raises:
        StoreError: If the folder does not exist, or its manifest is broken.
        QueryError: If the statement is not a SELECT, fails, or takes longer than `timeout_s`.
    """
    with open_tables(folder, tables) as select:
        return select(sql, params, timeout_s)


@contextlib.contextmanager
def open_tables(folder: Path, tables: Mapping[str, pa.Table] | None = None) -> Iterator[Callable[..., pa.Table]]:
    """Create the views of a store once, and yield a function that runs several SELECT statements over them.

    Several calls of `query_tables` would take longer, because each call creates the views again.

    Args:
        folder: Folder of the store.
        tables: Tables in memory that statements can also read, by name. A table replaces the view of the same name. If
            a table is called `scores`, the views of runs contain only those runs that this table contains.

    Yields:
        A function that runs one statement. It takes the arguments `sql`, `params` and `timeout_s` of `query_tables`,
        returns the selected rows, and raises the same QueryError as `query_tables`.

    Raises:
        StoreError: If the folder does not exist, or its manifest is broken.
    """
    import duckdb

    if not folder.is_dir():
        raise StoreError(f"{folder} is not a store: run 'jrdb-avr load ROOT --store {folder}' first")
    with duckdb.connect(":memory:") as connection:
        broken = _make_views(connection, folder, tables or {})
        connection.execute(read_statement("lock_down.sql"))

        def select(sql: str, params: Mapping[str, Any] | None = None, timeout_s: float = _TIMEOUT_S) -> pa.Table:
            try:
                sql.encode()
            except UnicodeEncodeError:
                raise QueryError("the statement is not UTF-8 text") from None
            timer = threading.Timer(timeout_s, connection.interrupt)
            timer.daemon = True
            timer.start()
            try:
                statements = connection.extract_statements(sql)
                if [statement.type for statement in statements] != [duckdb.StatementType.SELECT]:
                    raise QueryError("only one SELECT is allowed: statements that write, load or attach are refused")
                # Use `sql`, because its result is converted to Arrow without a second copy of the rows.
                values = {name: unwrap_scalar(value) for name, value in (params or {}).items()}
                return connection.sql(sql, params=values or None).to_arrow_table()
            except duckdb.InterruptException:
                raise QueryError(f"stopped after {timeout_s:g} s: narrow the statement, or raise the timeout") from None
            except duckdb.Error as error:
                message = " ".join(str(error).split())
                for name, reason in broken.items():
                    if f"Table with name {name} " in message:
                        message = reason
                raise QueryError(message if len(message) <= 300 else message[:297] + "...") from None
            finally:
                timer.cancel()
                # DuckDB reports a leak if the timer's thread still holds the connection when the program ends.
                timer.join()

        yield select


def _make_views(connection: Any, folder: Path, tables: Mapping[str, pa.Table]) -> dict[str, str]:
    """Create all views. Return a dictionary from the name of each view that could not be created to the reason."""
    import duckdb

    broken: dict[str, str] = {}
    allowed: list[str] = []

    def make(name: str, query: str, fault: str) -> None:
        try:
            connection.execute(f"CREATE VIEW {name} AS {query}")
        except duckdb.Error as error:
            broken[name] = f"{fault}: {' '.join(str(error).split())}"

    for name, table in tables.items():
        connection.register(name, table)
    runs = tables["scores"]["run_id"].unique().to_pylist() if "scores" in tables else None
    for name, schema, files in views(folder, runs):
        if name in tables:
            continue
        if files:
            paths = ["'" + str(path.resolve()).replace("'", "''") + "'" for path in files]
            allowed += paths
            listed = f"[{', '.join(paths)}]"
            kind = f"read_json({listed}, columns={{{_RUN_COLUMNS}}}" if name == "runs" else f"read_parquet({listed}"
            # DuckDB would otherwise replace a column by the value of a folder that is called `column=value`.
            query = f"SELECT * FROM {kind}, hive_partitioning=false)"  # noqa: S608
            make(name, query, f"cannot read the files of {name}")
        else:
            connection.register(name, schema.empty_table())
    for name, query in JOINED.items():
        if reason := next((reason for table, reason in broken.items() if table in query), ""):
            broken[name] = reason
        else:
            # The join fails if a Parquet file lacks one of the columns.
            make(name, query, f"cannot make {name}")
    connection.execute(f"SET allowed_paths = [{', '.join(allowed)}]")
    return broken
