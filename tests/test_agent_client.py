"""The endpoint client against a server that misbehaves, over a real socket."""

import json
import logging
import socket
import threading

import pytest
from fake_server import Body, CutOff, FakeServer, Slow, Status, completion

from jrdb_avr.agent.client import Client, Reply
from jrdb_avr.agent.messages import Message, Picture, fingerprint, transcript, wire
from jrdb_avr.agent.options import Options
from jrdb_avr.schema.errors import EndpointError

ASK = [Message("user", ("hello",))]
SECRET = "sk-very-secret-0123456789"


def client(server, cache=None, **options):
    pauses = []
    made = Client(server.url, "fake", Options(**options), cache=cache, pause=pauses.append)
    return made, pauses


def sequence_of(*replies):
    return lambda request, n: replies[min(n, len(replies) - 1)]


def test_a_clean_reply():
    with FakeServer(sequence_of("hi")) as server:
        made, pauses = client(server)
        assert made.complete(ASK) == Reply("hi", "", "stop", "fake-1", 10, 5)
    assert pauses == []
    (request,) = server.requests
    assert request["temperature"] == 0
    assert request["model"] == "fake"
    assert request["messages"] == [{"role": "user", "content": "hello"}]
    assert "response_format" not in request


def test_the_schema_travels_as_response_format():
    schema = {"type": "object"}
    with FakeServer(sequence_of("{}")) as server:
        made, _ = client(server)
        made.complete(ASK, schema)
        plain, _ = client(server, response_format="none")
        plain.complete(ASK, schema)
    assert server.requests[0]["response_format"]["type"] == "json_schema"
    assert server.requests[0]["response_format"]["json_schema"]["schema"] == schema
    assert "response_format" not in server.requests[1]


def test_pictures_travel_inline():
    picture = Picture("seq 000015 45", b"\xff\xd8jpeg")
    message = Message("user", ("look", picture))
    (sent,) = wire([message])
    assert sent["content"][1]["image_url"]["url"].startswith("data:image/jpeg;base64,")
    assert "base64" not in json.dumps(fingerprint([message]))
    assert transcript([message]) == [{"role": "user", "content": "look\n[image seq 000015 45]"}]


@pytest.mark.parametrize(
    "fault",
    [
        Status(429, "slow down", (("Retry-After", "7"),)),
        Status(500),
        Status(503),
        CutOff("hi"),
        Body(b"<html>bad gateway</html>"),
        Body(b'{"choices": []}'),
        Body(b""),
    ],
)
def test_what_transport_or_server_broke_is_tried_again(fault):
    with FakeServer(sequence_of(fault, fault, "hi")) as server:
        made, pauses = client(server)
        assert made.complete(ASK).content == "hi"
    assert len(server.requests) == 3
    assert pauses == ([7.0, 7.0] if isinstance(fault, Status) and fault.code == 429 else [0.5, 1.0])


def test_retries_end():
    with FakeServer(sequence_of(Status(500, "still\nbroken"))) as server:
        made, pauses = client(server)
        with pytest.raises(EndpointError) as caught:
            made.complete(ASK)
    assert len(server.requests) == 5
    assert len(pauses) == 4
    assert "\n" not in str(caught.value)
    assert "HTTP 500" in str(caught.value)


@pytest.mark.parametrize("code", [400, 401, 403, 404, 422])
def test_a_refusal_is_not_tried_again(code):
    with FakeServer(sequence_of(Status(code, "no"))) as server:
        made, _ = client(server)
        with pytest.raises(EndpointError, match=f"HTTP {code}"):
            made.complete(ASK)
    assert len(server.requests) == 1


def test_slow_replies_time_out_and_are_tried_again():
    with FakeServer(sequence_of(Slow(1.0, "late"), "hi")) as server:
        made, _ = client(server, timeout_s=0.2)
        assert made.complete(ASK).content == "hi"


def test_nobody_there_is_one_line():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/v1"
    made = Client(url, "fake", pause=lambda seconds: None)
    with pytest.raises(EndpointError, match="cannot reach the server") as caught:
        made.complete(ASK)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "url",
    ["", "localhost:8000", "ftp://x/v1", "http://", "http://me:pw@host/v1", "http://h/v1?key=1", "http://[::1/v1"],
)
def test_addresses_that_cannot_be_used(url):
    with pytest.raises(EndpointError):
        Client(url, "fake")


# -- the cache --------------------------------------------------------------------------------------------------------


def files(folder):
    return [path for path in folder.rglob("*") if path.is_file()]


def test_a_finished_call_is_made_once(tmp_path):
    with FakeServer(sequence_of("hi")) as server:
        first, _ = client(server, cache=tmp_path)
        a = first.complete(ASK, {"type": "object"})
        second, _ = client(server, cache=tmp_path)
        assert second.complete(ASK, {"type": "object"}) == a
        assert len(server.requests) == 1
        second.complete(ASK, {"type": "array"})
        second.complete([Message("user", ("hello", Picture("n", b"1")))])
        second.complete([Message("user", ("hello", Picture("n", b"2")))])
        assert len(server.requests) == 4
    assert len(files(tmp_path)) == 4


@pytest.mark.parametrize("reply", ["", completion("half", "length"), completion("", "content_filter")])
def test_what_did_not_finish_cleanly_is_not_kept(tmp_path, reply):
    with FakeServer(sequence_of(reply)) as server:
        made, _ = client(server, cache=tmp_path)
        made.complete(ASK)
        made.complete(ASK)
    assert len(server.requests) == 2
    assert files(tmp_path) == []


def test_a_broken_cache_file_is_a_call(tmp_path):
    with FakeServer(sequence_of("hi")) as server:
        made, _ = client(server, cache=tmp_path)
        made.complete(ASK)
        (kept,) = files(tmp_path)
        kept.write_bytes(kept.read_bytes()[:5])
        assert made.complete(ASK).content == "hi"
        assert made.complete(ASK).content == "hi"
    assert len(server.requests) == 2


def test_many_threads_share_a_client(tmp_path):
    with FakeServer(lambda request, n: request["messages"][0]["content"]) as server:
        made, _ = client(server, cache=tmp_path)
        replies = {}

        def work(i):
            replies[i] = made.complete([Message("user", (f"q{i}",))]).content

        threads = [threading.Thread(target=work, args=(i,)) for i in range(64)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert replies == {i: f"q{i}" for i in range(64)}


# -- keys -------------------------------------------------------------------------------------------------------------


def test_the_key_is_sent_and_goes_nowhere_else(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    caplog.set_level(logging.DEBUG)
    with FakeServer(sequence_of("hi", Status(401, f"bad key {SECRET}"))) as server:
        made, _ = client(server, cache=tmp_path)
        made.complete(ASK)
        with pytest.raises(EndpointError) as caught:
            made.complete([Message("user", ("again",))])
    assert server.headers[0]["authorization"] == f"Bearer {SECRET}"
    assert SECRET not in str(caught.value)
    assert SECRET not in caplog.text
    assert SECRET not in json.dumps(made.settings())
    for path in files(tmp_path):
        assert SECRET.encode() not in path.read_bytes()


# -- what servers get wrong -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "usage",
    [[], "x", {"prompt_tokens": 10**30}, {"prompt_tokens": -1}, {"prompt_tokens": 5.5}, {"prompt_tokens": True}, None],
    ids=str,
)
def test_a_server_that_counts_nonsense_is_still_heard(usage):
    with FakeServer(lambda request, n: {**completion("hi"), "usage": usage}) as server:
        made, _ = client(server)
        reply = made.complete(ASK)
    assert (reply.content, reply.prompt_tokens, reply.completion_tokens) == ("hi", 0, 0)


def test_a_reply_that_is_not_utf8_is_tried_again():
    broken = Body(b'{"choices": [{"finish_reason": "stop", "message": {"content": "\xff\xfe"}}]}')
    with FakeServer(sequence_of(broken, "hi")) as server:
        made, pauses = client(server)
        assert made.complete(ASK).content == "hi"
        assert len(pauses) == 1
    with FakeServer(sequence_of(broken)) as server, pytest.raises(EndpointError, match="no chat completion"):
        client(server)[0].ask(ASK)


def test_a_cached_call_that_is_not_utf8_is_made_again(tmp_path):
    with FakeServer(sequence_of("hi")) as server:
        made, _ = client(server, cache=tmp_path)
        made.complete(ASK)
        (kept,) = tmp_path.rglob("*.json")
        kept.write_bytes(b'{"content": "\xff"}')
        assert made.complete(ASK).content == "hi"
    assert len(server.requests) == 2


@pytest.mark.parametrize("key", ["sk-abc\nX-Evil: y", "sk abc", "sk-abc\x1b", "sk-\xe4bc"])
def test_a_key_that_is_no_key_is_refused_without_showing_it(monkeypatch, key):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(EndpointError, match="OPENAI_API_KEY") as caught:
        Client("http://localhost:1/v1", "fake")
    assert "sk" not in str(caught.value)
    assert "bc" not in str(caught.value)


def test_a_line_end_after_the_key_is_no_part_of_it(monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", SECRET + "\n")
    with FakeServer(sequence_of("hi")) as server:
        client(server)[0].complete(ASK)
    assert server.headers[0]["authorization"] == f"Bearer {SECRET}"


def test_no_part_of_the_key_is_left_where_a_message_is_cut(monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    for length in range(250, 300):
        message = "x" * length + SECRET
        with FakeServer(sequence_of(Status(400, message))) as server, pytest.raises(EndpointError) as caught:
            client(server)[0].complete(ASK)
        assert SECRET[:6] not in str(caught.value)


@pytest.mark.parametrize(("code", "remedy"), [(401, "OPENAI_API_KEY"), (403, "OPENAI_API_KEY"), (404, "--base-url")])
def test_a_refusal_says_what_to_do(code, remedy):
    with FakeServer(sequence_of(Status(code))) as server, pytest.raises(EndpointError, match=remedy):
        client(server)[0].complete(ASK)


def test_a_probe_does_not_wait_as_long_as_a_question(monkeypatch):
    monkeypatch.setattr("jrdb_avr.agent.client._PROBE_TIMEOUT_S", 0.2)
    with FakeServer(sequence_of(Slow(1.0, "hi"))) as server:
        with pytest.raises(EndpointError, match="no reply within"):
            client(server)[0].ask(ASK)
        assert client(server)[0].complete(ASK).content == "hi"
