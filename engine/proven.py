"""Tables of candidates: their plans, keys and answers as text, put together set-wise.

A presence template has millions of proven candidates, so plans are made from columns, and only for the rows asked for.
"""

from __future__ import annotations

import hashlib
from typing import Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.arrays import Floats
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.wording import stated_actions

from .candidates import VALUES, Candidates
from .conditions import ANCHOR_TIME
from .descriptions import Descriptions
from .relations import RELATIONS
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
    track = pa.array(scene.tracks[scene.persons(candidates.people[template.target][rows])], pa.int32())
    plan = _plans(scene, descriptions, candidates, rows)
    if template.answer is None:
        answer = pc.take(pa.array(VALUES, pa.string()), pa.array(candidates.answer[rows]))
    else:
        columns = {name: pa.array(numbers[rows]) for name, numbers in candidates.frames.items()}
        if "value" in template.answer:
            columns["value"] = _json_numbers(candidates.value[rows])
        if "angle" in template.answer:
            columns["angle"] = _angles(scene, candidates.segment[rows])
        answer = joined([columns.get(part, part) for part in template.answer])
    table = {
        "sequence": _constant(scene.sequence, len(rows)),
        "family": _constant(template.family, len(rows)),
        "template": _constant(template.name, len(rows)),
        "target_track": track,
        "plan": plan,
        "answer": answer,
        "row": pa.array(rows),
    }
    if keyed:
        table["key"] = hashed(joined([table["sequence"], "\n", track, "\n", plan]))
    return pa.table(table)


def with_selection_columns(table: pa.Table, candidates: Candidates) -> pa.Table:
    """Add what selection goes by: `read_frames`, the `stated` action words and the stated `times`."""
    rows = table["row"].to_numpy()
    template = candidates.template
    stated = [list(stated_actions(parse_plan(plan))) for plan in table["plan"].to_pylist()]
    table = table.append_column("read_frames", frame_lists(candidates, template.read, rows))
    table = table.append_column("stated", pa.array(stated, pa.list_(pa.string())))
    return table.append_column("times", frame_lists(candidates, template.stated, rows))


def frame_lists(candidates: Candidates, names: tuple[str, ...], rows: Ints) -> pa.Array:
    """One list per row with the frames of these names."""
    values = np.stack([candidates.frames[name][rows] for name in names], axis=1)
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * len(names)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel(), pa.int32()))


def hashed(texts: pa.Array) -> pa.Array:
    """sha256 of each text, in hex."""
    return pa.array([hashlib.sha256(text.encode()).hexdigest() for text in texts.to_pylist()], pa.string())


def _plans(scene: Scene, descriptions: Descriptions, candidates: Candidates, rows: Ints) -> pa.Array:
    texts, number = descriptions.texts
    at = f'"at":"{candidates.template.described}"'
    used, place = np.unique(number[candidates.name[rows]], return_inverse=True)
    texts = [texts[i].replace(f'"at":"{ANCHOR_TIME}"', at) for i in used.tolist()]
    columns = {"conditions": pc.take(pa.array(texts, pa.string()), pa.array(place))}
    columns |= {time: pa.array(candidates.frames[time][rows]) for time in candidates.template.stated}
    for name, codes in candidates.relations.items():
        columns[name] = pc.take(pa.array(RELATIONS, pa.string()), pa.array(codes[rows]))
    action = scene.segments["action"].combine_chunks()
    for name, segments in (("action", candidates.segment), ("action2", candidates.segment2)):
        columns[name] = pc.take(action, pa.array(segments[rows], mask=segments[rows] == NOBODY))
    return plan_texts(candidates.template, columns)


def _angles(scene: Scene, segments: Ints) -> pa.Array:
    """Direction in which a person is seen at the first frame of each segment, as JSON writes it."""
    persons = scene.person_of(scene.segments["track"].to_numpy()[segments])
    rows = scene.box_rows(persons, scene.segments["first"].to_numpy().astype(np.int64)[segments])
    return _json_numbers(scene.geometry["angle"][rows])


def _json_numbers(values: Floats) -> pa.Array:
    """Numbers as JSON writes them."""
    return pa.array([msgspec.json.encode(value).decode() for value in values.tolist()], pa.string())


def _constant(text: str, count: int) -> pa.Array:
    return pa.repeat(pa.scalar(text, pa.string()), count)
