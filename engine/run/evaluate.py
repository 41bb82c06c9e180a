"""A run: a method asked many questions, with everything it did on record.

    runs/<run_id>/run.json            what was asked, of whom, how; written first
    runs/<run_id>/journal.jsonl       one line per finished question, synced as it finishes
    runs/<run_id>/calls.jsonl         model calls that finished cleanly
    runs/<run_id>/predictions.parquet, steps.parquet, world.parquet   written from the journal at the end

A run killed at any point loses nothing that is in the journal; resumed, it asks what is not, and what ended in an
error. Only the public question tables and images are read here.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Final, get_args

import msgspec
import pyarrow as pa

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import ANSWER_TYPES, decode_answer, encode_answer
from jrdb_avr.schema.beliefs import Write
from jrdb_avr.schema.errors import AvrError, InputError, LockedError, StoreError
from jrdb_avr.schema.method import (
    GetPanorama,
    Method,
    Observation,
    Observe,
    Panorama,
    Prediction,
    Question,
    SequenceInfo,
    Status,
    Step,
    Task,
)
from jrdb_avr.schema.tables import QUESTIONS, RUNS

_STOP_S: Final = 1.0
"""Longest wait for the threads of a run that ends early."""

_SWITCH_S: Final = 0.05
"""Between the wake-ups of a thread that waits for the interpreter, which the others leave long before."""


class Finished(msgspec.Struct, frozen=True):
    """A line of the journal: a question's row of `predictions`, its rows of `steps` and of `world`, without run id."""

    question_id: str
    prediction: dict[str, Any]
    steps: list[dict[str, Any]]
    world: list[dict[str, Any]] = []

    @property
    def failed(self) -> bool:
        """Whether the question ended in an error, and is asked again when the run is resumed."""
        return bool(self.prediction["status"] == "error")


# Made at import: threads that meet a type first at the same time crash the decoder.
_FINISHED: Final = msgspec.json.Decoder(Finished)


def _row_type(table: str) -> type:
    """What a row of a table of `RUNS` may be, but for its run id."""
    fields = [field for field in RUNS[table] if field.name != "run_id"]
    kinds = [(f.name, _KINDS[f.type] | None if f.nullable else _KINDS[f.type]) for f in fields]
    return msgspec.defstruct(table, kinds, forbid_unknown_fields=True)


_KINDS: Final[dict[pa.DataType, Any]] = {
    pa.string(): str,
    pa.int32(): Annotated[int, msgspec.Meta(ge=-(2**31), le=2**31 - 1)],
    pa.int64(): Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)],
    # From there on not every whole number is one, and Arrow takes none.
    pa.float64(): Annotated[float, msgspec.Meta(gt=-(2.0**53), lt=2.0**53)],
    pa.bool_(): bool,
}
_STORABLE: Final = msgspec.json.Decoder(
    msgspec.defstruct(
        "Storable",
        [
            ("question_id", str),
            ("prediction", _row_type("predictions")),
            ("steps", list[_row_type("steps")]),  # type: ignore[misc]
            ("world", list[_row_type("world")], []),  # type: ignore[misc]
        ],
    )
)
"""Of lines of the journal that the tables can hold."""


# -- what is asked ----------------------------------------------------------------------------------------------------


def read_questions(store: Store) -> list[Question]:
    """The public questions, in the file's order. Raises StoreError where there are none or they are of another form."""
    rows = _public_rows(store, "questions")
    ids, modes = {row["question_id"] for row in rows}, {row["answer_mode"] for row in rows}
    if len(ids) < len(rows) or not modes <= set(ANSWER_TYPES):
        raise StoreError(f"{store.question_path('questions')} holds an unknown mode or an id twice: generate again")
    return [Question(**{**row, "choices": tuple(row["choices"])}) for row in rows]


def read_sequences(store: Store) -> dict[str, SequenceInfo]:
    """The public facts of each sequence, by name. Raises StoreError as `read_questions` does."""
    rows = _public_rows(store, "sequences")
    return {row["sequence"]: SequenceInfo(**{**row, "frames": tuple(row["frames"])}) for row in rows}


def _public_rows(store: Store, name: str) -> list[dict[str, Any]]:
    """The rows of a public table, with the columns of its schema and no nulls."""
    schema, table = QUESTIONS[name], store.questions(name)
    try:
        rows: list[dict[str, Any]] = table.select(schema.names).cast(schema).to_pylist()
    except (KeyError, ValueError, pa.ArrowException):
        raise StoreError(f"{store.question_path(name)} is of another version: generate again") from None
    return rows


def choose(questions: Sequence[Question], ids: Iterable[str] | None, limit: int | None) -> list[Question]:
    """The questions with these ids (None: all), at most `limit`. Raises InputError for an id that is not there."""
    chosen = list(questions)
    if ids is not None:
        by_id = {question.question_id: question for question in questions}
        wanted = list(dict.fromkeys(ids))
        unknown = [name for name in wanted if name not in by_id]
        if unknown:
            raise InputError(
                f"{len(unknown)} of {len(wanted)} question ids are not in the store, the first is {unknown[0][:40]!r}",
                field="question_id",
            )
        chosen = [by_id[name] for name in wanted]
    return chosen[:limit]


def with_images(questions: Sequence[Question], image_root: str | None) -> tuple[list[Question], dict[str, int]]:
    """The questions whose sequence has images, and how many of each other sequence were left out."""
    seen = {name: _has_images(image_root, name) for name in sorted({q.sequence for q in questions})}
    kept = [question for question in questions if seen[question.sequence]]
    out = {name: sum(q.sequence == name for q in questions) for name, found in seen.items() if not found}
    return kept, out


def is_of_sample(question: Question) -> bool:
    """Whether a question is about the synthetic world: the sample's writer begins every sequence's name so."""
    return question.sequence.startswith("sample-")


def _has_images(image_root: str | None, sequence: str) -> bool:
    if image_root is None:
        return False
    try:
        with os.scandir(Path(image_root) / sequence) as entries:
            return any(entry.name.endswith(".jpg") for entry in entries)
    except OSError:
        return False


# -- the journal ------------------------------------------------------------------------------------------------------


class Journal:
    """Finished questions on disk, in the order in which they finished; the last line of a question counts.

    Opening takes the file's lock (LockedError if another process runs this run) and drops a last line that a crash
    cut short. Raises StoreError where the file is damaged elsewhere or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Not buffered: what the disk did not take would be tried once more at the end.
            self._file = path.open("a+b", buffering=0)
        except OSError as error:
            raise StoreError(f"cannot write {path}: {error.strerror}; choose another --store") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise LockedError(
                f"{path.parent} is being run by another process: wait for it, or give another --run-id",
                holder=str(path),
            ) from None
        try:
            self.finished = self._replay()
        except BaseException:
            self._file.close()
            raise

    def _replay(self) -> dict[str, Finished]:
        self._file.seek(0)
        data = self._file.read()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            self._file.truncate(whole)
        found: dict[str, Finished] = {}
        for number, line in enumerate(data[:whole].splitlines(), 1):
            try:
                entry = _FINISHED.decode(line)
                _tables("", [entry])
            except (msgspec.DecodeError, UnicodeDecodeError, ValueError, TypeError, OverflowError, pa.ArrowException):
                raise StoreError(f"{self._path}, line {number}, is damaged: evaluate under another --run-id") from None
            found[entry.question_id] = entry
        return found

    def append(self, entry: Finished) -> None:
        """Add a finished question; returns when it is on disk."""
        line = msgspec.json.encode(entry) + b"\n"
        end = self._file.seek(0, os.SEEK_END)
        try:
            while line:
                line = line[self._file.write(line) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            # No part of a line is to stand before another. (At the end, opening drops it.)
            with contextlib.suppress(OSError):
                self._file.truncate(end)
            raise StoreError(f"cannot write {self._path}: {error.strerror}; then run again with --resume") from None
        self.finished[entry.question_id] = entry

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()


# -- asking -----------------------------------------------------------------------------------------------------------


class _Stopped(BaseException):
    """The run has ended while a question was being asked; no error of the method, and past its `except Exception`."""


def ask(
    method: Method,
    question: Question,
    sequence: SequenceInfo,
    look: Observe,
    show: GetPanorama,
    stopped: Callable[[], bool] = lambda: False,
) -> Finished:
    """Ask one question. Whatever the method raises, or returns that is no prediction, becomes an `error` with the
    reason.
    """
    steps: list[Step] = []
    writes: list[Write] = []
    looks: list[None] = []

    def observe(sequence: str, frame_index: int, angle_deg: float) -> Observation:
        go_on()
        observation = look(sequence, frame_index, angle_deg)
        looks.append(None)
        return observation

    def panorama(sequence: str, frame_index: int) -> Panorama:
        go_on()
        shown = show(sequence, frame_index)
        looks.append(None)
        return shown

    def record(step: Step) -> None:
        go_on()
        steps.append(step)

    def keep(write: Write) -> None:
        go_on()
        writes.append(write)

    def go_on() -> None:
        if stopped():
            raise _Stopped

    started = time.perf_counter()
    try:
        prediction = method.answer(Task(question, sequence, observe, panorama, record, keep))
        finished = _finished(question.question_id, prediction, steps, writes, time.perf_counter() - started)
        _check(finished, question)
    except Exception as error:
        reason = " ".join(str(error).split()).encode("utf-8", "backslashreplace").decode()
        kinds = [step.kind for step in steps if isinstance(step, Step) and isinstance(step.kind, str)]
        prediction = Prediction(
            status="error",
            reason=reason if isinstance(error, AvrError) else f"{type(error).__name__}: {reason}",
            n_observations=len(looks),
            n_model_calls=kinds.count("model"),
        )
        seconds = time.perf_counter() - started
        try:
            finished = _finished(question.question_id, prediction, steps, writes, seconds)
            _check(finished, question)
        except Exception:
            # What was recorded is what cannot be kept.
            finished = _finished(question.question_id, prediction, [], [], seconds)
    return finished


def _check(entry: Finished, question: Question) -> None:
    """Raises ValueError for what a journal or the tables would not give back as it was: a method may be anybody's."""
    if entry.prediction["status"] not in get_args(Status):
        raise ValueError(f"{entry.prediction['status']!a} is no status of a prediction"[:120])
    if (answer := entry.prediction["answer"]) is not None:
        decode_answer(question.answer_mode, answer)
    _STORABLE.decode(msgspec.json.encode(entry))
    for value in (value for row in (entry.prediction, *entry.steps, *entry.world) for value in row.values()):
        # Others are written as texts.
        if not isinstance(value, str | int | float | None):
            raise ValueError(f"what the method returned or recorded holds a {type(value).__name__}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError("what the method returned or recorded holds a number that is none (NaN, infinity)")


def _finished(
    question_id: str, prediction: Prediction, steps: Sequence[Step], writes: Sequence[Write], seconds: float
) -> Finished:
    evidence = prediction.evidence
    box: Sequence[float | None] = (None,) * 4 if evidence is None else evidence.box
    row = {
        "question_id": question_id,
        "status": prediction.status,
        "answer": None if prediction.answer is None else encode_answer(prediction.answer),
        "evidence_frame": None if evidence is None else evidence.frame,
        **{f"evidence_{name}": value for name, value in zip("xywh", box, strict=True)},
        "raw": _storable(prediction.raw),
        "reason": _storable(prediction.reason),
        "n_observations": prediction.n_observations,
        "n_model_calls": prediction.n_model_calls,
        "prompt_tokens": prediction.prompt_tokens,
        "completion_tokens": prediction.completion_tokens,
        "seconds": seconds,
    }
    transcript = [
        {
            "question_id": question_id,
            "step": number,
            "kind": step.kind,
            "request": _storable(step.request),
            "response": _storable(step.response),
            "seconds": step.seconds,
        }
        for number, step in enumerate(steps)
    ]
    world = [
        {
            "question_id": question_id,
            "number": write.number,
            "step": write.step,
            "tool": write.tool,
            "arguments": _storable(write.arguments),
            "accepted": write.accepted,
            "reason": _storable(write.reason),
            "fact": _storable(write.fact),
        }
        for write in writes
    ]
    return Finished(question_id, row, transcript, world)


def _storable(text: str) -> str:
    """The text with what UTF-8 cannot hold (lone surrogates) written out."""
    return text.encode("utf-8", "backslashreplace").decode()


@contextlib.contextmanager
def _for_many_threads() -> Iterator[None]:
    import cv2

    pool, interval = cv2.getNumThreads(), sys.getswitchinterval()
    # Its pool's threads go on spinning after each small piece of work, and the questions in flight are threads enough.
    cv2.setNumThreads(1)
    sys.setswitchinterval(_SWITCH_S)
    try:
        yield
    finally:
        cv2.setNumThreads(pool)
        sys.setswitchinterval(interval)


@_for_many_threads()
def ask_all(
    method: Method,
    questions: Sequence[Question],
    sequences: Mapping[str, SequenceInfo],
    observe: Observe,
    panorama: GetPanorama,
    journal: Journal,
    concurrency: int,
    advance: Callable[[int], None] = lambda steps: None,
) -> None:
    """Ask what the journal does not hold, or holds as an error; `concurrency` questions are in flight at a time.

    The threads are daemons and one thread writes: an interrupt ends the process within seconds, and loses only what is
    in flight.
    """
    waiting: queue.SimpleQueue[Question] = queue.SimpleQueue()
    done: queue.SimpleQueue[Finished | BaseException] = queue.SimpleQueue()
    held = {name for name, entry in journal.finished.items() if not entry.failed}
    due = [question for question in questions if question.question_id not in held]
    advance(len(questions) - len(due))
    for question in due:
        waiting.put(question)

    stop = threading.Event()

    def work() -> None:
        try:
            while not stop.is_set():
                question = waiting.get_nowait()
                done.put(ask(method, question, sequences[question.sequence], observe, panorama, stop.is_set))
        except (queue.Empty, _Stopped):
            return
        except BaseException as error:
            done.put(error)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(min(concurrency, len(due)))]
    for thread in threads:
        thread.start()
    try:
        for _ in due:
            entry = done.get()
            if isinstance(entry, BaseException):
                raise entry
            journal.append(entry)
            advance(1)
    finally:
        # A thread that is inside the image decoder when the interpreter ends would abort the process; one that waits
        # for a server would not, and is not waited for.
        stop.set()
        deadline = time.monotonic() + _STOP_S
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))


def write_tables(store: Store, run_id: str, entries: Iterable[Finished]) -> None:
    """Write a run's `predictions`, `steps` and `world`, sorted by question and step."""
    tables = _tables(run_id, sorted(entries, key=lambda entry: entry.question_id))
    # Predictions come last: where they are, the run is whole.
    for name in ("world", "steps", "predictions"):
        store.write_run(run_id, name, tables[name])


def world_rows(run_id: str, entries: Iterable[Finished]) -> pa.Table:
    """The rows of `world.parquet` that entries hold; those that ended in an error are left out, as asked again."""
    kept = [entry for entry in entries if not entry.failed]
    return _tables(run_id, sorted(kept, key=lambda entry: entry.question_id))["world"]


def _tables(run_id: str, entries: Sequence[Finished]) -> dict[str, pa.Table]:
    """The tables of entries. pyarrow's errors, ValueError and the like where one does not fit."""
    rows = {
        "predictions": [entry.prediction for entry in entries],
        "steps": [step for entry in entries for step in entry.steps],
        "world": [write for entry in entries for write in entry.world],
    }
    # The cast finds what the making of a table lets pass: a null where none may be.
    return {
        name: pa.Table.from_pylist([{"run_id": run_id, **row} for row in found], RUNS[name]).cast(RUNS[name])
        for name, found in rows.items()
    }
