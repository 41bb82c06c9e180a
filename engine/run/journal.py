"""Store each finished question of a run in a journal on disk, and write the tables of the run from the journal.

    runs/<run_id>/journal/<sequence>.jsonl    one line per finished question, on disk as soon as the question finishes
    runs/<run_id>/predictions.parquet, steps.parquet, world.parquet   written from the journal when the run ends

If a run is killed, its journal keeps all finished questions. The tables are sorted by sequence and question.
"""

from __future__ import annotations

import contextlib
import itertools
import operator
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, NamedTuple, get_args

import msgspec
import pyarrow as pa

from jrdb_avr.queries.files import lock_file, sync_folder
from jrdb_avr.queries.store import Store, read_table, safe_sequence, write_groups
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import encode_answer
from jrdb_avr.schema.beliefs import Write
from jrdb_avr.schema.errors import LockedError, StoreError
from jrdb_avr.schema.method import Prediction, Question, Status, Step, Verdict
from jrdb_avr.schema.tables import RUNS


class Finished(msgspec.Struct, frozen=True):
    """A line of the journal: the rows that a question has in `predictions`, `steps` and `world`, without the run id."""

    question_id: str
    prediction: dict[str, Any]
    steps: list[dict[str, Any]]
    world: list[dict[str, Any]] = []

    @property
    def failed(self) -> bool:
        """Whether the question ended in an error, so that a resumed run answers it again."""
        return self.prediction.get("status") == "error"


# This line runs at import, because msgspec crashes if several threads make a type's first decoder at the same time.
_FINISHED: Final = msgspec.json.Decoder(Finished)

_DAMAGE: Final = (msgspec.DecodeError, UnicodeDecodeError, ValueError, TypeError, OverflowError, pa.ArrowException)

_KINDS: Final[dict[pa.DataType, Any]] = {
    pa.string(): str,
    pa.int32(): Annotated[int, msgspec.Meta(ge=-(2**31), le=2**31 - 1)],
    pa.int64(): Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)],
    # From 2**53 on, a float cannot represent every whole number, and Arrow refuses such numbers.
    pa.float64(): Annotated[float, msgspec.Meta(gt=-(2.0**53), lt=2.0**53)],
    pa.bool_(): bool,
}


def _row_type(table: str) -> Any:
    """Return the msgspec type that checks rows of a table.

    Arrow alone would not refuse wrong types: it would turn 0.9 into 0, and True into 1.0.
    """
    fields = [field for field in RUNS[table] if field.name != "run_id"]
    kinds = [(f.name, _KINDS[f.type] | None if f.nullable else _KINDS[f.type]) for f in fields]
    return msgspec.defstruct(table, kinds, forbid_unknown_fields=True)


_LISTS: Final[Any] = [(table, list[_row_type(table)]) for table in ("steps", "world")]  # type: ignore[misc]
_STORABLE: Final = msgspec.json.Decoder(
    msgspec.defstruct("Storable", [("prediction", _row_type("predictions")), *_LISTS])
)


def finished_entry(
    question: Question, prediction: Prediction, steps: Sequence[Step], writes: Sequence[Write], seconds: float
) -> Finished:
    """Return the journal entry of a finished question.

    Args:
        question: The question.
        prediction: The prediction of the method.
        steps: The steps that the method recorded, in order.
        writes: The writes to the world model that the method recorded, in order.
        seconds: The time in seconds that the method took.

    Returns:
        The entry.

    Raises:
        ValueError: If the journal or a table would change a value, or cannot hold a value. Instead of ValueError, an
            error type of msgspec or Arrow may be raised.
    """
    evidence, answer = prediction.evidence, prediction.answer
    box: Sequence[float | None] = (None,) * 4 if evidence is None else evidence.box
    row = _row(
        "predictions",
        prediction,
        question_id=question.question_id,
        answer=None if answer is None else encode_answer(answer),
        evidence_frame=None if evidence is None else evidence.frame,
        seconds=seconds,
        **{f"evidence_{name}": value for name, value in zip("xywh", box, strict=True)},
    )
    transcript = [_row("steps", step, question_id=question.question_id, step=n) for n, step in enumerate(steps)]
    world = [_row("world", write, question_id=question.question_id) for write in writes]
    entry = Finished(question.question_id, row, transcript, world)
    _check(entry, question)
    return entry


def with_id(entry: Finished, question_id: str) -> Finished:
    """Return an entry with another id of its question, also in the rows and keys of its world model."""
    return _FINISHED.decode(msgspec.json.encode(entry).replace(entry.question_id.encode(), question_id.encode()))


def _check(entry: Finished, question: Question) -> None:
    """Raise ValueError or a msgspec error if an entry is invalid, or if storing would change the entry."""
    line, row = msgspec.json.encode(entry), entry.prediction
    _STORABLE.decode(line)
    if _FINISHED.decode(line) != entry:
        raise ValueError("the method returned or recorded a value that JSON cannot hold unchanged, such as NaN")
    for column, values in (("status", get_args(Status)), ("verdict", (None, *get_args(Verdict)))):
        if row[column] not in values:
            raise ValueError(f"{row[column]!a} is no {column} of a prediction"[:120])
    if row["answer"] is not None:
        decode_answer(question.answer_mode, row["answer"])


def _row(table: str, record: object, **given: Any) -> dict[str, Any]:
    """Return a row of a table of `RUNS` without the run id.

    The values of some columns are in `given`. The value of each other column is the attribute of `record` that has the
    name of the column.
    """
    names = [name for name in RUNS[table].names if name not in given and name != "run_id"]
    values = {name: getattr(record, name) for name in names}
    # UTF-8 cannot hold lone surrogates, so they are escaped in long texts. A later check refuses them in names.
    texts = {
        name: value.encode("utf-8", "backslashreplace").decode()
        for name, value in values.items()
        if isinstance(value, str) and name not in ("kind", "tool")
    }
    return {**given, **values, **texts}


def unanswered(questions: Iterable[Question], finished: Mapping[str, Finished]) -> list[Question]:
    """Return the questions that have not finished and those that ended in an error, in the given order."""
    return [question for question in questions if (entry := finished.get(question.question_id)) is None or entry.failed]


class LinePosition(NamedTuple):
    """Position of a line in a journal.

    Attributes:
        sequence: The sequence of the questions in the file that has the line.
        at: Offset of the line in this file, in bytes.
        size: Length of the line in bytes.
    """

    sequence: str
    at: int
    size: int


class KeptEntries(Mapping[str, Finished]):
    """Entries of a journal by question id. Each access reads an entry from disk, because entries may be large."""

    def __init__(
        self, folder: Path, positions: dict[str, LinePosition], aliases: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        """Store where the entries are.

        Args:
            folder: The folder of the journal.
            positions: The position of each question's line in the journal, by question id.
            aliases: Question ids by other ids, which give the same entries.
        """
        self._folder, self._positions, self._aliases = folder, positions, aliases

    def add(self, question_id: str, position: LinePosition) -> None:
        """Store the position of a question's line, in place of the position of an earlier line of this question."""
        self._positions[question_id] = position

    def of(self, question_ids: Iterable[str]) -> KeptEntries:
        """Return the entries of the given questions. Questions that have no entry are left out."""
        positions = self._positions
        return KeptEntries(self._folder, {name: positions[name] for name in question_ids if name in positions})

    def by_sequence(self) -> Iterator[list[str]]:
        """Yield one list of sorted question ids per sequence, in the order of the sequences' names."""
        ordered = sorted((position.sequence, name) for name, position in self._positions.items())
        for _, rows in itertools.groupby(ordered, operator.itemgetter(0)):
            yield [name for _, name in rows]

    def __getitem__(self, question_id: str) -> Finished:
        stored = question_id if question_id in self._positions else self._aliases.get(question_id, "")
        position = self._positions[stored]
        path = segment_path(self._folder, position.sequence)
        try:
            with path.open("rb") as file:
                return _FINISHED.decode(os.pread(file.fileno(), position.size, position.at))
        except (OSError, msgspec.DecodeError, UnicodeDecodeError):
            raise StoreError(f"{path} was changed while it was in use: run again with --resume") from None

    def __iter__(self) -> Iterator[str]:
        # A copy, because another thread may add an entry during the iteration.
        return iter(list(self._positions))

    def __len__(self) -> int:
        return len(self._positions)


def journal_folder(run: Path) -> Path:
    """Return the folder of the journal of a run."""
    return run / "journal"


def segment_path(folder: Path, sequence: str) -> Path:
    """Return the path of the journal file of a sequence."""
    return folder / f"{safe_sequence(sequence)}.jsonl"


def segments(folder: Path) -> list[Path]:
    """Return the paths of the journal's files, sorted."""
    return sorted(folder.glob("*.jsonl"))


@contextlib.contextmanager
def journal_lock(folder: Path, doing: str) -> Iterator[None]:
    """Hold the lock of a journal inside a `with` block.

    Args:
        folder: The folder of the journal.
        doing: Text that is appended to the message of the LockedError, such as advice to the user.

    Raises:
        LockedError: If another process holds the lock.
        OSError: If the folder does not exist.
        StoreError: If the file system has no locks.
    """
    path = folder / ".lock"
    with path.open("ab") as file:
        if not lock_file(file):
            raise LockedError(f"{folder.parent} is being run by another process: wait for it{doing}", holder=str(path))
        yield


class Journal(contextlib.ExitStack):
    """Journal of a run, with one file per sequence. Each file has one line per finished question.

    The question that finished first has the first line. If a question has several lines, the last line counts.
    """

    def __init__(
        self, folder: Path, sequence_of: Mapping[str, str], aliases: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        """Open the journal and take its lock. If the last line of a file was cut off by a crash, remove the line.

        Args:
            folder: The folder of the journal.
            sequence_of: The sequence of each question that may be added, by question id.
            aliases: Question ids by other ids, by which entries can also be read.

        Raises:
            LockedError: If another process holds the lock.
            StoreError: If a line other than a cut-off last line is damaged, or if the folder cannot be written.
        """
        super().__init__()
        self._folder, self._sequence_of, self._aliases = folder, sequence_of, aliases
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.enter_context(journal_lock(folder, ", or give another --run-id"))
        except OSError as error:
            raise StoreError(f"cannot write {folder}: {error.strerror}; choose another --store") from None
        try:
            self.finished = self._replay()
        except BaseException:
            self.close()
            raise

    def _replay(self) -> KeptEntries:
        positions: dict[str, LinePosition] = {}
        for path in segments(self._folder):
            whole = 0
            # Read line by line, because the file may be larger than memory.
            with path.open("rb") as lines:
                for line_number, line in enumerate(lines, 1):
                    if not line.endswith(b"\n"):
                        os.truncate(path, whole)
                        break
                    positions[_read_line(path, line_number, line)] = LinePosition(path.stem, whole, len(line))
                    whole += len(line)
        return KeptEntries(self._folder, positions, self._aliases)

    def append(self, entry: Finished) -> None:
        """Append the entry of a finished question, and return when it is on disk. Raise StoreError if writing fails."""
        line = msgspec.json.encode(entry) + b"\n"
        sequence, size = self._sequence_of[entry.question_id], len(line)
        path = segment_path(self._folder, sequence)
        try:
            exists = path.exists()
            # The file has no buffer. Otherwise, closing the file would try again to write the bytes that failed.
            with path.open("ab", buffering=0) as file:
                end = file.seek(0, os.SEEK_END)
                try:
                    while line:
                        line = line[file.write(line) :]
                    os.fsync(file.fileno())
                except OSError:
                    # Remove the partial line, because the next line would be appended to it. If the removal fails and
                    # the run ends here, the partial line is removed when the journal is opened again.
                    with contextlib.suppress(OSError):
                        file.truncate(end)
                    raise
            if not exists:
                sync_folder(self._folder)
        except OSError as error:
            raise StoreError(f"cannot write {path}: {error.strerror}; mend it, then run again with --resume") from None
        self.finished.add(entry.question_id, LinePosition(sequence, end, size))


def _read_line(path: Path, line_number: int, line: bytes) -> str:
    """Return the question id of a line of the journal.

    Raise StoreError if the line is damaged, or if its entry does not fit the tables of the run.
    """
    try:
        entry = _FINISHED.decode(line)
        for name in _TABLES:
            run_table("", name, [entry])
    except _DAMAGE:
        raise StoreError(f"{path}, line {line_number}, is damaged: evaluate under another --run-id") from None
    return entry.question_id


_TABLES: Final[dict[str, Callable[[Finished], list[dict[str, Any]]]]] = {
    # A question that is asked again begins a new world model.
    "world": lambda entry: [] if entry.failed else entry.world,
    "steps": lambda entry: entry.steps,
    "predictions": lambda entry: [entry.prediction],
}
"""Functions that return the rows of an entry in a table, by the name of the table."""

_GROUP: Final = 200
"""Maximum number of questions in a row group. The group's transcripts are in memory while it is written."""


def run_table(run_id: str, name: str, entries: Iterable[Finished]) -> pa.Table:
    """Make a table of a run from entries of its journal.

    Args:
        run_id: The id of the run.
        name: "predictions", "steps" or "world".
        entries: The entries. The rows of the table are in the order of the entries.

    Returns:
        The table.

    Raises:
        ValueError: If an entry does not fit the table. For some entries, Arrow raises an error of another type.
    """
    rows = [{"run_id": run_id, **row} for entry in entries for row in _TABLES[name](entry)]
    # `from_pylist` accepts a null in a column that must not have nulls. The cast refuses it.
    return pa.Table.from_pylist(rows, RUNS[name]).cast(RUNS[name])


def write_tables(store: Store, run_id: str, finished: KeptEntries) -> pa.Table:
    """Write the tables of a run, sorted by sequence, question and step.

    Each row group of a file holds at most `_GROUP` questions. The questions of a sequence are in one row group, unless
    the sequence has more than `_GROUP` questions.

    Args:
        store: The store.
        run_id: The id of the run.
        finished: The entries of the finished questions.

    Returns:
        The table `predictions`.
    """

    def groups(table: str) -> Iterator[pa.Table]:
        for names in _packed(finished.by_sequence()):
            group = run_table(run_id, table, (finished[name] for name in names))
            if group.num_rows:
                yield group

    # The predictions are written last, because a run that has predictions counts as complete.
    for table in ("world", "steps", "predictions"):
        path = store.run_path(run_id) / f"{table}.parquet"
        write_groups(path, groups(table), RUNS[table])
    return read_table(path)


def _packed(parts: Iterable[list[str]]) -> Iterator[list[str]]:
    """Yield groups of at most `_GROUP` questions.

    The questions of a list in `parts` are in one group, unless the list has more than `_GROUP` questions.
    """
    group: list[str] = []
    for part in parts:
        if len(group) + len(part) > _GROUP and group:
            yield group
            group = []
        group += part
        while len(group) > _GROUP:
            yield group[:_GROUP]
            group = group[_GROUP:]
    if group:
        yield group


def world_rows(run_id: str, finished: Mapping[str, Finished]) -> pa.Table:
    """Return the table `world` of a run, without the rows of questions that ended in an error."""
    return run_table(run_id, "world", (finished[name] for name in sorted(finished)))
