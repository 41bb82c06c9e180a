"""Where files of layers are found: every name of the formats, per sequence, configurable; and what the report says."""

from __future__ import annotations

import json
import os

import pytest
from click.testing import CliRunner
from loaded_stores import NAME, reported_store
from worlds import coco_file, member, person, person_3d, pose, write_root

from jrdb_avr.engine.commands.load import command
from jrdb_avr.loaders.root import LAYER_FILES, find_root
from jrdb_avr.schema.errors import InputError

BOX = (100, 60, 50, 200)
NAMES = {
    "2d": ["labels_2d_stitched"],
    "3d": ["labels_3d"],
    "social": ["labels_2d_activity_social_stitched", "labels_2d_social"],
    "reasoning": ["labels_2d_stitched_new_version", "labels_2d_stitched_test_new_version1"],
    "pose": ["labels_2d_pose_stitched_coco", "pose_stitched"],
    "panoptic": [
        *(f"labels_2d_panoptic_stitched_CW{suffix}" for suffix in ("", "_test", "_with5s", "_wo5s")),
        *(f"labels_2d_panoptic_stitched_OW{suffix}" for suffix in ("", "_test", "_with5s", "_wo5s")),
    ],
}
"""In the order of preference."""


def put(root, folder, *sequences, text='{"labels": {}}'):
    (root / folder).mkdir(parents=True, exist_ok=True)
    for sequence in sequences:
        (root / folder / f"{sequence}.json").write_text(text)


def files_of(root, **layer_dirs):
    return {files.sequence: files.labels for files in find_root(root, layer_dirs or None).sequences}


@pytest.mark.parametrize("level", ["labels", ""], ids=["case 34 with labels/", "case 34 without"])
@pytest.mark.parametrize("layer, folder", [(layer, name) for layer, names in NAMES.items() for name in names])
def test_case_34_every_folder_name_is_known(tmp_path, layer, folder, level):
    put(tmp_path / level, folder, NAME)
    found = files_of(tmp_path)[NAME]
    assert found[layer] == str(tmp_path / level / folder / f"{NAME}.json")
    # Social and reasoning files stand in for the 2D layer, and no file for any other.
    assert set(found) == ({layer, "2d"} if layer in ("social", "reasoning") else {layer})


@pytest.mark.parametrize("layer", NAMES)
def test_later_folders_serve_the_sequences_that_earlier_ones_lack(tmp_path, layer):
    names = NAMES[layer]
    places = [f"{level}{name}" for name in names for level in ("labels/", "")]
    for i, place in enumerate(places):
        # Folder i holds sequences i, i + 1, ...: each sequence is in all folders up to its own.
        put(tmp_path, place, *(f"s-{k:02d}" for k in range(len(places)) if k <= len(places) - 1 - i))
    found = files_of(tmp_path)
    assert set(found) == {f"s-{k:02d}" for k in range(len(places))}
    for labels in found.values():
        assert labels[layer].startswith(str(tmp_path / places[0]))
    put(tmp_path, places[-1], "late-1")
    assert files_of(tmp_path)["late-1"][layer] == str(tmp_path / places[-1] / "late-1.json")


def test_folders_of_single_cameras_and_heads_are_left_alone(tmp_path):
    put(tmp_path, "labels/labels_2d_stitched", NAME)
    for folder in ("labels_2d", "labels_2d_head", "labels_2d_head_stitched", "labels_2d_pose_coco", "notes"):
        put(tmp_path, f"labels/{folder}", f"{NAME}_image0", "other-1")
    put(tmp_path, "labels/labels_2d_panoptic_CW", f"{NAME}_camera_2")
    put(tmp_path, "labels/labels_2d_social", f"{NAME}_image8", NAME)
    root = find_root(tmp_path)
    assert [files.sequence for files in root.sequences] == [NAME]
    assert (root.problems, root.notes) == ((), ())


def test_an_ending_in_capitals_is_an_ending(tmp_path):
    put(tmp_path, "labels_3d", NAME)
    (tmp_path / "labels_3d" / f"{NAME}.JSON").write_text("{}")
    (tmp_path / "labels_3d" / "other-1.JSON").write_text("{}")
    root = find_root(tmp_path)
    files = {files.sequence: files.labels["3d"].rpartition("/")[2] for files in root.sequences}
    assert files == {NAME: f"{NAME}.json", "other-1": "other-1.JSON"}
    (problem,) = root.problems
    assert (problem.file, problem.reason) == (f"{NAME}.JSON", f"in labels_3d: {NAME}.json is the same sequence")


def test_timestamps_and_calibration_belong_to_sequences_and_make_none(tmp_path):
    put(tmp_path, "labels_3d", NAME)
    for sequence in (NAME, "other-1"):
        put(tmp_path, f"timestamps/{sequence}", "frames_img")
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "cameras.yaml").write_text("cameras: {}")
    found = files_of(tmp_path)
    assert set(found) == {NAME}
    assert found[NAME]["timestamps"] == str(tmp_path / "timestamps" / NAME)
    assert found[NAME]["calibration"] == str(tmp_path / "calibration" / "cameras.yaml")


def test_a_given_folder_is_looked_in_instead(tmp_path):
    root = tmp_path / "root"
    put(root, "labels_2d_stitched", NAME)
    put(root, "labels_3d", NAME)
    put(root, "mine/boxes", NAME)
    put(tmp_path, "elsewhere", NAME)
    found = files_of(root, **{"2d": ["mine/boxes"], "3d": [str(tmp_path / "elsewhere")]})[NAME]
    assert found["2d"] == str(root / "mine" / "boxes" / f"{NAME}.json")
    assert found["3d"] == str(tmp_path / "elsewhere" / f"{NAME}.json")
    assert set(files_of(root, **{"3d": []})[NAME]) == {"2d"}
    with pytest.raises(InputError, match="is not a folder"):
        find_root(root, {"pose": ["nowhere"]})
    with pytest.raises(InputError, match="there is no layer heads"):
        find_root(root, {"heads": ["labels_3d"]})


def test_left_out_boxes_are_not_taken_from_another_file(tmp_path):
    put(tmp_path, "labels_2d_activity_social_stitched", NAME)
    assert set(files_of(tmp_path)[NAME]) == {"social", "2d"}
    assert set(files_of(tmp_path, **{"2d": []})[NAME]) == {"social"}


def test_empty_and_unreadable_folders_are_said(tmp_path, monkeypatch):
    put(tmp_path, "labels/labels_2d_stitched", NAME)
    (tmp_path / "labels" / "labels_3d").mkdir()
    (tmp_path / "pose_stitched").write_text("a file")
    put(tmp_path, "labels_2d_social", NAME)
    scandir = os.scandir

    def refusing(folder):
        if str(folder).endswith("labels_2d_social"):
            raise PermissionError(13, "Permission denied")
        return scandir(folder)

    monkeypatch.setattr(os, "scandir", refusing)
    root = find_root(tmp_path)
    assert root.notes == ("labels/labels_3d holds no label files of sequences",)
    assert [(p.kind, p.file, p.reason) for p in root.problems] == [
        ("file", "labels_2d_social", "folder cannot be read: Permission denied"),
        ("file", "pose_stitched", "folder cannot be read: Not a directory"),
    ]
    assert set(root.sequences[0].labels) == {"2d"}


# -- awkward cases of bringing layers together ---------------------------------------------------------------------


def load_one(tmp_path, layers):
    return reported_store(tmp_path, layers)


def test_case_1_the_frame_is_the_key_and_file_id_a_note(tmp_path):
    records = {f: [person(1, BOX, {"walking": 1}, file_id=f"{f + 2:06d}.jpg")] for f in range(3)}
    store, report = load_one(tmp_path, {"2d": records})
    rows = store.annotation("boxes_2d", NAME).to_pylist()
    assert [(row["frame"], row["file_id"]) for row in rows] == [(f, f"{f + 2:06d}.jpg") for f in range(3)]
    assert report.problems == []


def test_case_13_people_of_one_layer_only_are_kept(tmp_path):
    layers = {
        "2d": {0: [person(1, BOX), person(2, BOX)]},
        "3d": {0: [person_3d(2, 3, 1), person_3d(3, 4, 1)]},
    }
    store, report = load_one(tmp_path, layers)
    assert store.interval("persons", NAME)["track"].to_pylist() == [1, 2, 3]
    located = {row["track"]: row["located"] for row in store.interval("sightings", NAME).to_pylist()}
    assert located == {1: False, 2: True}
    assert (report.boxes, report.boxes_3d, report.refused) == (2, 2, 0)


def test_case_14_frames_are_those_of_any_layer_but_the_timestamps(tmp_path):
    layers = {
        "2d": {f: [person(1, BOX)] for f in range(5, 31)},
        "3d": {f: [person_3d(1, 3, 1)] for f in range(4, 29)},
        "pose": {f: [pose(1)] for f in range(5, 30)},
        "panoptic": {0: [], 15: [], 30: []},
        "timestamps": {"images": {f: 10.0 + f / 15 for f in range(100)}},
        "images": [33],
    }
    store, report = load_one(tmp_path, layers)
    frames = store.interval("frames", NAME)["frame"].to_pylist()
    assert frames == [0, *range(4, 31), 33]
    assert report.steps["panoptic"] == 15 and report.steps["pose"] == 1
    assert (report.label_frames.first, report.label_frames.last) == (0, 30)
    assert (report.image_frames.first, report.image_frames.last) == (33, 33)
    assert any("off by 2 frames" in warning and "0-30" in warning for warning in report.warnings)


def test_case_35_the_frame_count_is_what_is_there(tmp_path):
    store, report = load_one(tmp_path, {"2d": {f: [] for f in range(1726)}})
    assert store.interval("sequence", NAME)["frame_count"].to_pylist() == [1726]
    assert report.frames == 1726


def test_reasoning_serves_social_facts_only_without_a_usable_social_file(tmp_path):
    said = {"gender": {"Male": "1"}}, {"gender": {"Female": "1"}}
    social = {0: [member(1, BOX, said[0], [(2, {"conversation": "1"})]), member(2, BOX)]}
    reasoning = {0: [member(1, BOX, said[1], [(2, {"hugging": "1"})], alias="HHI"), member(2, BOX)]}

    def facts(name, layers):
        store, report = load_one(tmp_path / name, {"2d": {0: [person(1, BOX), person(2, BOX)]}} | layers)
        listed = {(row["layer"], row["track"]) for row in store.annotation("listed", NAME).to_pylist()}
        return (
            store.annotation("demographics", NAME)["value"].to_pylist(),
            store.annotation("interactions", NAME)["label"].to_pylist(),
            listed,
            [(problem.layer, problem.kind) for problem in report.problems],
        )

    handling = {("handles", 1), ("handles", 2)}
    both = facts("both", {"social": social, "reasoning": reasoning})
    assert both == (["male"], ["conversation"], {("interactions", 1)} | handling, [])
    alone = facts("alone", {"reasoning": reasoning})
    assert alone == (["female"], ["hugging"], {("interactions", 1), ("interactions", 2)} | handling, [])
    broken = facts("broken", {"social": "{", "reasoning": reasoning})
    assert broken == (*alone[:3], [("social", "file")])
    empty = facts("empty", {"social": {0: []}, "reasoning": reasoning})
    assert empty == alone


BROKEN = dict.fromkeys(("2d", "3d", "social", "reasoning", "pose", "panoptic", "calibration"), "{")


@pytest.mark.parametrize("layer", BROKEN)
def test_a_broken_file_of_any_layer_costs_that_layer(tmp_path, layer):
    layers = {
        "2d": {0: [person(1, BOX)]},
        "3d": {0: [person_3d(1, 3, 1)]},
        "social": {0: [member(1, BOX)]},
        "reasoning": {0: [member(1, BOX)]},
        "pose": coco_file({0: [pose(1)]}, "pose"),
        "panoptic": {0: []},
        "calibration": "cameras: {}",
    }
    _, report = load_one(tmp_path, layers | {layer: BROKEN[layer]})
    assert [(p.kind, p.layer) for p in report.problems] == [("file", layer)]
    assert set(report.files) == set(LAYER_FILES) - {"timestamps"}


def test_the_command_takes_folders_and_prints_what_it_found(tmp_path):
    root = write_root(tmp_path / "root", {NAME: {"2d": {f: [person(1, BOX)] for f in range(20)}, "images": [0, 2]}})
    (root / "labels" / "labels_2d_stitched").rename(root / "mine")
    (root / "labels" / "labels_3d").mkdir()
    arguments = [str(root), "--store", str(tmp_path / "store"), "--layer-dir", "2d=mine"]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    shown = " ".join(result.output.split())
    assert "0-19" in shown and "0-2" in shown and "off by 2 frames" in shown
    assert "labels/labels_3d holds no label files" in shown
    assert json.loads(CliRunner().invoke(command, [*arguments, "--json"]).stdout)[0]["files"] == {
        "2d": f"mine/{NAME}.json"
    }
    assert CliRunner().invoke(command, [*arguments, "--layer-dir", "2d"]).exit_code == 2
    with pytest.raises(InputError, match="no layer heads"):
        CliRunner().invoke(command, [*arguments, "--layer-dir", "heads=mine"], catch_exceptions=False)
