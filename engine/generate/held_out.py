"""Held-out questions: their people and times, which no question of a training set may touch.

Two questions touch when they need a person in common, in one sequence, and their times overlap. A question's time goes
from the first to the last of its frames: those of the boxes it needs, of its plan's times, and of its answer.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from jrdb_avr.engine.generate.candidates import PASSED, RULES, Candidates
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import decode_answer, frames_of_answer
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import QuestionRecord
from jrdb_avr.schema.tables import GENERATION_KEY


class Extent(NamedTuple):
    """The tracks that a question needs, and its first and last frame."""

    tracks: tuple[int, ...]
    first: int
    last: int


class HeldOut(NamedTuple):
    """Questions to keep away from: the mark of their generation, and their extents by sequence."""

    generation: str
    extents: Mapping[str, Sequence[Extent]]


def read_held_out(path: Path) -> HeldOut:
    """The questions of the store at a path. Raises StoreError where they cannot be read."""
    questions, answers = Store(path).question_tables("questions", "answers")
    private = {row["question_id"]: row for row in answers.to_pylist()}
    extents: dict[str, list[Extent]] = defaultdict(list)
    try:
        for row in questions.to_pylist():
            extents[row["sequence"]].append(_extent(QuestionRecord.read(row, private[row["question_id"]])))
    except (AvrError, msgspec.MsgspecError, KeyError) as error:
        raise StoreError(f"{path}: its questions cannot be read ({error}); 'jrdb-avr validate' says more") from None
    return HeldOut((questions.schema.metadata or {}).get(GENERATION_KEY.encode(), b"").decode(), extents)


def _extent(record: QuestionRecord) -> Extent:
    nodes = {node.id for node in parse_plan(record.plan).nodes}
    tracks = {track for name, track in record.bindings.items() if name in nodes}
    frames = [frame for name, frame in record.bindings.items() if name not in nodes]
    frames += [box.frame for box in record.needed]
    frames += frames_of_answer(decode_answer(record.answer_mode, record.answer))
    return Extent(tuple(sorted(tracks | {box.track for box in record.needed})), min(frames), max(frames))


def refuse_held_out(context: SearchContext, candidates: Candidates, extents: Sequence[Extent]) -> Candidates:
    """Refuse the candidates that share a person and a time with a held-out question, by the rule `held_out`."""
    proven = np.flatnonzero(candidates.rule == PASSED)
    if not extents or not len(proven):
        return candidates
    rule = candidates.rule.copy()
    rule[proven[_touching(context, candidates.take(proven), extents)]] = RULES.index("held_out")
    return replace(candidates, rule=rule)


def _touching(context: SearchContext, candidates: Candidates, extents: Sequence[Extent]) -> Bools:
    scene, template = context.scene, candidates.template
    names = dict.fromkeys((*template.stated, *template.read, *template.decisive))
    frames = np.stack([candidates.frames[name] for name in names])
    first, last = frames.min(axis=0), frames.max(axis=0)
    tracks = np.stack([scene.tracks[scene.people(moments)] for moments in candidates.people.values()])
    touching = np.zeros(len(candidates), bool)
    for extent in extents:
        meanwhile = (first <= extent.last) & (last >= extent.first)
        touching |= meanwhile & np.isin(tracks, extent.tracks).any(axis=0)
    if template.counts:
        # People who are counted are nodes of no plan, and are few enough to be read one candidate at a time.
        for row in np.flatnonzero(~touching).tolist():
            counted = candidates.people_counted(context, row)
            people = {int(track) for track in tracks[:, row]} | {track for track, _ in counted}
            times = [int(first[row]), int(last[row]), *(frame for _, frame in counted)]
            touching[row] = any(
                min(times) <= extent.last and max(times) >= extent.first and people & set(extent.tracks)
                for extent in extents
            )
    return touching
