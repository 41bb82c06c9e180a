"""Publish the tables: selected candidates as questions, with their private tables.

All tables of one generation carry the same mark, a hash of the questions and answers, in their Parquet metadata. They
are written to temporary files first. Then they are moved in one after the other, the questions last. After a crash in
between, the marks differ, so that the tables do not belong together, and generating again completes them.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Mapping
from typing import Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.files import sync_folder
from jrdb_avr.queries.store import Store, write_groups
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS

PUBLISHED: Final = ("evidence", "answers", "rejected", "sequences", "questions")
"""Tables of a generation, in the order of their moves. The table `questions` comes last and makes them valid."""

QUESTION_GROUP: Final = 1 << 12
"""Number of questions in a row group of a table. Each takes some kilobytes with its proofs."""


def _evidence(store: Store, questions: pa.Table) -> Iterator[pa.Table]:
    """Yield a row group per sequence: every box of the questions' targets, by track and frame."""
    names = QUESTIONS["evidence"].names
    for sequence in sorted(set(questions["sequence"].to_pylist())):
        sightings = store.interval("sightings", sequence, names)
        rows = questions.filter(pc.equal(questions["sequence"], sequence))
        targets = rows["target_track"].combine_chunks().cast(sightings.schema.field("track").type)
        boxes = sightings.filter(pc.is_in(sightings["track"], value_set=targets))
        yield boxes.sort_by([("track", "ascending"), ("frame", "ascending")]).cast(QUESTIONS["evidence"])


def publish(
    store: Store, questions: pa.Table, tables: Mapping[str, pa.Table], metadata: Mapping[str, str] | None = None
) -> None:
    """Write the tables of a generation so that they are complete, or known to be incomplete. Under the writer lock.

    Args:
        store: Store with the boxes of people.
        questions: Questions in the columns of the tables `questions` and `answers`, in the order of their ids. Further
            columns of imported questions become columns of `answers`.
        tables: The tables `rejected` and `sequences` by name. Imported questions have a table `evidence`, too.
        metadata: Metadata in place of the canary, and of the mark if it has one.

    Raises:
        StoreError: If a file cannot be written.
    """
    folder = store.question_path("questions").parent
    pending, digest = folder / ".pending", hashlib.sha256()
    groups = [questions.slice(first, QUESTION_GROUP) for first in range(0, len(questions), QUESTION_GROUP)]
    for group in groups:
        digest.update(msgspec.json.encode(group.to_pylist(), order="sorted"))
    metadata = {GENERATION_KEY: digest.hexdigest(), **(metadata or {"canary": CANARY})}
    stored = {"key", *QUESTIONS["questions"].names, *QUESTIONS["answers"].names}
    added = [field for field in questions.schema if field.name not in stored]
    schemas = {**QUESTIONS, "answers": pa.schema([*QUESTIONS["answers"], *added])}
    parts = {"evidence": _evidence(store, questions), "questions": groups, "answers": groups}
    try:
        # A killed run may have left files.
        shutil.rmtree(pending, ignore_errors=True)
        for name, part in (parts | {name: [table] for name, table in tables.items()}).items():
            write_groups(pending / f"{name}.parquet", part, schemas[name], metadata)
        for name in PUBLISHED:
            (pending / f"{name}.parquet").replace(folder / f"{name}.parquet")
        sync_folder(folder)
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror}; free some space and generate again") from None
    finally:
        shutil.rmtree(pending, ignore_errors=True)
