"""Publish the tables: selected candidates as questions, with their private tables.

All tables of one generation carry the same mark, a hash of the questions and answers, in their Parquet metadata. They
are written to temporary files first. Then they are moved in one after the other, the questions last. After a crash in
between, the marks differ, so that the tables do not belong together, and generating again completes them.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.selection import with_choices
from jrdb_avr.queries.store import Store, write_groups
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS

PUBLISHED: Final = ("evidence", "answers", "rejected", "sequences", "questions")
"""The tables of a generation in the order in which they are moved in; `questions` last, it makes them valid."""

QUESTION_GROUP: Final = 1 << 12
"""Number of questions in a row group of a table. Each takes some kilobytes with its proofs."""


class Chosen:
    """The chosen questions of a generation, in the order of their ids. Their rows are made when they are read."""

    def __init__(self, pool: pa.Table, chosen: pa.Table) -> None:
        """Order the questions.

        Args:
            pool: Candidates in the columns of `selection.POOL`.
            chosen: Chosen candidates with the columns `row` (of the pool), `set`, `template`, `sequence` and
                `target_track`.
        """
        self._pool = pool
        slices = (chosen.slice(first, QUESTION_GROUP) for first in range(0, len(chosen), QUESTION_GROUP))
        ids = [row["question_id"] for part in slices for row in with_choices(pool, part)]
        self._chosen = chosen.append_column("question_id", pa.array(ids, pa.string())).sort_by("question_id")

    def tables(self, name: str) -> Iterator[pa.Table]:
        """Yield the row groups of the table `questions` or `answers`."""
        for first in range(0, len(self._chosen), QUESTION_GROUP):
            yield self._table(name, self._chosen.slice(first, QUESTION_GROUP))

    def digest(self) -> str:
        """Return a hash of all questions and answers, which marks their generation."""
        digest = hashlib.sha256()
        for name in ("questions", "answers"):
            rows = (row for group in self.tables(name) for row in group.to_pylist())
            digest.update(b"[")
            for place, row in enumerate(rows):
                digest.update(b"," * (place > 0) + msgspec.json.encode(row, order="sorted"))
            digest.update(b"]")
        return digest.hexdigest()

    def by_template(self, columns: Sequence[str]) -> Iterator[tuple[pa.Table, pa.Table]]:
        """Yield the questions of each template in the order of the names, with these columns of their answers."""
        for template in sorted(set(self._chosen["template"].to_pylist())):
            rows = self._chosen.filter(pc.equal(self._chosen["template"], template))
            yield self._table("questions", rows), self._table("answers", rows).select(columns)

    def evidence(self, store: Store) -> Iterator[pa.Table]:
        """Yield the evidence as a row group per sequence: every box of the questions' targets, by track and frame."""
        names = QUESTIONS["evidence"].names
        for sequence in sorted(set(self._chosen["sequence"].to_pylist())):
            sightings = store.interval("sightings", sequence, names)
            rows = self._chosen.filter(pc.equal(self._chosen["sequence"], sequence))
            targets = rows["target_track"].combine_chunks().cast(sightings.schema.field("track").type)
            boxes = sightings.filter(pc.is_in(sightings["track"], value_set=targets))
            yield boxes.sort_by([("track", "ascending"), ("frame", "ascending")]).cast(QUESTIONS["evidence"])

    def _table(self, name: str, chosen: pa.Table) -> pa.Table:
        schema = QUESTIONS[name]
        rows = with_choices(self._pool, chosen)
        return pa.Table.from_pylist([{column: row[column] for column in schema.names} for row in rows], schema=schema)


def publish(
    store: Store, chosen: Chosen, tables: Mapping[str, pa.Table], training: Mapping[str, str] | None = None
) -> None:
    """Write the tables of a generation so that they are complete, or known to be incomplete. Under the writer lock.

    Args:
        store: Store.
        chosen: Chosen questions.
        tables: All other tables by name, but for the evidence, which follows from the questions.
        training: Metadata of a training set in place of the canary.

    Raises:
        StoreError: If a file cannot be written.
    """
    folder = store.question_path("questions").parent
    pending = folder / ".pending"
    try:
        # A killed run may have left files.
        shutil.rmtree(pending, ignore_errors=True)
        metadata = {**(training or {"canary": CANARY}), GENERATION_KEY: chosen.digest()}
        groups: dict[str, Iterable[pa.Table]] = {name: chosen.tables(name) for name in ("questions", "answers")}
        groups |= {name: [table] for name, table in tables.items()} | {"evidence": chosen.evidence(store)}
        for name, parts in groups.items():
            write_groups(pending / f"{name}.parquet", parts, QUESTIONS[name], metadata)
        _move_in(pending, folder)
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror}; free some space and generate again") from None
    finally:
        shutil.rmtree(pending, ignore_errors=True)


def _move_in(pending: Path, folder: Path) -> None:
    """Move the files of a generation into their places."""
    for name in PUBLISHED:
        (pending / f"{name}.parquet").replace(folder / f"{name}.parquet")
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
