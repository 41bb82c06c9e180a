"""The people of a frame, against brute force over the label files, and of frames without labels."""

import json
import math

import pytest

from jrdb_avr.agent.simulated.noise import PictureView, Reader
from jrdb_avr.agent.simulated.profiles import PERFECT
from jrdb_avr.agent.simulated.sight import Sight
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.queries.opaque import opaque_names
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import DecodeError, StoreError
from jrdb_avr.schema.labels import CLEAR_OCCLUSIONS, INTERACTIONS, POSES
from jrdb_avr.schema.panorama import WIDTH
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import LoadRules

SEQUENCE = "sample-plaza-01_0"
FRAMES = range(0, 120, 7)


@pytest.fixture(scope="module")
def root(once):
    """A root of label files, with its store beside them."""

    def make(folder):
        list(write(plan(folder / "root", [(120, 24)], 3, "none"), 1))
        load(find_root(folder / "root"), Store(folder / "store"), LoadRules(), 1)

    return once("sight", make)


@pytest.fixture(scope="module")
def sight(root):
    return Sight(Store(root / "store"))


@pytest.fixture(scope="module")
def raw(root):
    """{frame: {track: record}} of the social and of the 3D label file."""

    def read(folder, end):
        labels = json.loads((root / "root" / "labels" / folder / f"{SEQUENCE}.json").read_text())["labels"]
        return {
            int(name.removesuffix(end)): {int(one["label_id"].partition(":")[2]): one for one in records}
            for name, records in labels.items()
        }

    return read("labels_2d_stitched_new_version", ".jpg"), read("labels_3d", ".pcd")


def text(label):
    return label.lower().replace("_", " ")


def test_people_are_those_of_the_label_files(sight, raw):
    flat, solid = raw
    compared = dict.fromkeys(("box", "hidden", "pose", "action", "interaction", "group", "metres", "gender"), 0)
    for frame in FRAMES:
        people = {person.track: person for person in sight.people(SEQUENCE, frame)}
        records = flat[frame]
        assert people.keys() <= records.keys()
        hidden = records.keys() - people.keys()
        assert all(records[track]["attributes"]["occlusion"] not in CLEAR_OCCLUSIONS for track in hidden)
        compared["hidden"] += len(hidden)
        for track, person in people.items():
            record = records[track]
            assert list(person.box) == record["box"]
            compared["box"] += 1
            labels = {text(name) for name in record["action_label"]} - {"impossible"}
            if "pose" in person.labels:
                assert person.labels["pose"] == labels & {*POSES}
                compared["pose"] += 1
            if "action" in person.labels and "holding something" not in labels:
                known = {name.replace("something", "sth") for name in labels - {*POSES}}
                assert person.labels["action"] <= known | {"interaction with door", "holding sth", "looking at sth"}
                compared["action"] += len(known)
            tied = {
                (label, int(pair["pair"].partition(":")[2]))
                for pair in record.get("HHI", ())
                for label in map(text, pair["inter_labels"])
                if label in INTERACTIONS
            }
            assert all(partner in person.ties[label] for label, partner in tied if label in person.ties)
            compared["interaction"] += len(tied)
            if SAME_GROUP in person.ties:
                group = record["social_group"]["cluster_ID"]
                mates = {other for other, one in records.items() if one["social_group"]["cluster_ID"] == group}
                assert person.ties[SAME_GROUP] == (mates & people.keys()) - {track}
                compared["group"] += len(mates) > 1
            box = solid.get(frame, {}).get(track)
            if box is not None and person.metres is not None:
                assert person.metres == pytest.approx(math.hypot(box["box"]["cx"], box["box"]["cy"]), rel=0.2)
                compared["metres"] += 1
            for value in person.labels.get("gender", ()):
                votes = [
                    text(name)
                    for frames in flat.values()
                    if track in frames
                    for info in frames[track].get("demographics_info", ())
                    for name in info.get("gender", ())
                ]
                assert votes.count(value) > len(votes) / 2
                compared["gender"] += 1
    assert min(compared.values()) >= 20, compared


def test_a_perfect_model_reads_what_is_annotated(sight):
    everyone = sight.people(SEQUENCE, 60)
    read = Reader(PERFECT, PictureView(SEQUENCE, 60, 0.0, WIDTH)).people(everyone)
    assert {one.identity for one in read} == {person.track for person in everyone}
    for one in read:
        assert all(one.holds("action", action) for action in one.person.labels.get("action", ()))
        assert {one.label("pose")} == {*one.person.labels["pose"]} or len(one.person.labels["pose"]) != 1
        numbers = {other.identity: number for number, other in enumerate(read, 1)}
        for relation, tied in one.person.ties.items():
            assert one.partners(relation, read) == sorted(numbers[track] for track in tied if track in numbers)


def test_pictures_over_the_seam_show_each_person_once(sight):
    for frame in FRAMES:
        everyone = sight.people(SEQUENCE, frame)
        for left in range(0, WIDTH, 94):
            view = PictureView(SEQUENCE, frame, float(left), 480.0)
            shown = {one.identity: one.box for one in Reader(PERFECT, view).people(everyone)}
            for person in everyone:
                middle = (person.box.x + person.box.w / 2 - left) % WIDTH
                assert (person.track in shown) == (middle < 480)
                if person.track in shown:
                    assert shown[person.track].x + person.box.w / 2 == pytest.approx(middle)


def test_a_frame_between_labels_is_the_nearest(root, tmp_path):
    """Labels of every fifteenth frame, as those of the public release."""
    for folder in ("labels_2d_stitched",):
        source = root / "root" / "labels" / folder / f"{SEQUENCE}.json"
        labels = json.loads(source.read_text())["labels"]
        kept = {name: one for name, one in labels.items() if int(name[:6]) % 15 == 0}
        target = tmp_path / "root" / "labels" / folder / f"{SEQUENCE}.json"
        target.parent.mkdir(parents=True)
        target.write_text(json.dumps({"labels": kept}))
    store = Store(tmp_path / "store")
    load(find_root(tmp_path / "root"), store, LoadRules(), 1)
    sparse = Sight(store)
    assert sparse.people(SEQUENCE, 60)
    for frame, nearest in ((53, 60), (52, 45), (67, 60), (68, 75), (119, 105)):
        assert sparse.people(SEQUENCE, frame) == sparse.people(SEQUENCE, nearest)


def test_opaque_names_and_unknown_ones(root, tmp_path, sight):
    import shutil

    shutil.copytree(root / "store", tmp_path / "store")
    store = Store(tmp_path / "store")
    name = opaque_names(store, [SEQUENCE])[SEQUENCE]
    assert Sight(store).people(name, 30) == sight.people(SEQUENCE, 30)
    with pytest.raises(DecodeError, match="no sequence"):
        sight.people("sequence-0123456789abcdef", 30)
    empty = Store(tmp_path / "empty")
    with pytest.raises(StoreError):
        Sight(empty)
