"""The policy `guided`: the model picks among the looks that the harness finds, and a model that cannot is driven."""

import json

import pytest
from painted import World
from reference_play import CHOICES, Scripted, text_of
from test_driven import CHANGE, FRAMES, OTHERS, READER, Chat

from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.look.attention import NextLook
from jrdb_avr.agent.reference.guided import PICK_LINE, pick_look
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.agent.simulated.knobs import Knobs
from jrdb_avr.schema.wording.text import render

LOOKS = [NextLook(150, 20.0, "identify", 2.0), NextLook(150, 63.0, "identify", 1.0), NextLook(90, 5.0, "verify", 0.5)]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return World(tmp_path_factory.mktemp("painted"), [READER, *OTHERS], FRAMES)


def played(world, policy, knobs):
    """The looks of one question, the prediction, and the requests that offered looks."""
    chat, steps = Chat(knobs), []
    task = world.task(render("change", CHANGE, "0" * 64), "multiple_choice", CHOICES, steps)
    prediction = ReferenceAgent(chat, policy=policy).answer(task)
    asked = [json.loads(one.request) for one in steps if one.kind == "observe"]
    looks = [(one["frame_index"], one["angle_deg"]) for one in asked]
    return looks, prediction, [one for one in chat.requests if text_of(one).endswith(PICK_LINE)]


def test_a_model_that_picks_the_first_look_answers_as_the_harness_does(world):
    guided, prediction, offers = played(world, "guided", Knobs())
    driven, alone, none = played(world, "driven", Knobs())
    assert guided == driven and offers and not none
    assert (prediction.answer, prediction.evidence) == (alone.answer, alone.evidence)
    assert all("Look 2: " in text_of(one) and "[image]" not in text_of(one) for one in offers)


def test_a_model_that_picks_otherwise_looks_elsewhere(world):
    guided, prediction, _ = played(world, "guided", Knobs(policy=0.5, seed=1))
    driven, _, _ = played(world, "driven", Knobs(policy=0.5, seed=1))
    assert guided != driven and prediction.answer is not None


@pytest.mark.parametrize(
    "replies, picked, calls",
    [
        ([{"look": 3}], 3, 1),
        (["?", {"look": 2}], 2, 2),
        ([{"look": 4}, {"look": 0}], 1, 2),
        ([{"look": True}, {"look": "2"}], 1, 2),
        ([{"look": 2, "why": "it is nearer"}, {"look": 2}], 2, 2),
    ],
)
def test_a_reply_names_one_of_the_looks_or_is_asked_for_once_more(world, replies, picked, calls):
    chat = Scripted(replies)
    attempt = Attempt(world.task("Who?", "multiple_choice", CHOICES), chat, CONTRACT)
    assert pick_look(attempt, LOOKS, None, 9) is LOOKS[picked - 1]
    assert len(chat.requests) == calls
