"""The tables of the keyframe layer: what the generators search in one sequence, as rows of the graph.

    (Person)-[:At]->(Moment)                 a person at a keyframe: where the person has a box, or is certainly absent
    (Moment)-[:Shift {by}]->(Moment)         the same person `by` frames later, for both directions of time.shift
    (Moment)-[:Fact {relation}]->(Moment) facts: `certain`, or possible; `unread` ones are possible as a list is missing
    (Moment)-[:Satisfies {certain}]->(Condition)  a condition at a keyframe, and who meets it or could
    (Name)-[:Uses {place}]->(Condition)      a name is the description chosen for a person at a keyframe
    (Name)-[:Of]->(Description)              its conditions, whoever and whenever they fit
    (Name)-[:Moved {by}]->(Moment)           whom they fit at the keyframe `by` frames later
    (Description)-[:Fits]->(Moment)          whom they fit at any keyframe
    (Person)-[:Acts]->(Segment)            stable segments of actions
    (Person)-[:Leaves]->(Absence)            between two boxes, with the keyframes before at which the person is present
    (Moment)-[:Begins]->(Encounter)          from then on, as long as it is known who is in a relation with the person
    (Encounter)-[:Meets {met}]->(Person)     who is in that relation with the person, from which keyframe on

What follows is found by statements (`keyframe_graph`): whom a relation leads to, and which names are anchors.

Numbers of nodes count up per sequence; a node's id is its number plus the sequence's `low`, so that a range of ids is a
sequence. Where nobody can be meant, an edge ends in one of three moments without a person, whose `nowhere` is the
outcome: empty, ambiguous or unknown. Their numbers are NO_MATCH, SEVERAL and UNDECIDED of `scene`, counted from the
end of the range.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.conditions import FALSE, TRUE
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.descriptions import Descriptions
from jrdb_avr.engine.generate.encounters import encounter_tables
from jrdb_avr.engine.generate.relations import KIND, RELATION_BITS, RELATION_LAYERS, RELATIONS, Facts, unknown_others
from jrdb_avr.engine.generate.scene import (
    NOBODY,
    NOWHERE,
    Ints,
    Scene,
    absence_tables,
    coded,
    find_sorted,
    ints,
    masked,
    named,
)
from jrdb_avr.queries.keyframes import SPAN
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames

OUTCOMES_NOWHERE: Final = ("empty", "ambiguous", "unknown")
"""`nowhere` of the moments NO_MATCH, SEVERAL and UNDECIDED."""


def keyframe_tables(context: SearchContext) -> Iterator[tuple[str, pa.Table]]:
    """The layer's tables of a sequence, by name."""
    scene, rules, low = context.scene, context.rules, context.low
    tables = _moments(context) | _segments(scene, rules) | absence_tables(scene, rules)
    tables |= encounter_tables(scene, context.facts, rules) | _facts(context) | _names(context.descriptions, rules)
    persons = pc.binary_join_element_wise(scene.sequence, pa.array(scene.tracks).cast(pa.string()), "/")
    for name, rows in tables.items():
        if name in KEYFRAME_NODES:
            columns = [_ids(rows["id"], low), pa.repeat(scene.sequence, len(rows)), *rows.drop("id").columns]
            yield name, pa.table(columns, ["id", "sequence", *rows.column_names[1:]])
            continue
        source, target, _ = KEYFRAME_RELS[name]
        ends = [
            persons.take(rows[end]) if table == "Person" else _ids(rows[end], low)
            for end, table in (("from", source), ("to", target))
        ]
        yield name, pa.table([*ends, *rows.columns[2:]], rows.column_names)


def _ids(numbers: pa.ChunkedArray, low: int) -> Ints:
    local = numbers.to_numpy()
    return np.asarray(np.where(local < 0, local + SPAN, local) + low)


# -- moments --------------------------------------------------------------------------------------------------------


def _moments(context: SearchContext) -> dict[str, pa.Table]:
    scene, rules = context.scene, context.rules
    moments = np.flatnonzero((scene.moment_rows != NOBODY) | scene.absent)
    rows, times = scene.moment_rows[moments], scene.frames(moments)
    clear, in_front = _seen(scene, rows, rules)
    table = pa.table(
        {
            "id": moments,
            "track": scene.tracks[scene.people(moments)],
            "frame": times,
            "nowhere": pa.nulls(len(moments), pa.string()),
            # 1 present, 0 absent, null unknown.
            "seen": pa.array(clear.astype(np.int64), mask=~clear & ~scene.absent[moments]),
            "clear": clear,
            "image": scene.has_image(times),
            "ahead": in_front,
            "pose": named(scene.moment_poses[moments], POSES),
            "distance": pc.take(pa.array(scene.distances, from_pandas=True), masked(rows)),
            "angle": pc.take(pa.array(scene.geometry["angle"]), masked(rows)),
            "open": _open(scene, context.facts)[moments],
        }
    )
    nowhere = {"id": pa.array(NOWHERE, pa.int64()), "nowhere": pa.array(OUTCOMES_NOWHERE)}
    none = [nowhere.get(field.name, pa.nulls(len(NOWHERE), field.type)) for field in table.schema]
    return {
        "Moment": pa.concat_tables([table, pa.table(none, table.schema)]),
        "At": pa.table({"from": scene.people(moments), "to": moments}),
        "Shift": pa.concat_tables(_shift(scene, moments, by) for by in shift_frames(rules)),
    }


def _open(scene: Scene, facts: Facts) -> Ints:
    """For each moment, the bits of the relations that somebody may have with the person, but not certainly.

    Such a fact is possible, or labels do not tell.
    """
    of_kind = np.array([RELATION_BITS[kind == KIND].sum() for kind in range(len(RELATION_LAYERS))])
    found = of_kind @ (unknown_others(scene, facts.known) > 0)
    possible = ~facts.certain
    np.bitwise_or.at(found, facts.source[possible], RELATION_BITS[facts.relation[possible]])
    return np.asarray(found)


def shift_frames(rules: Rules) -> tuple[int, int]:
    """By how many frames time.shift moves: earlier and later."""
    return -frames(rules.shift_s), frames(rules.shift_s)


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


def _facts(context: SearchContext) -> dict[str, pa.Table]:
    """Everybody who certainly has a relation with a person, and one who could have it, who stands for all who could.

    They are by far the most.
    """
    scene, facts = context.scene, context.facts
    possible = np.flatnonzero(~facts.certain)
    cell = facts.source[possible] * len(RELATIONS) + facts.relation[possible]
    stored = facts.certain.copy()
    stored[possible[np.unique(cell, return_index=True)[1]]] = True
    columns = {
        "from": facts.source,
        "to": facts.target,
        "relation": named(facts.relation, RELATIONS),
        "certain": facts.certain,
        "unread": facts.unread,
        # With how many others the relation is possible for want of knowledge.
        "unknown": unknown_others(scene, facts.known)[KIND[facts.relation], facts.source],
    }
    return {"Fact": pa.table(columns).filter(pa.array(stored))}


# -- names ----------------------------------------------------------------------------------------------------------


def _names(descriptions: Descriptions, rules: Rules) -> dict[str, pa.Table]:
    conditions, (distinct, number) = descriptions.conditions, descriptions.texts
    scene, uses = conditions.scene, descriptions.uses
    keyframe, used = conditions.keyframe[descriptions.sighting], np.unique(uses[uses != NOBODY])
    words = len(conditions.vocabulary)
    at = conditions.code(used), used // max(words, 1)
    which = np.zeros((len(scene.keyframes), words), bool)
    which[at[::-1]] = True
    sighting, code = np.nonzero(which[conditions.keyframe] & (conditions.states != FALSE))
    name, place = np.nonzero(uses != NOBODY)
    fits, fitting = descriptions.fits, np.nonzero(descriptions.fits >= 0)
    names = np.arange(len(uses))
    moved = []
    for by in shift_frames(rules):
        to = find_sorted(scene.keyframes[keyframe] + by, scene.keyframes)
        there = np.flatnonzero(to != NOBODY)
        moved.append(pa.table({"from": there, "to": fits[number[there], to[there]], "by": np.full(len(there), by)}))
    return {
        "Condition": pa.table(
            {
                "id": used,
                "frame": scene.keyframes[at[1]],
                "kind": pa.array([conditions.vocabulary[one].kind for one in at[0]], pa.string()),
                "words": pa.array([conditions.vocabulary[one].words for one in at[0]], pa.string()),
            }
        ),
        "Description": pa.table({"id": np.arange(len(distinct)), "conditions": pa.array(distinct, pa.string())}),
        "Name": pa.table(
            {
                "id": names,
                "size": np.count_nonzero(uses != NOBODY, axis=1),
                "people": conditions.people[keyframe],
                "general": descriptions.general,
                "poseless": descriptions.poseless,
            }
        ),
        "Satisfies": pa.table(
            {
                "from": conditions.moment[sighting],
                "to": conditions.keyframe[sighting] * words + code,
                "certain": conditions.states[sighting, code] == TRUE,
            }
        ),
        "Uses": pa.table({"from": name, "to": uses[name, place], "place": 1 << place}),
        "Of": pa.table({"from": names, "to": number}),
        "Moved": pa.concat_tables(moved),
        "Fits": pa.table({"from": fitting[0], "to": fits[fitting]}),
    }


# -- segments -------------------------------------------------------------------------------------------------------


def _segments(scene: Scene, rules: Rules) -> dict[str, pa.Table]:
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
    return {"Segment": pa.table(columns), "Acts": pa.table({"from": persons, "to": columns["id"]})}


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
