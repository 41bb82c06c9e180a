"""The in-memory graph of one sequence, in which generators and proofs search.

It is a Kùzu database made from a `Scene` and what was found in it:

    (Person)-[:Is]->(Moment)              where the person has a box, or is absent; no moment: it is unknown
    (Description)-[:Names]->(Moment)      the description chosen for this person at this keyframe
    (Person)-[:Does]->(Segment)           stable segments of actions
    (Moment)-[:Shift {by}]->(Moment)      the same person `by` frames later, for both directions of time.shift
    (Moment)-[:Step {relation}]->(Moment) to the one person who certainly has the relation while nobody else could
    (Moment)-[:Leads {relation}]->(Moment) the steps that lead to somebody
    (Description)-[:Fits {t}]->(Moment)   to the one person whom the description fits at keyframe t
    (Person)-[:Leaves]->(Absence)         between two boxes, with the keyframes before at which the person is present
    (Moment)-[:Keeps]->(Company)          from then on, as long as it is known who is in a relation with the person
    (Company)-[:Meets {met}]->(Person)    who is in that relation with the person, from which keyframe on

A step or fit that leads to nobody ends in one of three moments without a time, whose ids are EMPTY, SEVERAL and
UNKNOWN of `relations`; the steps of these three lead back to themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.scene import NOBODY, NOWHERE, Ints, Scene, coded
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames

_DDL: Final = (
    "CREATE NODE TABLE Person(id INT64 PRIMARY KEY, track INT64)",
    "CREATE NODE TABLE Moment(id INT64 PRIMARY KEY, t INT64, seen INT64, clear BOOLEAN, image BOOLEAN, "
    "ahead BOOLEAN, pose STRING, distance DOUBLE, angle DOUBLE)",
    "CREATE NODE TABLE Description(id INT64 PRIMARY KEY, conditions STRING)",
    "CREATE NODE TABLE Segment(id INT64 PRIMARY KEY, action STRING, `first` INT64, `last` INT64, start INT64, "
    "`end` INT64, quiet_from INT64, closed BOOLEAN, first_clear BOOLEAN, first_image BOOLEAN, first_ahead BOOLEAN, "
    "last_clear BOOLEAN, last_image BOOLEAN, last_ahead BOOLEAN, "
    "angle DOUBLE, held_from INT64, held_to INT64)",
    "CREATE NODE TABLE Absence(id INT64 PRIMARY KEY, leaves INT64, returns INT64, present_from INT64, clear BOOLEAN, "
    "image BOOLEAN, ahead BOOLEAN)",
    "CREATE NODE TABLE Company(id INT64 PRIMARY KEY, relation STRING, until INT64)",
    "CREATE REL TABLE `Is`(FROM Person TO Moment)",
    "CREATE REL TABLE Does(FROM Person TO Segment)",
    "CREATE REL TABLE Shift(FROM Moment TO Moment, by INT64)",
    "CREATE REL TABLE Step(FROM Moment TO Moment, relation STRING)",
    "CREATE REL TABLE Leads(FROM Moment TO Moment, relation STRING)",
    "CREATE REL TABLE Fits(FROM Description TO Moment, t INT64)",
    "CREATE REL TABLE Names(FROM Description TO Moment, id INT64, anchor BOOLEAN, general BOOLEAN, poseless BOOLEAN)",
    "CREATE REL TABLE Leaves(FROM Person TO Absence)",
    "CREATE REL TABLE Keeps(FROM Moment TO Company)",
    "CREATE REL TABLE Meets(FROM Company TO Person, met INT64, seen INT64, maybe INT64, image BOOLEAN)",
)
_GIVEN: Final = ("Description", "Absence", "Company", "Names", "Fits", "Step", "Leads", "Leaves", "Keeps", "Meets")
"""Tables that the scene alone does not fill, nodes first."""


def scene_graph(scene: Scene, tables: Mapping[str, pa.Table], rules: Rules) -> Graph:
    """The searchable graph of a sequence, in memory; the caller closes it.

    `tables` are those in `_GIVEN` by name: what was found in the scene, and is not of the scene alone.
    """
    graph = Graph.memory()
    for statement in _DDL:
        graph.execute(statement)
    persons = np.arange(len(scene.tracks))
    moments, table = _moments(scene, rules)
    nowhere = pa.table(
        [pa.array(NOWHERE, pa.int64()), *(pa.nulls(3, f.type) for f in list(table.schema)[1:])], table.schema
    )
    segments = _segments(scene, rules)
    graph.copy("Person", pa.table({"id": persons, "track": scene.tracks}))
    graph.copy("Moment", pa.concat_tables([table, nowhere]))
    graph.copy("Segment", segments)
    graph.copy("Is", pa.table({"from": scene.persons(moments), "to": moments}))
    doer = scene.person_of(scene.segments["track"].to_numpy())
    graph.copy("Does", pa.table({"from": doer, "to": segments["id"]}))
    for by in (-frames(rules.shift_s), frames(rules.shift_s)):
        graph.copy("Shift", _shift(scene, moments, by))
    for name in _GIVEN:
        graph.copy(name, tables[name])
    return graph


def _shift(scene: Scene, moments: Ints, by: int) -> pa.Table:
    """Edges between the moments of one person that lie `by` frames apart."""
    persons, times = scene.persons(moments), scene.frames(moments) + by
    at = np.minimum(np.searchsorted(scene.keyframes, times), len(scene.keyframes) - 1)
    there = scene.keyframes[at] == times
    source, target = moments[there], (persons * len(scene.keyframes) + at)[there]
    exists = np.isin(target, moments)
    source, target = source[exists], target[exists]
    return pa.table({"from": source, "to": target, "by": np.full(len(source), by)})


def _seen(scene: Scene, rows: Ints, rules: Rules) -> tuple[Bools, Bools]:
    """(clear, ahead) per row of `boxes`; false where there is no box."""
    if len(scene.boxes) == 0:
        return np.zeros(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
    there = rows != NOBODY
    in_front = views.ahead(scene.geometry["x"], scene.geometry["w"], rules.visible_share)
    return scene.clear[rows] & there, in_front[rows] & there


def _moments(scene: Scene, rules: Rules) -> tuple[Ints, pa.Table]:
    moments = np.flatnonzero((scene.moment_rows != NOBODY) | scene.absent)
    rows = scene.moment_rows[moments]
    clear, in_front = _seen(scene, rows, rules)
    there = pa.array(rows, mask=rows == NOBODY)
    times = scene.frames(moments)
    distance = pc.take(pa.array(scene.distances, from_pandas=True), there)
    return moments, pa.table(
        {
            "id": moments,
            "t": times,
            # 1 present, 0 absent, null unknown.
            "seen": pa.array(clear.astype(np.int64), mask=~clear & ~scene.absent[moments]),
            "clear": clear,
            "image": scene.has_image(times),
            "ahead": in_front,
            "pose": pc.take(
                pa.array(POSES, pa.string()), pc.take(pa.array(scene.poses, mask=scene.poses == NOBODY), there)
            ),
            "distance": distance,
            "angle": pc.take(pa.array(scene.geometry["angle"]), there),
        }
    )


def _segments(scene: Scene, rules: Rules) -> pa.Table:
    table = scene.segments
    persons = scene.person_of(table["track"].to_numpy())
    starts = scene.box_rows(persons, table["first"].to_numpy().astype(np.int64))
    angle = pc.take(pa.array(scene.geometry["angle"]), pa.array(starts, mask=starts == NOBODY))
    columns: dict[str, object] = {"id": np.arange(len(table))}
    for name in ("action", "first", "last", "start", "end", "quiet_from", "closed"):
        wide = pa.types.is_integer(table.schema.field(name).type)
        columns[name] = pc.cast(table[name], pa.int64()) if wide else table[name]
    for edge in ("first", "last"):
        times = table[edge].to_numpy().astype(np.int64)
        clear, in_front = _seen(scene, scene.box_rows(persons, times), rules)
        columns |= {f"{edge}_clear": clear, f"{edge}_image": scene.has_image(times), f"{edge}_ahead": in_front}
    held_from, held_to = _held_before(scene)
    return pa.table({**columns, "angle": angle, "held_from": held_from, "held_to": held_to})


def _held_before(scene: Scene) -> tuple[pa.Array, pa.Array]:
    """Per segment of a pose: the first and last keyframe of the other pose held, known at every keyframe of them, until
    the keyframe before the segment; null where there is none."""
    rows, keyframes = len(scene.segments), scene.keyframes
    if rows == 0 or len(keyframes) == 0:
        return pa.nulls(rows, pa.int64()), pa.nulls(rows, pa.int64())
    count, pose = len(keyframes), scene.moment_poses.astype(np.int64)
    # How many keyframes before each moment hold its pose without a break.
    moments = np.arange(scene.moment_count)
    place = moments % count
    joined = (place > 0) & (np.diff(keyframes, prepend=keyframes[0])[place] == KEYFRAME_STEP)
    joined &= (pose == np.roll(pose, 1)) & (pose != NOBODY)
    run = moments - np.maximum.accumulate(np.where(joined, 0, moments))
    # The keyframe that follows the start of each segment, and the one before it.
    own = coded(scene.segments["action"], POSES)
    after = np.searchsorted(keyframes, scene.segments["first"].to_numpy().astype(np.int64))
    inside = (after > 0) & (after < count) & (own != NOBODY)
    after = np.clip(after, 1, count - 1) if count > 1 else np.zeros(rows, np.int64)
    base = scene.person_of(scene.segments["track"].to_numpy()) * count
    held = pose[base + after - 1]
    inside &= (keyframes[after] - keyframes[after - 1] == KEYFRAME_STEP) & (held != NOBODY) & (held != own)
    inside &= pose[base + after] == own
    since = after - 1 - run[base + after - 1]
    return pa.array(keyframes[since], mask=~inside), pa.array(keyframes[after - 1], mask=~inside)
