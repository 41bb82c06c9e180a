"""The sample's label files: the formats, the awkward cases, what they say of one another, and determinism.

The files are read as plain JSON; geometry and shares are computed here again.
"""

import gc
import hashlib
import itertools
import math
from collections import Counter

import msgspec
import pytest
from click.testing import CliRunner
from loaded_stores import MemoryStore, kept_in

from jrdb_avr.engine.cli import group
from jrdb_avr.loaders.load import load_shard
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.schema.labels import POSES, normal_action
from jrdb_avr.schema.rules import LoadRules

LONG = 600
"""Frames of a sequence; in a shorter one most tracks are cut before they have a gap."""


def run(*arguments):
    return CliRunner().invoke(group, ["sample", *map(str, arguments)])


@pytest.fixture(scope="module", params=["short", pytest.param("default", marks=pytest.mark.slow)])
def sizes(request):
    """(frames, people) of each sequence: the default's are dear. Each of the five has awkward cases of its own."""
    return {"short": [(LONG, 26)] + [(120, 26)] * 4, "default": [(1050, 34)] * 5}[request.param]


@pytest.fixture(scope="module")
def root(once, sizes):
    """The default sample but for its sizes."""

    def make(folder):
        list(write(plan(folder / "root", sizes, 0, "none"), 1))

    return once(f"sample-{sizes[1][0]}", make) / "root"


def files(root, layer):
    return {path.stem: as_json(path) for path in sorted((root / "labels" / layer).glob("*.json"))}


def as_json(path):
    """Plain JSON of a file. Nothing looks for cycles among its millions of objects, neither now nor later."""
    gc.disable()
    try:
        return msgspec.json.decode(path.read_bytes())
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="module")
def flat(root):
    return files(root, "labels_2d_stitched")


@pytest.fixture(scope="module")
def solid(root):
    return files(root, "labels_3d")


def people(objects):
    """Records of people, without those that are of nobody: another prefix, or a box of no size."""
    return [one for one in objects if one["label_id"].startswith("pedestrian:") and min(one["box"][2:]) > 0]


def digest(folder):
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_boxes_are_where_the_formulas_put_them(flat, solid):
    """Column and row of the 3D box's middle and feet, worked out from the published formulas."""
    errors, checked = [], 0
    for name, content in flat.items():
        there = solid[name]["labels"]
        for key, objects in list(content["labels"].items())[::7]:
            places = {one["label_id"]: one["box"] for one in there.get(key[:6] + ".pcd", [])}
            for one in people(objects):
                if one["label_id"] not in places:
                    continue
                box = places[one["label_id"]]
                x, y, w, h = one["box"]
                if w <= 10 or x == 0 or x + w == 3760:
                    continue  # a sliver cut at the image's edge
                distance = math.hypot(box["cx"], box["cy"])
                column = 3760 * (0.5 - math.atan2(box["cy"], box["cx"]) / (2 * math.pi))
                off = abs((x + w / 2 - column + 1880) % 3760 - 1880)
                feet = 209.4 + 482.9 * -(box["cz"] - box["h"] / 2) / distance
                head = 209.4 + 482.9 * -(box["cz"] + box["h"] / 2) / distance
                errors.append(max(off, abs(min(feet, 480) - (y + h)), abs(max(head, 0) - y)))
                checked += 1
    assert checked > 3000
    assert max(errors) < 2.5


def actions_of(one):
    return one.get("action_label") or {}


def poses_of(one):
    return [action for action in actions_of(one) if action in POSES]


def truncated_is(kind):
    return lambda one: isinstance(one["attributes"].get("truncated", 0), kind)


def difficulty_is(kind):
    return lambda one: any(isinstance(difficulty, kind) for difficulty in actions_of(one).values())


BOXES_2D = {
    "3: no occlusion": lambda one: "occlusion" not in one["attributes"],
    "3: no truncated": lambda one: "truncated" not in one["attributes"],
    "4: truncated as a text": truncated_is(str),
    "4: truncated as a boolean": truncated_is(bool),
    "4: truncated is null": truncated_is(type(None)),
    "5: difficulty as a whole number": difficulty_is(int),
    "5: difficulty as a float": difficulty_is(float),
    "5: difficulty as a text": difficulty_is(str),
    "7: an empty list of actions": lambda one: one.get("action_label") == {},
    "7: no list of actions": lambda one: "action_label" not in one,
    "7: an impossible action": lambda one: "impossible" in actions_of(one),
    "8: no posture": lambda one: actions_of(one) and not poses_of(one),
    "8: two postures": lambda one: len(poses_of(one)) == 2,
    "9: another spelling": lambda one: any(normal_action(action) != action for action in actions_of(one)),
    "10: person 0": lambda one: one["label_id"] == "pedestrian:0",
    "11: nobody's id": lambda one: not one["label_id"].startswith("pedestrian:"),
    "16: left of the picture": lambda one: one["box"][0] < 0,
    "16: over the right edge": lambda one: one["box"][0] + one["box"][2] > 3760,
    "17: a sliver": lambda one: 0 < one["box"][2] <= 10,
    "18: no width": lambda one: one["box"][2] == 0,
    "18: a negative height": lambda one: one["box"][3] < 0,
    "19: fully occluded": lambda one: one["attributes"].get("occlusion") == "Fully_occluded",
    "22: no_eval": lambda one: one["attributes"]["no_eval"],
    "28: a group without actions": lambda one: "social_group" in one and not actions_of(one),
    "28: actions without a group": lambda one: "social_group" not in one and actions_of(one),
}
BOXES_3D = {
    "20: interpolated": lambda one: one["attributes"]["interpolated"],
    "21: no points": lambda one: one["attributes"]["num_points"] == 0,
    "23: a heading beyond pi": lambda one: abs(one["box"]["rot_z"]) > math.pi,
    "24: no distance": lambda one: one["attributes"]["distance"] is None,
}
"""Awkward records of the files, by the number of the case in the list that the loaders are built after."""


def test_awkward_records_occur(flat, solid):
    for contents, cases in ((flat, BOXES_2D), (solid, BOXES_3D)):
        records = [one for content in contents.values() for some in content["labels"].values() for one in some]
        assert [what for what, holds in cases.items() if not any(map(holds, records))] == []


@pytest.fixture(scope="module")
def refused(root, flat):
    """What a load refuses, counted in the files: (sequence, layer, a word of the reason) -> count.

    Records of nobody (case 11) and boxes of no size (18) in each file that repeats the boxes, poses without keypoints
    (section 6), and one thing named twice in a frame (12).
    """
    refused = Counter()
    for name, content in flat.items():
        count_refused_people(refused, name, "2d", content)
    for layer, folder in (("social", "activity_social_stitched"), ("reasoning", "stitched_new_version")):
        for name, content in files(root, f"labels_2d_{folder}").items():
            count_refused_people(refused, name, layer, content)
    for name, content in files(root, "labels_2d_pose_stitched_coco").items():
        refused[name, "pose", "keypoints"] += sum("keypoints" not in one for one in content["annotations"])
    for name, content in files(root, "labels_2d_panoptic_stitched_CW").items():
        refused[name, "panoptic", "twice"] += named_twice(content)
    return +refused


def count_refused_people(refused, name, layer, content):
    for one in itertools.chain(*content["labels"].values()):
        refused[name, layer, "label_id"] += not one["label_id"].startswith("pedestrian:")
        refused[name, layer, "width or height"] += min(one["box"][2:]) <= 0


def named_twice(content):
    tracks = [(one, one.get("attributes", {})) for one in content["annotations"]]
    seen = Counter(
        (one["image_id"], one["category_id"], one.get("tracking_id"), inner.get("tracking_id"), inner.get("floor_id"))
        for one, inner in tracks
        if "tracking_id" in one or inner
    )
    return sum(seen.values()) - len(seen)


def test_a_load_refuses_what_is_awkward_and_nothing_else(root, refused, tmp_path):
    # The report tells, which is made beside the tables: none of them is looked at.
    sequences = find_root(root).sequences
    with kept_in(MemoryStore(tmp_path)):
        reports = [msgspec.to_builtins(load_shard(files, str(tmp_path), LoadRules()).report) for files in sequences]
    words = ("label_id", "width or height", "keypoints", "twice")
    found = Counter()
    for report in reports:
        for problem in report["problems"]:
            (word,) = [word for word in words if word in problem["reason"]]
            found[report["sequence"], problem["layer"], word] += problem["count"]
        # Layers fit one another, headings fit the motion, and nothing needs a look.
        assert {shift["layer"]: shift["result"] for shift in report["shifts"]} == dict.fromkeys(
            ("3d", "social", "reasoning"), "agrees"
        )
        assert report["heading"]["median_deg"] < 40
        assert report["stamps"]["fps"] == pytest.approx(15, abs=0.1)
        assert report["warnings"] == []
        assert {one["label"] for one in report["unknown_labels"]} <= {"waiting for sth"}
    assert found == refused
    assert {word for *_, word in found} == set(words)
    assert sum(found.values()) < 60
    assert any(report["disagreements"] for report in reports)
    assert any(report["absent_partners"] for report in reports)


@pytest.mark.slow
def test_same_seed_same_bytes_whatever_the_workers(tmp_path):
    sizes = ("--frames", 60, "--people", 5, "--no-images")
    assert run(tmp_path / "one", *sizes, "--sequences", 2, "--workers", 1).exit_code == 0
    assert run(tmp_path / "two", *sizes, "--sequences", 2, "--workers", 2).exit_code == 0
    whole = digest(tmp_path / "one")
    assert digest(tmp_path / "two") == whole
    # A sequence depends on no other one.
    assert run(tmp_path / "few", *sizes, "--sequences", 1, "--workers", 1).exit_code == 0
    few = digest(tmp_path / "few")
    assert few == {path: whole[path] for path in few}
    assert len(few) == 11
    # Another seed, another world.
    assert run(tmp_path / "other", *sizes, "--sequences", 2, "--seed", 5, "--workers", 1).exit_code == 0
    other = digest(tmp_path / "other")
    assert set(other) == set(whole)
    assert not any(other[path] == whole[path] for path in whole if not path.startswith("calibration"))


def test_a_folder_with_something_in_it_is_refused(tmp_path):
    (tmp_path / "note.txt").write_text("mine")
    result = run(tmp_path)
    assert result.exit_code == 1
    assert "not empty" in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["note.txt"]
    assert run(tmp_path / "note.txt").exit_code == 1


@pytest.mark.parametrize(
    ("options", "frames"),
    [((), [60] * 5), (("--full-scale",), [75, 90]), (("--full-scale", "--sequences", 3), [75, 75, 90])],
)
def test_an_empty_folder_takes_as_many_sequences_as_asked_for(monkeypatch, tmp_path, options, frames):
    monkeypatch.setattr("jrdb_avr.loaders.synthetic.write.FULL_SCALE", ((75, 1), (90, 2)))
    options += ("--frames", 60, "--people", 1, "--no-images", "--workers", 1)
    assert run(tmp_path, *options).exit_code == 0
    assert sorted(int(max(one["labels"])[:6]) + 1 for one in files(tmp_path, "labels_2d_stitched").values()) == frames
