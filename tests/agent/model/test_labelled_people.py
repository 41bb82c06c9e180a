"""Labelled people: what a model is asked about them, its errors, and the weights that a calibration stores."""

import json
import random

import msgspec
import pytest
from fake_server import FakeServer, completion, images, sound, texts
from test_calibrate import writer

from jrdb_avr.agent.model.calibrate import Calibration, calibrate
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.labelled_people import PERSON_LINE, PersonView, find_errors, request_labels
from jrdb_avr.agent.model.messages import Picture
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.engine.commands._people import labelled_people
from jrdb_avr.engine.run import evaluate as evaluating
from jrdb_avr.engine.run.endpoint import Endpoint, read_calibration, write_calibration
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.panorama import CROP, Box
from jrdb_avr.schema.repeats import USUAL_REPEATS, ErrorCorrelation, Repeats
from jrdb_avr.schema.rules import LoadRules

TRUE = {"gender": "female", "age": "young adulthood", "pose": "standing"}
WRONG = {"gender": "male", "age": "late adulthood", "pose": "lying"}


def view(name, labels=TRUE):
    return PersonView(Picture(name, name.encode()), Box(120, 96, 48, 240), labels)


def test_the_prompt_states_the_box_and_no_known_label():
    (message,) = request_labels(view("p", {"pose": "bending"}))
    assert message.parts[-1] == PERSON_LINE and message.parts[1].name == "p"
    assert "[250, 200, 350, 700]" in message.parts[0]
    others = request_labels(view("p", {"pose": "sitting"}))
    assert others == [message]


@pytest.mark.parametrize(
    ("reply", "errors"),
    [
        (TRUE, {"gender": False, "age": False, "pose": False}),
        (TRUE | {"gender": "male"}, {"gender": True, "age": False, "pose": False}),
        (TRUE | {"pose": "cannot tell"}, {"gender": False, "age": False}),
        (TRUE | {"pose": ["standing"], "age": 3}, {"gender": False}),
        ({"pose": "walking"}, {"pose": True}),
        ("no object", {}),
    ],
)
def test_a_stated_label_is_right_or_wrong(reply, errors):
    assert find_errors(Reply(content=json.dumps(reply)), view("p"), CONTRACT) == errors


def test_a_label_that_the_person_may_be_called_too_is_no_error():
    assert find_errors(Reply(content='{"pose": "sitting"}'), view("p", {"pose": "bending"}), CONTRACT) == {
        "pose": False
    }


def reader(people, frame, person):
    """A model whose errors repeat with these correlations in a frame, and in another frame."""
    rng, replies = random.Random(2), {}
    for views in people:
        wrong = {topic: rng.random() < 0.4 for topic in TRUE}
        drawn = (0.0, frame, person)
        for shown, correlation in zip(views, drawn, strict=True):
            kept = {
                t: w if not correlation or rng.random() < correlation else rng.random() < 0.4 for t, w in wrong.items()
            }
            said = {topic: (WRONG if mistaken else TRUE)[topic] for topic, mistaken in kept.items()}
            replies[shown.picture.uri] = said

    def script(request, n):
        if PERSON_LINE in texts(request):
            return completion(json.dumps(replies[images(request)[0]]), model="fake-1")
        return writer()(request, n)

    return script


def test_the_weights_of_a_model_are_measured_stored_and_taken_by_later_runs(tmp_path):
    people = [tuple(view(f"{i} {which}") for which in "abc") for i in range(60)]
    store = Store(tmp_path)
    with FakeServer(sound(reader(people, 0.9, 0.6), model="fake-1")) as server:
        found = calibrate(Client(server.url, "fake"), 12, people=people)
        write_calibration(store, found)
        endpoint = Endpoint(read_calibration(store, "fake"), "fake", server.url)
    assert found.reason == "" and found.frame_errors.pairs == found.person_errors.pairs == 180
    for errors, true in ((found.frame_errors, 0.9), (found.person_errors, 0.6)):
        assert abs(errors.correlation - true) < 2 * errors.standard_error < 0.3
    assert found.repeats.frame == pytest.approx(
        (1 - found.frame_errors.correlation) / (1 + found.frame_errors.correlation)
    )
    assert endpoint.repeats == found.repeats
    assert endpoint.settings["repeats"] == msgspec.structs.asdict(found.repeats)
    with FakeServer(sound(writer(), model="fake-1")) as server:
        assert calibrate(Client(server.url, "fake"), 12).repeats == USUAL_REPEATS
        assert Endpoint(None, "fake", server.url).settings["repeats"] == {"frame": 0.05, "person": 0.25}


def test_the_world_model_of_a_run_weighs_repeats_as_calibrated(benchmark_copy, monkeypatch):
    worlds = []

    def stop(name, client, convention, world, playing, given):
        worlds.append(world.repeats)
        raise StoreError("stop")

    monkeypatch.setattr(evaluating, "make_method", stop)
    model = {"model": "simulated", "served_model": "simulated", "response_format": "json_schema", "thinking": "off"}
    unread = {"asked_sha256": "", "asked": 0, "readable": 0, "scores": (), "boxes": {}, "scales": {}}
    measured = {"frame_errors": ErrorCorrelation(correlation=0.6), "person_errors": ErrorCorrelation(correlation=0.0)}
    write_calibration(benchmark_copy, Calibration(**model, **unread, **measured))
    with pytest.raises(StoreError, match="stop"):
        evaluating.evaluate(benchmark_copy, "agent", "simulated")
    assert worlds == [Repeats(frame=pytest.approx(0.25), person=1.0)]


def test_people_of_a_store_are_shown_with_their_labels(tmp_path):
    list(write(plan(tmp_path / "root", [(120, 6)], 42, "keyframes"), 1))
    store = Store(tmp_path / "store")
    load(find_root(tmp_path / "root"), store, LoadRules(), 1)
    people = labelled_people(store, 6)
    assert len(people) == 6 and people == labelled_people(store, 6)
    assert len({tuple(person[0].labels.items()) for person in people}) > 2
    rows = store.sql("SELECT * FROM intervals_sightings").to_pylist()
    sights = {(row["sequence"], row["frame"], round(row["w"], 3), round(row["h"], 3)): row for row in rows}
    for person in people:
        (sequence, frame, angle), (_, frame2, angle2), (_, later, _) = (shown.picture.name.split() for shown in person)
        assert frame == frame2 and int(later) == int(frame) + 15
        assert (float(angle2) - float(angle)) % 360 == pytest.approx(6.0)
        for shown, at in zip(person, (frame, frame, later), strict=True):
            row = sights[sequence, int(at), round(shown.box.w, 3), round(shown.box.h, 3)]
            assert row["clear"] and shown.labels["pose"] == row["pose"]
            assert 0 < shown.box.x + shown.box.w / 2 < CROP
