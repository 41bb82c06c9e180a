"""Readings of a real detector on real panoramas replace the annotated boxes and postures."""

import json

import pytest
from environment import REAL

from jrdb_avr.agent.simulated.noise import PictureView
from jrdb_avr.agent.simulated.people import Person
from jrdb_avr.agent.simulated.profiles import PROFILES, parse_errors
from jrdb_avr.agent.simulated.recorded import RecordedReader
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.agent.simulated.sight import Sight
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, crop_left, iou
from jrdb_avr.schema.rules import LoadRules

SEQUENCE = "gates-ai-lab-2019-02-08_0"


def read(errors, frame, angle, everyone):
    return RecordedReader(errors, PictureView("s", frame, crop_left(angle), CROP)).people(everyone)


def test_readings_have_the_identity_of_the_person_whom_they_overlap(tmp_path):
    left = crop_left(180.0)
    file = tmp_path / "readings.json"
    rows = [[x, 100, 50, 150, 0.9, pose, None, None, 3.0] for x, pose in ((100, "standing"), (300, None))]
    file.write_text(json.dumps({"15": {"180.0": rows, "0.0": []}}))
    errors = parse_errors([f"readings={file}"])
    walking = Person(7, Box(left + 104, 96, 50, 150), {"pose": frozenset({"walking"}), "gender": frozenset({"male"})})
    first, second = read(errors, 20, 180.0, [walking])
    assert (first.identity, first.box, first.label("pose"), first.label("gender")) == (
        7,
        Box(100, 100, 50, 150),
        "standing",
        "male",
    )
    assert second.identity < 0 and second.label("pose") is None
    assert [one.identity for one in read(errors, 15, 187.0, [walking])] == [7, second.identity]
    assert read(errors, 15, 0.0, [walking]) == ()


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    for errors in (PROFILES["recorded"], parse_errors([f"readings={tmp_path}/none"])):
        with pytest.raises(InputError, match="--simulate readings: cannot take"):
            Server(None, errors)


@pytest.mark.skipif(not (REAL / "detector_readings.json").exists(), reason="needs a slice of JRDB (JRDB_REAL)")
def test_real_readings_show_two_fifths_of_the_people(tmp_path):
    labels = tmp_path / "root" / "labels" / "labels_2d_stitched"
    labels.mkdir(parents=True)
    (labels / f"{SEQUENCE}.json").symlink_to(REAL / "labels" / "labels_2d_stitched" / f"{SEQUENCE}.json")
    store = Store(tmp_path / "store")
    load(find_root(tmp_path / "root"), store, LoadRules(), 1)
    errors, sight = parse_errors([f"readings={REAL}/detector_readings.json"]), Sight(store)
    met = people = ghosts = 0
    for frame in range(15, 91, 15):
        everyone = sight.people(SEQUENCE, frame)
        found = RecordedReader(errors, PictureView(SEQUENCE, frame, 0.0, WIDTH)).people(everyone)
        known = {one.identity: one for one in found if one.identity >= 0}
        assert all(iou(one.box, one.person.box) >= 0.4 for one in known.values())
        met, people, ghosts = met + len(known), people + len(everyone), ghosts + len(found) - len(known)
    assert 0.25 < met / people < 0.65 and ghosts > 10
