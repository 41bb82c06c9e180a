"""The same load with layers removed one by one: what the others say stays as it was.

Per layer it is written down which tables it owns, and what else may follow from it. All other annotation and interval
tables must be equal to the row. Columns that a layer fills in a shared table become null or false, and only those.
"""

from __future__ import annotations

import pytest
from loaded_stores import NAME, read_store
from worlds import CAMERAS, VISIBLE, member, person, person_3d, pose, thing

from jrdb_avr.schema.tables import ANNOTATIONS, INTERVALS, LABELED

FILES = ("2d", "3d", "social", "reasoning", "pose", "panoptic", "timestamps", "calibration", "images")

OWNED = {
    "2d": {"boxes_2d", "actions", "groups", "social_activities"},
    "3d": {"boxes_3d"},
    "social": {"demographics", "interactions", "group_info", "listed"},
    "reasoning": {"handles", "listed"},
    "pose": {"poses"},
    "panoptic": {"panoptic", "categories"},
    "timestamps": {"timestamps"},
    "calibration": {"calibration"},
    "images": set(),
}
"""Annotation tables that a file fills. `listed` is shared by row, `frames` by everybody: both are compared by layer."""

KINDS = {
    "2d": ("2d", "actions", "groups"),
    "3d": ("3d",),
    "social": ("demographics", "interactions", "group_info"),
    "reasoning": ("handles",),
    "pose": ("pose",),
    "panoptic": ("panoptic",),
    "timestamps": ("timestamps",),
    "calibration": (),
    "images": ("images",),
}
"""Layers of the `frames` table per file."""

FOLLOWS = {
    # Without 2D boxes nobody is seen, no keyframe is led by actions, and no relation has its people in view.
    "2d": set(INTERVALS) - {"demographics", "objects", "object_sightings"},
    # People whom only lidar saw go, and with them the first and last frames; relations in a person's own frame too.
    "3d": {"persons", "beside", "sightings"},
    "social": {"demographics", "interactions", "possible_interactions", "group_info", "persons", "sightings"},
    # Things that only the reasoning file names.
    "reasoning": {"handles", "possible_handles", "objects", "sightings"},
    "pose": {"sightings"},
    # What is handled has lost its name, and people among the things cannot be told from things.
    "panoptic": {"objects", "object_sightings", "handles", "possible_handles"},
    # Seconds stand beside the frames of every interval.
    "timestamps": {"frames", "presences", "absences", *LABELED, *(f"possible_{kind}" for kind in LABELED), "beside"},
    "calibration": set(),
    "images": {"frames"},
}
"""Interval tables that may change with a file, beside the rows of frames that only it knows."""


def whole_world():
    """Three people who walk, talk, hold and sit, in every layer."""

    def box(track, frame):
        return (300 * track + 2 * frame, 60, 50 + track, 200)

    frames = range(0, 40)
    told = {"gender": {"Female": "1"}, "age": {"Young_Adulthood": "1"}}
    info = {"venue": {"indoor_room/class": "1"}, "aim": {"socializing": "1"}}

    def social(track, frame, handles=None):
        return member(track, box(track, frame), told, [((track + 1) % 3, {"conversation": "1"})], info, handles)

    return {
        "2d": {f: [person(t, box(t, f), {"walking": 1}, (7, 1), VISIBLE) for t in range(3)] for f in frames},
        # One person whom the panorama does not show, and a frame beyond the others.
        "3d": {f: [person_3d(t, 2.0 + t, 1.0, distance=2.5 + t) for t in range(4)] for f in range(0, 42)},
        "social": {f: [social(t, f) for t in range(3)] for f in frames},
        "reasoning": {
            f: [social(t, f, [((t, 40), {"holding": "1"}), ((9, 71), {"opening": "2"})]) for t in (0, 1)]
            for f in frames
        },
        "pose": {f: [pose(t, 300.0 * t) for t in range(2)] for f in range(0, 39)},
        "panoptic": {f: [thing(0, 40), thing(1, 40), thing(5, 63), thing(None, 4)] for f in (0, 15, 30)},
        "timestamps": {"images": {f: 1549500000.0 + f * 0.07 for f in range(45)}},
        "calibration": CAMERAS,
        "images": [0, 15, 41],
    }


def tables_of(folder, layers):
    """Rows of the annotation and interval tables of a load."""
    store, found = read_store(folder, layers)
    assert [p for p in found.problems if p.kind == "file"] == []
    annotations = {table: store.annotation(table, NAME).to_pylist() for table in ANNOTATIONS}
    return annotations, {kind: store.interval(kind, NAME).to_pylist() for kind in INTERVALS}


STAND_INS = {"2d": ("social", "reasoning"), "social": ("reasoning",)}
"""Files that would give the 2D boxes or the social facts in place of a missing file."""


@pytest.mark.slow
@pytest.mark.parametrize("gone", FILES)
def test_the_rest_is_unchanged_without_a_layer(tmp_path, gone):
    world = {layer: content for layer, content in whole_world().items() if layer not in STAND_INS.get(gone, ())}
    whole, derived = tables_of(tmp_path / "whole", world)
    part, rest = tables_of(tmp_path / "part", {layer: content for layer, content in world.items() if layer != gone})
    for table in ANNOTATIONS:
        if table in ("frames", "listed"):
            assert part[table] == [row for row in whole[table] if row["layer"] not in KINDS[gone]], table
        else:
            assert part[table] == ([] if table in OWNED[gone] else whole[table]), table
    for kind in set(INTERVALS) - FOLLOWS[gone] - {"sequence", "frames"}:
        assert rest[kind] == derived[kind], kind


@pytest.mark.parametrize("layer", ["social", "reasoning"])
def test_richer_files_stand_in_for_the_boxes(tmp_path, layer):
    """Without 2D boxes of their own the same people are seen as the richer file has them."""
    world = whole_world()
    only = {layer: world[layer]}
    annotations, intervals = tables_of(tmp_path, only)
    boxes = [(row["frame"], row["track"], row["x"]) for row in annotations["boxes_2d"]]
    assert boxes == [
        (f, int(r["label_id"].split(":")[1]), r["box"][0]) for f, rows in world[layer].items() for r in rows
    ]
    assert {row["source"] for row in intervals["interactions"]} == ({0, 1, 2} if layer == "social" else {0, 1})
