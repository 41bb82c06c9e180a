"""The Gymnasium environment: its own checker passes it, and what is played in it is what `evaluate` makes of it."""

import asyncio
import json
import runpy
import warnings

import numpy as np
import pytest
from environment import DOCS, needs
from fake_server import play

from jrdb_avr.agent.model.messages import jpeg_picture
from jrdb_avr.engine.run.journal import finished_entry
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.errors import AvrError, StoreError

needs("gymnasium")

ID = "jrdb_avr.engine.integrations.gymnasium:JRDBAVR-v0"
LOOK, ANSWER = 0, 1
NOTHING = {"frame": np.array(0.0), "angle": np.array(0.0), "numbers": np.zeros(2), "box": np.zeros(4)}


def action(act, **parts):
    return NOTHING | {"act": np.int64(act)} | {name: np.array(value, np.float64) for name, value in parts.items()}


def look(episode_frames, frame, angle):
    return action(LOOK, frame=episode_frames.index(frame) / (len(episode_frames) - 1), angle=angle % 360 / 360)


def numbers(mode, answer, choices, frame_count):
    """An answer of the contract as numbers in [0, 1]."""
    match mode:
        case "multiple_choice":
            return [(answer - 1) / (choices - 1), 0]
        case "number":
            return [float(answer["value"]) / 1000, 0]
        case "frame_viewpoint":
            return [int(answer["frame_id"]) / (frame_count - 1), answer["angle_deg"] / 360]
    frames = [int(frame) / (frame_count - 1) for frame in answer.values()]
    return [*frames, 0][:2]


@pytest.fixture
def make(public_store):
    """An environment of a folder that holds nothing private."""
    import gymnasium

    made = []

    def make(**options):
        store, images = public_store
        made.append(gymnasium.make(ID, store=str(store.path), images=images, **options))
        return made[-1].unwrapped

    yield make
    for env in made:
        env.close()


def test_its_checker_has_nothing_to_say(make):
    from gymnasium.utils.env_checker import check_env

    env = make(render_mode="rgb_array")
    with warnings.catch_warnings(action="error"):
        check_env(env)


def test_the_simulated_model_plays_as_in_evaluate(make, model, same, by_evaluate):
    env, rows = make(), []
    for question_id in by_evaluate:
        observation, info = env.reset(options={"question_id": question_id})
        assert not observation["image"].any() and info["question_id"] == question_id
        question = env.bench.question(question_id)
        info_of = env.bench.sequences[question.sequence]

        async def call(name, arguments, question=question, info_of=info_of):
            if name == "observe":
                move = look(info_of.frames, int(arguments["frame_id"]), arguments["angle_deg"])
            else:
                (box,) = arguments["evidence_bboxes"]
                parts = numbers(question.answer_mode, arguments["answer"], len(question.choices), info_of.frame_count)
                move = action(ANSWER, numbers=parts, box=np.array(box["bbox"]) / 1000)
            seen, reward, terminated, truncated, info = env.step(move)
            assert (reward, truncated, info["refused"]) == (0.0, False, "")
            if terminated:
                rows.append(finished_entry(question, info["prediction"], (), (), 0.0).prediction)
            return "looked", jpeg_picture("crop", seen["image"], {}).data

        asyncio.run(play(model[0], info["prompt"], call))
    same(rows)
    assert len(rows) == len(by_evaluate)


def test_refused_moves_are_spent_and_truncate(make):
    env = make(budget=1)
    env.reset(seed=1)
    _, _, terminated, truncated, info = env.step(action(ANSWER))
    assert (terminated, truncated) == (False, False) and "must look" in info["refused"]
    observation, *_, info = env.step(action(LOOK, frame=1.0, angle=0.25))
    assert info["refused"] == "" and observation["image"].any() and observation["left"].tolist() == [0.0, 0.5]
    assert observation["look"].tolist() == [1.0, 0.25]
    _, _, terminated, truncated, info = env.step(action(LOOK, frame=0.0))
    assert (terminated, truncated) == (False, False) and "no looks are left" in info["refused"]
    _, reward, terminated, truncated, info = env.step(action(LOOK, frame=0.0))
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["prediction"].n_model_calls == 4 and info["prediction"].n_observations == 1


@pytest.mark.parametrize(
    ("mode", "choices", "expected"),
    [
        ("multiple_choice", ("a", "b", "c"), Choice(2)),
        ("frame", (), FrameAnswer(500)),
        ("span", (), Span(500, 1000)),
        ("frame_viewpoint", (), FrameViewpoint(500, 360.0 % 360)),
        ("number", (), Number(500.0)),
    ],
)
def test_numbers_are_an_answer_of_each_mode(make, mode, choices, expected):
    import dataclasses

    env = make()
    env.reset(seed=1)
    question = dataclasses.replace(env.bench.questions[0], answer_mode=mode, choices=choices)
    env.bench.sequences[question.sequence] = dataclasses.replace(
        env.bench.sequences[question.sequence], frame_count=1001
    )
    env.bench._by_id[question.question_id] = question
    env.reset(options={"question_id": question.question_id})
    env.step(action(LOOK))
    _, _, terminated, _, info = env.step(action(ANSWER, numbers=[0.5, 1.0], box=[0, 0, 0.5, 1]))
    assert terminated and info["prediction"].answer == expected
    assert info["prediction"].evidence.box == (3520.0, 0.0, 240.0, 480.0)


@pytest.mark.slow
def test_the_reward_is_the_judges_where_asked_for(small_demo, by_evaluate, make):
    import gymnasium

    from jrdb_avr.engine.run.bench import Bench

    store = small_demo.folder / "store"
    question_id, row = next((name, own) for name, own in by_evaluate.items() if own["answer"].startswith('{"choice'))
    frames = Bench.open(store).sequences[Bench.open(store).question(question_id).sequence].frames
    rewards = {}
    for kind in ("answer", "combined"):
        env = gymnasium.make(ID, store=str(store), reward=kind).unwrapped
        env.reset(options={"question_id": question_id})
        assert env.step(look(frames, row["evidence_frame"], 0.0))[1] == 0.0
        share = (int(row["answer"][len('{"choice":') : -1]) - 1) / 3
        _, rewards[kind], terminated, _, _ = env.step(action(ANSWER, numbers=[share, 0], box=[0, 0, 1, 1]))
        assert terminated
        env.close()
    # A box of the whole crop, straight behind, proves nothing.
    assert rewards == {"answer": 1.0, "combined": 0.0}
    with pytest.raises(StoreError, match="is not a store"):
        make(reward="combined")


@pytest.mark.parametrize("wrong", [{"frame": np.array(np.nan)}, {"box": np.full(4, 2.0)}, {"act": np.int64(2)}])
def test_an_action_outside_its_space_is_an_error_and_no_move(make, wrong):
    env = make()
    with pytest.raises(AvrError, match="reset"):
        env.step(action(LOOK))
    env.reset(seed=1)
    with pytest.raises(AvrError, match="action space"):
        env.step(action(LOOK) | wrong)
    assert env.step(action(LOOK))[0]["left"][1] == pytest.approx(49 / 50)


def test_an_unknown_question_is_refused(make):
    with pytest.raises(AvrError, match="no question"):
        make().reset(options={"question_id": "nope"})


@pytest.mark.slow
def test_the_example_learns_a_question_by_heart(small_demo, by_evaluate):
    """A reward that tells right from wrong teaches the right choice, and nothing but the seed decides how."""
    train = runpy.run_path(str(DOCS / "examples" / "reinforce.py"))["train"]
    store = small_demo.folder / "store"
    truth = {row["question_id"]: row["answer"] for row in Store(store).questions("answers").to_pylist()}
    question_id = next(name for name in by_evaluate if truth[name].startswith('{"choice"'))
    logits, rewards = train(str(store), updates=25, count=2, rate=2.0, questions=[question_id])
    assert set(rewards) <= {0.0, 0.5, 1.0} and sum(rewards[-10:]) > sum(rewards[:10])
    assert logits[0, 2].argmax() + 1 == json.loads(truth[question_id])["choice"]
    assert not logits[1:].any()
    again, _ = train(str(store), updates=3, count=2, questions=[question_id])
    assert np.array_equal(again, train(str(store), updates=3, count=2, questions=[question_id])[0])
