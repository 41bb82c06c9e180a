"""The same load with layers removed one by one: what the others say stays as it was.

Per layer it is written down which tables it owns, and what else may follow from it. All other annotation and interval
tables must be equal to the row. Columns that a layer fills in a shared table become null or false, and only those.
"""

from __future__ import annotations

import random
import tempfile
from functools import cache
from itertools import combinations

import pytest
from loaded_stores import NAME, read_store
from random_worlds import random_world
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

COLUMNS = {
    "3d": {"located", "distance", "distance_word", "distance_word_other", "cx", "cy", "cz", "heading"},
    "social": {"interactions_listed"},
    "reasoning": {"handles_listed"},
    "pose": {"face_visible"},
}
"""Columns of `sightings` that a file fills."""

SECONDS = {"seconds", "first_s", "last_s"}


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


@cache
def world_of(seed):
    """A random world; of those with few layers another."""
    if seed is None:
        return whole_world()
    for number in range(seed, 10**9, 100):
        (world,) = random_world(random.Random(number), NAME).values()
        if {"2d", "3d", "social", "reasoning", "pose"} <= set(world):
            return world
    raise AssertionError


def tables_of(folder, layers):
    """Annotation and interval tables of a load as {name: {row, ...}}, or None where nothing could be loaded."""
    store, found = read_store(folder, layers)
    assert [p for p in found.problems if p.kind == "file"] == []
    if not found.frames:
        return None
    annotations = {table: store.annotation(table, NAME).to_pylist() for table in ANNOTATIONS}
    intervals = {kind: store.interval(kind, NAME).to_pylist() for kind in INTERVALS}
    return annotations, intervals


def plain(rows, without=()):
    """Rows that compare, columns left out."""
    return sorted(repr({k: v for k, v in row.items() if k not in without}) for row in rows)


def check_annotations(whole, part, gone):
    """Every table of the other layers, as it was."""
    owned = set().union(*(OWNED[layer] for layer in gone))
    kinds = {kind for layer in gone for kind in KINDS[layer]}
    for table in ANNOTATIONS:
        if table in ("frames", "listed"):
            left = [row for row in whole[table] if row["layer"] not in kinds]
            assert plain(part[table]) == plain(left), table
        elif table in owned:
            assert part[table] == [], table
        else:
            assert part[table] == whole[table], table


def check_intervals(whole, part, gone):
    """Every table that does not follow from what is gone, as it was; in the others what does not."""
    follows = set().union(*(FOLLOWS[layer] for layer in gone))
    for kind in set(INTERVALS) - follows - {"sequence", "frames"}:
        assert part[kind] == whole[kind], kind
    if "2d" in gone:
        return
    check_frames(whole, part, gone)
    lost = set().union(*(COLUMNS.get(layer, set()) for layer in gone))
    assert plain(part["sightings"], lost) == plain(whole["sightings"], lost)
    for row in part["sightings"]:
        assert all(row[name] in (None, False) for name in lost)
    if "timestamps" in gone:
        for kind in ("presences", "absences", "actions", "possible_actions", "memberships", "possible_memberships"):
            assert plain(part[kind], SECONDS) == plain(whole[kind], SECONDS), kind
    # What stays of relations stays as it was.
    robot = [[row for row in tables["beside"] if row["label"].endswith("(robot view)")] for tables in (whole, part)]
    assert plain(robot[0], SECONDS) == plain(robot[1], SECONDS)
    for kind in ("interactions", "possible_interactions", "handles", "possible_handles"):
        if part[kind] and not {"panoptic", "timestamps"} & set(gone):
            assert part[kind] == whole[kind], kind
    told = {row["track"]: row for row in whole["persons"]}
    for row in part["persons"]:
        fields = () if "social" in gone else ("gender", "age", "ethnicity")
        assert [row[name] for name in fields] == [told[row["track"]][name] for name in fields]


def check_frames(whole, part, gone):
    """Frames that the other layers know, with the same keyframes: actions lead them, and those are here."""
    without = SECONDS if "timestamps" in gone else set()
    without = without | ({"image"} if "images" in gone else set())
    before = {row["frame"]: row for row in whole["frames"]}
    for row in part["frames"]:
        assert plain([row], without) == plain([before[row["frame"]]], without)
    (now,), (then,) = part["sequence"], whole["sequence"]
    assert now["layers"] == [name for name in then["layers"] if name not in {k for g in gone for k in KINDS[g]}]
    for name in ("fps", "action_step", "keyframes", "has_attributes"):
        assert now[name] == then[name], name


def check_removal(tmp_path, seed, *gone):
    world = without_stand_ins(world_of(seed), gone)
    left = {layer: content for layer, content in world.items() if layer not in gone}
    gone = tuple(layer for layer in gone if layer in world)
    whole = whole_tables(seed, tuple(world))
    part = tables_of(tmp_path / "part", left)
    check_annotations(whole[0], part[0], gone)
    check_intervals(whole[1], part[1], gone)


@cache
def whole_tables(seed, layers):
    """Tables of these layers of a world."""
    with tempfile.TemporaryDirectory() as folder:
        return tables_of(folder, {layer: world_of(seed)[layer] for layer in layers})


def without_stand_ins(world, gone):
    """The world without files that would give the 2D boxes or the social facts in place of those gone."""
    banned = {"2d": ("social", "reasoning"), "social": ("reasoning",)}
    return {layer: content for layer, content in world.items() if not any(layer in banned.get(g, ()) for g in gone)}


@pytest.mark.parametrize("seed", [None, 1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("gone", FILES)
def test_the_rest_is_unchanged_without_a_layer(tmp_path, seed, gone):
    check_removal(tmp_path, seed, gone)


@pytest.mark.slow
@pytest.mark.parametrize("gone", list(combinations(FILES, 2)), ids="+".join)
def test_the_rest_is_unchanged_without_two_layers(tmp_path, gone):
    for seed in (None, 1, 2, 3):
        check_removal(tmp_path / str(seed), seed, *gone)


@pytest.mark.parametrize("seed", [None, 1])
def test_each_layer_alone_has_its_own_tables(tmp_path, seed):
    world = world_of(seed)
    whole, _ = whole_tables(seed, tuple(world))
    for layer in ("2d", "3d", "pose", "panoptic"):
        part, _ = tables_of(tmp_path / layer, {layer: world[layer]}) if layer in world else (whole, None)
        for table in OWNED[layer]:
            assert part[table] == whole[table], table


def test_the_reasoning_file_stands_in_for_the_social_one(tmp_path):
    """Without the social file the same facts come from the reasoning file, of the people that it has."""
    world = whole_world()
    del world["social"]
    annotations, _ = tables_of(tmp_path, world)
    whole, _ = tables_of(tmp_path / "whole", whole_world())
    for table in ("demographics", "interactions", "group_info"):
        assert annotations[table] == [row for row in whole[table] if row["track"] < 2], table
    assert annotations["handles"] == whole["handles"]


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
