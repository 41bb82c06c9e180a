"""Questions as environments of TRL, and runs as conversations: all that needs no TRL."""

import json
import shutil

import numpy as np
import pytest
from environment import needs
from processes import run

from jrdb_avr.agent.model.messages import picture_of
from jrdb_avr.engine.integrations.chat import export_chat
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import RefusedError, StoreError

needs("PIL")

RUN = "react-simulated-perfect"


@pytest.fixture
def environments(small_demo):
    from jrdb_avr.engine.integrations.trl import Environments

    made = Environments(small_demo.folder / "store")
    yield made
    made._judge.close()


def play(environment, moves):
    """Play moves, and return the results."""
    tools = {"observe": environment.observe, "answer": environment.submit_answer}
    return [tools[move["action"]](**{name: move[name] for name in move if name != "action"}) for move in moves]


def test_the_tools_play_a_question_and_the_judge_rewards_it(environments, played, by_evaluate, small_demo, secrets):
    rows = environments.rows()
    environment, bench = environments(), Bench(small_demo.folder / "store")
    assert {row["question_id"] for row in rows} >= by_evaluate.keys()
    for row in (row for row in rows if row["question_id"] in by_evaluate):
        environment.reset(**row)
        *looks, last = play(environment, played[row["question_id"]])
        assert (last, environment.get_reward()) == ("taken", 1.0)
        observe = bench.episode(row["question_id"]).observe
        for result, move in zip(looks, played[row["question_id"]], strict=False):
            text, picture = result
            assert np.array_equal(picture["image"], observe(int(move["frame_id"]), move["angle_deg"]).image)
            assert text["text"].startswith(f'{{"frame_id":"{move["frame_id"]}"') and "turns left: " in text["text"]
        shown = row["prompt"][0]["content"] + "".join(result[0]["text"] for result in looks)
        assert row["prompt"][0]["role"] == "user" and not [text for text in secrets if text in shown]


def test_a_model_reaches_only_the_tools(environments):
    public = {name for name in dir(environments()) if not name.startswith("_")}
    assert public == {"observe", "submit_answer", "reset", "get_reward"}


@pytest.mark.parametrize(("reward", "earned"), [("answer", 1.0), ("evidence", 0.0), ("combined", 0.0)])
def test_a_right_answer_with_a_wrong_box_earns_the_answer_only(small_demo, played, reward, earned):
    from jrdb_avr.engine.integrations.trl import Environments

    question_id, moves = next(iter(played.items()))
    (box,) = moves[-1]["evidence_bboxes"]
    environment = Environments(small_demo.folder / "store", questions=[question_id], reward=reward)()
    environment.reset(question_id)
    play(environment, [moves[-2], {**moves[-1], "evidence_bboxes": [{**box, "bbox": [0, 0, 9, 9]}]}])
    assert environment.get_reward() == earned


def test_a_refused_move_says_why_and_earns_nothing(environments, played):
    environment = environments()
    question_id, (look, *_) = next(iter(played.items()))
    environment.reset(question_id)
    with pytest.raises(RefusedError, match="must look"):
        environment.submit_answer(1, [{"frame_id": look["frame_id"], "bbox": [0, 0, 9, 9]}])
    play(environment, [look])
    with pytest.raises(RefusedError, match="earlier look"):
        play(environment, [look])
    assert environment.get_reward() == 0.0


def test_a_store_without_answers_gives_no_rewards(public_store):
    from jrdb_avr.engine.integrations.trl import Environments

    store, _ = public_store
    with pytest.raises(StoreError):
        Environments(store.path)


def test_a_run_is_exported_as_chats_with_its_pictures(small_demo, played, tmp_path):
    store, folder = small_demo.folder / "store", tmp_path / "chat"
    code, _, err = run("export", "--store", store, RUN, "--chat", folder)
    assert code == 0 and "holds a benchmark, which must not be trained on" in err
    lines = [json.loads(line) for line in (folder / "metadata.jsonl").read_text("utf-8").splitlines()]
    assert len(lines) == sum(map(len, played.values()))
    replies, observer = {}, Bench(store).observer
    for line in lines:
        *request, reply = line["messages"]
        assert [message["role"] for message in request] == ["system", "user"] and reply["role"] == "assistant"
        made = replies.setdefault(line["question_id"], [])
        parts = request[1]["content"]
        # Each picture is a look of a turn before, and comes after the text that describes it.
        assert len(line["images_file_names"]) == sum(part["type"] == "image" for part in parts) == len(made)
        for i, name in enumerate(line["images_file_names"]):
            shown = observer(Bench(store).question(line["question_id"]).sequence, *map(made[i].get, ("frame", "angle")))
            assert (folder / name).read_bytes() == picture_of(shown).data
        move = json.loads(reply["content"][0]["text"])
        made.append({"frame": int(move.get("frame_id", 0)), "angle": move.get("angle_deg")})
        assert parts[-1]["text"].endswith("Your next turn, as one JSON object:") and "[image " not in json.dumps(parts)
    assert run("export", "--store", store, RUN, "--chat", folder)[0] == 1
    assert run("export", "--store", store, "--chat", tmp_path / "other")[0] == 2


def test_a_run_without_model_calls_has_no_chats(small_demo, tmp_path):
    store = Store(shutil.copytree(small_demo.folder / "store", tmp_path / "store"))
    (store.run_path(RUN) / "steps.parquet").unlink()
    with pytest.raises(StoreError, match="has no model calls"):
        export_chat(store, RUN, tmp_path / "chat")
