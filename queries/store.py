"""The store on disk: where everything lies, and the Parquet side of it.

    STORE/
      annotations/<layer>/<sequence>.parquet    the label files as tables
      intervals/<kind>/<sequence>.parquet       intervals derived from them
      store.json                                the manifest, written last
      graph.kuzu                                an index over the intervals, rebuildable
      questions/*.parquet, questions/evidence/<sequence>.parquet
      runs/<run_id>/

A file is written whole (`queries/files.py`), so a reader sees the old one or the new one.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import hashlib
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.queries.display import Displayed, Tables
from jrdb_avr.queries.files import write_atomic, write_bytes
from jrdb_avr.queries.graph.file import STORE_GRAPH
from jrdb_avr.queries.graph.guard import query_graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.keyframes import STAMP, keyframe_values
from jrdb_avr.queries.manifest import MANIFEST_NAME, Manifest, read_manifest
from jrdb_avr.queries.named import find_query
from jrdb_avr.queries.sql import query_tables
from jrdb_avr.schema.errors import AvrWarning, InputError, LockedError, QueryError, StoreError, did_you_mean
from jrdb_avr.schema.questions import DISJOINT_KEY, PROFILE_KEY
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.tables import ANNOTATIONS, GENERATION_KEY, INTERVALS, QUESTIONS, RUNS

ROW_GROUP: Final = 1 << 18

_PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


def is_plain_name(name: str) -> bool:
    """Whether a name can be a folder's or file's: letters, digits, dot, dash, underscore, and no way up."""
    return bool(_PLAIN_NAME.fullmatch(name)) and ".." not in name


def safe_sequence(name: str) -> str:
    """The name, if it can be a sequence's: letters, digits, dot, dash, underscore. Raises InputError otherwise."""
    if not is_plain_name(name):
        raise InputError(f"{name!r} cannot be a sequence name: use letters, digits, '.', '_' and '-'", field="sequence")
    return name


def write_json(path: Path, value: msgspec.Struct) -> None:
    """Write a record as JSON that people can read, keys sorted, as `write_atomic` does. Raises StoreError likewise."""
    write_bytes(path, msgspec.json.format(msgspec.json.encode(value, order="sorted"), indent=1))


class Store(Displayed):
    """A store folder. Opening it checks nothing; `manifest()` raises StoreError if nothing has been loaded."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    @classmethod
    def of(cls, store: Store | str | Path) -> Store:
        """The store itself, or the one at a path."""
        return store if isinstance(store, Store) else cls(store)

    # -- where things are -------------------------------------------------------------------------------------

    @property
    def graph_path(self) -> Path:
        return self.path / STORE_GRAPH

    def annotation_path(self, layer: str, sequence: str) -> Path:
        return self.path / "annotations" / layer / f"{safe_sequence(sequence)}.parquet"

    def interval_path(self, kind: str, sequence: str) -> Path:
        return self.path / "intervals" / kind / f"{safe_sequence(sequence)}.parquet"

    def question_path(self, table: str) -> Path:
        """The file of a table of `questions/`; of `evidence` the folder of its files."""
        return self.path / "questions" / (table if table == "evidence" else f"{table}.parquet")

    def evidence_path(self, sequence: str) -> Path:
        return self.question_path("evidence") / f"{safe_sequence(sequence)}.parquet"

    def run_path(self, run_id: str) -> Path:
        """The folder of a run. Raises InputError for an id that is no plain name."""
        if not is_plain_name(run_id):
            raise InputError(
                f"{run_id[:120]!r} cannot be a run id: use up to 100 letters, digits, '.', '_' and '-'", field="run_id"
            )
        return self.path / "runs" / run_id

    # -- tables -----------------------------------------------------------------------------------------------

    def write_annotation(self, layer: str, sequence: str, table: pa.Table) -> str:
        """Write one annotation table; returns the sha256 of the file."""
        return write_table(self.annotation_path(layer, sequence), table, ANNOTATIONS[layer])

    def write_interval(self, kind: str, sequence: str, table: pa.Table) -> str:
        """Write one interval table; returns the sha256 of the file."""
        return write_table(self.interval_path(kind, sequence), table, INTERVALS[kind])

    def write_questions(self, name: str, table: pa.Table, metadata: dict[str, str]) -> str:
        """Write one table of `questions/`; returns the sha256 of the file."""
        return write_table(self.question_path(name), table, QUESTIONS[name], metadata)

    def write_run(self, run_id: str, name: str, table: pa.Table) -> str:
        """Write one table of a run; returns the sha256 of the file."""
        return write_table(self.run_path(run_id) / f"{name}.parquet", table, RUNS[name])

    def annotation(self, layer: str, sequence: str, columns: Sequence[str] | None = None) -> pa.Table:
        return read_table(self.annotation_path(layer, sequence), columns)

    def interval(self, kind: str, sequence: str, columns: Sequence[str] | None = None) -> pa.Table:
        return read_table(self.interval_path(kind, sequence), columns)

    def facts(self, kind: str, sequence: str) -> pa.Table:
        """Return the written labels of one kind (`LABELED`) and, as rows that are not certain, the unwritten facts."""
        labels, unwritten = (self.interval(name, sequence) for name in (kind, f"possible_{kind}"))
        unwritten = unwritten.append_column("certain", pa.repeat(pa.scalar(False), unwritten.num_rows))
        return pa.concat_tables([labels, unwritten], promote_options="default")

    def questions(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """A question file. Raises StoreError where there is none yet, or nothing is loaded at all."""
        path = self.question_path(name)
        if not path.exists():
            self.manifest()  # A folder that is no store lacks more than questions.
            raise StoreError(f"{self.path} has no questions yet: run 'jrdb-avr generate --store {self.path}'")
        return read_table(path, columns)

    def question_tables(self, *names: str, columns: Mapping[str, Sequence[str]] | None = None) -> list[pa.Table]:
        """Question files of one generation, each with its `columns`, or all of them.

        Raises StoreError as `questions` does, and where they are of several generations.
        """
        tables = [self.questions(name, (columns or {}).get(name)) for name in names]
        self._check_generation(names, tables)
        return tables

    def evidence(self, sequence: str, questions: pa.Table) -> pa.Table:
        """The boxes of the targets of a sequence's questions, by question and frame.

        Raises StoreError where there is no such file, and where it is of another generation than `questions`, a table
        of `questions/`.
        """
        path = self.evidence_path(sequence)
        if not path.exists():
            raise StoreError(f"{path} is missing: run 'jrdb-avr generate --store {self.path}'")
        table = read_table(path)
        self._check_generation(("questions", f"evidence/{sequence}"), (questions, table))
        return table

    def _check_generation(self, names: Sequence[str], tables: Sequence[pa.Table]) -> None:
        if len({(table.schema.metadata or {}).get(GENERATION_KEY.encode()) for table in tables}) > 1:
            raise StoreError(
                f"{self.path / 'questions'}: {', '.join(names)} are of different generations: "
                f"run 'jrdb-avr generate --store {self.path}'"
            )

    def training_set(self) -> dict[str, str]:
        """What the questions record where they are a training set: `profile`, and the generation of the questions that
        they are `disjoint_from`. Empty for a benchmark. Raises StoreError where there are none, or they are broken."""
        metadata = self.questions("questions", []).schema.metadata or {}
        keys = (PROFILE_KEY, DISJOINT_KEY)
        return {key: metadata[key.encode()].decode() for key in keys if key.encode() in metadata}

    def warn_of_training(self) -> None:
        """Give an AvrWarning where the questions are a training set."""
        if about := self.training_set():
            away = f", disjoint from generation {about[DISJOINT_KEY][:12]}" if about.get(DISJOINT_KEY) else ""
            line = f"{self.path} holds a training set (profile {about[PROFILE_KEY]}{away}), not a benchmark"
            warnings.warn(line, AvrWarning, stacklevel=3)

    def refuse_training(self) -> None:
        """Raise StoreError where the questions are a training set, which must not be published as a benchmark."""
        if self.training_set():
            raise StoreError(f"{self.path} holds a training set, not a benchmark: export the store of the benchmark")

    # -- the manifest -----------------------------------------------------------------------------------------

    def manifest(self) -> Manifest:
        """Read the manifest. Raises StoreError as `read_manifest` does."""
        return read_manifest(self.path)

    def relative(self, folder: str) -> str:
        """Return the path from the store to a folder inside it; return any other folder as it is."""
        root = self.path.resolve()
        return Path(folder).relative_to(root).as_posix() if Path(folder).is_relative_to(root) else folder

    def without_occlusion(self) -> list[str]:
        """The sequences whose 2D boxes come without attributes, so that every box of legal size is a clear view."""
        return [
            name
            for name in sorted(self.manifest().sequences)
            if not self.interval("sequence", name)["has_attributes"][0].as_py()
            and len(self.interval("sightings", name, ["frame"]))
        ]

    def write_manifest(self, manifest: Manifest) -> None:
        """Write the manifest, which makes the folder a store. Raises StoreError if the disk refuses."""
        write_json(self.path / MANIFEST_NAME, manifest)

    # -- queries ----------------------------------------------------------------------------------------------

    def cypher(self, query: str, /, **params: Any) -> pa.Table:
        """Query the scene graph with one reading statement, or the name of a query in `queries/explore/`.

        Raises QueryError where the statement is refused or fails, StoreError where there is no graph.

            store.cypher("who_is_where", sequence="gates-ai-lab-2019-02-08_0", seconds=10).to_pandas()
        """
        return self.query("cypher", query, params)

    def sql(self, query: str, /, **params: Any) -> pa.Table:
        """Query the Parquet tables with one SELECT over the views of `queries/sql.py`, or the name of a query in
        `queries/results/`.

        Raises QueryError where the statement is refused or fails, StoreError where there is no store.
        """
        return self.query("sql", query, params)

    def query(
        self, language: Literal["cypher", "sql"], query: str, params: Mapping[str, Any], timeout_s: float = 60.0
    ) -> pa.Table:
        """Run a statement, or a named query, of either language. Raises QueryError also where it takes too long."""
        statement, values = find_query(language, query, dict(params))
        if language == "sql":
            return query_tables(self.path, statement, values, timeout_s=timeout_s)
        if not self.graph_path.exists():
            self.manifest()  # A folder that is no store lacks more than a graph.
        self._check_sequence(values.get("sequence"))
        if "low" in parameters(statement) and "sequence" in values:
            values = self._keyframe_values(statement, dict(params))
        return query_graph(self.graph_path, statement, values, timeout_s=timeout_s)

    def _keyframe_values(self, statement: str, values: dict[str, Any]) -> dict[str, Any]:
        """The parameters of a statement over the keyframe layer, of whose values `sequence` stands for a range of ids.

        Raises StoreError where the graph has no such layer, or one of other rules than the questions.
        """
        try:
            found = query_graph(self.graph_path, STAMP).to_pylist()
        except QueryError as error:
            if "Keyframes" not in str(error):
                raise
            found = []
        layer = {row["sequence"]: row for row in found}.get(values["sequence"])
        path = self.question_path("answers")
        questions = set(read_table(path, ["rules"])["rules"].to_pylist()) if path.exists() else set()
        if layer is None or questions - {layer["rules_hash"]}:
            what = (
                "has no keyframe layer" if layer is None else "has a keyframe layer of other rules than the questions"
            )
            way = "validate --replay" if questions else "generate"
            raise StoreError(f"{self.graph_path} {what}: run 'jrdb-avr {way} --store {self.path}'")
        if unknown := sorted(values.keys() - parameters(statement) - {"sequence"}):
            raise QueryError(f"the statement has no parameter {unknown[0]}")
        known = keyframe_values(msgspec.json.decode(layer["rules"], type=Rules), layer["low"]) | values
        return {name: known[name] for name in parameters(statement) if name in known}

    def _check_sequence(self, name: object) -> None:
        """Raises QueryError for a sequence that is not loaded, naming the nearest that is."""
        if isinstance(name, str) and (self.path / "store.json").exists() and name not in self.manifest().sequences:
            raise QueryError(f"no sequence {name[:100]!r} is loaded{did_you_mean(name, self.manifest().sequences)}")

    # -- display ----------------------------------------------------------------------------------------------

    def _summary(self) -> str:
        if not (self.path / "store.json").exists():
            return f"{self.path}, nothing loaded"
        path, runs = self.question_path("questions"), len(list((self.path / "runs").glob("*/run.json")))
        try:
            questions = pq.read_metadata(path).num_rows if path.exists() else 0
            return f"{self.path}, {len(self.manifest().sequences)} sequences, {questions} questions, {runs} runs"
        except (StoreError, pa.ArrowException, OSError):
            # To look at a result must not fail.
            return f"{self.path}, damaged"

    def _tables(self) -> Tables:
        try:
            known = self.manifest().sequences
        except StoreError:
            return {}
        return {"Sequences": [{"sequence": name, "layers": ", ".join(known[name].layers)} for name in sorted(known)]}

    # -- one writer -------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def writing(self, what: str) -> Iterator[None]:
        """Hold the store's writer lock. Raises LockedError, naming the holder, if another process has it."""
        lock = self.path / ".writing"
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            file = lock.open("a+")
        except OSError as error:
            raise StoreError(f"cannot write to {self.path}: {error.strerror}; choose another --store") from None
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.seek(0)
                holder = file.read(200).strip() or "another process"
                raise LockedError(f"{self.path} is being written by {holder}: wait for it", holder=holder) from None
            file.truncate(0)
            file.write(f"'{what}', process {os.getpid()}")
            file.flush()
            yield


def write_table(path: Path, table: pa.Table, schema: pa.Schema, metadata: dict[str, str] | None = None) -> str:
    """Write a table under a schema, atomically. Returns the sha256 of the file.

    Numbered texts (dictionaries) are written by their numbers, in half the time, and read as plain texts. Equal tables
    give equal bytes where their texts are numbered alike.
    """
    table = table.select(schema.names)
    groups = (table.slice(start, ROW_GROUP) for start in range(0, table.num_rows, ROW_GROUP))
    return _write(path, groups, schema, with_numbered(schema, table), metadata)


def write_groups(
    path: Path, groups: Iterable[pa.Table], schema: pa.Schema, metadata: dict[str, str] | None = None
) -> str:
    """Write tables as the row groups of one file, as `write_table` does; only one of them is in memory at a time."""
    return _write(path, groups, schema, schema, metadata)


def with_numbered(schema: pa.Schema, table: pa.Table) -> pa.Schema:
    """The schema with the types of those columns of a table that are numbered texts (dictionaries)."""
    kinds = [(field, table.schema.field(field.name).type) for field in schema]
    return pa.schema([field.with_type(kind) if pa.types.is_dictionary(kind) else field for field, kind in kinds])


def _write(
    path: Path, groups: Iterable[pa.Table], schema: pa.Schema, kinds: pa.Schema, metadata: dict[str, str] | None
) -> str:
    """Write row groups with the column types of `kinds` to a file that is read with those of `schema`."""
    # Readers take the types from this entry; without it they would find numbered texts.
    read_as = base64.b64encode(schema.with_metadata(metadata or None).serialize()).decode()

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(temporary, kinds, store_schema=False, **_written(schema)) as writer:
            for group in groups:
                writer.write_table(group.select(schema.names).cast(kinds).unify_dictionaries())
            writer.add_key_value_metadata({**(metadata or {}), "ARROW:schema": read_as})

    write_atomic(path, write)
    return file_hash(path)


def file_hash(path: Path) -> str:
    """The sha256 of a file, in hex. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _written(schema: pa.Schema) -> dict[str, Any]:
    """How columns are written. Few measurements are alike, and nobody looks for the least of all texts: numbering the
    ones and comparing the others took a fifth of the writing."""
    measured = [field.name for field in schema if pa.types.is_floating(field.type) or pa.types.is_nested(field.type)]
    return {
        "compression": "zstd",
        "use_dictionary": [name for name in schema.names if name not in measured],
        "write_statistics": [field.name for field in schema if pa.types.is_integer(field.type)],
    }


def read_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a Parquet table, or some of its columns. Raises StoreError naming the file if it is missing or broken."""
    with _parquet(path) as file:
        # The reader would silently leave out columns that the file does not have.
        if lacking := set(columns or ()) - set(file.schema_arrow.names):
            raise pa.ArrowKeyError(f"it lacks the column {min(lacking)}")
        return file.read(columns)


def read_rows(path: Path, column: str, value: str) -> pa.Table:
    """The rows of a Parquet table with a value in a column; of row groups without it that column alone is read.

    Raises StoreError as `read_table`.
    """
    with _parquet(path) as file:
        found = [file.schema_arrow.empty_table()]
        for number in range(file.num_row_groups):
            if pc.index(file.read_row_group(number, [column])[column], value).as_py() >= 0:
                group = file.read_row_group(number)
                found.append(group.filter(pc.equal(group[column], value)))
        return pa.concat_tables(found)


@contextlib.contextmanager
def _parquet(path: Path) -> Iterator[pq.ParquetFile]:
    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(f"cannot read {path}: {reason}; run the step that writes it again") from None
