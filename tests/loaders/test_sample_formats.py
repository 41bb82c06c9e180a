"""The sample's other label files against an independent reading of their formats: COCO's own decoder for the segments,
a YAML parser for the calibration, plain JSON for the rest.
"""

import json
from collections import Counter

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


def test_people_are_drawn_in_their_boxes_and_fill_them(root):
    checked = 0
    for name, content in files(root, "labels_2d_panoptic_stitched_CW").items():
        (pedestrian,) = (one["id"] for one in content["categories"] if one["name"].lower().endswith("pedestrian"))
        labels = json.loads((root / "labels" / "labels_2d_stitched" / f"{name}.json").read_text())["labels"]
        for one in content["annotations"]:
            tracks = [*one.get("attributes", {}).values(), one.get("tracking_id")]
            records = labels[f"{(one['image_id'] - 1) * 15:06d}.jpg"]
            for record in records if one["category_id"] == pedestrian else ():
                (x, y, w, h), (left, top, width, height) = one["bbox"], record["box"]
                if record["label_id"] != f"pedestrian:{tracks[0]}" or left < 0 or left + width > 3760:
                    continue
                # Lines are wider than the joints at the edge of a box.
                slack = 2 + height // 10
                assert left - slack <= x and x + w <= left + width + slack
                assert top - slack <= y and y + h <= top + height + slack
                if record["attributes"].get("occlusion") == "Fully_visible" and "lying" not in record["action_label"]:
                    assert h > 0.8 * height
                    checked += 1
    assert checked > 50


CODES = {"1", "2", "3"}


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
