"""The ReAct protocol, played by scripted models over a real socket."""

import json
from itertools import chain, repeat

import numpy as np
import pytest
from environment import SNAPSHOTS
from fake_server import FakeServer, completion, images, texts
from hypothesis import example, given
from hypothesis import strategies as st
from painted import World, still

from jrdb_avr.agent.methods.react import ReAct
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.prompts import frame_ranges, read_frame_ranges
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.panorama import Box, crop_left, iou

CHOICES = ("walking", "standing", "sitting", "lying")


@pytest.fixture
def world(tmp_path):
    return World(tmp_path, [still(1845, 7, pose="standing"), still(-40, 8, pose="sitting")], tuple(range(0, 300, 5)))


def look(frame, angle):
    return json.dumps({"action": "observe", "frame_id": f"{frame:06d}", "angle_deg": angle})


def answer(value=2, frame=150, bbox=(427, 250, 573, 708)):
    evidence = [{"frame_id": f"{frame:06d}", "bbox": list(bbox)}]
    return json.dumps({"action": "answer", "answer": value, "evidence_bboxes": evidence})


def play(world, replies, mode="multiple_choice", choices=CHOICES, **options):
    """The prediction, the requests and the steps of a game with these replies (the last one repeats)."""
    script = replies if callable(replies) else lambda request, n: replies[min(n, len(replies) - 1)]
    steps = []
    with FakeServer(script) as server:
        method = ReAct(Client(server.url, "fake", pause=lambda s: None), **options)
        prediction = method.answer(world.task("What does the person do?", mode, choices, steps))
    return prediction, server.requests, steps


def test_look_and_answer(world):
    prediction, requests, steps = play(world, [look(150, 180), answer()])
    assert prediction.status == "answered"
    assert prediction.answer == Choice(2)
    assert prediction.evidence.frame == 150
    assert iou(Box(*prediction.evidence.box), Box(1845, 120, 70, 220)) > 0.95
    assert (prediction.n_observations, prediction.n_model_calls) == (1, 2)
    assert (prediction.prompt_tokens, prediction.completion_tokens) == (20, 10)
    assert [step.kind for step in steps] == ["model", "observe", "model", "solve"]
    assert images(requests[0]) == []
    assert len(images(requests[1])) == 1


def test_a_turn_says_look_on_until_no_look_is_left(world):
    _, requests, _ = play(world, [look(150, 180), look(150, 90)], budget=1)
    first, second = (texts(request) for request in requests[:2])
    assert "look on while anything is uncertain" in first and "no looks are left, so this turn must answer" in second
    # The pictures of the sixty legal frames can be looked at, and each can hold the evidence.
    look_form, answer_form = requests[0]["response_format"]["json_schema"]["schema"]["anyOf"]
    listed = [f"{frame:06d}" for frame in range(0, 300, 5)]
    assert look_form["properties"]["frame_id"] == {"type": "string", "enum": listed}
    assert answer_form["properties"]["evidence_bboxes"]["items"]["properties"]["frame_id"]["enum"] == listed


def test_every_turn_carries_all_crops_with_their_places(world):
    _, requests, _ = play(world, [look(150, 180), look(155, 90), look(0, -45), answer(frame=0)])
    assert [len(images(request)) for request in requests] == [0, 1, 2, 3]
    assert images(requests[3])[:2] == images(requests[2])
    last = texts(requests[3])
    assert '"frame_id":"000155","timestamp":10.333,"angle_deg":90.0,"fov_deg":45.96,"left":700' in last
    assert '"angle_deg":315.0' in last
    assert "Newest picture: 3" in last
    assert "Frames seen: 000000, 000150, 000155" in last
    assert "Looks made: 3, left: 21" in last
    assert "Turns left, this one included: 47" in last
    assert "Legal frames: 000000 to 000295 in steps of 5" in last
    assert "1. walking\n2. standing\n3. sitting\n4. lying" in last

    # A turn begins as the one before, up to its newest picture.
    parts = requests[2]["messages"][1]["content"]
    assert requests[3]["messages"][0] == requests[2]["messages"][0]
    assert requests[3]["messages"][1]["content"][: len(parts) - 1] == parts[:-1]


def test_of_older_pictures_a_short_history_sends_the_metadata_alone(world):
    script = [look(150, 180), look(155, 90), look(0, -45), answer(frame=0)]
    _, requests, _ = play(world, script, history=2)
    assert [len(images(request)) for request in requests] == [0, 1, 2, 2]
    _, whole, _ = play(world, script)
    assert images(requests[3]) == images(whole[3])[1:]
    assert texts(requests[3]) == texts(whole[3])


def test_malformed_turns_cost_turns_and_no_more(world):
    prediction, requests, _ = play(
        world, [look(150, 180), "I look left", look(150, 90), *["hm"] * 2, look(150, 0), "hm", answer()]
    )
    assert len(requests) == 8
    assert "Your last turn was malformed, and cost a turn: the reply is not one JSON object" in texts(requests[2])
    assert "Your last turn was malformed" not in texts(requests[3])
    assert "Turns left, this one included: 43" in texts(requests[7])
    assert (prediction.status, prediction.answer, prediction.reason) == ("answered", Choice(2), "")


MALFORMED = {
    "empty": "",
    "prose": f"Sure: {look(150, 180)}",
    "length": completion(look(150, 180), "length"),
    "two objects": look(150, 180) * 2,
    "no action": '{"frame_id": "000150", "angle_deg": 3}',
    "other action": '{"action": "think"}',
    "extra key": look(150, 180)[:-1] + ', "why": "x"}',
    "illegal frame": look(151, 180),
    "frame as number": '{"action": "observe", "frame_id": 150, "angle_deg": 3}',
    "angle as text": '{"action": "observe", "frame_id": "000150", "angle_deg": "left"}',
    "angle not finite": '{"action": "observe", "frame_id": "000150", "angle_deg": 1e999}',
    "path as frame": '{"action": "observe", "frame_id": "../../etc", "angle_deg": 3}',
    "lone surrogate": '{"action": "observe", "\\ud800": 1}',
}


@pytest.mark.parametrize("name", sorted(MALFORMED))
def test_malformed_turns(world, name):
    prediction, requests, _ = play(world, [MALFORMED[name]], budget=4)
    assert (prediction.status, prediction.n_observations, len(requests)) == ("invalid", 0, 4)
    assert "no looks are left, so this turn must answer" in texts(requests[3])
    assert "Turns left, this one included: 1;" in texts(requests[3])
    assert prediction.reason and prediction.answer is None and prediction.evidence is None
    prediction, _, _ = play(world, [MALFORMED[name], look(150, 180), answer()])
    assert prediction.status == "answered"


def test_after_three_identical_refusals_a_turn_must_answer(world):
    same, other = look(151, 180), look(152, 180)
    prediction, requests, _ = play(world, [look(150, 180), same, same, other, same, same, same, answer()])
    assert (prediction.status, len(requests)) == ("answered", 8)
    prediction, requests, _ = play(world, [look(150, 180), same, same, same, look(150, 90)])
    assert (prediction.status, prediction.n_observations, len(requests)) == ("invalid", 1, 5)


def test_a_duplicate_is_refused_told_and_counted(world):
    prediction, requests, steps = play(
        world, [look(150, 180), look(150, 180.9), look(150, 179.0), look(150, 181.1), answer()]
    )
    assert (prediction.n_observations, prediction.n_model_calls) == (2, 5)
    assert "refused, within 1 degree" in texts(requests[2])
    assert len(images(requests[3])) == 1
    assert prediction.status == "answered"
    refused = [step for step in steps if "refused" in step.response and step.kind == "observe"]
    assert len(refused) == 2


def test_evidence_must_be_in_the_newest_crop(world):
    prediction, requests, _ = play(world, [look(150, 180), look(155, 180), answer(frame=150)])
    assert prediction.status == "invalid"
    assert "not a frame of the image at hand" in prediction.reason
    assert prediction.answer == Choice(2)
    assert prediction.evidence is None
    assert len(requests) == 4


def test_a_part_that_is_left_out_leaves_the_other(world):
    """Shown the error once, as any malformed turn; at the end what could be read stands."""
    evidence = json.loads(answer())["evidence_bboxes"]
    for part in ({"answer": 2}, {"evidence_bboxes": evidence}):
        turn = json.dumps({"action": "answer", **part})
        prediction, requests, _ = play(world, [look(150, 180), turn])
        assert (prediction.status, len(requests)) == ("invalid", 3)
        assert (prediction.answer is not None, prediction.evidence is not None) == (
            "answer" in part,
            "answer" not in part,
        )


def test_the_transcript_names_images_and_holds_none(world):
    _, _, steps = play(world, [look(150, 180), answer()])
    kept = json.dumps([[step.request, step.response] for step in steps])
    assert "base64" not in kept
    assert "[image painted 000150 180]" in kept
    for step in steps:
        json.loads(step.request), json.loads(step.response)
    assert crop_left(180.0) == json.loads(steps[1].response)["left"]


@pytest.mark.parametrize("prompts", ["", "paper"])
@pytest.mark.parametrize("mode", ["multiple_choice", "frame", "span", "frame_viewpoint", "number"])
def test_prompts_are_as_they_were(world, mode, prompts):
    """The texts are part of the benchmark: to change one, delete its snapshot, run twice and read the new one."""
    choices = CHOICES if mode == "multiple_choice" else ()
    script = [look(150, 180), "x", look(150, 180.5), look(150, 90), "y"]
    _, requests, _ = play(world, script, mode, choices, prompts=prompts or "default")
    system = requests[4]["messages"][0]["content"]
    user = "\n".join(part.get("text", "[image]") for part in requests[4]["messages"][1]["content"])
    path = SNAPSHOTS / prompts / f"react_{mode}.txt"
    told = f"{system}\n=====\n{user}\n"
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        path.write_text(told)
        pytest.fail(f"wrote {path}: read it, then run again")
    assert told == path.read_text()


@given(st.lists(st.integers(0, 400), unique=True).map(sorted))
def test_frame_ranges_are_read_back(frames):
    assert read_frame_ranges(frame_ranges(frames)) == frames


def test_frame_ranges_are_short():
    assert frame_ranges(range(0, 1726)) == "000000 to 001725 in steps of 1"
    assert frame_ranges(range(0, 200, 5)) == "000000 to 000195 in steps of 5"
    assert frame_ranges([7]) == "000007"
    assert frame_ranges([]) == "none"


@given(st.integers(0, 3599), st.sampled_from([10, -10]))
@example(22, -10)
@example(27, -10)
def test_one_degree_is_a_duplicate_whatever_rounding_says(tenths, turn):
    """Two looks, counted in whole tenths of a degree: ten apart are one look, eleven are two."""
    from jrdb_avr.agent.model.reply import Reply
    from jrdb_avr.schema.method import Observation, Question, SequenceInfo, Task

    image = np.zeros((480, 480, 3), np.uint8)

    def observe(sequence, frame_index, angle_deg):
        return Observation(sequence, frame_index, 0.0, angle_deg, 45.96, 0, image)

    for beyond, looks in ((0, 1), (1, 2)):
        second = (tenths + turn + (beyond if turn > 0 else -beyond)) % 3600
        replies = chain([look(0, tenths / 10), look(0, second / 10)], repeat("no more"))

        class Chat:
            def complete(self, messages, schema=None, replies=replies):
                return Reply(next(replies), finish_reason="stop")

        question = Question("0" * 16, "s", "?", CHOICES, "multiple_choice")
        task = Task(question, SequenceInfo("s", 15.0, 1, (0,)), observe, None, lambda step: None, None)
        assert ReAct(Chat()).answer(task).n_observations == looks
