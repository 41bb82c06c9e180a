"""Where files of layers are found: every name of the formats, per sequence, configurable; and what the report says."""

from __future__ import annotations

import json
import os
import re

import pytest
from click.testing import CliRunner
from loaded_stores import NAME, reported_store
from worlds import member, person, write_root

from jrdb_avr.engine.commands.load import command
from jrdb_avr.loaders.root import find_root
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


def test_the_error_for_a_root_without_a_readable_folder_names_the_folder(tmp_path):
    (tmp_path / "labels_3d").write_text("a file")
    result = CliRunner().invoke(command, [str(tmp_path), "--store", str(tmp_path / "store"), "--workers", "1"])
    assert result.exit_code == 1 and "; first: labels_3d: folder cannot be read" in str(result.exception)


# -- awkward cases of bringing layers together ---------------------------------------------------------------------


def load_one(tmp_path, layers):
    return reported_store(tmp_path, layers)


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


@pytest.mark.parametrize("above", ["", "labels"])
def test_the_folder_of_one_layer_is_no_root(tmp_path, above):
    write_root(tmp_path, {"yard-1": {"2d": {0: [person(1, (100, 60, 50, 200))]}}}, labels_level=bool(above))
    with pytest.raises(InputError, match=f"is the folder of one layer: give {re.escape(str(tmp_path))}$"):
        find_root(tmp_path / above / "labels_2d_stitched")
    assert [files.sequence for files in find_root(tmp_path).sequences] == ["yard-1"]
