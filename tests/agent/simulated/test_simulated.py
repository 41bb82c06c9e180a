"""The marker server: what it refuses, what it reads, and how it ends."""

import base64
import contextlib
import json
import os
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request

import cv2
import numpy as np
import pytest
from fake_server import recorded_server
from painted import World, still

from jrdb_avr.agent.methods.react import ReAct
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.model.probes import BOX_LINE
from jrdb_avr.agent.preflight import CORNER_LINE
from jrdb_avr.agent.simulated.knobs import Knobs
from jrdb_avr.agent.simulated.play import STAGES
from jrdb_avr.agent.simulated.server import Server, marker_server
from jrdb_avr.schema.panorama import Box, iou
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time
from jrdb_avr.schema.wording.text import render

HELLO = [Message("user", ("hello",))]
POSES = ("walking", "sitting", "standing", "lying")


def check_evidence(prediction, box, least=0.9):
    assert prediction.status == "answered", prediction
    assert iou(Box(*prediction.evidence.box), box(prediction.evidence.frame)) >= least


# -- the server -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def marker():
    with recorded_server() as (url, _):
        yield url


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


def jpeg(image):
    return "data:image/jpeg;base64," + base64.b64encode(cv2.imencode(".jpg", image)[1].tobytes()).decode()


GREY = jpeg(np.full((480, 480, 3), 96, np.uint8))


def bomb():
    """A few bytes that say they are a picture of 4 billion pixels."""
    data = bytearray(base64.b64decode(GREY.partition(",")[2]))
    size = data.index(b"\xff\xc0") + 5
    data[size : size + 4] = struct.pack(">HH", 65500, 65500)
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()


def prompt(question=KNOWN, image=None, place=PLACE, frames="000000", left="23", more="", stage=REACT):
    parts = [
        {"type": "text", "text": f"Question: {question}\nMode: frame\nNo choices.\nLegal frames: {frames}"},
        {"type": "text", "text": f"Picture 1: {place}"},
        {"type": "text", "text": f"Looks made: 1, left: {left}\n{more}\n{stage}"},
    ]
    if image is not None:
        parts.insert(2, {"type": "image_url", "image_url": {"url": image}})
    return json.dumps({"model": "marker", "messages": [{"role": "user", "content": parts}]}).encode()


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"[]",
        b'{"messages": 3}',
        prompt("What is the weather?"),
        prompt("Find the only person who is standing at 1.0 s (frame 15). What?"),
        b'{"messages": [{"content": "\xff"}]}',
        prompt(frames="none"),
        prompt(frames="000000 to 000060 in steps of 0"),
        prompt(place="{}"),
        prompt(place=PLACE.replace("000000", "../../")),
        prompt(image="file:///etc/passwd"),
        prompt(image="data:image/jpeg;base64,////"),
        prompt(image="data:image/jpeg;base64,!"),
        b"[" * 200_000,
        b'{"messages": ' + b"[" * 200_000,
        prompt(left="x"),
        prompt(left="99999999999"),
        prompt(place=PLACE.replace("0.0", "NaN")),
        prompt(stage=ANSWER),
        prompt(stage=FACTS),
        prompt(stage=PLACE_STAGE),
        prompt(stage=BOX),
        prompt(stage=CHOICE),
        prompt(stage=CHOICE, image=GREY),
        prompt(stage=CHOICE, image=GREY, more="Refined box, stitched pixels: [1, 2, 3]"),
        prompt(stage=CHOICE, image=GREY, more='Refined box, stitched pixels: [1, 2, 3, "x"]'),
        prompt(stage=BOX_LINE),
        prompt(stage=CORNER_LINE, image=GREY),
        prompt(image=bomb()),
    ],
)
def test_requests_that_the_server_cannot_understand(marker, body):
    status, reply = post(marker, body)
    assert status == 400, reply
    assert "\n" not in reply["error"]["message"]


def test_a_model_named_like_a_profile_has_its_knobs():
    with Server(knobs=Knobs(thinking=1.0)) as server:
        said = {"messages": [{"role": "user", "content": "hello"}]}
        replies = {
            model: server.reply(json.dumps({"model": model, **said}).encode()) for model in ("marker", "perfect")
        }
    texts = {model: reply["choices"][0]["message"]["content"] for model, reply in replies.items()}
    assert texts["marker"].endswith(texts["perfect"]) and texts["marker"] != texts["perfect"]


def test_the_child_process_serves_and_ends(tmp_path):
    ask = [Message("user", (f"Question: {KNOWN}\nLegal frames: 000000\nLooks made: 0, left: 24\n{REACT}",))]
    with marker_server(tmp_path / "log", Knobs(refusal=1.0, seed=4)) as url:
        assert Client(url, "marker").probe(HELLO).model == "marker"
        assert Client(url, "marker").complete(ask).refusal, "it takes its knobs"
    with pytest.raises(urllib.error.URLError):
        post(url, b"{}")


def test_the_server_ends_with_its_parent():
    code = (
        "import sys, time\nfrom jrdb_avr.agent.simulated.server import marker_server\n"
        "with marker_server() as url:\n    print(url, flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        url = parent.stdout.readline().strip()
        assert Client(url, "marker").probe(HELLO).model == "marker"
        parent.kill()
    for _ in range(1200):
        try:
            post(url, b"{}")
        except OSError:
            return
        threading.Event().wait(0.05)
    pytest.fail("the server outlived its parent")


WATCHED = """
import os, runpy, sys
def watch(event, args):
    if event == "open" and isinstance(args[0], (str, bytes)):
        name = args[0] if isinstance(args[0], str) else args[0].decode()
        if "site-packages" not in name and not name.startswith((sys.prefix, sys.base_prefix)):
            print("opened", name, file=sys.stderr, flush=True)
sys.addaudithook(watch)
open(os.devnull).close()
sys.argv = ["marker"]
runpy.run_module("jrdb_avr.agent.simulated", run_name="__main__")
"""


@contextlib.contextmanager
def serving(code):
    """The URL of a server that this code starts in a process of its own, and its stderr's lines once it has ended."""
    told = []
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], text=True, **pipes) as process:
        try:
            yield process.stdout.readline().rpartition(" ")[2].strip(), told
        finally:
            told += process.communicate()[1].splitlines()


def test_the_marker_reads_nothing_but_what_it_is_sent(tmp_path):
    """While it plays a question, its process opens no file but the program's own."""
    box = still(1800, 7, pose="standing")
    world = World(tmp_path, [box], tuple(range(0, 151, 15)))
    with serving(WATCHED) as (url, told):
        times = {"t0": Time(frame=15), "t1": Time(frame=150)}
        spec = AnswerSpec(mode="multiple_choice", read="action", of="a", at="t1")
        plan = Plan("a", "a", times, (Node("a", (Condition(action="standing", at="t0"),)),), (), spec)
        task = world.task(render("change", plan, "0" * 64), "multiple_choice", POSES)
        prediction = ReAct(Client(url, "marker")).answer(task)
    assert prediction.status == "answered"
    check_evidence(prediction, box.box)
    # The first shows that the watch sees; source files are told of where the package runs from its folder.
    assert told[:1] == [f"opened {os.devnull}"]
    assert [line for line in told[1:] if not line.endswith((".py", ".pyc", ".pyi"))] == []


def test_a_client_that_goes_away_is_no_traceback():
    code = "import sys, runpy; sys.argv = ['m']; runpy.run_module('jrdb_avr.agent.simulated', run_name='__main__')"
    with serving(code) as (url, told):
        place = urllib.parse.urlsplit(url)
        for sent in (b"", b"POST /v1/chat/completions HTTP/1.1\r\nContent-Length: 100\r\n\r\n{"):
            gone = socket.create_connection((place.hostname, place.port))
            gone.sendall(sent)
            time.sleep(0.1)
            # A reset, as the kernel sends for a process that was killed.
            gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            gone.close()
        time.sleep(0.2)
        assert Client(url, "marker").probe(HELLO).model == "marker"
    assert told == []


def test_the_marker_loads_neither_loaders_nor_engines():
    code = (
        "import sys, jrdb_avr.agent.simulated.server\n"
        "bad = ('jrdb_avr.engine', 'jrdb_avr.loaders', 'jrdb_avr.queries', 'kuzu', 'duckdb', 'pyarrow')\n"
        "print([m for m in sys.modules if m.startswith(bad)])\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
