"""The MCP server, driven by the SDK's own client: over memory, standard streams and HTTP."""

import asyncio
import base64
import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import httpx2
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from environment import needs
from fake_server import play
from painted import QUESTIONS_ASKED
from question_files import blocked_store
from scored_runs import journal_lines

from jrdb_avr import __version__
from jrdb_avr.engine.cli import group
from jrdb_avr.engine.run.run import write_partial
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError

needs("mcp")

PROGRAM = ["-c", "from jrdb_avr.engine.cli import main; main()", "mcp", "--store"]


def predictions(store, run_id="mcp-agent"):
    return pq.read_table(store.run_path(run_id) / "predictions.parquet").to_pylist()


def text_of(result):
    return result.content[0].text


async def play_all(client, url, results):
    """Play every question through an MCP client; all results as JSON go to `results`."""
    while True:
        begun = await client.call_tool("next_question")
        results.append(begun.model_dump_json())
        question = begun.structured_content
        if question["done"]:
            return

        async def call(name, arguments, token=question["episode"]):
            result = await client.call_tool(name, {"episode": token, **arguments})
            assert not result.is_error, text_of(result)
            text = [part.text for part in result.content if part.type == "text"]
            jpeg = [base64.b64decode(part.data) for part in result.content if part.type == "image"]
            results.append(json.dumps(text))
            return text[0], next(iter(jpeg), None)

        await play(url, question["prompt"], call)


# -- over standard streams and HTTP -----------------------------------------------------------------------------------


def test_over_stdio_it_plays_as_in_evaluate(public_store, model, same, by_evaluate, tmp_path):
    import mcp

    store, images = public_store
    results = []
    command = [*PROGRAM, str(store.path), "--images", images, "--limit", "3"]

    async def main():
        environment = {"PYTHONPATH": os.environ.get("PYTHONPATH", ""), "PATH": "/usr/bin:/bin"}
        server = mcp.StdioServerParameters(command=sys.executable, args=command, env=environment)
        async with mcp.Client(server) as client:
            await play_all(client, model[0], results)

    asyncio.run(main())
    # On a busy machine the client kills the server before it has written the tables. Each command on runs then does it.
    write_partial(store, "mcp-agent")
    rows = predictions(store)
    same(rows)
    assert len(rows) == 3
    manifest = read_run_manifest(store, "mcp-agent")
    assert (manifest.method, manifest.model, manifest.synthetic) == ("mcp", "agent", True)
    assert {step["kind"] for step in pq.read_table(store.run_path("mcp-agent") / "steps.parquet").to_pylist()} == {
        "observe",
        "solve",
    }


@contextlib.contextmanager
def http_server(*arguments):
    """Address, token and process of a server over HTTP."""
    command = [sys.executable, *PROGRAM, *map(str, arguments), "--http", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            url, token = process.stdout.readline().split()
            yield url, token, process
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=300)


@pytest.mark.slow
def test_over_http_it_plays_as_in_evaluate_and_reads_nothing_private(small_demo, model, same, secrets, tmp_path):
    """Of a whole store, whose private files are pipes that whoever opens them waits at for ever."""
    import mcp

    store, results = blocked_store(small_demo.folder / "store", tmp_path / "store"), []

    async def main(url, token):
        async with httpx2.AsyncClient(headers={"Authorization": f"Bearer {token}"}) as http:
            transport = mcp.client.streamable_http.streamable_http_client(url, http_client=http)
            async with mcp.Client(transport) as client:
                await play_all(client, model[0], results)

    with http_server(store.path, "--limit", 2, "--run-id", "mine", "--model", "somebody") as (url, token, process):
        asyncio.run(main(url, token))
        same([json.loads(line)["prediction"] for line in journal_lines(store.run_path("mine"))])
        process.send_signal(signal.SIGTERM)
        assert process.wait(300) == 0
    rows = predictions(store, "mine")
    same(rows)
    assert len(rows) == 2 and read_run_manifest(store, "mine").model == "somebody"
    kept = "".join(path.read_text() for path in store.run_path("mine").glob("*.json*"))
    sent = [*results, *(body.decode() for body in model[1]), kept]
    assert not [secret for secret in secrets if any(secret in text for text in sent)]


@pytest.mark.slow
def test_the_http_server_answers_its_token_and_its_own_names_alone(public_store):
    store, images = public_store
    body = {"jsonrpc": "2.0", "id": 1, "method": "tools/list", "params": {}}
    common = {"Accept": "application/json, text/event-stream", "Content-Type": "application/json"}

    def status(url, **headers):
        return httpx2.post(url, json=body, headers=common | headers, trust_env=False).status_code

    with http_server(store.path, "--images", images) as (url, token, _):
        assert url.startswith("http://127.0.0.1:")
        port = url.split(":")[2].partition("/")[0]
        own = {"Authorization": f"Bearer {token}"}
        assert status(url) == status(url, Authorization="Bearer x") == status(url, Authorization=token) == 401
        assert status(url.replace("/mcp", "/other")) == 401
        assert status(url, Host="evil.example", **own) == status(url, Host=f"evil.example:{port}", **own) == 421
        assert status(url, Host="127.0.0.1:1", **own) == 421
        assert status(url, Origin="http://evil.example", **own) == status(url, Origin="null", **own) == 403
        assert status(url, Origin=f"http://localhost:{port}", **own) not in (401, 403, 421)
        assert len(token) >= 40
        # On this machine's own address alone; the kernel writes it backwards.
        sockets = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        assert {own.partition(":")[0] for own in sockets if own.endswith(f":{int(port):04X}")} == {"0100007F"}


HELD = ["questions/answers.parquet", "questions/reviews.parquet", "graph.kuzu", "annotations", "runs/r/scores.parquet"]


@pytest.mark.parametrize("held", HELD)
def test_over_stdio_a_store_with_answers_or_labels_is_refused(public_store, held):
    store, images = public_store
    (store.path / held).mkdir(parents=True)
    result = CliRunner().invoke(group, ["mcp", "--store", str(store.path), "--images", images])
    assert isinstance(result.exception, InputError)
    assert f"has {held}" in str(result.exception) and "--i-trust-the-agent" in str(result.exception)
    assert "\n" not in str(result.exception) and not (store.path / "runs" / "mcp-agent").exists()


def test_over_stdio_panoramas_beside_labels_are_refused(public_store, small_demo):
    store, _ = public_store
    beside = Store(small_demo.folder / "store").manifest().image_root
    result = CliRunner().invoke(group, ["mcp", "--store", str(store.path), "--images", beside])
    assert isinstance(result.exception, InputError) and "labels" in str(result.exception)
    assert not (store.path / "runs" / "mcp-agent").exists()


# -- in this process --------------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def desk(store, questions=(QUESTIONS_ASKED[0].question_id, QUESTIONS_ASKED[4].question_id)):
    """A client in this process; the run's tables are written at the end."""
    import mcp

    from jrdb_avr.engine.integrations.mcp import METHOD, Desk
    from jrdb_avr.engine.run.bench import Bench
    from jrdb_avr.engine.run.run import Run

    with Run(store, "r") as run:
        bench = Bench.open(store, questions=questions)
        run.start(METHOD, "m", [own.question_id for own in bench.questions], {}, True, {})
        async with mcp.Client(Desk(bench, run).server()) as client:
            yield client
        run.finish()


def box(frame):
    return [{"frame_id": f"{frame:06d}", "bbox": [1, 2, 300, 400]}]


def test_moves_that_are_malformed_or_refused_are_spent_and_told_why(store, monkeypatch):
    monkeypatch.setattr("jrdb_avr.engine.run.playing.BUDGET", 2)

    async def main():
        async with desk(store) as client:
            begun = (await client.call_tool("next_question")).structured_content
            assert QUESTIONS_ASKED[0].question in begun["prompt"] and begun["answer_schema"]["maximum"] == 4

            async def refused(tool, **arguments):
                result = await client.call_tool(tool, {"episode": begun["episode"], **arguments})
                assert result.is_error
                return text_of(result)

            assert "must look (looks left: 2, turns left: 5)" in await refused(
                "submit_answer", answer=1, evidence_bboxes=box(15)
            )
            assert "six digits" in await refused("observe", frame_id=15, angle_deg=180)
            assert "number of degrees" in await refused("observe", frame_id="000015", angle_deg="left")
            seen = await client.call_tool("observe", {**begun, "frame_id": "000015", "angle_deg": 180})
            assert [part.type for part in seen.content] == ["text", "image"]
            assert base64.b64decode(seen.content[1].data)[:2] == b"\xff\xd8"
            assert "within 1 degree" in await refused("observe", frame_id="000015", angle_deg=180.5)
            assert "the question is over" in await refused("submit_answer", answer="x", evidence_bboxes=None)
            assert "no such episode" in await refused("observe", frame_id="000015", angle_deg=90)

    asyncio.run(main())
    (row,) = predictions(store, "r")
    assert (row["status"], row["n_model_calls"], row["n_observations"]) == ("invalid", 6, 1)


def test_a_missing_argument_is_a_malformed_turn(store):
    async def main():
        async with desk(store, [QUESTIONS_ASKED[0].question_id]) as client:
            episode = (await client.call_tool("next_question")).structured_content["episode"]
            calls = [("observe", {"angle_deg": 90}), ("observe", {}), ("submit_answer", {"answer": 1})]
            texts = [text_of(await client.call_tool(name, {"episode": episode, **given})) for name, given in calls]
            assert "no such episode" in text_of(await client.call_tool("observe", {}))
            await client.call_tool("observe", {"episode": episode, "frame_id": "000015", "angle_deg": 180})
            given = {"episode": episode, "answer": 1, "evidence_bboxes": box(15)}
            assert not (await client.call_tool("submit_answer", given)).is_error
            return texts

    first, second, third = asyncio.run(main())
    assert "refused: an observe turn lacks frame_id (looks left: 24, turns left: 49)" in first
    assert "an observe turn lacks angle_deg, frame_id (looks left: 24, turns left: 48)" in second
    assert "the first turn must look (looks left: 24, turns left: 47)" in third
    (row,) = predictions(store, "r")
    assert (row["status"], row["n_model_calls"]) == ("answered", 5)


def test_the_server_describes_itself_and_its_tools(store):
    async def main():
        async with desk(store) as client:
            return client.server_info, (await client.list_tools()).tools

    server, tools = asyncio.run(main())
    assert (server.name, server.version) == ("jrdb-avr", __version__)
    required = {tool.name: tool.input_schema.get("required") for tool in tools}
    assert required == {
        "next_question": [],
        "observe": ["episode", "frame_id", "angle_deg"],
        "submit_answer": ["episode", "answer", "evidence_bboxes"],
    }
    # Each call changes the episode, but only adds to it, and reaches nothing outside the store.
    for tool in tools:
        hints = tool.annotations.model_dump(exclude_none=True)
        assert len(hints) == 4 and not any(hints.values())
    typed = tools[0].output_schema
    assert typed["properties"].keys() == {"done", "message", "episode", "prompt", "answer_schema"}
    assert typed["required"] == ["done"]


def test_questions_are_handed_out_once_and_asked_again_where_they_were_left_open(store):
    async def main(answered):
        async with desk(store) as client:
            tokens = []
            while not (begun := (await client.call_tool("next_question")).structured_content)["done"]:
                tokens.append(begun["episode"])
            for token in tokens[:answered]:
                await client.call_tool("observe", {"episode": token, "frame_id": "000015", "angle_deg": 180})
                taken = await client.call_tool(
                    "submit_answer", {"episode": token, "answer": 1, "evidence_bboxes": box(15)}
                )
                assert not taken.is_error and "taken" in text_of(taken)
            return len(tokens)

    assert [asyncio.run(main(1)), asyncio.run(main(1)), asyncio.run(main(0))] == [2, 1, 0]
    assert len(predictions(store, "r")) == 2


def test_a_question_that_cannot_begin_stays_the_next_one(store, monkeypatch):
    from jrdb_avr.engine.integrations.mcp import Play

    attempts = iter([Mock(side_effect=InputError("its frames cannot be read")), Play.begin])
    monkeypatch.setattr(Play, "begin", lambda *given: next(attempts)(*given))

    async def main():
        async with desk(store) as client:
            return [await client.call_tool("next_question") for _ in range(2)]

    failed, begun = asyncio.run(main())
    assert failed.is_error and text_of(failed).endswith("cannot begin: its frames cannot be read")
    assert QUESTIONS_ASKED[0].question in begun.structured_content["prompt"]


def test_two_time_twins_are_not_asked_in_one_session(store):
    """Of twelve questions about three moments, only the first of each moment is asked; the others in other sessions."""

    async def main():
        prompts = []
        async with desk(store, [own.question_id for own in QUESTIONS_ASKED]) as client:
            while not (begun := (await client.call_tool("next_question")).structured_content)["done"]:
                prompts.append(begun["prompt"])
                call = {"episode": begun["episode"]}
                await client.call_tool("observe", {**call, "frame_id": "000015", "angle_deg": 180})
                await client.call_tool("submit_answer", {**call, "answer": 1, "evidence_bboxes": box(15)})
        return prompts, begun["message"]

    asked = []
    for left in (9, 6, 3, 0):
        prompts, message = asyncio.run(main())
        assert (
            message.startswith("no question is left") and f"; {left} questions wait" in f"{message}; 0 questions wait"
        )
        described = [{f for f in (0, 15, 30) if f"(frame {f})" in prompt} for prompt in prompts]
        assert described == [{0}, {15}, {30}]
        asked += [own.question for own in QUESTIONS_ASKED for prompt in prompts if own.question in prompt]
    assert sorted(asked) == sorted(own.question for own in QUESTIONS_ASKED)


def test_only_so_many_questions_may_be_open(store, monkeypatch):
    from jrdb_avr.engine.integrations import mcp as door

    monkeypatch.setattr(door, "MOST_OPEN", 1)

    async def main():
        async with desk(store) as client:
            await client.call_tool("next_question")
            result = await client.call_tool("next_question")
            assert result.is_error and "finish one" in text_of(result)

    asyncio.run(main())


def test_many_calls_at_once_are_moves_one_after_the_other(store):
    async def main():
        async with desk(store) as client:
            token = (await client.call_tool("next_question")).structured_content["episode"]
            calls = [
                client.call_tool("observe", {"episode": token, "frame_id": "000015", "angle_deg": angle})
                for angle in range(0, 300, 10)
            ]
            results = await asyncio.gather(*calls)
            assert sum(not result.is_error for result in results) == 24

    asyncio.run(main())


def test_without_the_extra_one_line_says_what_to_install(public_store, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcp", None)
    for name in [own for own in sys.modules if own.startswith(("mcp.", "jrdb_avr.engine.integrations.mcp"))]:
        monkeypatch.delitem(sys.modules, name)
    result = CliRunner().invoke(group, ["mcp", "--store", str(public_store[0].path)])
    assert isinstance(result.exception, InputError)
    assert str(result.exception) == "the package mcp is missing: pip install 'jrdb-avr[mcp]'"
