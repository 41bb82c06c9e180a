"""Tables of candidates: their plans, keys and answers as text, put together set-wise.

A presence template has millions of proven candidates, so plans are made from columns, and only for the rows asked for.
"""

from __future__ import annotations

from typing import Final

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.wording import stated_actions

from .candidates import VALUES, Candidates
from .descriptions import Descriptions
from .scene import NOBODY, Ints, Scene
from .templates import joined, plan_texts

BLOCK: Final = 200_000
"""Rows whose plans are held in memory at once."""


def candidate_table(
    scene: Scene, descriptions: Descriptions, candidates: Candidates, rows: Ints, *, keyed: bool = True
) -> pa.Table:
    """The given candidates as rows for selection: sequence, family, template, target_track, plan, answer, key.

    `keyed=False` leaves the key out. `row` is the candidate's number.
    """
    template = candidates.template
    person = descriptions.moment[candidates.name[rows]] // len(scene.keyframes)
    track = pa.array(scene.tracks[person], pa.int32())
    plan = _plans(scene, descriptions, candidates, rows)
    if template.answer is None:
        answer = pc.take(pa.array(VALUES), pa.array(candidates.answer[rows]))
    else:
        parts = [
            pa.array(candidates.frames[part][rows]) if part in candidates.frames else part for part in template.answer
        ]
        answer = joined(parts)
    columns = {
        "sequence": _constant(scene.sequence, len(rows)),
        "family": _constant(template.family, len(rows)),
        "template": _constant(template.name, len(rows)),
        "target_track": track,
        "plan": plan,
        "answer": answer,
        "row": pa.array(rows),
    }
    if keyed:
        columns["key"] = hashed(joined([columns["sequence"], "\n", track, "\n", plan]))
    return pa.table(columns)


def with_selection_columns(table: pa.Table, candidates: Candidates) -> pa.Table:
    """Add what selection goes by: `read_frames`, the `stated` action words and the stated `times`."""
    rows = table["row"].to_numpy()
    template = candidates.template
    stated = [list(stated_actions(parse_plan(plan))) for plan in table["plan"].to_pylist()]
    table = table.append_column("read_frames", frame_lists(candidates, template.read, rows))
    table = table.append_column("stated", pa.array(stated, pa.list_(pa.string())))
    return table.append_column("times", frame_lists(candidates, template.times, rows))


def frame_lists(candidates: Candidates, names: tuple[str, ...], rows: Ints) -> pa.Array:
    """One list per row with the frames of these names."""
    values = np.stack([candidates.frames[name][rows] for name in names], axis=1)
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * len(names)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel(), pa.int32()))


def hashed(texts: pa.Array) -> pa.Array:
    """sha256 of each text, in hex."""
    with duckdb.connect(config={"threads": 1}) as connection:
        connection.register("given", pa.table({"text": texts}))
        result = connection.sql("SELECT sha256(text) AS key FROM given").to_arrow_table()
    return result["key"].combine_chunks()


def _plans(scene: Scene, descriptions: Descriptions, candidates: Candidates, rows: Ints) -> pa.Array:
    nodes, names = descriptions.tables
    text_of_name = pc.take(nodes["conditions"].combine_chunks(), names["from"].combine_chunks())
    columns = {"conditions": pc.take(text_of_name, pa.array(candidates.name[rows]))}
    columns |= {time: pa.array(candidates.frames[time][rows]) for time in candidates.template.times}
    segment = candidates.segment[rows]
    if len(segment) and segment[0] != NOBODY:
        columns["action"] = pc.take(scene.segments["action"].combine_chunks(), pa.array(segment))
    elif candidates.template.time_proof == "construction":
        columns["action"] = pa.array([], pa.string())
    return plan_texts(candidates.template, columns)


def _constant(text: str, count: int) -> pa.Array:
    return pa.repeat(pa.scalar(text), count)
