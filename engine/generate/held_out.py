"""Held-out questions, with the people and times that no question of a training set may touch.

Two questions of a sequence touch if they need the same person and their times overlap. The time of a question
extends from its first to its last frame. Its boxes, the times of its plan, and its answer have frames.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import decode_answer, frames_of_answer
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import QuestionRecord
from jrdb_avr.schema.tables import GENERATION_KEY


class Extent(NamedTuple):
    """Tracks that a question needs, and its first and last frame."""

    tracks: tuple[int, ...]
    first: int
    last: int


def read_held_out(path: Path) -> tuple[str, Mapping[str, Sequence[Extent]]]:
    """Read the questions of a store as held-out questions.

    Args:
        path: Folder of the store.

    Returns:
        The hash of their generation, and their extents by sequence.

    Raises:
        StoreError: If the questions cannot be read.
    """
    questions, answers = Store(path).question_tables("questions", "answers")
    private = {row["question_id"]: row for row in answers.to_pylist()}
    extents: dict[str, list[Extent]] = defaultdict(list)
    try:
        for row in questions.to_pylist():
            extents[row["sequence"]].append(_extent(QuestionRecord.read(row, private[row["question_id"]])))
    except (AvrError, msgspec.MsgspecError, KeyError) as error:
        raise StoreError(f"{path}: its questions cannot be read ({error}); 'jrdb-avr validate' says more") from None
    return (questions.schema.metadata or {}).get(GENERATION_KEY.encode(), b"").decode(), extents


def _extent(record: QuestionRecord) -> Extent:
    nodes = {node.id for node in parse_plan(record.plan).nodes}
    tracks = {track for name, track in record.bindings.items() if name in nodes}
    frames = [frame for name, frame in record.bindings.items() if name not in nodes]
    frames += [box.frame for box in record.needed]
    frames += frames_of_answer(decode_answer(record.answer_mode, record.answer))
    return Extent(tuple(sorted(tracks | {box.track for box in record.needed})), min(frames), max(frames))
