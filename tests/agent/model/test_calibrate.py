"""Calibration: models that write boxes in known ways, and the one reading that explains each."""

import functools
import json
import random

import pytest
from click.testing import CliRunner
from fake_server import FakeServer, Status, completion, images, marked, sound, texts

from jrdb_avr.agent.model.calibrate import calibrate, request
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT, Reading, convention_of
from jrdb_avr.agent.model.messages import wire
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.probes import CORNERS, CROP_SIZE, drawn_picture, drawn_rectangles
from jrdb_avr.agent.simulated.server import simulated_server
from jrdb_avr.engine.cli import group
from jrdb_avr.engine.run.endpoint import Endpoint, convention_path, read_calibration, write_calibration
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import EndpointError, StoreError
from jrdb_avr.schema.panorama import iou

N = 12
GEMMA = "google/gemma-4-E4B-it"
QWEN = "Qwen/Qwen3-VL-8B-Instruct"


@pytest.fixture(scope="module", autouse=True)
def drawn_once():
    """The pictures are a function of number and seed, and dear to draw."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jrdb_avr.agent.model.calibrate.drawn_rectangles", functools.cache(drawn_rectangles))
        yield


def writer(order="xyxy", scale="thousandths", key="bbox", noise=0.0, resized=None, keys=None):
    """A model that sees the red rectangle and writes its box in one way."""

    def script(request, n):
        width, height, (x, y, w, h) = marked(request)
        rng = random.Random(n)
        x, y = (v + rng.uniform(-noise, noise) for v in (x, y))
        full = {"thousandths": (1000, 1000), "unit": (1, 1), "pixels": (width, height)}.get(scale)
        across, down = full or resized(width, height)
        corners = [x / width * across, y / height * down, (x + w) / width * across, (y + h) / height * down]
        if scale != "unit":
            corners = [round(corner) for corner in corners]
        if order == "yxyx":
            corners = [corners[1], corners[0], corners[3], corners[2]]
        written = keys[n % len(keys)] if keys else key
        return completion(json.dumps({"evidence_bboxes": [{"frame_id": "000150", written: corners}]}), model="fake-1")

    return script


def asked(script, model="fake", n=N, **options):
    with FakeServer(script) as server:
        client = Client(server.url, model, EndpointOptions(**options), convention=convention_of(model))
        return calibrate(client, n)


@pytest.mark.parametrize(
    ("model", "habit"),
    [
        ("fake", {}),
        ("fake", {"order": "yxyx"}),
        ("fake", {"scale": "unit"}),
        ("fake", {"scale": "unit", "order": "yxyx"}),
        ("fake", {"scale": "pixels"}),
        (GEMMA, {"key": "box_2d", "order": "yxyx"}),
        (GEMMA, {"key": "bbox", "order": "yxyx"}),
        (GEMMA, {"scale": "resized", "resized": convention_of(GEMMA).resized}),
        (QWEN, {"key": "bbox_2d"}),
        (QWEN, {"key": "bbox_2d", "scale": "pixels"}),
        ("fake", {"order": "yxyx", "noise": 8.0}),
    ],
)
def test_the_reading_that_explains_the_replies(model, habit):
    found = asked(writer(**habit), model)
    key = habit.get("key", "bbox")
    reading = Reading(habit.get("order", "xyxy"), habit.get("scale", "thousandths"))
    assert found.reason == ""
    assert (found.boxes, found.scales) == ({key: reading.order}, {key: reading.scale})
    (best,) = [score for score in found.scores if score.chosen]
    assert best.share == 1.0 and best.n == N
    assert best.median_iou > (0.75 if "noise" in habit else 0.9)
    convention = found.convention(convention_of(model))
    assert convention.calibrated and convention.reading(key) == reading
    others = set(convention_of(model).boxes) - {key}
    assert all(convention.reading(other) == convention_of(model).reading(other) for other in others)


def test_two_keys_are_read_each_as_it_is_written():
    habits = writer(keys=["bbox", "box_2d"]), writer(order="yxyx", keys=["bbox", "box_2d"])
    found = asked(lambda request, n: habits[n % 2](request, n), GEMMA, n=2 * N)
    assert found.boxes == {"bbox": "xyxy", "box_2d": "yxyx"}


def test_a_key_that_is_rarely_written_stays_as_declared():
    found = asked(writer(keys=["bbox_2d"] * 5 + ["bbox"]), QWEN, n=N)
    assert found.boxes == {"bbox_2d": "xyxy"}
    assert {score.key for score in found.scores} == {"bbox", "bbox_2d"}


def somewhere(request, n):
    """A model that guesses."""
    x, y = random.Random(n).sample(range(0, 700), 2)
    box = [x, y, x + 300, y + 300]
    return completion(json.dumps({"evidence_bboxes": [{"frame_id": "000150", "bbox": box}]}))


def undecided(request, n):
    """Both orders in turn."""
    return writer(order=("xyxy", "yxyx")[n % 4 // 2])(request, n)


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        (somewhere, "no reading explains"),
        (undecided, "no reading"),
        (lambda request, n: "It is in the middle.", "only 0 of 12 replies hold a box"),
        (lambda request, n: '{"evidence_bboxes": [{"bbox": [0, 0, 9]}]}', "only 0 of 12"),
        (lambda request, n: '{"evidence_bboxes": [{"bbox": [0, 0, NaN, 9]}]}', "only 0 of 12"),
        (lambda request, n: '{"evidence_bboxes": [{"bbox": [0, 0, true, 9]}]}', "only 0 of 12"),
        (lambda request, n: '{"evidence_bboxes": [{"bbox": [9, 9, 0, 0]}]}', "no reading explains"),
        (lambda request, n: completion("{", "length"), "only 0 of 12"),
        (lambda request, n: writer()(request, n) if n < 5 else "no", "only 5 of 12"),
        (writer(keys=["bbox", "bbox_2d", "box_2d"]), "no key was written 10 times"),
    ],
)
def test_where_nothing_is_clear_nothing_is_chosen(script, reason):
    found = asked(script)
    assert reason in found.reason
    assert found.boxes == found.scales == {}
    assert not any(score.chosen for score in found.scores)
    assert found.convention(CONTRACT).boxes == CONTRACT.boxes


def test_the_simulated_model_writes_as_the_contract_asks():
    with simulated_server(None, None) as url:
        found = calibrate(Client(url, "simulated", EndpointOptions(simulated=True)), N)
    assert (found.boxes, found.scales) == ({"bbox": "xyxy"}, {"bbox": "thousandths"})
    assert found.scores[0].median_iou > 0.95


# -- what is asked ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_pictures_show_what_is_known_of_them():
    """The red pixels of each JPEG say where its rectangle is."""
    pictures = drawn_rectangles(50, 0)
    assert len(pictures) == 50
    assert {drawn.size for drawn in pictures} == {(480, 480), (3760, 480)}
    for drawn in pictures:
        width, height, box = marked({"messages": wire(request(drawn))})
        assert (width, height) == drawn.size
        assert iou(type(drawn.box)(*box), drawn.box) > 0.95
    assert [drawn.picture.digest for drawn in drawn_rectangles(4, 0)] == [d.picture.digest for d in pictures[:4]]
    assert drawn_rectangles(1, 1)[0].picture.digest != pictures[0].picture.digest


def test_each_corner_shows_its_own_rectangle():
    assert len({drawn_picture(CROP_SIZE, box).digest for box in CORNERS.values()}) == 4


def test_a_server_that_changes_its_model_is_no_model():
    write = writer()
    found = asked(lambda request, n: {**write(request, n), "model": ["fake-1", "other\x1b"][n == 3]})
    assert "several models replied" in found.reason and found.reason.isprintable()
    assert not found.boxes and not any(score.chosen for score in found.scores)


def test_what_was_asked_is_told_by_its_hash():
    plain = asked(writer(), n=N)
    assert asked(writer(order="yxyx"), n=N).asked_sha256 == plain.asked_sha256
    for other in ({"n": N + 1}, {"response_format": "none"}):
        assert asked(writer(), **other).asked_sha256 != plain.asked_sha256


def test_the_true_box_is_in_no_request():
    """Requests of different rectangles differ in their pictures only."""
    pictures = drawn_rectangles(10, 0)
    assert len({drawn.box for drawn in pictures}) == 10
    sent = [part for drawn in pictures for message in request(drawn) for part in message.parts]
    assert len({part for part in sent if isinstance(part, str)}) == 2
    wired = [wire(request(drawn), simulated)[0]["content"] for drawn in pictures for simulated in (False, True)]
    said = [part for parts in wired for part in parts if "jrdb_avr" in part]
    assert [part["jrdb_avr"]["rectangle"] for part in said] == [drawn.box for drawn in pictures]
    assert [drawn.picture.name for drawn in pictures[:2]] == ["drawn 000 480x480", "drawn 001 3760x480"]


# -- the store --------------------------------------------------------------------------------------------------------


def test_what_was_found_is_taken_by_later_runs(tmp_path):
    store = Store(tmp_path)
    with FakeServer(sound(writer(order="yxyx"), model="fake-1")) as server:
        before = Endpoint(read_calibration(store, "fake"), "fake", server.url)
        assert before.convention == CONTRACT
        path = write_calibration(store, calibrate(before.client, N))
        assert path == tmp_path / "conventions" / "fake.json"
        after = Endpoint(read_calibration(store, "fake"), "fake", server.url)
        assert after.convention.boxes == {"bbox": "yxyx"}
        assert after.settings["convention"]["calibrated"]
        assert after.settings["convention"]["asked_sha256"] == read_calibration(store, "fake").asked_sha256
        assert json.loads(json.dumps(after.settings)) == after.settings
        for what, options in (("response format", {"response_format": "none"}), ("thinking", {"thinking": "template"})):
            with pytest.raises(EndpointError, match=f"calibrated with {what}"):
                Endpoint(read_calibration(store, "fake"), "fake", server.url, EndpointOptions(**options))
    with (
        FakeServer(sound(writer(), model="fake-2")) as server,
        pytest.raises(EndpointError, match="served model 'fake-1', not 'fake-2'"),
    ):
        Endpoint(read_calibration(store, "fake"), "fake", server.url)


@pytest.mark.parametrize("model", ["fake", "a/b", "a-b", "../../etc/passwd", "..", "", "x" * 300, "caf\u00e9", "a b"])
def test_any_model_has_a_place_in_the_store(tmp_path, model):
    path = convention_path(Store(tmp_path), model)
    assert path.parent == tmp_path / "conventions"
    assert len(path.name) < 110
    assert path.name.isascii() and not path.name.startswith(".")


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"\xff", b'{"model": "fake"}'])
def test_a_broken_calibration_is_told(tmp_path, data):
    store = Store(tmp_path)
    path = convention_path(store, "fake")
    path.parent.mkdir()
    path.write_bytes(data)
    with pytest.raises(StoreError, match="calibrate again"):
        read_calibration(store, "fake")


def test_a_calibration_of_another_model_is_told(tmp_path):
    store = Store(tmp_path)
    path = write_calibration(store, asked(writer()))
    path.rename(convention_path(store, "other"))
    with pytest.raises(StoreError, match="of another model"):
        read_calibration(store, "other")


# -- the command ------------------------------------------------------------------------------------------------------


@pytest.fixture
def public(tmp_path):
    """A store as it is on a machine without labels."""
    Store(tmp_path).question_path("questions").parent.mkdir()
    Store(tmp_path).question_path("questions").touch()
    return tmp_path


def run(server, store, *more):
    arguments = ["calibrate", "--model", "fake", "--base-url", server.url, "--store", str(store), *more]
    return CliRunner().invoke(group, arguments)


def test_the_command_stores_what_it_finds(public):
    with FakeServer(sound(writer(order="yxyx"), model="fake")) as server:
        result = run(server, public, "--json")
        again = run(server, public)
    assert result.exit_code == again.exit_code == 0
    rows = json.loads(result.stdout)
    (chosen,) = [row for row in rows if row["chosen"]]
    assert (chosen["key"], chosen["order"], chosen["scale"], chosen["n"]) == ("bbox", "yxyx", "thousandths", 50)
    assert read_calibration(Store(public), "fake").boxes == {"bbox": "yxyx"}
    assert "yxyx" in again.output


def test_the_command_stores_nothing_that_is_not_clear(public):
    with FakeServer(sound(somewhere)) as server:
        result = run(server, public, "--json")
    assert result.exit_code == 1
    assert "nothing is stored: bbox: no reading explains" in result.stderr
    assert len(json.loads(result.stdout)) == 8
    assert [path.name for path in public.iterdir()] == ["questions"]


def test_a_server_that_takes_one_picture_at_a_time_is_calibrated(public):
    def one(request, n):
        return Status(400, "at most 1 image") if len(images(request)) > 1 else sound(writer())(request, n)

    with FakeServer(one) as server:
        result = run(server, public)
    assert result.exit_code == 0
    assert "warning: panoramas: 8 panoramas in one request" in result.stderr


def test_a_server_that_fails_its_preflight_is_warned_of_and_nothing_is_stored(public):
    with FakeServer(lambda request, n: "ready" if "ready" in texts(request) else "no") as server:
        result = run(server, public)
    assert result.exit_code == 1
    assert "warning: schema: json_schema is not followed" in result.stderr
    assert "nothing is stored" in result.stderr
