"""The sample's other label files against an independent reading of their formats: COCO's own decoder for the segments,
a YAML parser for the calibration, plain JSON for the rest.
"""

import json
import re
from collections import Counter

import numpy as np
import pytest
from click.testing import CliRunner
from pycocotools import mask

from jrdb_avr.engine.cli import group

FRAMES = 75


def run(*arguments):
    result = CliRunner().invoke(group, list(map(str, arguments)))
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("formats") / "root"
    run("sample", folder, "--sequences", 4, "--frames", FRAMES, "--people", 20, "--no-images", "--workers", 1)
    return folder


def files(root, layer):
    return {path.stem: json.loads(path.read_text()) for path in sorted((root / "labels" / layer).glob("*.json"))}


def stuff(content):
    return {one["id"] for one in content["categories"] if not one["isthing"]}


def test_segments_decode_to_their_area_and_box_and_fill_the_picture(root):
    for content in files(root, "labels_2d_panoptic_stitched_CW").values():
        assert list(content) == ["categories", "images", "annotations"]
        ids = [one["id"] for one in content["annotations"]]
        assert ids == list(range(len(ids)))
        for one in content["annotations"]:
            code = {**one["segmentation"], "counts": one["segmentation"]["counts"].encode()}
            assert code["size"] == [480, 3760]
            assert one["area"] == mask.area(code) > 0
            assert one["bbox"] == mask.toBbox(code).tolist()


def test_panoptic_files_name_frames_and_categories(root):
    tracked = set()
    for name, content in files(root, "labels_2d_panoptic_stitched_CW").items():
        assert [one["file_name"] for one in content["images"]] == [
            f"image_stitched/{name}/{frame:06d}.jpg" for frame in range(0, FRAMES, 15)
        ]
        assert [one["id"] for one in content["images"]] == list(range(1, FRAMES // 15 + 1))
        assert {(one["width"], one["height"]) for one in content["images"]} == {(3760, 480)}
        assert len({one["id"] for one in content["categories"]}) == 72
        assert len(stuff(content)) == 11
        for one in content["annotations"]:
            inner = one.get("attributes", {})
            tracks = [one.get("tracking_id"), inner.get("tracking_id"), inner.get("floor_id")]
            tracked.add(tuple(track is not None for track in tracks))
            assert sum(track is not None for track in tracks) == (one["category_id"] not in stuff(content))
    assert len(tracked) == 4


def test_poses_have_the_format(root):
    flat = files(root, "labels_2d_stitched")
    points = 0
    for name, content in files(root, "labels_2d_pose_stitched_coco").items():
        assert list(content) == ["images", "annotations", "categories"]
        (category,) = content["categories"]
        assert category["id"] == 1
        assert len(category["keypoints"]) == 17
        assert sorted(map(sorted, category["skeleton"])) == sorted(
            [a + 1, b + 1]
            for a, b in re.findall(
                r"(\d+)-(\d+)", "1-2 0-4 3-4 8-10 5-7 10-13 14-16 4-5 7-12 4-8 3-6 13-15 11-14 6-9 8-11"
            )
            for a, b in [(int(a), int(b))]
        )
        names = {one["id"]: one["file_name"] for one in content["images"]}
        assert len(names) == len(content["images"])
        ids = [one["id"] for one in content["annotations"]]
        assert len(set(ids)) == len(ids)
        for one in content["annotations"]:
            folder, sequence, key = names[one["image_id"]].split("/")
            assert (folder, sequence) == ("image_stitched", name)
            people = {o["label_id"]: o["box"] for o in flat[name]["labels"].get(key, [])}
            if key in flat[name]["labels"] and people:
                assert f"pedestrian:{one['track_id']}" in people
            if "keypoints" not in one:
                continue
            assert len(one["keypoints"]) == 51
            triples = [one["keypoints"][k : k + 3] for k in range(0, 51, 3)]
            assert {v for *_, v in triples} <= {0, 1, 2}
            assert one["num_keypoints"] == sum(v > 0 for *_, v in triples)
            for x, y, v in triples:
                assert (0 <= x < 3760 and 0 <= y < 480) if v else (x, y) == (0, 0)
                points += v > 0
    assert points > 10_000


CODES = {"1", "2", "3"}


def test_social_and_reasoning_records_have_the_format(root):
    for name, content in files(root, "labels_2d_activity_social_stitched").items():
        flat = json.loads((root / "labels" / "labels_2d_stitched" / f"{name}.json").read_text())["labels"]
        assert list(content["labels"]) == list(flat)
        for key, objects in content["labels"].items():
            for one, other in zip(objects, flat[key], strict=True):
                assert other.items() <= one.items()
                if one["label_id"] != other["label_id"] or "demographics_info" not in one:
                    continue
                assert len(one["demographics_info"]) <= 1
                assert len(one["group_info"]) <= 1
                for element in one["demographics_info"]:
                    assert list(element) == ["gender", "age", "race"]
                for element in one["group_info"]:
                    assert list(element) == ["venue", "aim", "inter", "BPC", "SSC", "location_pre"]
                    assert re.fullmatch(r"(indoor|outdoor)[_:][a-z_/]+", *element["venue"])
                for element in one["demographics_info"] + one["group_info"]:
                    for field, values in element.items():
                        assert values or field == "inter"
                        assert set(values.values()) <= CODES
                for entry in one.get("H-interaction", []):
                    assert list(entry) == ["pair", "box_pair", "inter_labels"]
                    assert re.fullmatch(r"pedestrian:\d+", entry["pair"])
                    assert entry["pair"] != one["label_id"]
                    assert len(entry["box_pair"]) == 4
                    assert set(entry["inter_labels"].values()) <= CODES


def test_things_handled_are_things_of_the_panoptic_file(root):
    checked = 0
    for name, content in files(root, "labels_2d_stitched_new_version").items():
        panoptic = json.loads((root / "labels" / "labels_2d_panoptic_stitched_CW" / f"{name}.json").read_text())
        things = {one["id"] for one in panoptic["categories"]} - stuff(panoptic)
        for objects in content["labels"].values():
            clusters = Counter(one["social_group"]["cluster_ID"] for one in objects if "social_group" in one)
            for one in objects:
                assert "H-interaction" not in one
                if "group_size" in one and len(clusters) == len(objects):
                    assert one["group_size"] == clusters[one["social_group"]["cluster_ID"]]
                for entry in one.get("HOI", []):
                    assert sorted(entry) == ["inter_labels", "pair"]
                    track, category = map(int, entry["pair"])
                    assert track >= 0
                    assert category in things
                    assert set(entry["inter_labels"].values()) <= CODES
                    checked += 1
    assert checked > 500


def test_timestamps_have_the_format(root):
    for folder in sorted((root / "timestamps").iterdir()):
        times = {}
        for file, key, names in (
            ("frames_img.json", "cameras", [f"image_{k}" for k in (0, 2, 4, 6, 8)]),
            ("frames_pc.json", "pointclouds", ["upper_velodyne", "lower_velodyne"]),
        ):
            rows = json.loads((folder / file).read_text())["data"]
            assert [row["frame_id"] for row in rows] == list(range(len(rows)))
            assert len(rows) >= FRAMES
            times[file] = np.array([row["timestamp"] for row in rows])
            assert (np.diff(times[file]) > 0.05).all()
            for row in rows:
                assert [part["name"] for part in row[key]] == names
                assert all(f"/{folder.name}/{row['frame_id']:06d}." in part["url"] for part in row[key])
        assert np.abs(times["frames_img.json"] - times["frames_pc.json"]).max() <= 0.04
