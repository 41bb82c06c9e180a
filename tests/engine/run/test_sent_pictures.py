"""What pictures a model is sent, byte for byte: crops as JPEG of quality 95, panoramas as their files."""

import base64
import json
import struct

import cv2
import numpy as np
import pytest
from painted import SEQUENCE, World, still
from reference_play import CHOICES, PLAN, Scripted, look, turn

from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.messages import wire
from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.engine.run.methods import METHODS, WORLD_METHODS, make_method
from jrdb_avr.queries.beliefs.graph import WorldGraph


def tables_of_quality(quality):
    _, data = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return tables_in(data.tobytes())


def tables_in(jpeg):
    """The quantisation tables in a JPEG file, by their numbers: its segments are gone through as far as the pixels."""
    found, at = {}, 2
    assert jpeg[:2] == b"\xff\xd8"
    while jpeg[at + 1] != 0xDA:
        (length,) = struct.unpack(">H", jpeg[at + 2 : at + 4])
        if jpeg[at + 1] == 0xDB:
            body = jpeg[at + 4 : at + 2 + length]
            for start in range(0, len(body), 65):
                assert body[start] >> 4 == 0, "eight bits a step"
                found[body[start] & 15] = body[start + 1 : start + 65]
        at += 2 + length
    return [found[number] for number in sorted(found)]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return World(tmp_path_factory.mktemp("painted"), [still(1845, 7, pose="standing")], tuple(range(0, 300, 15)))


EVIDENCE = {"evidence_bboxes": [{"frame_id": "000165", "bbox": [490, 250, 510, 700]}]}
SCRIPTS = {
    "search-recognize": [EVIDENCE, EVIDENCE],
    "react": [{"action": "observe", "frame_id": "000150", "angle_deg": 170.5}] * 2,
    "agent": [PLAN, turn(look(), look(165, 3.0))],
    "agent-passive": [PLAN],
    "agent-no-world": [turn(look(), look(165, 3.0))],
}
CROPS = {"search-recognize": 1, "react": 1, "agent": 2, "agent-no-world": 2}


@pytest.mark.parametrize("name", METHODS)
def test_what_a_method_sends(world, name):
    chat = Scripted([*SCRIPTS.get(name, []), "nothing more"])
    with WorldGraph.memory() as graph:
        method = make_method(name, chat, CONTRACT, WorldModel(graph, "run") if name in WORLD_METHODS else None)
        method.answer(world.task("What does the person do?", "multiple_choice", CHOICES))
    files = [path.read_bytes() for path in (world.root / SEQUENCE).glob("*.jpg")]
    crops, panoramas = set(), set()
    for jpeg in set(sent(chat.requests)):
        height, width = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape[:2]
        if (width, height) == (480, 480):
            assert tables_in(jpeg) == tables_of_quality(95)
            crops.add(jpeg)
        else:
            assert (width, height) == (3760, 480)
            assert jpeg in files
            # The files of this world are of another quality: nothing was encoded anew.
            assert tables_in(jpeg) == tables_of_quality(90)
            panoramas.add(jpeg)
    # Most directions of this world look the same.
    assert len(crops) == CROPS.get(name, 0)
    assert bool(panoramas) == (name not in ("react", "agent", "agent-no-world"))


def sent(requests):
    """The pictures of requests, as they travel."""
    for messages in requests:
        for message in json.loads(json.dumps(wire(messages))):
            for part in message["content"] if isinstance(message["content"], list) else ():
                if part["type"] == "image_url":
                    kind, _, data = part["image_url"]["url"].partition(",")
                    assert kind == "data:image/jpeg;base64"
                    yield base64.b64decode(data, validate=True)


def test_a_crop_is_sent_in_its_own_colours(world):
    chat = Scripted([*SCRIPTS["react"], "nothing more"])
    make_method("react", chat, CONTRACT).answer(world.task("?", "multiple_choice", CHOICES))
    (jpeg,) = set(sent(chat.requests))
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_RGB).astype(float)
    seen = world.observe(SEQUENCE, 150, 170.5).image.astype(float)
    assert np.abs(shown - seen).mean() < np.abs(shown - seen[:, :, ::-1]).mean() / 3
    assert 10 * np.log10(255**2 / ((shown - seen) ** 2).mean()) > 35
