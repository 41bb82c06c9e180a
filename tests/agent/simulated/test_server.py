"""The simulated model's server: requests that it refuses, profiles, and its process."""

import contextlib
import json
import socket
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request

import pytest
from fake_server import recorded_server
from painted import FRAMES, POSES, asked_people

from jrdb_avr.agent.model.calibrate import calibrate
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.labelled_people import PERSON_LINE, PersonView, find_errors, request_labels
from jrdb_avr.agent.model.messages import Message, picture_of
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.probes import BOX_LINE, CORNER_LINE
from jrdb_avr.agent.preflight import preflight
from jrdb_avr.agent.simulated.brain import STAGES
from jrdb_avr.agent.simulated.profiles import PROFILES, parse_errors
from jrdb_avr.agent.simulated.server import Server, simulated_server
from jrdb_avr.schema.errors import EndpointError
from jrdb_avr.schema.panorama import Box, to_crop

HELLO = [Message("user", ("Reply with the one word: ready",))]
DECLARED = EndpointOptions(simulated=True)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return asked_people(tmp_path_factory.mktemp("world"))


@pytest.fixture(scope="module")
def url(world):
    with recorded_server(world) as (address, _):
        yield address


def post(url, body):
    request = urllib.request.Request(f"{url}/chat/completions", body, {"Content-Type": "application/json"})
    try:
        with urllib.request.urlopen(request) as response:
            return response.status, json.load(response)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)


KNOWN = (
    "Find the only person who is standing at 1.0 s (frame 15). "
    "Which of these is that person doing at 4.0 s (frame 60)? Only one is true."
)
ANSWER, FACTS, PLACE_STAGE, BOX, CHOICE, REACT, *_ = STAGES
PLACE = '{"frame_id":"000000","angle_deg":0.0,"left":3520}'
IMAGE = "data:image/jpeg;base64,AA=="
REFERENCE = {"sequence": "painted", "frame": 0, "angle": 0.0}


def prompt(
    question=KNOWN, image=None, place=PLACE, frames="000000", left="23", more="", stage=REACT, reference=REFERENCE
):
    parts = [
        {"type": "text", "text": f"Question: {question}\nMode: frame\nNo choices.\nLegal frames: {frames}"},
        {"type": "text", "text": f"Picture 1: {place}"},
        {"type": "text", "text": f"Looks made: 1, left: {left}\n{more}\n{stage}"},
    ]
    if image is not None:
        parts.insert(2, {"type": "image_url", "image_url": {"url": image}, "jrdb_avr": reference})
    return json.dumps({"model": "simulated", "messages": [{"role": "user", "content": parts}]}).encode()


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"[]",
        b'{"messages": 3}',
        b'{"messages": [], "stream": true}',
        prompt("What is the weather?"),
        prompt("Find the only person who is standing at 1.0 s (frame 15). What?"),
        b'{"messages": [{"content": "\xff"}]}',
        prompt(frames="none"),
        prompt(frames="000000 to 000060 in steps of 0"),
        prompt(place="{}"),
        prompt(place=PLACE.replace("000000", "../../")),
        prompt(image=IMAGE, reference=None),
        prompt(image=IMAGE, reference={"frame": "x"}),
        b"[" * 200_000,
        b'{"messages": ' + b"[" * 200_000,
        prompt(left="x"),
        prompt(left="99999999999"),
        prompt(place=PLACE.replace("0.0", "NaN")),
        prompt(stage=CHOICE),
        prompt(stage=CHOICE, image=IMAGE),
        prompt(stage=CHOICE, image=IMAGE, more="Refined box, stitched pixels: [1, 2, 3]"),
        prompt(stage=CHOICE, image=IMAGE, more='Refined box, stitched pixels: [1, 2, 3, "x"]'),
        prompt(stage=BOX_LINE),
        prompt(stage=CORNER_LINE, image=IMAGE),
        prompt(stage=PERSON_LINE, image=IMAGE),
    ],
)
def test_requests_that_the_server_cannot_understand(url, body):
    status, reply = post(url, body)
    assert status == 400, reply
    assert "\n" not in reply["error"]["message"]


def test_an_undeclared_run_is_refused(world, url):
    picture = picture_of(world.observe("painted", 15, 0.0))
    text = f"Question: {KNOWN}\nLegal frames: 000015\nPicture 1: {PLACE}"
    chat = [Message("user", (text, picture, f"Looks made: 1, left: 3\n{REACT}"))]
    with pytest.raises(EndpointError, match="declare the run simulated"):
        Client(url, "m").complete(chat)
    assert Client(url, "m", DECLARED).complete(chat).content


def test_a_model_named_after_a_profile_has_its_errors(world):
    with Server(world) as server:
        bodies = [prompt(image=IMAGE, stage=ANSWER), prompt(image=IMAGE, stage=PLACE_STAGE)]
        said = {
            model: [server.reply(body.replace(b'"simulated"', f'"{model}"'.encode())) for body in bodies]
            for model in ("simulated:perfect", "perfect", "simulated")
        }
    contents = {
        model: [reply["choices"][0]["message"]["content"] for reply in replies] for model, replies in said.items()
    }
    assert contents["simulated:perfect"] == contents["perfect"]
    assert said["simulated"][0]["model"] == "simulated"


def test_replies_are_malformed_at_their_rate(world):
    with Server(world, parse_errors(["malformed=0.2", "seed=5"])) as server:
        bodies = [prompt(left=str(n), stage=REACT) for n in range(300)]
        broken = 0
        for body in bodies:
            content = server.reply(body)["choices"][0]["message"]["content"]
            assert content == server.reply(body)["choices"][0]["message"]["content"]
            try:
                json.loads(content)
            except ValueError:
                broken += 1
    assert 40 <= broken <= 80


def test_it_passes_every_check_and_the_calibration(url):
    client = Client(url, "simulated", DECLARED)
    assert [check.line for check in preflight(client) if not check.passed] == []
    found = calibrate(client, 12)
    assert (found.reason, found.readable, found.boxes) == ("", 12, {"bbox": "xyxy"})


def test_labels_of_a_person_are_read_for_the_calibration(world, url):
    seen = world.observe("painted", 90, 0.0)
    (person,) = [person for person in world.people("painted", 90) if person.track == 7]
    view = PersonView(picture_of(seen), to_crop(Box(*person.box), seen.left), {"pose": "sitting"})
    reply = Client(url, "simulated", DECLARED).complete(request_labels(view))
    assert find_errors(reply, view, CONTRACT) == {"pose": False}


def test_a_server_without_a_store_passes_checks_and_plays_nothing():
    with simulated_server(None, None) as url:
        assert [check.name for check in preflight(Client(url, "simulated", DECLARED)) if not check.passed] == []
        status, reply = post(url, prompt(image=IMAGE, stage=ANSWER))
        assert status == 400 and "no store" in reply["error"]["message"]
    with pytest.raises(urllib.error.URLError):
        post(url, b"{}")


@contextlib.contextmanager
def serving(*arguments):
    """The URL of a server in a process of its own, and the lines of its stderr once it has ended."""
    command = [sys.executable, "-m", "jrdb_avr.agent.simulated", *arguments]
    lines = []
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            yield process.stdout.readline().rpartition(" ")[2].strip(), lines
        finally:
            process.kill()
            lines += process.communicate()[1].splitlines()


def test_a_client_that_goes_away_is_no_traceback(small_demo):
    with serving("--store", str(small_demo.folder / "store"), "--profile", "lasting") as (url, lines):
        place = urllib.parse.urlsplit(url)
        for sent in (b"", b"POST /v1/chat/completions HTTP/1.1\r\nContent-Length: 100\r\n\r\n{"):
            gone = socket.create_connection((place.hostname, place.port))
            gone.sendall(sent)
            time.sleep(0.1)
            # A reset, as the kernel sends for a process that was killed.
            gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            gone.close()
        time.sleep(0.2)
        assert Client(url, "any").probe(HELLO).model == "any"
    assert lines == []


def test_a_store_without_annotations_is_named(tmp_path):
    with serving("--store", str(tmp_path)) as (url, lines):
        assert url == ""
    assert "is not a store" in lines[-1]


def test_it_loads_neither_loaders_nor_engines():
    code = (
        "import sys, jrdb_avr.agent.simulated.server\n"
        "print([m for m in sys.modules if m.startswith(('jrdb_avr.engine', 'jrdb_avr.loaders', 'kuzu', 'duckdb'))])\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_the_profiles_of_a_run_play_the_world(world, url):
    """A whole request, so that each profile reads pictures without an error."""
    places = [{"frame_id": f"{frame:06d}", "angle_deg": 0.0} for frame in FRAMES]
    parts = [{"type": "text", "text": f"Question: {KNOWN}\nChoices:\n" + "\n".join(f"1. {pose}" for pose in POSES)}]
    for place in places:
        parts.append({"type": "text", "text": f"Picture: {json.dumps(place)}"})
        reference = {"sequence": "painted", "frame": int(place["frame_id"]), "angle": None}
        parts.append({"type": "image_url", "image_url": {"url": IMAGE}, "jrdb_avr": reference})
    parts.append({"type": "text", "text": ANSWER})
    for name in PROFILES.keys() - {"recorded"}:
        body = json.dumps({"model": f"simulated:{name}", "messages": [{"role": "user", "content": parts}]}).encode()
        with Server(world) as server:
            content = server.reply(body)["choices"][0]["message"]["content"]
        assert "answer" in content
