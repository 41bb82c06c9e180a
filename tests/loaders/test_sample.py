"""The sample's label files: the formats, the awkward cases, what they say of one another, and determinism.

The files are read as plain JSON; geometry and shares are computed here again.
"""

import gc
import hashlib
import itertools
import math
from collections import Counter, defaultdict

import msgspec
import pytest
from click.testing import CliRunner
from loaded_stores import MemoryStore, kept_in

from jrdb_avr.engine.cli import group
from jrdb_avr.loaders.load import Shard, load_shard
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.synthetic.write import plan, sequence_name, write
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
def frames(sizes):
    """Frames of each sequence, by its name."""
    return {sequence_name(i): length for i, (length, _) in enumerate(sizes)}


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


def code(value):
    return int(float(value))


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


CASES = {
    1: ["file_id differs"],
    3: ["no occlusion", "no truncated"],
    4: ["truncated text", "truncated bool", "truncated null", "no truncated"],
    5: ["difficulty whole", "difficulty float", "difficulty text"],
    7: ["empty action list", "no action list", "impossible"],
    8: ["no pose", "two poses"],
    9: ["other spelling", "unknown label"],
    10: ["person 0"],
    11: ["foreign id"],
    12: ["same thing twice"],
    13: ["2D without 3D", "3D without 2D"],
    14: ["frame in 2D only", "frame in 3D only", "panoptic 1 in 15"],
    15: ["empty frame 2D", "empty frame 3D", "keyframe without segments"],
    16: ["x < 0", "past the edge"],
    17: ["sliver"],
    18: ["zero width", "negative height"],
    19: ["fully occluded"],
    20: ["3D interpolated"],
    21: ["no points"],
    22: ["no_eval"],
    23: ["unwrapped rot_z"],
    24: ["distance null"],
    25: ["cluster changes", "cluster reused", "alone in its cluster"],
    26: ["track with a gap"],
    27: ["short track"],
    28: ["group without actions", "actions without group"],
    33: ["tracking_id", "attributes.tracking_id", "attributes.floor_id", "other category ids", "same track elsewhere"],
}
"""What occurs in the files, by number of the awkward case of the formats.

Not in the sample, as a root that holds them does not load as it is, or there is nothing of the kind in label files:
layers of different numbering (2), other folder names (34), counts of frames published elsewhere (35).
"""


@pytest.fixture(scope="module")
def counted(root, flat, solid, frames):
    """How often each thing occurs in the files, and what a load refuses."""
    seen, refused = Counter(), Counter()
    for name, content in flat.items():
        count_boxes(seen, content["labels"], solid[name]["labels"])
        count_refused_people(refused, name, "2d", content)
    for layer, folder in (("social", "activity_social_stitched"), ("reasoning", "stitched_new_version")):
        for name, content in files(root, f"labels_2d_{folder}").items():
            count_refused_people(refused, name, layer, content)
    ids = set()
    for name, content in files(root, "labels_2d_pose_stitched_coco").items():
        refused[name, "pose", "keypoints"] += sum("keypoints" not in one for one in content["annotations"])
    for name, content in files(root, "labels_2d_panoptic_stitched_CW").items():
        count_segments(seen, content, frames[name])
        refused[name, "panoptic", "twice"] += named_twice(content)
        ids.add(tuple(one["id"] for one in content["categories"]))
    seen["other category ids"] = len(ids) - 1
    return seen, +refused


@pytest.fixture(scope="module")
def seen(counted):
    """How often each thing occurs in the files."""
    return counted[0]


@pytest.fixture(scope="module")
def refused(counted):
    """What a load refuses, counted in the files: (sequence, layer, a word of the reason) -> count.

    Records of nobody (case 11) and boxes of no size (18) in each file that repeats the boxes, poses without keypoints
    (section 6), and one thing named twice in a frame (12).
    """
    return counted[1]


def count_boxes(seen, labels, labels_3d):
    frames_3d = {key[:6] for key in labels_3d}
    frames_2d = {key[:6] for key in labels}
    seen["frame in 2D only"] += len(frames_2d - frames_3d)
    seen["frame in 3D only"] += len(frames_3d - frames_2d)
    seen["empty frame 2D"] += sum(not objects for objects in labels.values())
    seen["empty frame 3D"] += sum(not objects for objects in labels_3d.values())
    times, clusters, members = defaultdict(list), defaultdict(set), defaultdict(set)
    for key, objects in labels.items():
        ids = {one["label_id"] for one in objects}
        others = {one["label_id"] for one in labels_3d.get(key[:6] + ".pcd", [])}
        seen["2D without 3D"] += len(ids - others)
        seen["3D without 2D"] += len(others - ids)
        sizes = Counter(one["social_group"]["cluster_ID"] for one in people(objects) if "social_group" in one)
        seen["alone in its cluster"] += sum(size == 1 for size in sizes.values())
        for one in objects:
            seen["records"] += 1
            attributes, actions = one["attributes"], one.get("action_label")
            x, _, w, h = one["box"]
            poses = [action for action in actions or {} if action in POSES]
            seen["person 0"] += one["label_id"] == "pedestrian:0"
            seen["foreign id"] += not one["label_id"].startswith("pedestrian:")
            seen["file_id differs"] += one["file_id"] != key
            seen["zero width"] += w == 0
            seen["negative height"] += h < 0
            seen["x < 0"] += x < 0
            seen["past the edge"] += x + w > 3760
            seen["sliver"] += 0 < w <= 10 and (x == 0 or x + w == 3760)
            seen["no occlusion"] += "occlusion" not in attributes
            seen["fully occluded"] += attributes.get("occlusion") == "Fully_occluded"
            seen["no truncated"] += "truncated" not in attributes
            seen["truncated null"] += "truncated" in attributes and attributes["truncated"] is None
            seen["truncated bool"] += isinstance(attributes.get("truncated"), bool)
            seen["truncated text"] += isinstance(attributes.get("truncated"), str)
            seen["no_eval"] += attributes["no_eval"]
            seen["no action list"] += actions is None
            seen["empty action list"] += actions == {}
            seen["impossible"] += "impossible" in (actions or {})
            seen["no pose"] += bool(actions) and not poses and "impossible" not in actions
            seen["two poses"] += len(poses) == 2
            seen["other spelling"] += any(normal_action(a) != a for a in actions or {})
            seen["unknown label"] += "waiting for sth" in (actions or {})
            for kind, word in ((int, "whole"), (float, "float"), (str, "text")):
                seen[f"difficulty {word}"] += any(isinstance(d, kind) for d in (actions or {}).values())
            seen["no group"] += "social_group" not in one
            seen["group without actions"] += "social_group" in one and not actions
            seen["actions without group"] += "social_group" not in one and bool(actions)
            if "social_group" in one:
                clusters[one["label_id"]].add(one["social_group"]["cluster_ID"])
                members[one["social_group"]["cluster_ID"]].add((one["label_id"], key))
            if w > 0 and h > 0:
                times[one["label_id"]].append(int(key[:6]))
    seen["track with a gap"] += sum(any(b - a > 15 for a, b in itertools.pairwise(t)) for t in times.values())
    seen["short track"] += sum(sum(frame % 15 == 0 for frame in t) <= 2 for t in times.values())
    seen["cluster changes"] += sum(len(one) > 1 for one in clusters.values())
    for rows in members.values():
        # People who share a number and are never there together.
        who = {label for label, _ in rows}
        spans = {label: {key for other, key in rows if other == label} for label in who}
        seen["cluster reused"] += any(not spans[a] & spans[b] for a, b in itertools.combinations(sorted(who), 2))
    for objects in labels_3d.values():
        for one in objects:
            seen["no points"] += one["attributes"]["num_points"] == 0
            seen["distance null"] += one["attributes"]["distance"] is None
            seen["unwrapped rot_z"] += abs(one["box"]["rot_z"]) > math.pi
            seen["3D interpolated"] += one["attributes"]["interpolated"]


def count_segments(seen, content, frames):
    images = {one["id"]: int(one["file_name"][-10:-4]) for one in content["images"]}
    seen["panoptic 1 in 15"] += set(images.values()) == set(range(0, frames, 15))
    seen["keyframe without segments"] += len(set(images) - {one["image_id"] for one in content["annotations"]})
    things, places = Counter(), defaultdict(set)
    for one in content["annotations"]:
        track = one.get("tracking_id")
        seen["tracking_id"] += track is not None
        for field in ("tracking_id", "floor_id"):
            inner = one.get("attributes", {}).get(field)
            seen[f"attributes.{field}"] += inner is not None
            track = inner if track is None else track
        if track is not None:
            things[one["image_id"], track, one["category_id"]] += 1
            places[track].add(one["category_id"])
    seen["same thing twice"] += sum(count > 1 for count in things.values())
    seen["same track elsewhere"] += sum(len(categories) > 1 for categories in places.values())


@pytest.mark.parametrize("number", sorted(CASES))
def test_an_awkward_case_occurs(number, seen):
    assert [what for what in CASES[number] if seen[what] == 0] == []


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
    shards = [Shard(files, str(tmp_path), LoadRules()) for files in find_root(root).sequences]
    with kept_in(MemoryStore(tmp_path)):
        reports = [msgspec.to_builtins(load_shard(shard).report) for shard in shards]
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
