"""The store on disk: its folders and its Parquet tables.

    STORE/
      annotations/<layer>/<sequence>.parquet    the label files as tables
      intervals/<kind>/<sequence>.parquet       intervals derived from annotations
      store.json                                the manifest, which `load` writes last
      graph.kuzu                                a graph of the intervals, which `load --rebuild` builds again
      questions/*.parquet                       questions, and the private tables with answers and evidence
      runs/<run_id>/                            manifest and tables of a run

Files are written atomically (`queries/files.py`), so that a reader sees either the old file or the new file.
"""

from __future__ import annotations

import base64
import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.queries.display import Displayed, Tables
from jrdb_avr.queries.files import file_hash, lock_file, write_atomic, write_bytes
from jrdb_avr.queries.graph.file import STORE_GRAPH
from jrdb_avr.queries.graph.guard import query_graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.keyframes import keyframe_values, queries_layer, stamp_statement
from jrdb_avr.queries.manifest import MANIFEST_NAME, Manifest, read_manifest, refuse_public
from jrdb_avr.queries.named import find_query
from jrdb_avr.queries.sql import query_tables
from jrdb_avr.schema.errors import InputError, LockedError, QueryError, StoreError, did_you_mean, warn
from jrdb_avr.schema.questions import DISJOINT_KEY, PROFILE_KEY
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.tables import ANNOTATIONS, GENERATION_KEY, INTERVALS, QUESTIONS, RUNS

ROW_GROUP: Final = 1 << 18
"""Maximum number of rows in a row group of a Parquet file."""

_PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


def is_plain_name(name: str) -> bool:
    """Return whether a name is safe as a file name: up to 100 letters, digits, '.', '-' and '_', without '..'."""
    return bool(_PLAIN_NAME.fullmatch(name)) and ".." not in name


def safe_sequence(name: str) -> str:
    """Return the given name of a sequence. Raises InputError if the name is not safe as a file name."""
    if not is_plain_name(name):
        raise InputError(f"{name!r} cannot be a sequence name: use letters, digits, '.', '_' and '-'", field="sequence")
    return name


def write_json(path: Path, value: msgspec.Struct) -> None:
    """Write a struct atomically as indented JSON with sorted keys. Raises StoreError if the file cannot be written."""
    write_bytes(path, msgspec.json.format(msgspec.json.encode(value, order="sorted"), indent=1))


class Store(Displayed):
    """Store in a folder. The constructor checks nothing. If nothing is loaded, `manifest()` raises StoreError."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    @classmethod
    def of(cls, store: Store | str | Path) -> Store:
        """Return the argument if it is a store already. Otherwise return the store at the given path."""
        return store if isinstance(store, Store) else cls(store)

    # -- paths ------------------------------------------------------------------------------------------------

    @property
    def graph_path(self) -> Path:
        """Path of the graph file."""
        return self.path / STORE_GRAPH

    def annotation_path(self, layer: str, sequence: str) -> Path:
        """Return the path of a sequence's annotation table for one layer."""
        return self.path / "annotations" / layer / f"{safe_sequence(sequence)}.parquet"

    def interval_path(self, kind: str, sequence: str) -> Path:
        """Return the path of a sequence's interval table for one kind of facts."""
        return self.path / "intervals" / kind / f"{safe_sequence(sequence)}.parquet"

    def question_path(self, table: str) -> Path:
        """Return the path of a table in `questions/`."""
        return self.path / "questions" / f"{table}.parquet"

    def run_path(self, run_id: str) -> Path:
        """Return the path of a run's folder. Raises InputError if the id is not safe as a file name."""
        if not is_plain_name(run_id):
            raise InputError(
                f"{run_id[:120]!r} cannot be a run id: use up to 100 letters, digits, '.', '_' and '-'", field="run_id"
            )
        return self.path / "runs" / run_id

    # -- tables -----------------------------------------------------------------------------------------------

    def write_annotation(self, layer: str, sequence: str, table: pa.Table) -> str:
        """Write a sequence's annotation table for one layer, and return the sha256 of the file."""
        return write_table(self.annotation_path(layer, sequence), table, ANNOTATIONS[layer])

    def write_interval(self, kind: str, sequence: str, table: pa.Table) -> str:
        """Write a sequence's interval table for one kind of facts, and return the sha256 of the file."""
        return write_table(self.interval_path(kind, sequence), table, INTERVALS[kind])

    def write_questions(self, name: str, table: pa.Table, metadata: dict[str, str]) -> str:
        """Write a table in `questions/`, and return the sha256 of the file."""
        return write_table(self.question_path(name), table, QUESTIONS[name], metadata)

    def write_run(self, run_id: str, name: str, table: pa.Table) -> str:
        """Write a table of a run, and return the sha256 of the file."""
        return write_table(self.run_path(run_id) / f"{name}.parquet", table, RUNS[name])

    def annotation(self, layer: str, sequence: str, columns: Sequence[str] | None = None) -> pa.Table:
        """Read an annotation table, or only the given columns. Raises StoreError if the file is missing or broken."""
        return read_table(self.annotation_path(layer, sequence), columns)

    def interval(self, kind: str, sequence: str, columns: Sequence[str] | None = None) -> pa.Table:
        """Read an interval table, or only the given columns. Raises StoreError if the file is missing or broken."""
        return read_table(self.interval_path(kind, sequence), columns)

    def facts(self, kind: str, sequence: str) -> pa.Table:
        """Return the rows of `intervals_<kind>`, then the rows of `intervals_possible_<kind>` (as not `certain`)."""
        labels, unwritten = (self.interval(name, sequence) for name in (kind, f"possible_{kind}"))
        unwritten = unwritten.append_column("certain", pa.repeat(pa.scalar(False), unwritten.num_rows))
        return pa.concat_tables([labels, unwritten], promote_options="default")

    def questions(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a table in `questions/`, or only given columns. Raises StoreError if the file is missing or broken."""
        path = self.question_path(name)
        if not path.exists():
            self.manifest()  # If nothing is loaded, this error is more useful.
            export = f"jrdb-avr export RUN --jsonl FILE --store {self.path}"
            refuse_public(self.path, f"answers: run '{export}', then 'score --jsonl FILE' on the store with answers")
            raise StoreError(f"{self.path} has no questions yet: run 'jrdb-avr generate --store {self.path}'")
        return read_table(path, columns)

    def question_tables(self, *names: str, columns: Mapping[str, Sequence[str]] | None = None) -> list[pa.Table]:
        """Read several tables in `questions/`, and check that the same run of `generate` wrote them.

        Args:
            names: Names of the tables.
            columns: Columns to read, by the name of the table. If a table has no entry, all its columns are read.

        Raises:
            StoreError: If a table is missing or broken, or the tables come from different runs of `generate`.
        """
        tables = [self.questions(name, (columns or {}).get(name)) for name in names]
        if len({(table.schema.metadata or {}).get(GENERATION_KEY.encode()) for table in tables}) > 1:
            raise StoreError(
                f"{self.path / 'questions'}: {', '.join(names)} are of different generations: "
                f"run 'jrdb-avr generate --store {self.path}'"
            )
        return tables

    def training_set(self) -> dict[str, str]:
        """Return a record of how the training set was made, or {} if the questions are a benchmark.

        The entry `profile` is the profile of `generate`. The entry `disjoint_from` is the generation id of the held-out
        questions that the training set avoids. Raises StoreError if the file of questions is missing or broken.
        """
        metadata = self.questions("questions", []).schema.metadata or {}
        keys = (PROFILE_KEY, DISJOINT_KEY)
        return {key: metadata[key.encode()].decode() for key in keys if key.encode() in metadata}

    def warn_of_training(self) -> None:
        """Issue an AvrWarning if the questions are a training set."""
        if record := self.training_set():
            apart = f", disjoint from generation {record[DISJOINT_KEY][:12]}" if record.get(DISJOINT_KEY) else ""
            warn(f"{self.path} holds a training set (profile {record[PROFILE_KEY]}{apart}), not a benchmark")

    def refuse_training(self) -> None:
        """Raise StoreError if the questions are a training set, which must not be published as a benchmark."""
        if self.training_set():
            raise StoreError(f"{self.path} holds a training set, not a benchmark: export the store of the benchmark")

    # -- the manifest -----------------------------------------------------------------------------------------

    def manifest(self) -> Manifest:
        """Read the manifest. Raises StoreError if nothing is loaded or the manifest is broken."""
        return read_manifest(self.path)

    def relative(self, folder: str) -> str:
        """Return the path of a folder. The path becomes relative to the store if the folder is inside the store."""
        root = self.path.resolve()
        return Path(folder).relative_to(root).as_posix() if Path(folder).is_relative_to(root) else folder

    def visibility(self) -> dict[str, str]:
        """Return the evidence for clear views by sequence: "attributes", "geometry" (of boxes) or "nothing"."""
        names = sorted(self.manifest().sequences)
        return {name: self.interval("sequence", name)["visibility"][0].as_py() for name in names}

    def without_occlusion(self) -> list[str]:
        """Return the sequences with 2D boxes but without degrees of occlusion that decide about clear views."""
        unclear = [name for name, evidence in self.visibility().items() if evidence != "attributes"]
        return [name for name in unclear if len(self.interval("sightings", name, ["frame"]))]

    def write_manifest(self, manifest: Manifest) -> None:
        """Write the manifest. A folder with a manifest is a store. Raises StoreError if the file cannot be written."""
        write_json(self.path / MANIFEST_NAME, manifest)

    # -- queries ----------------------------------------------------------------------------------------------

    def cypher(self, query: str, /, **params: Any) -> pa.Table:
        """Run a Cypher statement on the graph.

            store.cypher("who_is_where", sequence="gates-ai-lab-2019-02-08_0", seconds=10).to_pandas()

        Args:
            query: One statement that only reads, or the name of a query (`jrdb-avr cypher --list`).
            params: Values of the parameters.

        Returns:
            The rows that the statement returns.

        Raises:
            QueryError: If the statement is refused or fails.
            StoreError: If nothing is loaded, or the graph is missing or damaged.
        """
        return self.query("cypher", query, params)

    def sql(self, query: str, /, **params: Any) -> pa.Table:
        """Run a SQL statement on the Parquet tables.

        Args:
            query: One SELECT over the tables of docs/tables.md, or the name of a query (`jrdb-avr sql --list`).
            params: Values of the parameters.

        Returns:
            The rows that the statement selects.

        Raises:
            QueryError: If the statement is refused or fails.
            StoreError: If the folder does not exist, or its manifest is broken.
        """
        return self.query("sql", query, params)

    def query(
        self, language: Literal["cypher", "sql"], query: str, params: Mapping[str, Any], timeout_s: float = 60.0
    ) -> pa.Table:
        """Run a statement or a named query in the given language, and return the rows of the result.

        Raises QueryError if the statement is refused, fails, or is stopped because it takes longer than `timeout_s`.
        Raises StoreError if the store lacks what the statement reads.
        """
        statement, values = find_query(language, query, dict(params))
        if language == "sql":
            return query_tables(self.path, statement, values, timeout_s=timeout_s)
        name, loaded = values.get("sequence"), self.manifest().sequences
        if isinstance(name, str) and name not in loaded:
            raise QueryError(f"no sequence {name[:100]!r} is loaded{did_you_mean(name, loaded)}")
        if "sequence" in values and queries_layer(statement):
            values = self._keyframe_values(statement, values)
        return query_graph(self.graph_path, statement, values, timeout_s=timeout_s)

    def _keyframe_values(self, statement: str, values: dict[str, Any]) -> dict[str, Any]:
        """Return the values of the parameters of a statement that queries one sequence of the keyframe layer.

        Raises StoreError if the graph lacks the keyframe layer, or if the layer and the questions have different rules.
        """
        try:
            rows = query_graph(self.graph_path, stamp_statement()).to_pylist()
        except QueryError as error:
            if "Keyframes" not in str(error):
                raise
            rows = []
        layer = {row["sequence"]: row for row in rows}.get(values["sequence"])
        path = self.question_path("answers")
        questions = set(read_table(path, ["rules"])["rules"].to_pylist()) if path.exists() else set()
        if layer is None or questions - {layer["rules_hash"]}:
            what = (
                "has no keyframe layer" if layer is None else "has a keyframe layer of other rules than the questions"
            )
            options = " with the options that made the questions" if questions else ""
            raise StoreError(f"{self.graph_path} {what}: run 'jrdb-avr generate --store {self.path}'{options}")
        if unknown := sorted(values.keys() - parameters(statement) - {"sequence"}):
            raise QueryError(f"the statement has no parameter {unknown[0]}")
        values = keyframe_values(msgspec.json.decode(layer["rules"], type=Rules)) | values
        return {name: values[name] for name in parameters(statement) if name in values}

    # -- display ----------------------------------------------------------------------------------------------

    def _summary(self) -> str:
        if not (self.path / "store.json").exists():
            return f"{self.path}, nothing loaded"
        path, runs = self.question_path("questions"), len(list((self.path / "runs").glob("*/run.json")))
        try:
            questions = pq.read_metadata(path).num_rows if path.exists() else 0
            return f"{self.path}, {len(self.manifest().sequences)} sequences, {questions} questions, {runs} runs"
        except (StoreError, pa.ArrowException, OSError):
            # The display of an object must not fail.
            return f"{self.path}, damaged"

    def _tables(self) -> Tables:
        try:
            entries = self.manifest().sequences
        except StoreError:
            return {}
        rows = [{"sequence": name, "layers": ", ".join(entries[name].layers)} for name in sorted(entries)]
        return {"Sequences": rows}

    # -- one writer -------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def writing(self, what: str) -> Iterator[None]:
        """Hold the writer lock of the store inside a `with` block, so that only one process writes.

        Args:
            what: Name of the command. The error messages of other processes show this name.

        Raises:
            LockedError: If another process holds the lock.
            StoreError: If the folder cannot be written, or its file system has no locks.
        """
        lock = self.path / ".writing"
        try:
            # Labels give the answers back, so other users of the machine may read nothing of a new store.
            self.path.mkdir(0o700, parents=True, exist_ok=True)
            file = lock.open("a+")
        except OSError as error:
            raise StoreError(f"cannot write to {self.path}: {error.strerror}; choose another --store") from None
        with file:
            if not lock_file(file):
                file.seek(0)
                holder = file.read(200).strip() or "another process"
                raise LockedError(f"{self.path} is being written by {holder}: wait for it", holder=holder)
            file.truncate(0)
            file.write(f"'{what}', process {os.getpid()}")
            file.flush()
            yield


def write_table(path: Path, table: pa.Table, schema: pa.Schema, metadata: dict[str, str] | None = None) -> str:
    """Write a table to a Parquet file atomically. Columns that the schema lacks are left out.

    Dictionary columns are written as dictionaries, which takes half as long as writing plain texts. Readers of the file
    get plain texts. Equal tables with equal dictionaries give equal bytes.

    Args:
        path: File to write.
        table: Table with all columns of the schema, in any order.
        schema: Schema that readers of the file see.
        metadata: Texts to store in the metadata of the file, by key.

    Returns:
        The sha256 of the file, in hexadecimal digits.

    Raises:
        StoreError: If the file cannot be written.
    """
    table = table.select(schema.names)
    groups = (table.slice(start, ROW_GROUP) for start in range(0, table.num_rows, ROW_GROUP))
    return write_groups(path, groups, schema, metadata, with_numbered(schema, table))


def write_groups(
    path: Path,
    groups: Iterable[pa.Table],
    schema: pa.Schema,
    metadata: dict[str, str] | None = None,
    kinds: pa.Schema | None = None,
) -> str:
    """Write several tables to one Parquet file atomically, and return the sha256 of the file in hexadecimal digits.

    Each table becomes a row group. Only one table is in memory at a time. The file has the types of `kinds`, and
    readers get the types of `schema`. `write_table` describes the other arguments.
    """
    # Readers take the column types from this entry. Without the entry, readers would return dictionary columns.
    read_as = base64.b64encode(schema.with_metadata(metadata or None).serialize()).decode()

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(temporary, kinds or schema, store_schema=False, **_parquet_options(schema)) as writer:
            for group in groups:
                writer.write_table(group.select(schema.names).cast(kinds or schema).unify_dictionaries())
            writer.add_key_value_metadata({**(metadata or {}), "ARROW:schema": read_as})

    write_atomic(path, write)
    return file_hash(path)


def with_numbered(schema: pa.Schema, table: pa.Table) -> pa.Schema:
    """Return a copy of the schema, with the table's type for each column that is a dictionary column in the table."""
    kinds = [(field, table.schema.field(field.name).type) for field in schema]
    return pa.schema([field.with_type(kind) if pa.types.is_dictionary(kind) else field for field, kind in kinds])


def _parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """Return the options of the Parquet writer.

    The options disable dictionaries for floats and lists, and min/max statistics for all columns except integers.
    Readers need neither of them, and both together would take 20 % of the writing time.
    """
    measured = [field.name for field in schema if pa.types.is_floating(field.type) or pa.types.is_nested(field.type)]
    return {
        "compression": "zstd",
        "use_dictionary": [name for name in schema.names if name not in measured],
        "write_statistics": [field.name for field in schema if pa.types.is_integer(field.type)],
    }


def read_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a Parquet table, or only given columns. Raises StoreError if the file or a column is missing or broken."""
    with open_parquet(path) as file:
        # Check the columns here. Otherwise the result would lack the column, and the error would appear later.
        if lacking := set(columns or ()) - set(file.schema_arrow.names):
            raise pa.ArrowKeyError(f"it lacks the column {min(lacking)}")
        return file.read(columns)


@contextlib.contextmanager
def open_parquet(path: Path) -> Iterator[pq.ParquetFile]:
    """Yield an open Parquet file. Raise StoreError if the file is missing, or if it is broken when it is read."""
    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(f"cannot read {path}: {reason}; run the step that writes it again") from None
