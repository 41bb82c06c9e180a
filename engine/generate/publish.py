"""The published tables: selected candidates as questions, and what is kept beside them in private.

All tables of one generation carry the same mark, a hash of the questions and answers, in their Parquet metadata. They
are written to temporary files first and then moved in one after the other, the questions last: after a crash in
between, the marks tell that the tables do not belong together, and generating again completes them.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.queries.store import Store, write_atomic, write_table
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, rules_hash
from jrdb_avr.schema.tables import CANARY, QUESTIONS
from jrdb_avr.schema.wording import question_id, render

TABLES: Final = ("answers", "evidence", "rejected", "sequences", "questions")
"""The tables of a generation in the order in which they are moved in; `questions` last, it makes them valid."""

EVIDENCE_BLOCK: Final = 500
"""Questions whose evidence is held in memory at once."""

_EVIDENCE: Final = ["frame", "x", "y", "w", "h"]


GENERATION_KEY: Final = "generation"
"""Metadata key of the mark that the tables of one generation share."""


@dataclass(frozen=True)
class Heads:
    """What generation needs to know of each sequence at the end: its row of the table `sequences`, and its steps."""

    rows: tuple[dict[str, Any], ...]
    action_steps: Mapping[str, int]


def read_heads(store: Store, sequences: Sequence[str]) -> Heads:
    """The public facts of every sequence: frames with an image, or where there is none at all, annotated ones."""
    rows, steps = [], {}
    for sequence in sorted(sequences):
        head = store.interval("sequence", sequence).to_pylist()[0]
        frames = store.interval("frames", sequence)
        shown = frames.filter(frames["image" if "images" in head["layers"] else "annotated"])
        rows.append(
            {
                "sequence": sequence,
                "fps": head["fps"],
                "frame_count": head["frame_count"],
                "frames": sorted(shown["frame"].to_pylist()),
            }
        )
        steps[sequence] = head["action_step"]
    return Heads(tuple(rows), steps)


def question_tables(selected: pa.Table, heads: Heads, rules: Rules) -> tuple[pa.Table, pa.Table]:
    """The tables `questions` and `answers` of the selected candidates, both sorted by question id."""
    questions, answers = [], []
    for line in selected.to_pylist():
        plan = parse_plan(line["plan"])
        about = heads.action_steps[line["sequence"]] == KEYFRAME_STEP
        text = render(line["template"], plan, line["key"], about)
        public = (line["sequence"], line["family"], line["template"], text, line["choices"], plan.answer.mode)
        identity = question_id(*public)
        questions.append(dict(zip(QUESTIONS["questions"].names, (identity, *public), strict=True)))
        choice = plan.answer.mode == "multiple_choice"
        kept = {name: line[name] for name in QUESTIONS["answers"].names if name in line}
        answers.append(
            kept
            | {
                "question_id": identity,
                "answer": encode_answer(Choice(line["true_choice"])) if choice else line["answer"],
                "rules": rules_hash(rules),
            }
        )
    order = [("question_id", "ascending")]
    return (
        pa.Table.from_pylist(questions, schema=QUESTIONS["questions"]).sort_by(order),
        pa.Table.from_pylist(answers, schema=QUESTIONS["answers"]).sort_by(order),
    )


def evidence_blocks(store: Store, questions: pa.Table, answers: pa.Table) -> Iterator[pa.Table]:
    """Every box of each question's target, by question and frame, a block of questions at a time.

    Thousands of questions with a thousand boxes each would not fit into memory comfortably as one table.
    """
    boxes: dict[str, tuple[Ints, pa.Table]] = {}
    for sequence in sorted(set(questions["sequence"].to_pylist())):
        table = store.interval("sightings", sequence).select(["track", *_EVIDENCE])
        table = table.sort_by([("track", "ascending"), ("frame", "ascending")])
        boxes[sequence] = (table["track"].to_numpy().astype(np.int64), table.select(_EVIDENCE))
    track_of = dict(zip(answers["question_id"].to_pylist(), answers["target_track"].to_pylist(), strict=True))
    where = questions.select(["question_id", "sequence"]).sort_by("question_id").to_pylist()
    for start in range(0, len(where), EVIDENCE_BLOCK):
        parts = []
        for line in where[start : start + EVIDENCE_BLOCK]:
            tracks, table = boxes[line["sequence"]]
            low, high = np.searchsorted(tracks, [track_of[line["question_id"]], track_of[line["question_id"]] + 1])
            part = table.slice(low, high - low)
            owner = pa.repeat(pa.scalar(line["question_id"], pa.string()), len(part))
            parts.append(part.add_column(0, "question_id", owner))
        yield pa.concat_tables(parts).cast(QUESTIONS["evidence"]).combine_chunks()


def publish(store: Store, tables: Mapping[str, pa.Table]) -> None:
    """Write the tables of a generation so that they are all there, or tell that they are not. Under the writer lock.

    `tables` holds all but the evidence, which follows from questions and answers.
    """
    digest = hashlib.sha256()
    for name in ("questions", "answers"):
        digest.update(msgspec.json.encode(tables[name].to_pylist(), order="sorted"))
    metadata = {"canary": CANARY, GENERATION_KEY: digest.hexdigest()}
    folder = store.question_path("questions").parent
    pending = folder / ".pending"
    try:
        # What a killed run left behind.
        shutil.rmtree(pending, ignore_errors=True)
        for name, table in tables.items():
            write_table(pending / f"{name}.parquet", table, QUESTIONS[name], metadata)
        blocks = evidence_blocks(store, tables["questions"], tables["answers"])
        write_atomic(pending / "evidence.parquet", lambda path: _write_blocks(path, blocks, metadata))
        for name in TABLES:
            (pending / f"{name}.parquet").replace(store.question_path(name))
        _sync_folder(str(folder))
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror}; free some space and generate again") from None
    finally:
        shutil.rmtree(pending, ignore_errors=True)


def _write_blocks(path: Path, blocks: Iterator[pa.Table], metadata: dict[str, str]) -> None:
    schema = QUESTIONS["evidence"].with_metadata(metadata)
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for block in blocks:
            writer.write_table(block.replace_schema_metadata(metadata))


def _sync_folder(path: str) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
