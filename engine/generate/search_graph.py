"""The in-memory graph of one sequence, in which generators and proofs search.

It is a Kùzu database made from a `Scene` and its facts:

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
    (Path)-[:From]->(Moment)              candidates whose hops are being proven, and the moment at which each begins
    (Path)-[:Of]->(Description)           the description of each
    (Moment)-[:Joined {a, c}]->(Moment)   from b to the d whom relations of b and c single out beside a

A step or fit that leads to nobody ends in one of three moments without a time, whose ids are NO_MATCH, SEVERAL and
UNDECIDED of `scene`; the steps of these three lead back to themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.scene import NOBODY, NOWHERE, Ints, Scene, coded, find_sorted, ints, masked, named
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames

_ENDS: Final = {
    "Is": ("Person", "Moment"),
    "Does": ("Person", "Segment"),
    "Shift": ("Moment", "Moment"),
    "Step": ("Moment", "Moment"),
    "Leads": ("Moment", "Moment"),
    "Fits": ("Description", "Moment"),
    "Names": ("Description", "Moment"),
    "Leaves": ("Person", "Absence"),
    "Keeps": ("Moment", "Company"),
    "Meets": ("Company", "Person"),
    "From": ("Path", "Moment"),
    "Of": ("Path", "Description"),
    "Joined": ("Moment", "Moment"),
}
"""Node tables at both ends of each kind of edge; every other table holds nodes."""

_TYPES: Final = {pa.bool_(): "BOOLEAN", pa.string(): "STRING", pa.float64(): "DOUBLE"}
"""Types of the graph's columns by Arrow type; all others are whole numbers."""


def add_table(graph: Graph, name: str, rows: pa.Table) -> None:
    """Create a table of the graph and fill it: nodes, whose first column is their id, or edges, whose first two are the
    ids of their ends."""
    ends = _ENDS.get(name)
    wide = [(f.name, pa.int64() if pa.types.is_integer(f.type) else f.type) for f in rows.schema]
    rows = rows.cast(pa.schema(wide))
    columns = [f"`{field.name}` {_TYPES.get(field.type, 'INT64')}" for field in rows.schema]
    if ends is None:
        graph.execute(f"CREATE NODE TABLE `{name}`({', '.join(columns)}, PRIMARY KEY({rows.column_names[0]}))")
    else:
        graph.execute(f"CREATE REL TABLE `{name}`({', '.join([f'FROM {ends[0]} TO {ends[1]}', *columns[2:]])})")
    if len(rows):
        graph.copy(name, rows)


def scene_graph(scene: Scene, tables: Mapping[str, pa.Table], rules: Rules) -> Graph:
    """The searchable graph of a sequence, in memory; the caller closes it.

    `tables` are those that the scene alone does not fill, by name.
    """
    moments, table = _moments(scene, rules)
    nowhere = pa.table(
        [pa.array(NOWHERE, pa.int64()), *(pa.nulls(3, f.type) for f in list(table.schema)[1:])], table.schema
    )
    segments = _segments(scene, rules)
    own = {
        "Person": pa.table({"id": np.arange(len(scene.tracks)), "track": scene.tracks}),
        "Moment": pa.concat_tables([table, nowhere]),
        "Segment": segments,
        "Is": pa.table({"from": scene.people(moments), "to": moments}),
        "Does": pa.table({"from": scene.person_of(ints(scene.segments, "track")), "to": segments["id"]}),
        "Shift": pa.concat_tables(_shift(scene, moments, by * frames(rules.shift_s)) for by in (-1, 1)),
    }
    graph = Graph.memory()
    # Nodes first: edges are between nodes that are there.
    for name, rows in sorted((own | dict(tables)).items(), key=lambda item: item[0] in _ENDS):
        add_table(graph, name, rows)
    return graph


def _shift(scene: Scene, moments: Ints, by: int) -> pa.Table:
    """Edges between the moments of one person that lie `by` frames apart."""
    at = find_sorted(scene.frames(moments) + by, scene.keyframes)
    target = scene.people(moments) * len(scene.keyframes) + at
    exists = (at != NOBODY) & np.isin(target, moments)
    source, target = moments[exists], target[exists]
    return pa.table({"from": source, "to": target, "by": np.full(len(source), by)})


def _seen(scene: Scene, rows: Ints, rules: Rules) -> tuple[Bools, Bools]:
    """(clear, ahead) per row of `boxes`; false where there is no box."""
    in_front = views.ahead(scene.geometry["x"], scene.geometry["w"], rules.visible_share)
    # A last row stands for NOBODY.
    clear, ahead = (np.append(column, False)[rows] for column in (scene.clear, in_front))
    return clear, ahead


def _moments(scene: Scene, rules: Rules) -> tuple[Ints, pa.Table]:
    moments = np.flatnonzero((scene.moment_rows != NOBODY) | scene.absent)
    rows = scene.moment_rows[moments]
    clear, in_front = _seen(scene, rows, rules)
    times = scene.frames(moments)
    table = {
        "id": moments,
        "t": times,
        # 1 present, 0 absent, null unknown.
        "seen": pa.array(clear.astype(np.int64), mask=~clear & ~scene.absent[moments]),
        "clear": clear,
        "image": scene.has_image(times),
        "ahead": in_front,
        "pose": named(scene.moment_poses[moments], POSES),
        "distance": pc.take(pa.array(scene.distances, from_pandas=True), masked(rows)),
        "angle": pc.take(pa.array(scene.geometry["angle"]), masked(rows)),
    }
    return moments, pa.table(table)


def _segments(scene: Scene, rules: Rules) -> pa.Table:
    table = scene.segments
    persons = scene.person_of(ints(table, "track"))
    columns: dict[str, object] = {"id": np.arange(len(table))}
    for name in ("action", "first", "last", "start", "end", "quiet_from", "closed"):
        columns[name] = table[name]
    for edge in ("first", "last"):
        times = ints(table, edge)
        clear, in_front = _seen(scene, scene.box_rows(persons, times), rules)
        columns |= {f"{edge}_clear": clear, f"{edge}_image": scene.has_image(times), f"{edge}_ahead": in_front}
    starts = scene.box_rows(persons, ints(table, "first"))
    columns["angle"] = pc.take(pa.array(scene.geometry["angle"]), masked(starts))
    columns["held_from"], columns["held_to"] = _held_before(scene)
    return pa.table(columns)


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
    after = np.searchsorted(keyframes, ints(scene.segments, "first"))
    inside = (after > 0) & (after < count) & (own != NOBODY)
    after = np.clip(after, 1, count - 1) if count > 1 else np.zeros(rows, np.int64)
    base = scene.person_of(ints(scene.segments, "track")) * count
    held = pose[base + after - 1]
    inside &= (keyframes[after] - keyframes[after - 1] == KEYFRAME_STEP) & (held != NOBODY) & (held != own)
    inside &= pose[base + after] == own
    since = after - 1 - run[base + after - 1]
    return pa.array(keyframes[since], mask=~inside), pa.array(keyframes[after - 1], mask=~inside)
