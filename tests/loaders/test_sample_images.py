"""The sample's panoramas, read back from the JPEG files and compared with the label files, by code of its own."""

import itertools
import json
import math
from collections import Counter, defaultdict

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from jrdb_avr.engine.cli import group
from jrdb_avr.schema.labels import POSES, normal_action
from jrdb_avr.schema.markers import read

pytestmark = pytest.mark.slow

SIZES = ("--sequences", "2", "--frames", "150", "--people", "26")


def sample(folder, *options):
    result = CliRunner().invoke(group, ["sample", str(folder), *SIZES, *options])
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return sample(tmp_path_factory.mktemp("sample") / "root", "--workers", "1")


def load(path):
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


def same_place(box, other):
    """Intersection over union on the cylinder, by counting columns modulo 3760."""
    columns = [{(round(b[0]) + i) % 3760 for i in range(round(b[2]))} for b in (box, other)]
    rows = min(box[1] + box[3], other[1] + other[3]) - max(box[1], other[1])
    shared = len(columns[0] & columns[1]) * max(rows, 0)
    return shared / (len(columns[0]) * box[3] + len(columns[1]) * other[3] - shared)


@pytest.fixture(scope="module")
def readings(root):
    """(label record, 3D box or None, reading, overlap, sequence) of each mark in crops of a panorama of each second."""
    found, missed, boxes_at_seam = [], [], 0
    for folder in sorted((root / "images" / "image_stitched").iterdir()):
        name = folder.name
        flat = json.loads((root / "labels" / "labels_2d_stitched" / f"{name}.json").read_text())["labels"]
        solid = json.loads((root / "labels" / "labels_3d" / f"{name}.json").read_text())["labels"]
        panoramas = sorted(folder.glob("*.jpg"))
        # Of the three of a second the first, the second and the third in turn.
        for number, path in enumerate(panoramas[3 * second + second % 3] for second in range(len(panoramas) // 3)):
            image = load(path)
            # Its first columns once more behind its last.
            image = np.concatenate([image, image[:, :480]], axis=1)
            objects = [one for one in flat[path.name] if one["label_id"].startswith("pedestrian:")]
            places = {one["label_id"]: one["box"] for one in solid.get(path.stem + ".pcd", [])}
            seen = set()
            for left in range(137 * number % 300, 3760 + 137 * number % 300, 300):
                for reading in read(np.ascontiguousarray(image[:, left % 3760 : left % 3760 + 480])):
                    box = (reading.box.x + left, *reading.box[1:])
                    one = max(objects, key=lambda one, box=box: same_place(box, one["box"]))
                    found.append((one, places.get(one["label_id"]), reading, same_place(box, one["box"]), name))
                    seen.add(one["label_id"])
            for one in objects:
                x, _, w, _ = one["box"]
                boxes_at_seam += x < 0 or x + w > 3760
                if one["label_id"] not in seen:
                    missed.append(one)
    return found, missed, boxes_at_seam


def test_every_reading_lies_on_its_label(readings):
    found, _, boxes_at_seam = readings
    assert len(found) > 200
    assert boxes_at_seam > 0
    assert min(overlap for *_, overlap, _ in found) >= 0.85
    at_seam = [one for one, *_ in found if one["box"][0] < 0 or one["box"][0] + one["box"][2] > 3760]
    assert at_seam


def test_identity_and_track_go_together(readings):
    found, _, _ = readings
    pairs = {(name, one["label_id"], reading.mark.identity) for one, _, reading, _, name in found}
    assert len(pairs) == len({(name, track) for name, track, _ in pairs})
    assert len(pairs) == len({(name, identity) for name, _, identity in pairs})
    # The mark does not repeat the label's number.
    assert sum(track == f"pedestrian:{identity}" for _, track, identity in pairs) <= 1


def test_marks_say_what_certain_labels_say(readings):
    found, _, _ = readings
    poses = others = 0
    for one, place, reading, _, _ in found:
        listed = {normal_action(a): int(float(d)) for a, d in one.get("action_label", {}).items()}
        certain = {a for a, d in listed.items() if d < 3}
        pose = certain & set(POSES)
        if len(pose) == 1 and len(set(listed) & set(POSES)) == 1:
            assert {reading.mark.pose} == pose
            poses += 1
            # All that is shown is listed, and all that is listed is shown.
            assert set(reading.mark.actions) == set(listed) - set(POSES) - {"waiting for sth"}
            others += len(reading.mark.actions)
        if place is not None:
            distance = math.hypot(place["cx"], place["cy"])
            assert reading.mark.distance_dm == pytest.approx(10 * distance, abs=0.51)
            if reading.complete:
                heading = math.degrees(math.pi - place["rot_z"])
                assert abs((reading.mark.heading_deg - heading + 180) % 360 - 180) <= 2.6
    assert poses > 200
    assert others > 100


def test_marks_name_partners_and_things_that_the_labels_name(root, readings):
    """A partner's identity and the label, an object and the verb: each is an entry of the frame's lists."""
    found, _, _ = readings
    tracks = {(name, reading.mark.identity): one["label_id"] for one, _, reading, _, name in found}
    lists, categories = {}, {}
    for path in (root / "labels" / "labels_2d_stitched_new_version").glob("*.json"):
        for key, objects in json.loads(path.read_text())["labels"].items():
            for one in objects:
                lists[path.stem, key, one["label_id"]] = one
    for path in (root / "labels" / "labels_2d_panoptic_stitched_CW").glob("*.json"):
        categories[path.stem] = {one["id"]: one["name"] for one in json.loads(path.read_text())["categories"]}
    spelled = {"standing together together": "standing together", "walking_together": "walking together"}
    partners = things = 0
    for one, _, reading, _, name in found:
        # File names inside are those of another numbering in these sequences.
        key = f"{int(one['file_id'][:6]) - 2:06d}.jpg"
        mine = lists[name, key, one["label_id"]]
        if reading.mark.partner is not None and (name, reading.mark.partner) in tracks:
            other = tracks[name, reading.mark.partner]
            both = [mine, lists[name, key, other]]
            said = {
                (entry["pair"], spelled.get(label, label.replace("something", "sth")))
                for row in both
                for entry in row.get("HHI", [])
                for label in entry["inter_labels"]
            }
            assert {(other, reading.mark.interaction), (one["label_id"], reading.mark.interaction)} & said
            partners += 1
        if reading.mark.object is not None:
            held = {
                (categories[name][int(entry["pair"][1])], verb)
                for entry in mine.get("HOI", [])
                for verb in entry["inter_labels"]
            }
            assert (reading.mark.object, reading.mark.verb) in held
            things += 1
        elif reading.complete:
            assert not mine.get("HOI")
    assert partners > 50
    assert things > 100


def test_marks_say_gender_and_age_as_most_frames_of_the_labels_do(root, readings):
    found, _, _ = readings
    votes = defaultdict(Counter)
    for path in (root / "labels" / "labels_2d_activity_social_stitched").glob("*.json"):
        for one in itertools.chain(*json.loads(path.read_text())["labels"].values()):
            for element in one.get("demographics_info", []):
                for attribute, values in element.items():
                    ((value, level),) = values.items()
                    if value != "impossible" and level != "3":
                        votes[path.stem, one["label_id"], attribute][value.lower().replace("_", " ")] += 1
    checked = 0
    for one, _, reading, _, name in found:
        for attribute in ("gender", "age"):
            told = votes[name, one["label_id"], attribute]
            if told:
                assert told[getattr(reading.mark, attribute)] > sum(told.values()) / 2
                checked += 1
    assert checked > 500


def test_marks_say_who_is_in_one_group_and_who_is_alone(root, readings):
    """Against the whole frame's records: a person whom a mark calls alone shares its cluster with nobody there."""
    found, _, _ = readings
    labels = {
        path.stem: json.loads(path.read_text())["labels"]
        for path in (root / "labels" / "labels_2d_stitched").glob("*.json")
    }
    frames = defaultdict(dict)
    for one, _, reading, _, name in found:
        if "social_group" in one:
            # File names inside are those of another numbering in these sequences.
            key = f"{int(one['file_id'][:6]) - 2:06d}.jpg"
            frames[name, key][one["label_id"]] = one["social_group"]["cluster_ID"], reading.mark.group
    groups = pairs = 0
    for (name, key), told in frames.items():
        # One record may be of nobody, and repeats another one.
        members = [one for one in labels[name][key] if one["label_id"].startswith("pedestrian:")]
        sizes = Counter(one["social_group"]["cluster_ID"] for one in members if "social_group" in one)
        for cluster, group_ in told.values():
            assert (sizes[cluster] == 1) == (group_ == 0)
            groups += group_ > 0
        for (a, shown_a), (b, shown_b) in itertools.combinations(told.values(), 2):
            assert (a == b) == (shown_a == shown_b > 0)
            pairs += a == b
    assert groups > 50
    assert pairs > 20


def test_clear_people_are_read_and_covered_ones_are_not(readings):
    found, missed, _ = readings

    def rate(word):
        read_ = len({id(one) for one, *_ in found if one["attributes"].get("occlusion") == word})
        lost = sum(
            one["attributes"].get("occlusion") == word and one["box"][2] >= 18 and one["box"][3] >= 60 for one in missed
        )
        return read_ / (read_ + lost)

    assert rate("Fully_visible") > 0.93
    assert rate("Fully_occluded") < 0.03


def test_images_stand_at_keyframes_and_once_per_second_round_a_moment(root):
    """Three per second, also where nothing changes, and the pairs at many places: they do not tell when."""
    for folder in (root / "images" / "image_stitched").iterdir():
        frames = sorted(int(path.stem) for path in folder.glob("*.jpg"))
        seconds = [[frame - start for frame in frames if 0 <= frame - start < 15] for start in range(0, 150, 15)]
        assert all(places[0] == 0 and places[2] == places[1] + 1 and len(places) == 3 for places in seconds)
        assert len({places[1] for places in seconds}) > 3


def test_changes_have_an_image_on_either_side(root):
    for path in (root / "labels" / "labels_2d_stitched").glob("*.json"):
        images = {int(one.stem) for one in (root / "images" / "image_stitched" / path.stem).glob("*.jpg")}
        before, changes = {}, set()
        for key, objects in json.loads(path.read_text())["labels"].items():
            frame = int(key[:6])
            for one in objects:
                poses = [action for action in one.get("action_label", {}) if action in POSES]
                seen, old = before.get(one["label_id"], (-9, None))
                if len(poses) == 1 and seen == frame - 1 and old != poses:
                    changes |= {frame - 1, frame}
                if len(poses) == 1:
                    before[one["label_id"]] = frame, poses
        assert len(changes) > 6
        assert changes <= images


@pytest.mark.parametrize(
    ("option", "count"),
    [(("--images", "keyframes"), 4), (("--images", "all"), 60), (("--no-images",), 0)],
)
def test_fewer_images(tmp_path, option, count):
    folder = sample(tmp_path / "root", "--sequences", "1", "--frames", "60", "--people", "3", *option)
    assert len(list(folder.rglob("*.jpg"))) == count


def test_images_do_not_depend_on_the_workers(tmp_path):
    sizes = ("--frames", "60", "--people", "8")
    one, two = (sample(tmp_path / workers, *sizes, "--workers", workers) for workers in ("1", "2"))
    mine = sorted(path.relative_to(one) for path in one.rglob("*.jpg"))
    assert len(mine) > 20
    assert mine == sorted(path.relative_to(two) for path in two.rglob("*.jpg"))
    assert all((one / path).read_bytes() == (two / path).read_bytes() for path in mine)
