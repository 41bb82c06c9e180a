"""The pose layer: what is kept of a keypoint file, what is refused, and what follows from it."""

from __future__ import annotations

import itertools
import json

import pytest
from loaded_stores import NAME, graphless_store, read_store
from worlds import coco_file, person, pose

from jrdb_avr.loaders.labelfiles import coco
from jrdb_avr.loaders.labelfiles import frames as labelfile
from jrdb_avr.loaders.layers.pose import load_pose
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

POINTS = [value for i in range(17) for value in (100.0 + i, 200.0 + i, i % 3)]


def read(folder, content):
    """Rows {(frame, track): keypoints}, frames {frame: records} and problems of a pose file."""
    path = folder / f"{NAME}.json"
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    problems = Problems(path.name)
    reading = load_pose(path, problems).of(NAME)
    table = reading.tables["poses"]
    assert table.cast(ANNOTATIONS["poses"]).schema == ANNOTATIONS["poses"]
    rows = [((row["frame"], row["track"]), row["keypoints"]) for row in table.to_pylist()]
    assert rows == sorted(rows), "by frame and track"
    frames = dict(zip(*(column.tolist() for column in reading.frames["pose"]), strict=True))
    return dict(rows), frames, problems.listed()


def found(problems):
    return [(p.kind, p.reason, p.count, p.frame, p.field) for p in problems]


def image(number, frame, folder=f"image_stitched/{NAME}/", **more):
    return {"id": number, "file_name": f"{folder}{frame:06d}.jpg", "width": 752, "height": 480} | more


def annotation(number, image_id, track, **more):
    record = {"id": number, "image_id": image_id, "track_id": track, "category_id": 1, "keypoints": POINTS}
    return {key: value for key, value in (record | more).items() if value is not ...}


def a_file(*annotations, images=None):
    """A file of the frames 0 and 15, with person 1 in both."""
    good = [annotation(1, 10, 1), annotation(2, 20, 1)]
    return {"images": images or [image(10, 0), image(20, 15)], "annotations": [*good, *annotations], "categories": []}


GOOD = {(0, 1): POINTS, (15, 1): POINTS}


def test_keypoints_are_kept_as_written(tmp_path):
    rows, frames, problems = read(tmp_path, a_file(annotation(3, 20, 0, keypoints=[-7.25, 3800.5, 2, *POINTS[3:]])))
    assert rows == GOOD | {(15, 0): [-7.25, 3800.5, 2.0, *POINTS[3:]]}  # a person 0, beyond both edges
    assert frames == {0: 1, 15: 2}
    assert problems == []


# -- what is refused -----------------------------------------------------------------------------------------------


BAD_KEYPOINTS = {
    "missing": ...,
    "null": None,
    "fifty": POINTS[:50],
    "fifty-two": [*POINTS, 0],
    "texts": ["1"] * 51,
    "beyond a float": [10**400, *POINTS[1:]],
    "far outside": [1e9, *POINTS[1:]],
    "a null inside": [None, *POINTS[1:]],
    "visibility 3": [1, 2, 3, *POINTS[3:]],
    "visibility 0.5": [1, 2, 0.5, *POINTS[3:]],
}


@pytest.mark.parametrize("keypoints", BAD_KEYPOINTS.values(), ids=BAD_KEYPOINTS)
def test_bad_keypoints_cost_their_own_record(tmp_path, keypoints):
    rows, frames, problems = read(tmp_path, a_file(annotation(3, 20, 2, keypoints=keypoints), annotation(4, 20, 3)))
    assert rows == GOOD | {(15, 3): POINTS}
    assert frames == {0: 1, 15: 2}
    ((kind, reason, count, frame, field),) = found(problems)
    assert (kind, count, field) == ("record", 1, "keypoints")
    assert reason and frame in ("annotation 3", "000015.jpg")


BAD_NUMBERS = {
    "missing": ...,
    "null": None,
    "a fraction": 1.5,
    "a text": "one",
    "a list": [1],
}


@pytest.mark.parametrize("number", [*BAD_NUMBERS.values(), -1, 2**31], ids=[*BAD_NUMBERS, "negative", "beyond 31 bits"])
def test_a_bad_track_costs_its_own_record(tmp_path, number):
    rows, _, problems = read(tmp_path, a_file(annotation(3, 20, 2, track_id=number)))
    assert rows == GOOD
    ((kind, _, count, frame, field),) = found(problems)
    assert (kind, count, field) == ("record", 1, "track_id")
    assert frame in ("annotation 3", "000015.jpg")


@pytest.mark.parametrize("number", [*BAD_NUMBERS.values(), 30, -1], ids=[*BAD_NUMBERS, "unknown", "negative"])
def test_an_annotation_of_no_image_is_refused(tmp_path, number):
    rows, frames, problems = read(tmp_path, a_file(annotation(3, number, 2), annotation("b", number, 3)))
    assert rows == GOOD
    assert frames == {0: 1, 15: 1}
    ((kind, _, count, frame, field),) = found(problems)
    assert (kind, count, frame, field) == ("record", 2, "annotation 3", "image_id")


BAD_IMAGES = {
    "another sequence": ({"file_name": "image_stitched/hall-2020-01-01_0/000030.jpg"}, "images.file_name"),
    "no frame": ({"file_name": f"{NAME}/panorama.jpg"}, "images.file_name"),
    "five digits": ({"file_name": "00030.jpg"}, "images.file_name"),
    "other digits": ({"file_name": "٠٠٠٠٣٠.jpg"}, "images.file_name"),
    "no name": ({"file_name": None}, "file_name"),
    "no number": ({"id": None}, "id"),
}


@pytest.mark.parametrize(("change", "field"), BAD_IMAGES.values(), ids=BAD_IMAGES)
def test_a_bad_image_is_no_frame_and_takes_its_annotations_along(tmp_path, change, field):
    images = [image(10, 0), image(20, 15), image(30, 30) | change]
    rows, frames, problems = read(tmp_path, a_file(annotation(3, 30, 2), images=images))
    assert rows == GOOD
    assert frames == {0: 1, 15: 1}
    assert [(p[2], p[4]) for p in found(problems)] in ([(1, field), (1, "image_id")], [(1, "image_id"), (1, field)])


@pytest.mark.parametrize("other", [image(30, 45), image(30, 15), image(30, 30, "image_stitched/hall-2020-01-01_0/")])
@pytest.mark.parametrize("order", [1, -1])
def test_a_number_of_two_images_stands_for_neither(tmp_path, other, order):
    """Where the other one is of no use either: its annotations are there all the same."""
    images = [image(10, 0), image(20, 15), *[image(30, 30), other][::order]]
    rows, frames, problems = read(tmp_path, a_file(annotation(3, 30, 2), images=images))
    assert rows == GOOD
    assert frames == {0: 1, 15: 1}
    counts = {field: count for _, _, count, _, field in found(problems)}
    assert sum(counts.values()) == 3
    assert counts["image_id"] == 1


@pytest.mark.parametrize("record", ["3", "null", '"x"', "[]", "{}"])
def test_what_is_no_annotation_is_refused(tmp_path, record):
    text = json.dumps(a_file()).replace('"annotations": [', f'"annotations": [{record}, ')
    rows, frames, problems = read(tmp_path, text.encode())
    assert (rows, frames) == (GOOD, {0: 1, 15: 1})
    ((kind, _, count, _, _),) = found(problems)
    assert (kind, count) == ("record", 1)


BAD_FILES = {
    "no images": b'{"annotations": []}',
    "no annotations": b'{"images": []}',
    "images null": b'{"images": null, "annotations": []}',
    "annotations an object": b'{"images": [], "annotations": {}}',
    "text behind": b'{"images": [], "annotations": []} {}',
    "a 2D file": b'{"labels": {"000000.jpg": []}}',
}


@pytest.mark.parametrize("data", BAD_FILES.values(), ids=BAD_FILES)
def test_a_file_that_cannot_be_used_is_refused_as_a_whole(tmp_path, data):
    with pytest.raises(InputError) as caught:
        read(tmp_path, data)
    assert caught.value.file == f"{NAME}.json"
    assert "\n" not in str(caught.value)


def test_limits(tmp_path, monkeypatch):
    monkeypatch.setattr(coco, "MAX_LISTED", 3)
    read(tmp_path, a_file(annotation(3, 20, 2)))
    with pytest.raises(InputError, match="more than 3 annotations"):
        read(tmp_path, a_file(annotation(3, 20, 2), annotation(4, 20, 3)))
    with pytest.raises(InputError, match="more than 3 images"):
        read(tmp_path, a_file(images=[image(i, i) for i in range(4)]))
    monkeypatch.setattr(labelfile, "MAX_FILE", 100)
    with pytest.raises(InputError, match="larger than the limit"):
        read(tmp_path, a_file())


# -- what follows from it ------------------------------------------------------------------------------------------


def test_a_face_is_visible_where_head_or_an_eye_is(tmp_path):
    """Of a person per key point and visibility. The last one has no pose, and frame 15 has none at all."""
    cases = list(itertools.product(range(17), range(3)))
    poses = [
        pose(track, visibility=[code if i == point else 1 if i < 3 else 2 for i in range(17)])
        for track, (point, code) in enumerate(cases)
    ]
    world = {0: [person(t, (70 * t, 60, 50, 200)) for t in range(52)], 15: [person(0, (0, 60, 50, 200))]}
    store, _ = read_store(tmp_path, {"2d": world, "pose": coco_file({0: poses}, "pose")})
    rows = store.interval("sightings", NAME).to_pylist()
    seen = {(row["frame"], row["track"]): row["face_visible"] for row in rows}
    visible = {(0, track): point < 3 and code == 2 for track, (point, code) in enumerate(cases)}
    assert seen == visible | {(0, 51): None, (15, 0): None}


def test_keypoints_are_read_with_their_sighting(tmp_path):
    people = {0: [1, 2], 15: [1]}
    world = {f: [person(t, (100 * t, 60, 50, 200)) for t in tracks] for f, tracks in people.items()}
    poses = coco_file({0: [pose(1, visibility=[2] * 17), pose(3)]}, "pose")
    store = graphless_store(tmp_path, {NAME: {"2d": world, "pose": poses}})
    rows = store.sql("SELECT * FROM sightings_keypoints ORDER BY frame, track").to_pylist()
    (kept,) = [a["keypoints"] for a in poses["annotations"] if a["track_id"] == 1]
    # Each sighting once: a pose without a box is none, a box without a pose has no key points.
    assert [(r["frame"], r["track"], r["keypoints"]) for r in rows] == [(0, 1, kept), (0, 2, None), (15, 1, None)]
    assert [r["face_visible"] for r in rows] == [True, None, None]
