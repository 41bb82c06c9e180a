"""What `cypher` and `sql` share: their options, named queries, and the four ways to print an Arrow table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from jrdb_avr.engine.console import json_option, pairs, print_json, print_rows
from jrdb_avr.schema.errors import QueryError

C = TypeVar("C", bound=Callable[..., Any])


def asking_options(function: C) -> C:
    """Add the arguments and options of a command that asks."""
    for decorate in (
        click.argument("query", required=False),
        click.option("--store", type=click.Path(file_okay=False, path_type=Path), help="Folder of the store."),
        click.option("--param", "params", multiple=True, metavar="NAME=VALUE", help="A parameter; JSON or text."),
        click.option("--timeout", type=click.FloatRange(0.1, 86_400), default=60.0, show_default=True, help="Seconds."),
        click.option("--list", "listing", is_flag=True, help="List the named queries."),
        click.option("--csv", "as_csv", is_flag=True, help="Print CSV."),
        json_option,
        click.option("--parquet", type=click.Path(dir_okay=False, path_type=Path), help="Write a Parquet file."),
    ):
        function = decorate(function)
    return function


def run_asking(
    language: str,
    ask: Callable[[Path, str, dict[str, Any], float], Any],
    store: Path | None,
    query: str | None,
    params: tuple[str, ...],
    timeout: float,
    listing: bool,
    as_csv: bool,
    as_json: bool,
    parquet: Path | None,
) -> None:
    """Answer `query`, a statement or a name, by `ask(store, statement, parameters, seconds)`, and print it."""
    from jrdb_avr.queries.named import find_query, named_queries

    if as_csv + as_json + (parquet is not None) > 1:
        raise click.UsageError("choose one of --csv, --json and --parquet")
    if listing:
        rows = [
            {"name": known.name, "answers": known.answers, "parameters": known.takes}
            for known in named_queries(language).values()
        ]
        print_json(rows) if as_json else print_rows(rows)
        return
    if query is None:
        raise click.UsageError("give a QUERY or the NAME of one (--list shows them)")
    try:
        "".join((query, *params)).encode()
    except UnicodeEncodeError:
        raise click.UsageError("QUERY and --param must be UTF-8 text") from None
    if store is None:
        raise click.UsageError("Missing option '--store'.")
    table = ask(store, *find_query(language, query, _parameters(params)), timeout)
    _print_table(table, as_csv, as_json, parquet)


def _parameters(params: tuple[str, ...]) -> dict[str, Any]:
    from jrdb_avr.queries.named import parse_value

    given = {}
    for name, value in pairs("--param", params).items():
        if not name.isidentifier():
            raise click.UsageError(f"--param {name}: not the name of a parameter")
        given[name] = parse_value(value)
    return given


def _print_table(table: Any, as_csv: bool, as_json: bool, parquet: Path | None) -> None:
    table = _unique_names(table)
    if parquet is not None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        from jrdb_avr.queries.store import write_atomic

        try:
            write_atomic(parquet, lambda temporary: pq.write_table(table, temporary))
        except pa.ArrowException as error:
            raise QueryError(f"Parquet does not hold this result ({error}): cast the column to text") from None
        click.echo(f"{table.num_rows} rows -> {parquet}", err=True)
    elif as_json:
        print_json(_rows(table))
    elif as_csv:
        click.echo(_csv(table), nl=False)
    else:
        print_rows(_rows(table), columns=table.column_names)


def _rows(table: Any) -> list[dict[str, Any]]:
    """The rows as Python values. Raises QueryError for times that Python cannot hold."""
    try:
        rows: list[dict[str, Any]] = table.to_pylist()
    except (OverflowError, ValueError) as error:
        raise QueryError(f"the result holds a time that cannot be printed ({error}): cast it to text") from None
    return rows


def _unique_names(table: Any) -> Any:
    """The table with repeated column names numbered: a row object holds each name once."""
    names: list[str] = []
    for name in table.column_names:
        fresh, number = name, 1
        while fresh in names:
            number += 1
            fresh = f"{name}_{number}"
        names.append(fresh)
    return table.rename_columns(names)


def _csv(table: Any) -> str:
    import csv
    import io

    import msgspec

    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(table.column_names)
    for row in _rows(table):
        writer.writerow(
            msgspec.json.encode(cell, enc_hook=str).decode() if isinstance(cell, list | dict) else cell
            for cell in row.values()
        )
    return out.getvalue()
