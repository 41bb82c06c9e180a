"""The OpenEnv server of the examples, played by OpenEnv's own client."""

import base64
import contextlib
import runpy
import socket
import threading

import pytest
from environment import DOCS, needs

from jrdb_avr.agent.model.messages import picture_of
from jrdb_avr.engine.run.bench import Bench

needs("openenv")


@pytest.fixture
def client(small_demo):
    import uvicorn
    from openenv.core.generic_client import GenericEnvClient

    example = runpy.run_path(str(DOCS / "examples" / "serve_openenv.py"))
    application = example["application"](small_demo.folder / "store")
    with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as listener:
        server = uvicorn.Server(uvicorn.Config(application, log_level="warning"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        with GenericEnvClient(base_url=f"http://127.0.0.1:{listener.getsockname()[1]}").sync() as connected:
            yield connected
        server.should_exit = True
        thread.join(60)


def test_the_client_plays_questions_and_is_rewarded(client, played, small_demo, secrets):
    bench = Bench(small_demo.folder / "store")
    for question_id, moves in played.items():
        results = [client.reset(question_id=question_id), *map(client.step, moves)]
        assert [result.reward for result in results[1:]] == [0.0] * (len(moves) - 1) + [1.0]
        assert [result.done for result in results] == [False] * len(moves) + [True]
        look = bench.episode(question_id).observe(int(moves[0]["frame_id"]), moves[0]["angle_deg"])
        assert base64.b64decode(results[1].observation["jpeg"]) == picture_of(look).data
        assert bench.question(question_id).question in results[0].observation["text"]
        assert not [text for text in secrets if any(text in result.observation["text"] for result in results)]
        assert client.state()["step_count"] == len(moves)
        # A finished question gives no second reward.
        assert (again := client.step(moves[-1])).reward == 0.0 and "is finished" in again.observation["text"]


def test_a_refused_move_says_why(client):
    assert "reset first" in client.step({"action": "observe"}).observation["text"]
    first = client.reset(seed=1).observation["text"]
    assert client.reset(seed=1).observation["text"] == first
    assert "must look" in client.step({"action": "answer", "answer": 1, "evidence_bboxes": []}).observation["text"]
