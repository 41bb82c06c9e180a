"""The marker model's knobs: rates, draws that depend on the request alone, and nothing changed where none is turned."""

import base64
import json
import random
import subprocess
import sys

import cv2
import msgspec
import numpy as np
import pytest
from environment import DOCS

from jrdb_avr.agent.model.decode import reply_object
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.policy.explorer import Look, Sighting
from jrdb_avr.agent.simulated.knobs import (
    PERFECT,
    PROFILES,
    Draws,
    Knobs,
    knob_table,
    parse,
    profile_of,
    settings,
)
from jrdb_avr.agent.simulated.reply_faults import with_wrong_boxes
from jrdb_avr.agent.simulated.perception import Perception, PictureMarks
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.schema.errors import DecodeError, InputError
from jrdb_avr.schema.markers import Mark, Reading
from jrdb_avr.schema.panorama import Box, iou
from jrdb_avr.schema.things import OBJECTS, VERBS

REACT = "Your next turn, as one JSON object:"
N = 500
RATE = 0.2
NEAR = 4 * (RATE * (1 - RATE) / N) ** 0.5
"""Four standard deviations of the share of N draws: fixed seeds make it all or never."""

QUESTION = (
    "Find the only person who is standing at 1.0 s (frame 15). "
    "Which of these is that person doing at 4.0 s (frame 60)? Only one is true."
)


def body(salt=0):
    """A ReAct turn before any look; `salt` makes it another request."""
    text = f"Question: {QUESTION}\nChoices:\n1. sitting\n2. lying\nLegal frames: 000000 to 000090 in steps of 15"
    messages = [
        {"role": "system", "content": f"{salt}"},
        {"role": "user", "content": f"{text}\nLooks made: 0, left: 24\n{REACT}"},
    ]
    return json.dumps({"model": "marker", "messages": messages}).encode()


@pytest.fixture
def serve():
    """Replies of servers with knobs, without a socket in between."""
    servers = []

    def replies(bodies, **knobs):
        servers.append(Server(knobs=Knobs(**knobs)))
        return [msgspec.json.encode(servers[-1].reply(one)) for one in bodies]

    yield replies
    for server in servers:
        server.server_close()


def decoded(reply):
    """A completion's bytes as the client hands them on."""
    choice = json.loads(reply)["choices"][0]
    message = choice["message"]
    return Reply(message["content"] or "", finish_reason=choice["finish_reason"], refusal=message.get("refusal") or "")


def readable(reply):
    try:
        return reply_object(decoded(reply))
    except DecodeError:
        return None


# -- settings ---------------------------------------------------------------------------------------------------------


def test_knobs_are_read_from_texts_and_written_back():
    matrix = {"pose": {"standing": {"walking": 0.25}}}
    texts = ["wrong_box=0.1", "refusal=1", "latency=0.25", " seed = 3", "ids=off", f"confuse={json.dumps(matrix)}"]
    knobs = parse(texts)
    assert knobs == Knobs(wrong_box=0.1, refusal=1.0, latency=0.25, seed=3, ids=False, confuse=matrix)
    assert parse(settings(knobs)) == knobs
    assert parse([]) == PERFECT and settings(PERFECT) == []


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["wrong=0.1"], "no knob"),
        (["wrong_box"], "no knob"),
        (["__init__=1"], "no knob"),
        (["wrong_box="], "from 0 to 1"),
        (["wrong_box=1.01"], "from 0 to 1"),
        (["wrong_box=-0.1"], "from 0 to 1"),
        (["malformed=nan"], "from 0 to 1"),
        (["refusal=inf"], "from 0 to 1"),
        (["latency=601"], "from 0 to 600"),
        (["seed=1.5"], "whole number"),
        (["seed=-1"], "whole number"),
        (["seed=1e3"], "whole number"),
        (["seed=5.0"], "whole number"),
        (["seed=\u0663"], "whole number"),
        (["refusal=0.1", "refusal=0.1"], "twice"),
        (["ids=no"], "on or off"),
        (["pixels=1.5"], "whole number"),
        (["confuse=2"], "from 0 to 1"),
        (["confuse={"], "a JSON object"),
        (['confuse={"pose": {"standing": {"flying": 1}}}'], "no pose is called 'flying'"),
    ],
)
def test_a_wrong_knob_is_told_in_one_line(texts, said):
    with pytest.raises(InputError, match=said) as caught:
        parse(texts)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_is_a_model_and_knobs_change_it(name):
    profile = profile_of(f"simulated:{name}")
    assert parse(settings(profile)) == profile
    changed = parse(["seed=5", "ids=on", "wrong_box=0"], profile)
    assert (changed.seed, changed.ids, changed.wrong_box) == (5, True, 0)
    assert changed.malformed == profile.malformed


def test_every_knob_has_a_meaning_and_help_lists_it():
    table = knob_table()
    assert [name for name, *_ in table] == [*Knobs.__struct_fields__] and all(meaning for *_, meaning in table)
    printed = subprocess.run(
        [sys.executable, "-m", "jrdb_avr.agent.simulated", "--help"], capture_output=True, text=True
    )
    assert all(f"{name}={default}  {meaning}" in printed.stdout for name, default, meaning in table)


def test_the_page_on_models_lists_every_knob_and_profile():
    page = (DOCS / "models.md").read_text()
    assert all(f"| `{name}` | {default} | {meaning} |" in page for name, default, meaning in knob_table())
    assert all(f"`{name}`" in page for name in PROFILES)


# -- replies ----------------------------------------------------------------------------------------------------------


def test_nothing_turned_changes_no_byte(serve):
    bodies = [body(salt) for salt in range(20)]
    perfect = serve(bodies)
    assert serve(bodies, seed=77) == perfect
    assert serve(bodies, refusal=1e-12, wrong_box=1e-12, wrong_attribute=1e-12) == perfect


@pytest.mark.parametrize(
    "knob", ["malformed", *(pytest.param(knob, marks=pytest.mark.slow) for knob in ("refusal", "truncated"))]
)
def test_rate_of_spoiled_replies(serve, knob):
    bodies = [body(salt) for salt in range(N)]
    replies = serve(bodies, **{knob: RATE, "seed": 1})
    spoiled = [readable(reply) is None for reply in replies]
    assert abs(sum(spoiled) / N - RATE) < NEAR
    assert [r for r, bad in zip(replies, spoiled, strict=True) if not bad] == [
        r for r, bad in zip(serve(bodies), spoiled, strict=True) if not bad
    ], "the others are as they were"
    others = serve(bodies, **{knob: RATE, "seed": 2})
    assert [readable(reply) is None for reply in others] != spoiled
    kinds = {
        (decoded(r).finish_reason, bool(decoded(r).refusal)) for r, bad in zip(replies, spoiled, strict=True) if bad
    }
    assert kinds == {{"malformed": ("stop", False), "refusal": ("stop", True), "truncated": ("length", False)}[knob]}


def test_thinking_stands_before_replies_and_changes_none(serve):
    bodies = [body(salt) for salt in range(N)]
    replies = serve(bodies, thinking=RATE)
    thinks = [decoded(reply).content.startswith("<think>") for reply in replies]
    assert abs(sum(thinks) / N - RATE) < NEAR
    assert [readable(reply) for reply in replies] == [readable(reply) for reply in serve(bodies)]


def test_replies_depend_on_the_request_alone(serve):
    bodies = [body(salt) for salt in range(200)]
    knobs = {"malformed": 0.3, "refusal": 0.2, "truncated": 0.2, "thinking": 0.5, "seed": 9}
    straight = dict(zip(bodies, serve(bodies, **knobs), strict=True))
    shuffled = random.Random(0).sample(bodies, len(bodies))
    assert dict(zip(shuffled, serve(shuffled, **knobs), strict=True)) == straight


# -- boxes ------------------------------------------------------------------------------------------------------------


def look(*people, name="", frame=30):
    sightings = [Sighting(frame, Mark(i), box, True, 180.0) for i, box in enumerate(people)]
    return Look(frame, 180.0, tuple(sightings), name=name)


HERS, HIS = [208, 208, 333, 625], [625, 208, 833, 833]
CROWD = look(Box(100, 100, 60, 200), Box(300, 100, 100, 300))


def evidence(box, frame="000030"):
    return {"answer": 2, "evidence_bboxes": [{"frame_id": frame, "bbox": box}]}


def wrong_boxes(reply, looks, seeds=N, rate=RATE):
    """What each of many requests gets in the reply's place, where anything is changed."""
    changed = []
    for seed in range(seeds):
        got = with_wrong_boxes(reply, looks, Knobs(wrong_box=rate), Draws(seed, "request"))
        changed += [got] if got != reply else []
    return changed


def area(box):
    return Box(box[0], box[1], box[2] - box[0], box[3] - box[1])


def test_wrong_boxes_are_another_person_or_shifted_away():
    changed = wrong_boxes(evidence(HERS), [CROWD])
    assert abs(len(changed) / N - RATE) < NEAR
    boxes = [reply["evidence_bboxes"][0]["bbox"] for reply in changed]
    his = sum(box == HIS for box in boxes)
    assert 0.25 < his / len(boxes) < 0.75
    for reply, box in zip(changed, boxes, strict=True):
        assert reply["answer"] == 2 and reply["evidence_bboxes"][0]["frame_id"] == "000030"
        assert 0 <= box[0] < box[2] <= 1000 and 0 <= box[1] < box[3] <= 1000 and all(type(v) is int for v in box)
        assert iou(area(box), area(HERS)) < 0.5


# -- what is read -----------------------------------------------------------------------------------------------------


def reader(knobs, question=QUESTION):
    """Returns what the mark of a large person in the picture of a hash is read as."""

    def see(digest, mark):
        box = Box(100, 100, 100, 300)
        readings = Perception(knobs, question).readings(PictureMarks(digest, (480, 480), (Reading(mark, box, True),)))
        return readings[0].mark

    return see


FULL = Mark(
    7,
    gender="female",
    age="adolescence",
    pose="standing",
    actions=("reading",),
    group=3,
    distance_dm=50,
    heading_deg=90,
    partner=9,
    interaction="conversation",
    object=OBJECTS[3],
    verb=VERBS[1],
)
FIELDS = ("gender", "age", "pose", "actions", "group", "distance_dm", "heading_deg", "interaction", "object")


def test_every_field_is_misread_at_its_rate_and_apart_from_the_others():
    see = reader(Knobs(wrong_attribute=RATE, seed=3))
    seen = [see(number.to_bytes(4, "big"), FULL) for number in range(N)]
    wrong = {name: [getattr(mark, name) != getattr(FULL, name) for mark in seen] for name in FIELDS}
    for name, flags in wrong.items():
        assert abs(sum(flags) / N - RATE) < NEAR, name
    assert len({tuple(flags) for flags in wrong.values()}) == len(FIELDS)
    assert {mark.identity for mark in seen} == {7} and {mark.partner for mark in seen} == {9}


def test_the_log_names_the_knob_that_spoiled_an_answer(tmp_path):
    log = tmp_path / "log"
    with Server(log=log, knobs=Knobs(refusal=1.0)) as server:
        text = f'Question: {QUESTION}\nPanorama 1: {{"frame_id": "000015"}}'
        parts = [
            {"type": "text", "text": text},
            {"type": "image_url", "image_url": {"url": EMPTY}},
            {"type": "text", "text": "Your answer, as one JSON object:"},
        ]
        server.reply(json.dumps({"messages": [{"role": "user", "content": parts}]}).encode())
    line = json.loads(log.read_text())
    assert line["knobs"] == ["refusal"] and "not shown: t1" in line["missing"]


def _grey():
    data = cv2.imencode(".jpg", np.full((480, 3760, 3), 96, np.uint8))[1].tobytes()
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()


EMPTY = _grey()
