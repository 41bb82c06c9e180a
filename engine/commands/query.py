"""`jrdb-avr cypher` and `jrdb-avr sql`: run a statement or a named query, and print its rows."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import click
import msgspec

from jrdb_avr.engine.commands._options import FILE, json_option, pairs_option, store_option
from jrdb_avr.engine.console import print_json, print_rows
from jrdb_avr.schema.errors import QueryError

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store

_C = TypeVar("_C", bound=Callable[..., Any])
Language = Literal["cypher", "sql"]


def _query_options(function: _C) -> _C:
    """Add the argument and the options of a query."""
    for decorate in (
        click.argument("query", required=False),
        store_option(required=False),
        pairs_option("--param", "params", "A parameter; JSON or text."),
        click.option("--timeout", type=click.FloatRange(0.1, 86_400), default=60.0, show_default=True, help="Seconds."),
        click.option("--list", "listing", is_flag=True, help="List the named queries."),
        click.option("--csv", "as_csv", is_flag=True, help="Print CSV."),
        json_option,
        click.option("--parquet", type=FILE, help="Write a Parquet file."),
    ):
        function = decorate(function)
    return function


@click.command(
    epilog="Examples: jrdb-avr cypher who_is_where --store S --param sequence=gates-ai-lab-2019-02-08_0 "
    "--param frame=15   |   jrdb-avr cypher 'MATCH (p:Person) RETURN count(*) AS people' --store S --json"
)
@_query_options
def cypher(**options: Any) -> None:
    """Query the graph: QUERY is one reading Cypher statement, or the name of a saved query (see --list)."""
    _run("cypher", **options)


@click.command(
    epilog="Examples: jrdb-avr sql question_counts --store S   |   "
    "jrdb-avr sql 'SELECT run_id, avg(answer_score) FROM scores GROUP BY 1 ORDER BY 1' --store S --csv   |   "
    "jrdb-avr sql 'SHOW TABLES' --store S"
)
@_query_options
def sql(**options: Any) -> None:
    """Ask the Parquet tables: QUERY is one SELECT over the store's views, or the name of a saved query (see --list)."""
    _run("sql", **options)


def _run(
    language: Language, query: str | None, store: Store | None, params: list[tuple[str, str]], **options: Any
) -> None:
    from jrdb_avr.queries.named import named_queries, parse_value

    as_csv, as_json, parquet = options["as_csv"], options["as_json"], options["parquet"]
    if as_csv + as_json + (parquet is not None) > 1:
        raise click.UsageError("choose one of --csv, --json and --parquet")
    if options["listing"]:
        known = named_queries(language).values()
        rows = [{"name": own.name, "answers": own.answers, "parameters": own.takes} for own in known]
        print_rows(rows, as_json=as_json)
        return
    if query is None:
        raise click.UsageError("give a QUERY or the NAME of one (--list shows them)")
    try:
        "".join((query, *(text for pair in params for text in pair))).encode()
    except UnicodeEncodeError:
        raise click.UsageError("QUERY and --param must be UTF-8 text") from None
    if store is None:
        raise click.UsageError("Missing option '--store'.")
    for name, _ in params:
        if not name.isidentifier():
            raise click.UsageError(f"--param {name}: not the name of a parameter")
    values = {name: parse_value(text) for name, text in params}
    table = _unique_names(store.query(language, query, values, options["timeout"]))
    if parquet is not None:
        _write_parquet(table, parquet)
        return
    try:
        rows = table.to_pylist()
    except (OverflowError, ValueError) as error:
        raise QueryError(f"the result holds a time that cannot be printed ({error}): cast it to text") from None
    if as_json:
        print_json(rows)
    elif as_csv:
        click.echo(_csv(rows, table.column_names), nl=False)
    else:
        print_rows(rows, columns=table.column_names)


def _unique_names(table: Any) -> Any:
    """The table with repeated column names numbered: a row object holds each name once."""
    names: list[str] = []
    for name in table.column_names:
        numbered = (f"{name}_{number}" for number in itertools.count(2))
        names.append(next(own for own in itertools.chain([name], numbered) if own not in names))
    return table.rename_columns(names)


def _write_parquet(table: Any, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from jrdb_avr.queries.store import write_atomic

    try:
        write_atomic(path, lambda temporary: pq.write_table(table, temporary))
    except pa.ArrowException as error:
        raise QueryError(f"Parquet does not hold this result ({error}): cast the column to text") from None
    click.echo(f"{table.num_rows} rows -> {path}", err=True)


def _csv(rows: list[dict[str, Any]], columns: list[str]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow(
            msgspec.json.encode(cell, enc_hook=str).decode() if isinstance(cell, list | dict) else cell
            for cell in row.values()
        )
    return out.getvalue()
