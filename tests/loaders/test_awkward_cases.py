"""The awkward cases that real JRDB files contain: what the tables and the report of a load make of them.

The numbers are those of the list of cases that the loaders are built after. The missing ones are tested with the
readers of their layers.
"""

from __future__ import annotations

import pytest
from loaded_stores import NAME, load_root, reported_store
from worlds import VISIBLE, member, person, person_3d, pose, thing, write_root


def placed(track):
    """A box of the person's own."""
    return (100 * track + 10, 60, 50, 200)


def walking(track, **more):
    return person(track, placed(track), {"walking": 1}, (5, 1), **more)


def loaded(tmp_path, **layers):
    """The store without a graph, and the report, of one sequence; layers by their names, `boxes` for `2d`."""
    layers = {{"boxes": "2d", "solid": "3d"}.get(name, name): content for name, content in layers.items()}
    return reported_store(tmp_path, layers)


def column(store, kind, name):
    return store.interval(kind, NAME)[name].to_pylist()


def rows(store, kind, *names):
    return [tuple(row[name] for name in names) for row in store.interval(kind, NAME).to_pylist()]


def written(store, layer, *names):
    return [tuple(row[name] for name in names) for row in store.annotation(layer, NAME).to_pylist()]


def problems(report, word=""):
    """Count, file, frame and field of the problems whose reason holds a word."""
    return [(p.count, p.file, p.frame, p.field) for p in report.problems if word in p.reason]


def test_case_01_file_id_disagrees_with_its_key(tmp_path):
    store, report = loaded(tmp_path, boxes={0: [walking(1, file_id="000002.jpg")], 15: [walking(1)]})
    assert column(store, "sightings", "frame") == [0, 15]
    assert written(store, "boxes_2d", "frame", "file_id") == [(0, "000002.jpg"), (15, None)]
    assert report.problems == []


def test_case_04_truncation_in_four_forms(tmp_path):
    forms = ["true", True, None, "False"]
    people = [walking(i, attributes=VISIBLE | {"truncated": form}) for i, form in enumerate(forms)]
    store, report = loaded(tmp_path, boxes={0: people})
    assert written(store, "boxes_2d", "truncated") == [(True,), (True,), (None,), (False,)]
    assert report.problems == []


def test_case_09_spelling_variants(tmp_path):
    doors = {"opening the door": 1, "Pushing_the-door": 1, "looking at something": 1, "juggling balls": 1}
    told = {"gender": {"Male": "1"}, "age": {"young-adulthood": "1"}}
    talk = [(2, {"standing together together": "1", "looking_at something together": "1", "fencing": "1"})]
    info = {"venue": {"indoor:room/class": "1"}, "SSC": {"food-truck": "1"}, "aim": {"socializing&commuting": "1"}}
    store, report = loaded(
        tmp_path,
        boxes={0: [person(1, placed(1), doors, (5, 1)), person(2, placed(2), {"walking": 1}, (5, 1))]},
        social={0: [member(1, placed(1), told, talk, info), member(2, placed(2))]},
    )
    actions = {
        (action, certain)
        for track, action, certain in rows(store, "actions", "track", "action", "certain")
        if track == 1
    }
    assert actions == {(action, True) for action in ("interaction with door", "looking at sth", "juggling balls")}
    # A person who uses a door may be said to hold something too.
    assert (1, "holding sth") in rows(store, "possible_actions", "track", "action")
    assert {label for (label,) in rows(store, "interactions", "label")} == {
        "standing together",
        "looking at sth together",
        "fencing",
    }
    assert column(store, "persons", "age")[0] == "young adulthood"
    assert rows(store, "group_info", "attribute", "value") == [
        ("aim", "commuting"),
        ("aim", "socializing"),
        ("ssc", "food_truck"),
        ("venue", "indoor_room/class"),
    ]
    assert sorted(label.label for label in report.unknown_labels) == ["fencing", "juggling balls"]
    assert report.problems == []


def test_case_11_label_ids_of_others(tmp_path):
    others = [walking(1) | {"label_id": label} for label in ("person:-1", "pedestrian:-1", "car:2", "dog")]
    store, report = loaded(
        tmp_path,
        boxes={0: [walking(1), *others]},
        solid={0: [person_3d(1, 3.0, 0.0), person_3d(1, 3.0, 0.0) | {"label_id": "person:-1"}]},
        social={0: [member(1, placed(1), {"gender": {"Male": "1"}}), member(1, placed(1)) | {"label_id": "car:1"}]},
    )
    assert rows(store, "persons", "track", "gender") == [(1, "male")]
    # "person:-1" may be anybody, so that the frame's places are nobody's.
    assert rows(store, "sightings", "track", "located") == [(1, False)]
    assert sum(p.count for p in report.problems if p.field == "label_id") == 6


def test_case_12_the_same_person_twice(tmp_path):
    store, report = loaded(
        tmp_path,
        boxes={0: [walking(1), walking(1) | {"box": [900, 60, 50, 200]}]},
        solid={0: [person_3d(1, 3.0, 0.0), person_3d(1, 9.0, 0.0)]},
        social={
            0: [member(1, placed(1), {"gender": {"Male": "1"}}), member(1, placed(1), {"gender": {"Female": "1"}})]
        },
        pose={0: [pose(1, visibility=2), pose(1, visibility=0)]},
        panoptic={0: [thing(1, 40, box=(1, 2, 3, 4)), thing(1, 40, box=(5, 6, 7, 8))]},
    )
    assert rows(store, "sightings", "x", "cx", "face_visible") == [(placed(1)[0], None, True)]
    assert rows(store, "demographics", "value", "votes") == []
    assert written(store, "panoptic", "object", "x") == [(1, 1.0)]
    assert len(problems(report, "twice")) == 5


def test_case_32_poses_join_by_file_name(tmp_path):
    """Image numbers that say frame + 2, that run backwards, and that say nothing."""
    names = {17: 15, 2: 0, 5: 30}
    images = [{"id": i, "width": 752, "file_name": f"image_stitched/x/{f:06d}.jpg"} for i, f in names.items()]
    annotations = [{"id": i, "image_id": i, **pose(i)} for i in names]
    file = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "person"}]}
    store, report = loaded(tmp_path, boxes={f: [walking(1)] for f in (0, 15, 30)}, pose=file)
    assert written(store, "poses", "frame", "track") == [(0, 2), (15, 17), (30, 5)]
    assert report.problems == []


@pytest.mark.parametrize("labels_level", [True, False])
@pytest.mark.parametrize(
    "names",
    [
        {},
        {
            "social": "labels_2d_social",
            "pose": "pose_stitched",
            "reasoning": "labels_2d_stitched_test_new_version1",
            "panoptic": "labels_2d_panoptic_stitched_OW",
        },
        {"panoptic": "labels_2d_panoptic_stitched_CW_wo5s"},
    ],
)
def test_case_34_directories_have_several_names(tmp_path, labels_level, names):
    from worlds import FOLDERS

    layers = {
        "2d": {0: [walking(1)]},
        "3d": {0: [person_3d(1, 3.0, 0.0)]},
        "social": {0: [member(1, placed(1), {"gender": {"Male": "1"}})]},
        "reasoning": {0: [member(1, placed(1), handles=[((1, 40), {"holding": "1"})])]},
        "pose": {0: [pose(1)]},
        "panoptic": {0: [thing(1, 40)]},
    }
    root = write_root(tmp_path / "root", {NAME: layers}, labels_level, FOLDERS | names)
    store, report = load_root(tmp_path, root)
    assert rows(store, "sightings", "located", "face_visible", "handles_listed") == [(True, True, True)]
    assert column(store, "persons", "gender") == ["male"]
    assert rows(store, "objects", "category", "first_frame") == [("accessory", 0)]
    assert report.problems == []


def test_case_35_frames_are_counted_as_they_lie_on_disk(tmp_path):
    """bytes-cafe has 1,727 frames by the published constants, and 1,726 in the files."""
    name = "bytes-cafe-2019-02-07_0"
    root = write_root(tmp_path / "root", {name: {"2d": {0: [walking(1)], 1725: [walking(1)]}}})
    store, report = load_root(tmp_path, root)
    assert store.interval("sequence", name)["frame_count"].to_pylist() == [1726]
    assert report.frames == 2


def test_case_10_person_zero(tmp_path):
    told = [
        member(0, placed(0), {"gender": {"Female": "1"}}, handles=[((0, 40), {"holding": "1"})]),
        member(1, placed(1), None, [(0, {"conversation": "1"})], alias="HHI"),
    ]
    store, report = loaded(
        tmp_path,
        boxes={0: [person(t, placed(t), {"sitting": 1}, (0, 1)) for t in (0, 1)]},
        solid={0: [person_3d(0, 3.0, 0.0)]},
        reasoning={0: told},
        pose={0: [pose(0)]},
        panoptic={0: [thing(0, 40)]},
    )
    assert rows(store, "persons", "track", "gender") == [(0, "female"), (1, None)]
    seen = rows(store, "sightings", "track", "pose", "located", "face_visible", "group_size", "cluster")
    assert seen[0] == (0, "sitting", True, True, 2, 0)
    assert rows(store, "handles", "track", "object", "certain") == [(0, 0, True)]
    assert rows(store, "interactions", "source", "target") == [(0, 1), (1, 0)]
    assert report.problems == []
