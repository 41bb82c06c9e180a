"""Everything that a load holds for certain, one row per fact and frame, so that two loads can be compared.

A fact is certain where a table states it without doubt, and also where its absence follows: an action that a whole list
of actions does not name is false for certain. `gained` compares two loads of one world: `certain_facts` of the second
that the first does not hold. All of it is read from the interval tables, as `docs/tables.md` explains their columns.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.labels import POSES

GAP, EDGE, QUIET = 8, 15, 46
"""Frames over which one frame's labels reach: a closed gap of seven frames, a second, and the quiet of a segment."""

REACH = {
    "action": GAP,
    "no action": GAP,
    "no pose": GAP,
    "membership": GAP,
    "interaction": GAP,
    "no interaction": GAP,
    "handling": GAP,
    "no handling": GAP,
    "group_size": EDGE,
}
"""Frames round a changed frame within which the facts of a kind may change; those of the others stay in their frame."""

ELSEWHERE = frozenset({"absence", "segment", "closed segment", "object"})
"""Kinds of facts that a change may alter at any distance: absence depends on a person's first and last box."""


def certain_facts(tables):
    """The certain facts of a load's interval tables: {kind: {column: values}}, each with a column `frame`."""
    seen = tables["sightings"]
    person = ("frame", "track")
    facts = {"box": _columns(seen, *person, "x", "y", "w", "h", "sector")}
    for flag in ("clear", "listed", "interactions_listed", "handles_listed", "located"):
        facts[flag] = _columns(seen.filter(seen[flag]), *person)
    for name in ("pose", "group_size", "face_visible", "occlusion"):
        facts[name] = _columns(seen.filter(pc.is_valid(seen[name])), *person, name)
    near = seen.filter(pc.and_(pc.is_valid(seen["distance_word"]), pc.is_null(seen["distance_word_other"])))
    facts["distance"] = _columns(near, *person, "distance_word")
    facts["place"] = _columns(seen.filter(seen["located"]), *person, "cx", "cy", "cz", "heading")
    frames = tables["frames"]
    facts["annotated"] = _columns(frames.filter(frames["annotated"]), "frame")
    facts["keyframe"] = _columns(frames.filter(frames["keyframe"]), "frame")
    for kind, table in (("presence", "presences"), ("absence", "absences")):
        facts[kind] = _spread(tables[table].filter(tables[table]["certain"]), "track")
    for kind, table, *names in (
        ("action", "actions", "track", "action"),
        ("membership", "memberships", "track", "cluster"),
        ("interaction", "interactions", "source", "target", "label"),
        ("handling", "handles", "track", "object", "category_id", "verb"),
    ):
        facts[kind] = _spread(tables[table].filter(tables[table]["certain"]), *names)
    beside = tables["beside"]
    # Person-frame relations join keyframes.
    facts["beside"] = _spread(beside.filter(beside["certain"]), "source", "target", "label", step=15)
    segments = tables["segments"]
    facts["segment"] = _columns(segments, "track", "action", "first", "last", "start", "end", frame="first")
    facts["closed segment"] = _columns(
        segments.filter(segments["closed"]), "track", "action", "first", "last", frame="first"
    )
    # Without its category's name a thing may be anything, somebody too.
    named, things = tables["objects"], tables["object_sightings"]
    named = pc.unique(named.filter(pc.is_valid(named["category"]))["category_id"])
    things = things.filter(pc.is_in(things["category_id"], named))
    facts["object"] = _columns(things, "frame", "object", "category_id", "x", "y", "w", "h")
    return facts


def false_facts(tables, known):
    """Find the facts that a load denies for certain, among the names that the tables of another load, `known`, hold.

    A list that was read whole denies what it does not name, and so does a pose that is known.
    """
    seen, facts = tables["sightings"], {}
    listed = seen.filter(seen["listed"])
    posed = pc.is_valid(listed["pose"]).to_numpy(zero_copy_only=False)
    for names, rows in (
        (sorted(POSES), posed),
        (_distinct(_either(known, "actions"), "action", POSES), np.ones(len(listed), bool)),
    ):
        possible = _times(
            _columns(listed.filter(pa.array(rows)), "frame", "track"), {"action": np.array(names, object)}
        )
        facts["no action" if names != sorted(POSES) else "no pose"] = _without(
            possible, _spread(_either(tables, "actions"), "track", "action")
        )
    told = seen.filter(seen["interactions_listed"])
    pairs = _unique(_either(known, "interactions"), "source", "target", "label")
    facts["no interaction"] = _without(
        _both(told, "track", pairs, "source", "target"),
        _spread(_either(tables, "interactions"), "source", "target", "label"),
    )
    told = seen.filter(seen["handles_listed"])
    things = _unique(_either(known, "handles"), "track", "object", "category_id", "verb")
    facts["no handling"] = _without(
        _both(told, "track", things, "track"),
        _spread(_either(tables, "handles"), "track", "object", "category_id", "verb"),
    )
    frames = tables["frames"]
    keyframes = frames.filter(pc.and_(frames["keyframe"], frames["annotated"]))["frame"]
    there = seen.filter(pc.is_in(seen["frame"], keyframes.combine_chunks()))
    sides = pc.match_substring(known["beside"]["label"], "robot view")
    stands = _spread(tables["beside"], "source", "target", "label", step=15)
    for kind, rows, people in (
        ("not first beside", known["beside"].filter(sides), there),
        ("not near", known["beside"].filter(pc.invert(sides)), there.filter(there["located"])),
    ):
        pairs = _unique(rows, "source", "target", "label")
        facts[kind] = _without(_both(people, "track", pairs, "source", "target"), stands)
    return facts


def _either(tables, kind):
    """The rows of a table of labels, and those of what may hold without a label."""
    return pa.concat_tables([tables[kind], tables[f"possible_{kind}"]], promote_options="default")


def closed_gaps(tables):
    """What lies in a closed gap, under the kinds of `false_facts`: unknown only because of labels on both sides."""
    facts = {}
    for kinds, table, *names in (
        (("no action", "no pose"), "possible_actions", "track", "action"),
        (("no interaction",), "possible_interactions", "source", "target", "label"),
        (("no handling",), "possible_handles", "track", "object", "category_id", "verb"),
    ):
        gaps = _spread(tables[table].filter(tables[table]["gap"]), *names)
        facts |= dict.fromkeys(kinds, gaps)
    return facts


def with_gaps(segments, actions):
    """Per segment of `certain_facts` whether a closed gap lies in it; `actions` is the table `possible_actions`."""
    gaps = _columns(actions.filter(actions["gap"]), "track", "action", "last", frame="first")
    return np.array(
        [
            bool(
                (
                    (gaps["track"] == track)
                    & (gaps["action"] == action)
                    & (gaps["frame"] <= last)
                    & (gaps["last"] >= first)
                ).any()
            )
            for track, action, first, last in zip(
                *(segments[n] for n in ("track", "action", "first", "last")), strict=True
            )
        ],
        np.bool_,
    )


def gained(before, after):
    """Facts of `after` that `before` lacks, as {kind: rows}; both are from the functions above."""
    found = {}
    for kind, columns in after.items():
        new = ~_isin(columns, before[kind])
        if new.any():
            found[kind] = {name: values[new] for name, values in columns.items()}
    return found


def of_rows(facts, mask):
    """The facts at a mask."""
    return {name: values[mask] for name, values in facts.items()}


# -- columns -------------------------------------------------------------------------------------------------------


def _columns(table, *names, frame="frame"):
    found = {"frame": table[frame].to_numpy()}
    for name in names:
        column = table[name].combine_chunks()
        if pa.types.is_dictionary(column.type):
            column = column.dictionary_decode()
        if pa.types.is_floating(column.type):
            column = pc.round(column, 9)
        found[name] = column.to_numpy(zero_copy_only=False)
    return found


def _spread(table, *names, step=1):
    """One row per frame of every interval."""
    first, last = table["first"].to_numpy(), table["last"].to_numpy()
    counts = (last - first) // step + 1
    row = np.repeat(np.arange(len(first)), counts)
    place = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    columns = _columns(table, *names, frame="first")
    return {name: values[row] for name, values in columns.items()} | {"frame": first[row] + place * step}


def _distinct(table, name, without=()):
    return sorted(set(table[name].unique().to_pylist()) - set(without))


def _unique(table, *names):
    return table.select(names).group_by(list(names)).aggregate([])


def _times(left, right):
    """Every row of one set of columns with every row of another."""
    n, m = len(left["frame"]), len(next(iter(right.values())))
    return {name: np.repeat(values, m) for name, values in left.items()} | {
        name: np.tile(values, n) for name, values in right.items()
    }


def _both(people, track, pairs, *ends):
    """Rows of `pairs` at every frame at which each of their ends is among `people` (frame, track)."""
    frames = np.unique(people["frame"].to_numpy())
    columns = {name: pairs[name].to_numpy(zero_copy_only=False) for name in pairs.column_names}
    possible = _times({"frame": frames}, columns)
    there = _columns(people, "frame", track)
    for end in ends:
        inside = _isin({"frame": possible["frame"], "track": possible[end]}, there)
        possible = {name: values[inside] for name, values in possible.items()}
    return possible


def _without(rows, others):
    keep = ~_isin(rows, others)
    return {name: values[keep] for name, values in rows.items()}


def _isin(rows, others):
    """Per row whether the others hold it, compared by the columns of the rows."""
    n = len(rows["frame"])
    key = np.zeros(n + len(others["frame"]), np.int64)
    for name, values in rows.items():
        both = np.concatenate([values, others[name]])
        if both.dtype == object:
            both = pa.array(both, pa.string(), from_pandas=True).dictionary_encode(null_encoding="encode").indices
            code = np.asarray(both)
        else:
            code = np.unique(both, return_inverse=True)[1]
        key = np.unique(key * (int(code.max(initial=0)) + 1) + code, return_inverse=True)[1]
    return np.isin(key[:n], key[n:])
