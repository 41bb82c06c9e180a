"""A store of made-up interval tables of every kind, and its graph: scenes of any size without label files.

    store = table_store(tmp_path, seed=1)

The tables keep to their schemas and to the promises that queries rest on (intervals of one fact do not overlap, an
interaction stands in both directions), and are otherwise random: nulls, uncertain rows and empty corners everywhere.
"""

from __future__ import annotations

import itertools

import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.graph import build_scene
from jrdb_avr.queries.graph.handle import build_graph
from jrdb_avr.queries.manifest import Manifest, SequenceEntry
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.labels import ACTIONS, AGES, GENDERS, INTERACTIONS, OCCLUSIONS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT
from jrdb_avr.schema.rules import LoadRules, rules_hash
from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS, LABELED, LAYERS

CATEGORIES = ("bag", "chair/sofa", "door", "phone", None)
VERBS = ("holding", "sitting", "opening", "looking at")
GROUP_FACTS = {
    "venue": ("indoor", "outdoor"),
    "aim": ("conversation", "eating"),
    "bpc": ("floor", "chair"),
    "ssc": ("table", "door"),
    "location": ("hall",),
    "inter": ("talking",),
}


def table_store(folder, seed=0, sequences=("yard-1_0", "hall-2_0"), frames=121, people=12):
    """Write the tables and the graph into `folder`/store and return the store."""
    store = Store(folder / "store")
    entries = {}
    for i, name in enumerate(sequences):
        tables = scene_tables(name, np.random.default_rng([seed, i]), frames, people)
        hashes = {f"intervals/{kind}/{name}.parquet": store.write_interval(kind, name, tables[kind]) for kind in tables}
        for layer, schema in ANNOTATIONS.items():
            hashes[f"annotations/{layer}/{name}.parquet"] = store.write_annotation(layer, name, schema.empty_table())
        entries[name] = SequenceEntry(LAYERS, hashes)
    rules = LoadRules()
    with build_graph(store.graph_path) as graph:
        rows = build_scene(graph, store, list(entries))
    store.write_manifest(Manifest(None, rules, rules_hash(rules), entries, rows))
    return store


def scene_tables(sequence, rng, frames, people):
    """Interval tables by kind."""
    (other,) = rng.spawn(1)
    tracks = np.sort(rng.choice(people * 3, people, replace=False))
    clusters = list(range(1, max(2, people // 3) + 1))
    keyframes = list(range(0, frames, 15))
    spans = [_presence(rng, frames) for _ in tracks]
    things = [(int(n), int(c)) for c in range(4) for n in range(3)]
    labels = list(INTERACTIONS[:6])
    pairs = [(a, b) for i, a in enumerate(tracks) for b in tracks[i + 1 :] if rng.random() < 6 / people]
    rows = {
        "sequence": [
            {"fps": 15.0, "frame_count": frames, "layers": list(LAYERS), "action_step": 1}
            | {"keyframes": keyframes, "has_attributes": True}
        ],
        "frames": [
            {"frame": f, "seconds": f / 15, "keyframe": f % 15 == 0, "annotated": True, "image": f % 15 == 0}
            for f in range(frames)
        ],
        "persons": [
            {"track": t, "gender": _maybe(rng, GENDERS), "age": _maybe(rng, AGES), "ethnicity": None}
            | {"first_frame": first, "last_frame": last}
            for t, (first, last) in zip(tracks, spans, strict=True)
        ],
        "demographics": [],
        "actions": [
            {"track": t, "action": action, **_sure(rng, s)} | {"difficulty": _maybe(rng, (1, 2, 3))}
            for t, (first, last) in zip(tracks, spans, strict=True)
            for action in rng.choice(ACTIONS, 4, replace=False)
            for s in _runs(rng, first, last)
        ],
        "memberships": [
            {"track": t, "cluster": int(rng.choice(clusters)), **_sure(rng, s)}
            for t, (first, last) in zip(tracks, spans, strict=True)
            for s in _runs(rng, first, last)
        ],
        "handles": [
            {"track": t, "object": thing, "category_id": category, "verb": str(rng.choice(VERBS)), **_sure(rng, s)}
            for t, (first, last) in zip(tracks, spans, strict=True)
            for thing, category in [things[int(n)] for n in rng.choice(len(things), 2, replace=False)]
            for s in _runs(rng, first, last)
        ],
        "objects": [
            {"object": thing, "category_id": category, "category": CATEGORIES[category], "first_frame": 0}
            | {"last_frame": frames - 1 if thing else None}
            for thing, category in things
        ],
        "object_sightings": [
            {"frame": f, "object": thing, "category_id": category, "angle": float(other.uniform(0, 360))}
            | {side: float(other.uniform(1, 400)) for side in "xywh"}
            for f in keyframes
            for thing, category in things
            if other.random() < 0.5
        ],
        "presences": [],
        "absences": [],
        "group_info": [
            {"cluster": c, "attribute": attribute, "value": value, "votes": int(rng.integers(1, 9))}
            | {"chosen": bool(rng.random() < 0.7) and (attribute != "venue" or value == values[0])}
            for c in clusters
            for attribute, values in GROUP_FACTS.items()
            for value in values
        ],
        "interactions": [],
        "beside": [],
        "segments": [],
    }
    for t, (first, last) in zip(tracks, spans, strict=True):
        cuts = np.unique([first, last + 1, *other.integers(first, last + 1, 3)])
        for kind, (a, b) in zip(itertools.cycle(("presences", "absences")), itertools.pairwise(cuts), strict=False):
            rows[kind].append({"track": t, **_span((a, b - 1)), "certain": bool(other.random() < 0.7)})
    for a, b in pairs:
        for label in rng.choice(labels, 2, replace=False):
            for s in _runs(rng, 0, frames - 1):
                sure = _sure(rng, s)
                for source, target in ((a, b), (b, a)):
                    rows["interactions"].append({"source": source, "target": target, "label": str(label), **sure})
    for f in keyframes:
        here = rng.permutation(tracks)
        for a, b in itertools.pairwise(here):
            sure = {**_span((f, f)), "certain": bool(rng.random() < 0.7)}
            rows["beside"].append({"source": a, "target": b, "label": FIRST_LEFT, **sure})
            rows["beside"].append({"source": b, "target": a, "label": FIRST_RIGHT, **sure})
    for a, b in pairs:
        rows["beside"].append(
            {"source": a, "target": b, "label": "front left, close", **_span((0, frames // 2)), "certain": True}
        )
    # Each group has a label of one member at least.
    for row in {row["cluster"]: row for row in rows["memberships"]}.values():
        row["written"] = True
    for kind in LABELED:
        rows[f"possible_{kind}"] = [row | {"gap": row["first"] % 3 > 0} for row in rows[kind] if not row["written"]]
        rows[kind] = [row for row in rows[kind] if row["written"]]
    tables = {
        kind: pa.Table.from_pylist([{"sequence": sequence, **_plain(row)} for row in rows[kind]], INTERVALS[kind])
        for kind in rows
    }
    return tables | {"sightings": _sightings(sequence, rng, tracks, spans)}


def _sightings(sequence, rng, tracks, spans):
    """Person by person, a tenth of the frames left out."""
    where = [
        (t, f)
        for t, (first, last) in zip(tracks, spans, strict=True)
        for f in range(first, last + 1)
        if rng.random() > 0.1
    ]
    n = len(where)
    x, y, w, h = (rng.uniform(low, high, n) for low, high in ((0, 3700), (50, 200), (10, 300), (40, 250)))
    located = rng.random(n) < 0.7
    angle = (x + w / 2) / 3760 * 360 % 360
    off = np.abs(180 - np.abs(180 - np.abs(angle[:, None] - np.array([*ROBOT_SECTORS.values()]))))
    sector = pa.array(np.array([*ROBOT_SECTORS])[off.argmin(axis=1)], mask=off.min(axis=1) > 40)
    words = np.array(("very close", "close", "moderate", "far", "very far"))
    distance = rng.uniform(0.3, 20, n)
    columns = {
        "sequence": [sequence] * n,
        "frame": [f for _, f in where],
        "track": [t for t, _ in where],
        **dict(zip("xywh", (x, y, w, h), strict=True)),
        "angle": angle,
        "occlusion": _masked(rng, rng.choice(OCCLUSIONS, n)),
        "no_eval": rng.random(n) < 0.1,
        "clear": rng.random(n) < 0.6,
        "face_visible": _masked(rng, rng.random(n) < 0.5),
        "listed": rng.random(n) < 0.9,
        "interactions_listed": rng.random(n) < 0.9,
        "handles_listed": rng.random(n) < 0.9,
        "pose": _masked(rng, rng.choice(POSES, n)),
        "cluster": _masked(rng, rng.integers(1, 5, n)),
        "group_size": _masked(rng, rng.integers(1, 6, n)),
        "sector": sector,
        "located": located,
        **{
            k: pa.array(distance if k == "distance" else rng.uniform(-9, 9, n), mask=~located)
            for k in ("distance", "cx", "cy", "cz")
        },
        "heading": _masked(rng, rng.uniform(-3, 3, n)),
        "distance_word": pa.array(words[rng.integers(0, 5, n)], mask=~located),
        "distance_word_other": pa.nulls(n, pa.string()),
    }
    return pa.table(columns).select(INTERVALS["sightings"].names).cast(INTERVALS["sightings"])


def _presence(rng, frames):
    first = int(rng.integers(0, frames // 2))
    return first, int(rng.integers(frames // 2, frames))


def _runs(rng, first, last):
    """Disjoint spans within [first, last], with a gap between them."""
    at = first + int(rng.integers(0, 30))
    while at < last:
        end = min(last, at + int(rng.integers(0, 60)))
        yield at, end
        at = end + int(rng.integers(2, 40))


def _span(span):
    first, last = span
    return {"first": first, "last": last, "first_s": first / 15, "last_s": last / 15}


def _sure(rng, span):
    certain = bool(rng.random() < 0.75)
    return {**_span(span), "certain": certain, "written": certain or bool(rng.random() < 0.5)}


def _maybe(rng, values):
    pick = rng.integers(0, len(values) + 1)
    return None if pick == len(values) else values[pick]


def _masked(rng, values, share=0.2):
    return pa.array(values, mask=rng.random(len(values)) < share)


def _plain(row):
    return {key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()}
