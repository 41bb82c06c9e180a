"""Another program drives the simulated model by function calling, without references in its pictures."""

import json

import pytest
from painted import World, still

from jrdb_avr.agent.model.messages import picture_of
from jrdb_avr.agent.simulated.profiles import PERFECT
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box, from_crop, iou

FRAMES = tuple(range(0, 301, 5))
HER = Box(1700, 120, 70, 220)
QUESTION = (
    "Find the only person who is standing at 1.0 s (frame 15). "
    "Which of these is that person doing at 10.0 s (frame 150)? Only one is true."
)
HEADING = f"Question: {QUESTION}\nChoices:\n1. sitting\n2. standing\nLegal frames: 000000 to 000300 in steps of 5"


def tool(name, *required, **properties):
    schema = {"type": "object", "properties": properties, "required": [*required]}
    return {"type": "function", "function": {"name": name, "description": "", "parameters": schema}}


OBSERVE = tool("observe", "frame_id", "angle_deg", frame_id={"type": "string"}, angle_deg={"type": "number"})
ANSWER = tool("final_answer", "answer", answer={"type": "integer"}, evidence_bboxes={"type": "array"})
TOOLS = [OBSERVE, ANSWER]


@pytest.fixture
def world(tmp_path):
    crowd = [still(300, 21, pose="walking", gender="male"), still(3000, 24, pose="walking", gender="female")]
    return World(tmp_path, [still(HER.x, 7, pose="standing", gender="female", w=HER.w, h=HER.h), *crowd], FRAMES)


@pytest.fixture
def server(world):
    with Server(world, PERFECT) as made:
        yield made


def asked(server, messages, **more):
    return server.reply(json.dumps({"model": "m", "messages": messages, **more}).encode())["choices"][0]


def image(world, arguments):
    seen = world.observe("painted", int(arguments["frame_id"]), arguments["angle_deg"])
    return seen, {"type": "image_url", "image_url": {"url": picture_of(seen).uri}}


def play(server, world, in_result, **more):
    """The loop of a harness with prompts of its own; returns the last call's arguments, looks and messages."""
    messages = [{"role": "system", "content": "Look around."}, {"role": "user", "content": HEADING}]
    looks = []
    for _ in range(30):
        choice = asked(server, messages, tools=TOOLS, **more)
        message = choice["message"]
        assert choice["finish_reason"] == "tool_calls" and message["content"] is None
        messages.append(message)
        (call,) = message["tool_calls"]
        arguments = json.loads(call["function"]["arguments"])
        if call["function"]["name"] == "final_answer":
            return arguments, looks, messages
        seen, part = image(world, arguments)
        looks.append(seen)
        result = [{"type": "text", "text": "done"}, *([part] if in_result else [])]
        messages.append({"role": "tool", "tool_call_id": call["id"], "content": result})
        if not in_result:
            messages.append({"role": "user", "content": [part]})
    raise AssertionError("no answer")


@pytest.mark.parametrize("in_result", [True, False])
def test_a_program_with_tools_gets_looks_and_then_the_answer(server, world, in_result):
    arguments, looks, messages = play(server, world, in_result)
    assert arguments["answer"] == 2
    (box,) = arguments["evidence_bboxes"]
    x1, y1, x2, y2 = (value * 0.48 for value in box["bbox"])
    last = looks[-1]
    assert box["frame_id"] == f"{last.frame_index:06d}"
    assert iou(from_crop(Box(x1, y1, x2 - x1, y2 - y1), last.left), HER) > 0.85
    ids = [call["id"] for message in messages for call in message.get("tool_calls", ())]
    assert len(set(ids)) == len(ids) == len(looks) + 1
    assert {look.frame_index for look in looks} == {15, 150}


def test_without_tools_to_call_the_reply_is_plain_json(server):
    messages = [{"role": "user", "content": f"{HEADING}\nLooks made: 0, left: 24\nYour next turn, as one JSON object:"}]
    turn = json.loads(asked(server, messages)["message"]["content"])
    (call,) = asked(server, messages, tools=TOOLS)["message"]["tool_calls"]
    assert call["function"]["name"] == turn.pop("action") == "observe"
    assert json.loads(call["function"]["arguments"]) == turn


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"stream": True}, "does not stream"),
        ({"tools": [{"type": "retrieval"}]}, "not a chat-completions request"),
    ],
)
def test_what_it_does_not_do_is_refused_in_one_line(server, more, said):
    with pytest.raises(DecodeError, match=said) as caught:
        asked(server, **{"messages": [{"role": "user", "content": HEADING}], **more})
    assert "\n" not in str(caught.value)


def test_pictures_without_references_need_tools(server, world):
    _, part = image(world, {"frame_id": "000015", "angle_deg": 180.0})
    place = {"type": "text", "text": 'Picture 1: {"frame_id": "000015", "angle_deg": 180.0}'}
    end = {"type": "text", "text": "Looks made: 1, left: 23\nYour next turn, as one JSON object:"}
    messages = [{"role": "user", "content": [{"type": "text", "text": HEADING}, place, part, end]}]
    with pytest.raises(DecodeError, match="no reference"):
        asked(server, messages)
    assert asked(server, messages, tools=TOOLS)["message"]["tool_calls"]
