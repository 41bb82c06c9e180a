"""`jrdb-avr cypher` and `jrdb-avr sql`: run a statement or a saved query, and print the resulting rows."""

from __future__ import annotations

import itertools
import json
import re
import shlex
import sys
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import click

from jrdb_avr.engine.commands._complete import complete_query
from jrdb_avr.engine.commands._options import FILE, FOLDER, form_option, given, pairs_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_data, print_rows
from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.schema.errors import InputError, QueryError

if TYPE_CHECKING:
    from jrdb_avr.engine.validate.explain import ProofQuery
    from jrdb_avr.queries.store import Store

Language = Literal["cypher", "sql"]

_LONGEST: Final = 1 << 20
"""Maximum bytes of a statement from a file or from standard input."""

_WIDTH: Final = 80
"""Maximum characters of a printed line. Words and JSON texts are not divided."""

_JSON_TEXT: Final = re.compile(r'"(?:\\.|[^"\\])*"')


def _query_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the argument QUERY and all options of `cypher` and `sql`."""
    for decorate in (
        click.argument("query", required=False, shell_complete=complete_query),
        store_option(required=False),
        pairs_option("--param", "params", "Value of the parameter $NAME, as JSON or plain text. May be repeated."),
        click.option(
            "--timeout", type=click.FloatRange(0.1, 86_400), default=60.0, show_default=True, help="Maximum seconds."
        ),
        click.option("--list", "listing", is_flag=True, help="List the saved queries with their parameters."),
        form_option,
        click.option("--parquet", type=FILE, help="Parquet file to write instead of printing the rows."),
        click.option(
            "--crops",
            type=FOLDER,
            help="Folder for a picture of each row and a contact sheet, if the rows name sequence, frame, and track or "
            "the box x, y, w, h. Values of --param fill missing columns.",
        ),
    ):
        function = decorate(function)
    return function


@click.command()
@_query_options
@click.option("--question", metavar="ID", help="Prove a question again, and print its statements with their rows.")
def cypher(question: str | None, **options: Any) -> None:
    """Query the graph of a store with Cypher.

    QUERY is one of these: a read-only statement, the name of a saved query (see --list), the path of a file FILE.cypher
    that holds a statement, or - to read a statement from standard input.

    With --question and no QUERY, the command proves a question of the store again. It prints each proof with the
    numbers of its statements. Then it prints each statement as a command to run, with the rows that it returns.

    Examples:
      jrdb-avr cypher --list
      jrdb-avr cypher --question 0098303b6414dec4 --store S
      jrdb-avr cypher who_is_where --store S --param sequence=NAME --param frame=15
      jrdb-avr cypher 'MATCH (p:Person) RETURN count(*) AS people' --store S --json
    """
    if question is None:
        _run("cypher", **options)
    elif options["query"] or options["params"] or options["listing"] or options["parquet"]:
        raise click.UsageError("--question goes with --store, --json and --csv only")
    else:
        _explain(options["store"], question, options["form"])


@click.command()
@_query_options
def sql(**options: Any) -> None:
    """Query the tables of a store with SQL.

    QUERY is one of these: a read-only statement, the name of a saved query (see --list), the path of a file FILE.sql
    that holds a statement, or - to read a statement from standard input. 'jrdb-avr schema tables' lists the tables.

    Examples:
      jrdb-avr sql 'SHOW TABLES' --store S
      jrdb-avr sql question_counts --store S
      jrdb-avr sql 'SELECT run_id, avg(answer_score) FROM scores GROUP BY 1' --store S
    """
    _run("sql", **options)


def _run(
    language: Language, query: str | None, store: Store | None, params: list[tuple[str, str]], **options: Any
) -> None:
    from jrdb_avr.queries.named import find_query, named_queries, parse_value

    form, parquet = options["form"], options["parquet"]
    if form and parquet is not None:
        raise click.UsageError("choose one of --csv, --json and --parquet")
    if options["listing"]:
        named = named_queries(language)
        rows = [{"name": name, "answers": query.answers, "parameters": query.takes} for name, query in named.items()]
        print_rows(rows, form=form)
        return
    if query is None:
        raise click.UsageError("give a QUERY, or the name of a saved query (see --list)")
    query = _statement(language, query)
    try:
        "".join((query, *(text for pair in params for text in pair))).encode()
    except UnicodeEncodeError:
        raise click.UsageError("QUERY and --param must be UTF-8 text") from None
    values = {name: parse_value(text) for name, text in params}
    table = _unique_names(given(store).query(language, query, values, options["timeout"]))
    if not table.num_rows and language == "cypher":
        _note_frame(given(store), find_query(language, query, values)[1])
    if parquet is not None:
        _write_parquet(table, parquet)
        return
    try:
        rows = table.to_pylist()
    except (OverflowError, ValueError) as error:
        raise QueryError(f"the result holds a time that cannot be printed ({error}): cast it to text") from None
    print_rows(rows, columns=table.column_names, form=form)
    if options["crops"] is not None:
        _write_crops(given(store), rows, values, options["crops"])


def _write_crops(store: Store, rows: list[dict[str, Any]], values: dict[str, Any], folder: Path) -> None:
    from jrdb_avr.engine.pages.crops import contact_sheet, crops_of_rows, png
    from jrdb_avr.queries.files import new_folder, write_bytes

    with new_folder(folder) as made:
        crops = dict(crops_of_rows(store, rows, values))
        for name, crop in [*crops.items(), ("sheet.png", contact_sheet([*crops.values()]))]:
            write_bytes(made / name, png(crop))
    note(f"wrote {folder}: {len(crops)} crops of {len(rows)} rows, and sheet.png")


def _note_frame(store: Store, values: Mapping[str, Any]) -> None:
    """Name the nearest frame that has labels of people, if a query about one frame has given no rows."""
    if {"sequence", "frame"} <= values.keys():
        frames = "SELECT frame FROM intervals_sightings WHERE sequence = $sequence"
        asked = {name: values[name] for name in ("sequence", "frame")}
        nearest = store.sql(f"{frames} ORDER BY abs(frame - $frame), frame LIMIT 1", **asked)["frame"].to_pylist()
        if nearest and nearest != [asked["frame"]]:
            note(f"frame {asked['frame']} has no labels of people: give the nearest, --param frame={nearest[0]}")


def _explain(store: Store | None, question: str, form: RowFormat) -> None:
    from jrdb_avr.engine.validate.explain import explain

    explanation = explain(given(store), question)
    if form:
        print_data(explanation.rows(), form)
    else:
        record = explanation.record
        proofs = [
            {"proof": f"{proof.kind} {proof.variant}", "outcome": proof.outcome, "holds": proof.holds}
            | {"answer": proof.answer, "statements": " ".join(map(str, ids))}
            for proof, ids in explanation.proofs
        ]
        print_rows(proofs, "\n".join([_fold(record.question), *record.choices, f"Answer: {record.answer_text}"]))
        for statement in explanation.statements:
            print_rows(statement.rows, _to_text(statement, explanation.store))


def _to_text(statement: ProofQuery, store: Path) -> str:
    """Return the comments of a statement, and the shell command that runs it on a store."""
    comments, lines = re.findall(r"(?m)^// *(.+)", statement.cypher), re.findall(r"(?m)^(?!//).+", statement.cypher)
    parts = [f"jrdb-avr cypher --store {shlex.quote(str(store))}"]
    parts += [
        _fold(f"--param {shlex.quote(f'{name}={json.dumps(value)}')}") for name, value in statement.params.items()
    ]
    # Double quotes of texts need no escapes in the shell.
    parts.append(shlex.quote("\n".join(_fold(line.replace("'", '"')) for line in lines)))
    title = f"\nStatement {statement.id}: {statement.name}\n{_fold(' '.join(comments))}"
    return f"{title}\n\n" + " \\\n".join(parts) + ("\n" if statement.rows else "\n\n(no rows)")


def _fold(text: str) -> str:
    """Divide a long line at spaces outside of JSON texts. Each line leaves room for a space and a backslash."""
    guarded = _JSON_TEXT.sub(lambda quoted: quoted[0].replace(" ", "\0"), text)
    lines = textwrap.wrap(guarded, _WIDTH - 2, break_long_words=False, break_on_hyphens=False)
    return "\n".join(lines).replace("\0", " ")


def _statement(language: Language, query: str) -> str:
    """Return QUERY. If QUERY is the path of a file or "-", return the content of the file or of standard input instead.

    Raise InputError if the content cannot be read.
    """
    if query != "-" and not re.fullmatch(rf"/dev/\S+|\S+\.{language}", query):
        return query
    try:
        text = sys.stdin.buffer.read(_LONGEST + 1) if query == "-" else read_input(Path(query))
        if len(text) > _LONGEST:
            raise InputError(f"{query} is no statement: it is longer than {_LONGEST:,} bytes", file=query)
        return to_utf8(text, Path(query)).decode()
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {query}: {getattr(error, 'strerror', None) or error}", file=query) from None


def _unique_names(table: Any) -> Any:
    """Append numbers to repeated column names, because a row is a dictionary and holds each name once."""
    names: list[str] = []
    for name in table.column_names:
        numbered = (f"{name}_{count}" for count in itertools.count(2))
        names.append(next(candidate for candidate in itertools.chain([name], numbered) if candidate not in names))
    return table.rename_columns(names)


def _write_parquet(table: Any, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from jrdb_avr.queries.files import write_atomic

    try:
        write_atomic(path, lambda temporary: pq.write_table(table, temporary))
    except pa.ArrowException as error:
        raise QueryError(f"Parquet does not hold this result ({error}): cast the column to text") from None
    click.echo(f"{table.num_rows} rows -> {path}", err=True)
