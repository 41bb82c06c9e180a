"""Publish the tables: selected candidates as questions, with their private tables.

All tables of one generation carry the same mark, a hash of the questions and answers, in their Parquet metadata. They
are written to temporary files first and then moved in one after the other, the questions last: after a crash in
between, the marks differ, so that the tables do not belong together, and generating again completes them.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.queries.files import write_atomic
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS

PUBLISHED: Final = ("answers", "evidence", "rejected", "sequences", "questions")
"""The tables of a generation in the order in which they are moved in; `questions` last, it makes them valid."""

EVIDENCE_BLOCK: Final = 500
"""Questions whose evidence is held in memory at once."""

_EVIDENCE: Final = ["frame", "x", "y", "w", "h"]


def evidence_blocks(store: Store, questions: pa.Table, answers: pa.Table) -> Iterator[pa.Table]:
    """Every box of each question's target, by question and frame, a block of questions at a time.

    Thousands of questions with a thousand boxes each would not fit into memory comfortably as one table.
    """
    boxes: dict[str, pa.Table] = {}
    for sequence in pc.unique(questions["sequence"]).to_pylist():
        table = store.interval("sightings", sequence).select(["track", *_EVIDENCE])
        boxes[sequence] = table.sort_by([("track", "ascending"), ("frame", "ascending")]).combine_chunks()
    track_of = dict(zip(answers["question_id"].to_pylist(), answers["target_track"].to_pylist(), strict=True))
    where = questions.select(["question_id", "sequence"]).sort_by("question_id").to_pylist()
    for start in range(0, len(where), EVIDENCE_BLOCK):
        parts = []
        for line in where[start : start + EVIDENCE_BLOCK]:
            table, track = boxes[line["sequence"]], track_of[line["question_id"]]
            low, high = np.searchsorted(table["track"].to_numpy(), [track, track + 1])
            owner = pa.repeat(pa.scalar(line["question_id"], pa.string()), high - low)
            parts.append(table.select(_EVIDENCE).slice(low, high - low).add_column(0, "question_id", owner))
        yield pa.concat_tables(parts).cast(QUESTIONS["evidence"]).combine_chunks()


def publish(store: Store, tables: Mapping[str, pa.Table], training: Mapping[str, str] | None = None) -> None:
    """Write the tables of a generation so that they are all there, or known to be incomplete. Under the writer lock.

    `tables` holds all but the evidence, which follows from questions and answers. `training`: the metadata of a
    training set, which stand in place of the canary.
    """
    digest = hashlib.sha256()
    for name in ("questions", "answers"):
        digest.update(msgspec.json.encode(tables[name].to_pylist(), order="sorted"))
    metadata = {**(training or {"canary": CANARY}), GENERATION_KEY: digest.hexdigest()}
    folder = store.question_path("questions").parent
    pending = folder / ".pending"
    try:
        # Files of a killed run.
        shutil.rmtree(pending, ignore_errors=True)
        for name, table in tables.items():
            write_table(pending / f"{name}.parquet", table, QUESTIONS[name], metadata)
        blocks = evidence_blocks(store, tables["questions"], tables["answers"])
        write_atomic(pending / "evidence.parquet", lambda path: _write_blocks(path, blocks, metadata))
        for name in PUBLISHED:
            (pending / f"{name}.parquet").replace(store.question_path(name))
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror}; free some space and generate again") from None
    finally:
        shutil.rmtree(pending, ignore_errors=True)


def _write_blocks(path: Path, blocks: Iterator[pa.Table], metadata: dict[str, str]) -> None:
    schema = QUESTIONS["evidence"].with_metadata(metadata)
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for block in blocks:
            writer.write_table(block.replace_schema_metadata(metadata))
