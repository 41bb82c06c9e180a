"""Publish the tables: selected candidates as questions, with their private tables.

All tables of one generation carry the same mark, a hash of the questions and answers, in their Parquet metadata. They
are written to temporary files first and then moved in one after the other, the questions last: after a crash in
between, the marks differ, so that the tables do not belong together, and generating again completes them.

The tables are in the order of the question ids, in which sequences lie mixed. So the questions are first appended to
scratch files, one sequence after the other, and then read back in that order, a row group at a time.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.store import Store, write_groups
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS

PUBLISHED: Final = ("evidence", "answers", "rejected", "sequences", "questions")
"""The tables of a generation in the order in which they are moved in; `questions` last, it makes them valid."""

QUESTION_GROUP: Final = 1 << 12
"""How many questions one row group of a table holds: each takes some kilobytes with its proofs."""


class _Records:
    """Records in a scratch file, numbered as they are added; memory holds where each one ends."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b")
        self._ends = array("q", [0])

    def add(self, record: bytes) -> None:
        self._file.write(record)
        self._ends.append(self._ends[-1] + len(record))

    def __getitem__(self, number: int) -> bytes:
        self._file.seek(self._ends[number])
        return self._file.read(self._ends[number + 1] - self._ends[number])

    def close(self) -> None:
        self._file.close()


class Chosen:
    """The chosen questions of a generation with all that is published of them, in scratch files of a folder."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self._records = {name: _Records(folder / f"{name}.records") for name in ("questions", "answers")}
        self._ids: list[str] = []
        self._numbers: dict[str, list[int]] = {}
        self._targets: dict[str, set[int]] = {}

    def add(self, sequence: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add the questions of one sequence."""
        for row in rows:
            self._targets.setdefault(sequence, set()).add(row["target_track"])
            for name in ("questions", "answers"):
                own = {column: row[column] for column in QUESTIONS[name].names}
                self._records[name].add(msgspec.json.encode(own, order="sorted"))
            self._numbers.setdefault(row["template"], []).append(len(self._ids))
            self._ids.append(row["question_id"])

    def digest(self) -> str:
        """A hash of all questions and answers, which marks their generation."""
        found, order = hashlib.sha256(), self._order(range(len(self._ids)))
        for name in ("questions", "answers"):
            found.update(b"[")
            for place, number in enumerate(order):
                found.update(b"," * (place > 0) + self._records[name][number])
            found.update(b"]")
        return found.hexdigest()

    def tables(self, name: str) -> Iterator[pa.Table]:
        """The row groups of `questions` or `answers`."""
        order = self._order(range(len(self._ids)))
        for start in range(0, len(order), QUESTION_GROUP):
            yield self._table(name, order[start : start + QUESTION_GROUP])

    def by_template(self, answers: Sequence[str]) -> Iterator[tuple[pa.Table, pa.Table]]:
        """The questions of each template, by its name, and these columns of their answers."""
        for _, numbers in sorted(self._numbers.items()):
            order = self._order(numbers)
            yield self._table("questions", order), self._table("answers", order, answers)

    def evidence(self, store: Store) -> Iterator[pa.Table]:
        """The evidence as a row group per sequence: every box of the questions' targets, by track and frame."""
        names = QUESTIONS["evidence"].names
        for sequence, tracks in sorted(self._targets.items()):
            sightings = store.interval("sightings", sequence, names)
            targets = pa.array(sorted(tracks), sightings.schema.field("track").type)
            boxes = sightings.filter(pc.is_in(sightings["track"], value_set=targets))
            yield boxes.sort_by([("track", "ascending"), ("frame", "ascending")]).cast(QUESTIONS["evidence"])

    def close(self) -> None:
        for records in self._records.values():
            records.close()

    def _order(self, numbers: Sequence[int]) -> list[int]:
        return sorted(numbers, key=self._ids.__getitem__)

    def _table(self, name: str, numbers: Sequence[int], columns: Sequence[str] | None = None) -> pa.Table:
        schema = pa.schema([field for field in QUESTIONS[name] if columns is None or field.name in columns])
        found = (msgspec.json.decode(self._records[name][number]) for number in numbers)
        return pa.Table.from_pylist([{column: row[column] for column in schema.names} for row in found], schema=schema)


def publish(
    store: Store,
    scratch: Path,
    questions: Iterable[tuple[str, Sequence[Mapping[str, Any]]]],
    tables: Mapping[str, Iterable[pa.Table]],
    training: Mapping[str, str] | None = None,
) -> Chosen:
    """Write the tables of a generation so that they are all there, or known to be incomplete. Under the writer lock.

    `questions` are the rows of both tables, each sequence with its own; `tables` the row groups of all other tables but
    the evidence, which follows from them. `training`: the metadata of a training set, which stand in place of the
    canary. `scratch` is a folder for the questions, which stay readable until they are closed.
    """
    folder = store.question_path("questions").parent
    pending = folder / ".pending"
    try:
        # Files of a killed run.
        shutil.rmtree(pending, ignore_errors=True)
        chosen = Chosen(scratch)
        for sequence, rows in questions:
            chosen.add(sequence, rows)
        metadata = {**(training or {"canary": CANARY}), GENERATION_KEY: chosen.digest()}
        written = {name: chosen.tables(name) for name in ("questions", "answers")} | dict(tables)
        written["evidence"] = chosen.evidence(store)
        for name, groups in written.items():
            write_groups(pending / f"{name}.parquet", groups, QUESTIONS[name], metadata)
        _move_in(pending, folder)
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror}; free some space and generate again") from None
    finally:
        shutil.rmtree(pending, ignore_errors=True)
    return chosen


def _move_in(pending: Path, folder: Path) -> None:
    """Move the files of a generation into their places."""
    for name in PUBLISHED:
        (pending / f"{name}.parquet").replace(folder / f"{name}.parquet")
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
