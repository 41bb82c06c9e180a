"""The endpoint client against a server that misbehaves, over a real socket."""

import contextlib
import gzip
import json
import logging
import re
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fake_server import Body, CutOff, Drip, FakeServer, Slow, Status, completion
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.messages import Message, Picture, fingerprint, transcript, wire
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.reply import Reply, read_completion
from jrdb_avr.agent.model.transport import Bounds
from jrdb_avr.schema.errors import EndpointError, FilteredError, RunStoppedError, StoreError

ASK = [Message("user", ("hello",))]
OBJECT = '{"answer": 2}'
SECRET = "sk-very-secret-0123456789"


def client(server, cache=None, **options):
    pauses = []
    made = Client(server.url, "fake", EndpointOptions(**options), cache=cache, pause=pauses.append)
    return made, pauses


def about(pauses, least):
    """Whether pauses are these or up to half as long again: those who were refused together do not come back so."""
    return len(pauses) == len(least) and all(b <= a <= 1.5 * b for a, b in zip(pauses, least, strict=True))


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
        Status(429),
        Status(500),
        Status(503),
        *map(Status, (408, 409, 424, 498)),
        CutOff("hi"),
        Body(b"<html>bad gateway</html>", "text/html"),
        Body(b'{"choices": []}'),
        Body(b'{"choices": [{"message": {"content": 5}}]}'),
        Body(b""),
        Body(b"[" * 100_000),
    ],
)
def test_what_transport_or_server_broke_is_tried_again(fault):
    with FakeServer(sequence_of(fault, fault, "hi")) as server:
        made, pauses = client(server)
        assert made.complete(ASK).content == "hi"
    assert len(server.requests) == 3
    assert about(pauses, [7.0, 7.0] if isinstance(fault, Status) and fault.headers else [0.5, 1.0])


@pytest.mark.parametrize(
    ("asked", "waited"), [("3", 3.0), ("0", 0.5), ("-5", 0.5), ("9999", 60.0), ("soon", 0.5), ("nan", 0.5), ("", 0.5)]
)
def test_the_pause_that_a_server_asks_for(asked, waited):
    with FakeServer(sequence_of(Status(429, "slow down", (("Retry-After", asked),)), "hi")) as server:
        made, pauses = client(server)
        made.complete(ASK)
    assert about(pauses, [waited])


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (Status(500, "later"), "HTTP 500: later \\(tries: 5\\): look into the server's log"),
        (CutOff("hi"), "the reply broke off"),
        (Body(b"<html>bad gateway</html>", "text/html; charset=utf-8"), "no chat completion but text/html"),
        (Body(b'{"choices": []}'), "no chat completion but application/json \\(it holds no choice\\)"),
        (Body(b'{"model": "x"}'), "missing required field `choices`"),
        (Body(b"\x00\x1b[2J", "text/\x01plain"), "no chat completion but"),
    ],
)
def test_what_never_gets_better_is_told_in_one_line(fault, words):
    with FakeServer(sequence_of(fault)) as server:
        made, _ = client(server)
        with pytest.raises(EndpointError, match=words) as caught:
            made.complete(ASK)
    assert len(server.requests) == 5
    assert "\n" not in str(caught.value)
    assert "--base-url" not in str(caught.value), "the address is right: there is a server"


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b'{"error": {"message": "no such model", "type": "x"}}', "no such model"),
        (b'{"error": "no such model"}', "no such model"),
        (b'{"object": "error", "message": "no such model", "code": 400}', "no such model"),
        (b'{"detail": "no such model"}', "no such model"),
        (b'{"detail": [{"loc": ["body", "seed"], "msg": "is no number"}, {"msg": "y"}]}', "body.seed: is no number"),
        (b'{"error": {"detail": ["no such", "model"]}}', "no such"),
        (b'[{"error": {"code": 400, "message": "no such model"}}]', "no such model"),
        (b"no such\nmodel", "no such model"),
        (b'{"reason": "odd"}', '{"reason": "odd"}'),
        (b"[]", r"\[\]"),
    ],
)
def test_the_servers_reason_is_told(body, reason):
    """In each form that servers send: nothing of the form itself is printed where the reason is found."""
    with FakeServer(sequence_of(Body(body, code=400))) as server, pytest.raises(EndpointError) as caught:
        client(server)[0].complete(ASK)
    assert re.search(f"HTTP 400: {reason}$", str(caught.value))


@pytest.mark.parametrize(
    ("body", "words", "tries"),
    [
        ({"error": {"message": "context too long", "code": 400}}, "HTTP 400: context too long", 1),
        ({"error": {"message": "upstream died", "code": "odd"}}, "HTTP 502: upstream died", 5),
        ({"error": "upstream died", "choices": []}, "HTTP 502: upstream died", 5),
        ({"object": "error", "message": "context too long", "code": 400}, "HTTP 400: context too long", 1),
        (completion("hal", "abort"), "finish_reason 'abort'", 5),
        (completion(OBJECT, "insufficient_system_resource"), "finish_reason 'insufficient_system_resource'", 5),
        (completion(OBJECT, "Network_Error"), "finish_reason 'Network_Error'", 5),
        (completion(OBJECT, "timeout"), "finish_reason 'timeout'", 5),
        (completion(OBJECT, "ENGINE_CRASHED"), "finish_reason 'ENGINE_CRASHED'", 5),
        (completion(OBJECT, {"type": "error"}), "finish_reason .*error", 5),
        (
            {"choices": [{"message": {"content": "hal"}, "finish_reason": "error", "error": {"message": "gone"}}]},
            "HTTP 502: gone",
            5,
        ),
    ],
)
def test_an_error_with_the_status_of_a_success(body, words, tries):
    with FakeServer(sequence_of(body)) as server, pytest.raises(EndpointError, match=words):
        client(server)[0].complete(ASK)
    assert len(server.requests) == tries


def test_a_busy_reply_with_the_status_of_a_success_is_waited_for():
    busy = {"error": {"message": "rate limited", "code": 429}}
    with FakeServer(sequence_of(*[busy] * 7, "hi")) as server:
        assert client(server, retries=1)[0].complete(ASK).content == "hi"


@pytest.mark.parametrize(
    ("content", "read", "reasoning"),
    [
        ([{"type": "text", "text": '{"a"'}, {"type": "text", "text": ": 1}"}], '{"a": 1}', ""),
        (
            [{"type": "thinking", "thinking": [{"type": "text", "text": "hm"}]}, {"type": "text", "text": "x"}],
            "x",
            "hm",
        ),
        ([{"text": "x"}, {"type": "odd", "text": "y"}], "x", ""),
        ([{"type": "thinking", "thinking": "hm"}, "x", {"type": "image"}, 5, None], "x", "hm"),
        ([], "", ""),
        (None, "", ""),
    ],
)
def test_content_that_is_a_list_of_parts(content, read, reasoning):
    reply = read_completion(json.dumps(completion(content)).encode())
    assert (reply.content, reply.reasoning) == (read, reasoning)


@pytest.mark.parametrize(
    ("sent", "read"),
    [
        ("eos_token", "stop"),
        ("STOP", "stop"),
        ("end_turn", "stop"),
        ("MAX_TOKENS", "length"),
        ("too_many_tokens", "length"),
        ("max-tokens", "length"),
        ("CONTENT_FILTER", "content_filter"),
        ("guardrail_intervened", "content_filter"),
        ("NO_ERROR", "NO_ERROR"),
        ("content_filter", "content_filter"),
        ("SAFETY", "content_filter"),
        ("FINISH_REASON_STOP", "stop"),
        ({"type": "stop"}, ""),
        ("odd", "odd"),
        (None, ""),
    ],
)
def test_finish_reasons_of_other_protocols(sent, read):
    assert read_completion(json.dumps(completion("x", sent)).encode()).finish_reason == read


# -- a busy server ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", [429, 503, 529])
@pytest.mark.parametrize("headers", [(), (("Retry-After", "0"),), (("Retry-After", "5"),)], ids=str)
def test_a_busy_server_is_waited_for_but_not_for_ever(headers, code):
    """Longer than a broken one: it says that it is there. Two minutes of pauses at least, and an end of the run."""
    with FakeServer(sequence_of(Status(code, "later", headers))) as server:
        made, pauses = client(server)
        with pytest.raises(RunStoppedError, match=rf"HTTP {code}: later .*less busy"):
            made.complete(ASK)
        assert 120 <= sum(pauses) < 180
        assert len(server.requests) == len(pauses) + 1
        for soon in (client(server, retries=0)[0].complete, client(server)[0].probe):
            before = len(server.requests)
            with pytest.raises(EndpointError, match=f"HTTP {code}"):
                soon(ASK)
            assert len(server.requests) - before <= 2


def test_waiting_for_a_busy_server_leaves_the_retries():
    busy, broken = Status(429), Status(500)
    script = sequence_of(*[busy] * 6, broken, busy, broken, broken, busy, broken, "hi")
    with FakeServer(script) as server:
        assert client(server)[0].complete(ASK).content == "hi"


@pytest.mark.parametrize("said", [{"message": "no more"}, {"message": None}, {}])
@pytest.mark.parametrize("wrap", [lambda error: {"error": error}, lambda error: error], ids=["nested", "flat"])
def test_an_account_without_credit_is_told_at_once(said, wrap):
    body = json.dumps(wrap({**said, "code": "insufficient_quota"})).encode()
    with FakeServer(sequence_of(Body(body, code=429))) as server, pytest.raises(EndpointError, match="credit"):
        client(server)[0].complete(ASK)
    assert len(server.requests) == 1


@pytest.mark.slow
def test_sixty_four_share_a_server_that_takes_four():
    """It refuses whoever comes while four are served: nobody's question may be lost for that."""
    places, held = threading.Semaphore(4), [0.03]

    def script(request, n):
        if not places.acquire(blocking=False):
            return Status(429, "busy")
        begun = time.monotonic()
        time.sleep(held[0])
        held.append(time.monotonic() - begun)
        places.release()
        return "hi"

    with FakeServer(script) as server, ThreadPoolExecutor(64) as pool:
        # A part of every pause, so that the ratio of work to pauses is at most that of a second's work per reply.
        made = Client(server.url, "fake", pause=lambda seconds: time.sleep(seconds * max(held)))
        assert {reply.content for reply in pool.map(made.complete, [ASK] * 128)} == {"hi"}
    assert len(server.requests) > 128


def test_a_reply_without_end_is_not_read_to_its_end():
    with FakeServer(sequence_of("x" * 90_000, "x" * 200_000)) as server:
        made = Client(server.url, "fake", bounds=Bounds(reply_bytes=100_000))
        assert len(made.complete(ASK).content) == 90_000
        with pytest.raises(EndpointError, match="is this a chat server"):
            made.complete(ASK)
    assert len(server.requests) == 2


def test_nothing_of_a_reply_over_a_megabyte_is_read_further_or_stored(tmp_path):
    """The connection breaks after 1.1 MB: the rest is not asked for again."""
    with FakeServer(sequence_of("x" * 1_000_000, CutOff("x" * 2_200_000))) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        assert len(made.complete(ASK).content) == 1_000_000
        before = (tmp_path / CALLS).read_bytes()
        with pytest.raises(EndpointError, match="the reply is longer than 1 MB"):
            made.complete([Message("user", ("more",))])
        assert (tmp_path / CALLS).read_bytes() == before
    assert len(server.requests) == 2


@pytest.mark.parametrize("late", [Drip(0.05, "late"), Slow(60, "late")])
def test_a_reply_that_comes_late_is_given_up_and_requested_again(late):
    """Each byte of a dripping reply comes in time; were all of them waited for, the reply would be another."""
    with FakeServer(sequence_of(late, "hi")) as server:
        made, _ = client(server, timeout_s=1)
        assert made.complete(ASK).content == "hi"


@pytest.mark.parametrize("said", [b"a", b"HTTP/1.1 102 Processing\r\n\r\n"], ids=["head", "announcements"])
def test_a_reply_that_never_begins_is_given_up(said):
    """A byte of a header line, or an announcement that the reply is to come, again and again, each in time.

    Were all of them waited for, the connection would end in another error.
    """
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(8)

        def drip(connection):
            with connection, contextlib.suppress(OSError):
                connection.recv(1 << 16)
                connection.sendall(b"HTTP/1.1 200 OK\r\nX: " if said == b"a" else b"")
                for _ in range(400):
                    time.sleep(0.05)
                    connection.sendall(said)

        def serve():
            for _ in range(2):
                threading.Thread(target=drip, args=listening.accept()[:1], daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        made = Client(f"http://127.0.0.1:{listening.getsockname()[1]}/v1", "x", EndpointOptions(timeout_s=1, retries=0))
        with pytest.raises(EndpointError, match=r"no whole reply within 1 s \(tries: 1\): .*--concurrency"):
            made.complete(ASK)
        assert made.server_version() == ""


@pytest.mark.parametrize(
    ("code", "reason", "remedy"),
    [
        (400, "no", "no$"),
        (401, "no", "OPENAI_API_KEY"),
        (402, "no", "no credit is left"),
        (403, "no", "OPENAI_API_KEY"),
        (403, "Your account is suspended: content policy", "OPENAI_API_KEY"),
        (404, "no", "--base-url"),
        (422, "no", "no$"),
        (400, "Your credit balance is too low", "no credit is left"),
        (429, "余额不足或无可用资源包", "no credit is left.*--resume"),
        (400, "Unrecognized request argument supplied: chat_template_kwargs", "--thinking template"),
        (400, "This model only supports stream mode", "reply without a stream"),
    ],
)
def test_a_refusal_is_not_tried_again_and_says_what_to_do(code, reason, remedy):
    words = f"HTTP {code}: {reason}.*{remedy}" if remedy != "no$" else f"HTTP {code}: no$"
    with FakeServer(sequence_of(Status(code, reason))) as server, pytest.raises(EndpointError, match=words) as caught:
        client(server)[0].complete(ASK)
    assert len(server.requests) == 1
    assert isinstance(caught.value, RunStoppedError) == (code == 401 or "credit" in remedy)


@pytest.mark.parametrize(
    ("code", "error"),
    [
        (400, {"message": "The response was filtered due to the prompt", "code": "content_filter"}),
        (400, {"message": "no", "code": "data_inspection_failed"}),
        (400, {"message": "considered high risk", "type": "content_filter"}),
        (400, {"message": "生成内容可能包含不安全或敏感内容", "code": "1301"}),
        (400, {"message": "Content Exists Risk", "code": "invalid_request_error"}),
        (403, {"message": "The model requires moderation. Your input was flagged for violence", "code": 403}),
    ],
)
def test_a_filtered_prompt_is_a_refusal_of_the_question(code, error):
    body = Body(json.dumps({"error": error}).encode(), code=code)
    with FakeServer(sequence_of(body)) as server, pytest.raises(FilteredError, match=r"^refused: content filter$"):
        client(server)[0].complete(ASK)
    assert len(server.requests) == 1


def test_a_stream_is_one_line_that_says_what_to_do():
    body = Body(b'data: {"choices": []}\n\ndata: [DONE]\n\n', "text/event-stream; charset=utf-8")
    with FakeServer(sequence_of(body)) as server, pytest.raises(EndpointError, match=r"streams .* without a stream$"):
        client(server)[0].complete(ASK)
    assert len(server.requests) == 1


def test_a_redirect_is_refused_whatever_its_body():
    bomb = gzip.compress(bytes(5_000_000))
    headers = (("Location", "/v1/elsewhere"), ("Content-Encoding", "gzip"))
    script, words = sequence_of(Body(bomb, code=307, headers=headers), "hi"), r"redirects .*HTTP 307.*--base-url"
    with FakeServer(script) as server, pytest.raises(EndpointError, match=words):
        client(server)[0].complete(ASK)
    assert len(server.requests) == 1


def test_nobody_there_is_one_line():
    with socket.socket() as free:
        # The port stays taken, so that no other server gets it. A socket that does not listen refuses connections.
        free.bind(("127.0.0.1", 0))
        pauses = []
        made = Client(f"http://127.0.0.1:{free.getsockname()[1]}/v1", "fake", pause=pauses.append)
        words = r"cannot reach the server .*: start the server or correct --base-url"
        with pytest.raises(RunStoppedError, match=words) as e:
            made.complete(ASK)
    assert "\n" not in str(e.value)
    assert 120 <= sum(pauses) < 180, "it may be restarting"


def test_who_alone_is_refused_does_not_stop_the_run():
    """A server that stays busy for one request, while others are replied to, is that question's trouble alone."""
    with FakeServer(lambda request, n: Status(503) if "poison" in json.dumps(request) else "hi") as server:
        made = Client(server.url, "fake", pause=lambda seconds: made.complete(ASK))
        with pytest.raises(EndpointError) as caught:
            made.complete([Message("user", ("poison",))])
    assert not isinstance(caught.value, RunStoppedError)


def test_a_host_that_takes_no_connection_is_not_waited_for_as_for_a_reply():
    """A full queue of connections: the kernel answers no further one."""
    with socket.socket() as full, contextlib.ExitStack() as stack:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        for _ in range(3):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(full.getsockname())
        url = f"http://127.0.0.1:{full.getsockname()[1]}/v1"
        made = Client(url, "x", EndpointOptions(retries=0), bounds=Bounds(connect_s=0.3))
        with pytest.raises(EndpointError, match="cannot reach the server"):
            made.complete(ASK)


@pytest.mark.parametrize(
    "url",
    [
        "",
        "localhost:8000",
        "ftp://x/v1",
        "http://",
        "http://me:pw@host/v1",
        "ftp://me:pw@host/v1",
        "me:pw@host/v1",
        "http://h/v1?key=pw",
        "http://h/v1#pw",
        "http://[::1/v1",
        "http://h:99999/v1",
        "http://a..b/v1",
        f"http://{'a' * 64}/v1",
        "http://ho\nst/v1",
        "http://ho st/v1",
        "http://h/\x1b[2J",
        "http://h\udcff/v1",
    ],
)
def test_addresses_that_cannot_be_used(url):
    """Whatever is told of them holds no password that one may hold, and can be printed."""
    with pytest.raises(EndpointError) as caught:
        Client(url, "fake")
    assert "pw" not in str(caught.value)
    assert str(caught.value).isascii() and str(caught.value).isprintable()


@pytest.mark.parametrize("proxy", ["::", "junk://x"])
def test_a_proxy_that_is_none_is_told(monkeypatch, proxy):
    monkeypatch.setenv("HTTPS_PROXY", proxy)
    with pytest.raises(EndpointError, match="HTTPS_PROXY"):
        Client("http://host.invalid/v1", "fake")
    Client("http://localhost:1/v1", "fake")


def test_few_bytes_that_would_become_many_are_not_unpacked():
    bomb = gzip.compress(json.dumps(completion("x" * 5_000_000)).encode())
    script = sequence_of(Body(bomb, headers=(("Content-Encoding", "gzip"),)))
    with FakeServer(script) as server, pytest.raises(EndpointError, match="is compressed"):
        client(server)[0].complete(ASK)
    assert server.headers[0]["accept-encoding"] == "identity"
    assert len(server.requests) == 1


# -- the cache --------------------------------------------------------------------------------------------------------


CALLS = "calls.jsonl"


def kept_in(folder):
    """The lines of finished calls."""
    path = folder / CALLS
    return [json.loads(line) for line in path.read_text().splitlines() if line] if path.exists() else []


def test_a_finished_call_is_made_once(tmp_path):
    with FakeServer(sequence_of("hi")) as server:
        first, _ = client(server, cache=tmp_path / CALLS)
        a = first.complete(ASK, {"type": "object"})
        second, _ = client(server, cache=tmp_path / CALLS)
        assert second.complete(ASK, {"type": "object"}) == a
        assert len(server.requests) == 1
        second.complete(ASK, {"type": "array"})
        second.complete([Message("user", ("hello", Picture("n", b"1")))])
        second.complete([Message("user", ("hello", Picture("n", b"2")))])
        assert len(server.requests) == 4
    assert len(kept_in(tmp_path)) == 4


def test_a_broken_cache_file_is_a_call(tmp_path):
    with FakeServer(sequence_of("hi")) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        made.complete(ASK)
        kept = tmp_path / CALLS
        kept.write_bytes(kept.read_bytes()[:-5])
        assert made.complete(ASK).content == "hi"
        assert made.complete(ASK).content == "hi"
    assert len(server.requests) == 2


@pytest.mark.parametrize(
    ("reply", "kept"),
    [
        (completion("<think>hm</think>{}"), True),
        (completion("<think>hm, {}"), False),
        (completion("<think>hm</think>"), False),
        (completion(" \n"), False),
        (completion("", reasoning="{}"), False),
        (completion(None, reasoning_content="hm</think>{}"), True),
        (completion("{}", finish_reason=None), False),
        (completion("{}", finish_reason="tool_calls"), True),
        (completion("{}", refusal={"odd": 1}, reasoning=["odd"]), True),
        (completion("{}", refusal="I would rather not."), False),
        (completion("", refusal="I cannot help with that."), False),
        (completion("half", "length"), False),
        (completion("", "content_filter"), False),
    ],
)
def test_only_a_call_that_said_something_is_kept(tmp_path, reply, kept):
    with FakeServer(sequence_of(reply)) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        made.complete(ASK)
        made.complete(ASK)
    assert len(server.requests) == (1 if kept else 2)
    assert len(kept_in(tmp_path)) == kept


def test_whatever_shapes_a_reply_is_in_its_key(tmp_path):
    """And what does not is not: a server may move, or need more time, without a call being paid for again."""
    qwen = convention_of("Qwen/Qwen3.5-9B")

    def made(model="fake", convention=qwen, **options):
        return Client(server.url, model, EndpointOptions(**options), convention=convention, cache=tmp_path / CALLS)

    with FakeServer(sequence_of("{}")) as server, FakeServer(sequence_of("{}")) as moved:
        made().complete(ASK, {"type": "object"})
        for same in ({}, {"timeout_s": 5.0}, {"retries": 0}):
            made(**same).complete(ASK, {"type": "object"})
        Client(moved.url, "fake", convention=qwen, cache=tmp_path / CALLS).complete(ASK, {"type": "object"})
        assert (len(server.requests), len(moved.requests)) == (1, 0)
        others = (
            {"model": "fake-2"},
            {"max_tokens": 100},
            {"thinking": "on"},
            {"response_format": "json_object"},
            {"response_format": "none"},
        )
        for number, other in enumerate(others, 2):
            made(**other).complete(ASK, {"type": "object"})
            assert len(server.requests) == number
    assert server.requests[0]["chat_template_kwargs"] == {"enable_thinking": False}


WRITER = """
import sys, time
from pathlib import Path
from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.reply import Reply

calls = Calls(Path(sys.argv[1]))
digest = calls.digest({"model": "x"})
print("ready", flush=True)
while True:
    calls.append(digest, Reply(sys.argv[2] * 300_000, finish_reason="stop"))
    time.sleep(0.01)
"""


@pytest.mark.slow
def test_calls_survive_kills_and_two_processes(tmp_path):
    """Two processes keep the same call over and over, and are killed: every read finds one reply, whole."""
    path = tmp_path / CALLS
    digest = Calls(path).digest({"model": "x"})
    command = [sys.executable, "-c", WRITER, str(path)]
    for _ in range(2):
        writers = [subprocess.Popen([*command, letter], stdout=subprocess.PIPE) for letter in "ab"]
        for writer in writers:
            assert writer.stdout.readline() == b"ready\n"
        seen = set()
        while len(seen) < 2:
            assert all(writer.poll() is None for writer in writers)
            if (reply := Calls(path).read(digest)) is not None:
                assert len(reply.content) == 300_000
                assert len(set(reply.content)) == 1
                seen.add(reply.content[0])
        for writer in writers:
            writer.kill()
            writer.wait()
            writer.stdout.close()
        assert len(Calls(path).read(digest).content) == 300_000


def test_a_line_that_was_cut_short_costs_one_call(tmp_path):
    """Wherever a kill cut the last line, the calls before it and those kept after it are found."""
    path = tmp_path / CALLS
    calls = Calls(path)
    names = [calls.digest({"n": number}) for number in range(3)]
    for name in names[:2]:
        calls.append(name, Reply(name))
    whole = path.read_bytes()
    first = whole.index(b"\n\n") + 1
    for size in range(first, len(whole) + 1):
        path.write_bytes(whole[:size])
        again = Calls(path)
        again.append(names[2], Reply(names[2]))
        for reader in (again, Calls(path)):
            assert reader.read(names[2]).content == names[2]
            assert reader.read(names[0]).content == names[0]
            # Whole but for its line end is as good as whole, once another line follows.
            cut = size < len(whole) - 1
            assert (reader.read(names[1]) is None) is cut


def test_what_cannot_be_read_leaves_no_file_open(tmp_path, monkeypatch):
    path = tmp_path / CALLS
    Calls(path).append("a", Reply("hi"))
    calls = Calls(path)

    def refuse(*_):
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(Path, "open", refuse)
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(20):
        assert calls.read("a") is None
    assert len(list(Path("/proc/self/fd").iterdir())) <= before
    monkeypatch.undo()
    assert calls.read("a").content == "hi"


LATE = """
import atexit, sys
from pathlib import Path
from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.reply import Reply

atexit.register(lambda: calls.append("b", Reply("late")))
calls = Calls(Path(sys.argv[1]))
calls.append("a", Reply("hi"))
"""


def test_a_reply_that_comes_at_the_very_end_is_kept(tmp_path):
    path = tmp_path / CALLS
    subprocess.run([sys.executable, "-c", LATE, str(path)], check=True)
    assert [line["request"] for line in kept_in(tmp_path)] == ["a", "b"]


def test_many_threads_keep_and_find_calls(tmp_path):
    calls = Calls(tmp_path / CALLS)

    def work(number):
        digest = calls.digest({"n": number % 50})
        calls.append(digest, Reply(f"{number % 50} " * 200))
        return calls.read(digest).content == f"{number % 50} " * 200

    with ThreadPoolExecutor(16) as pool:
        assert all(pool.map(work, range(800)))
    assert len(kept_in(tmp_path)) == 800


def test_a_full_disk_is_told(tmp_path):
    (tmp_path / CALLS).mkdir()
    with FakeServer(sequence_of("hi")) as server, pytest.raises(StoreError, match="cannot keep a finished call"):
        client(server, cache=tmp_path / CALLS)[0].complete(ASK)


def test_sixty_four_are_in_flight_at_once():
    together = threading.Barrier(64)

    def script(request, n):
        together.wait(300)
        return "hi"

    with FakeServer(script) as server:
        made, pauses = client(server)
        with ThreadPoolExecutor(64) as pool:
            assert {reply.content for reply in pool.map(made.complete, [ASK] * 64)} == {"hi"}
    assert pauses == []


# -- keys -------------------------------------------------------------------------------------------------------------


def test_the_key_is_sent_and_goes_nowhere_else(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    caplog.set_level(logging.DEBUG)
    with FakeServer(sequence_of("hi", Status(401, f"bad key {SECRET}"))) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        made.complete(ASK)
        with pytest.raises(EndpointError) as caught:
            made.complete([Message("user", ("again",))])
    assert server.headers[0]["authorization"] == f"Bearer {SECRET}"
    assert SECRET not in str(caught.value)
    assert SECRET not in caplog.text
    assert SECRET not in json.dumps(made.settings())
    assert SECRET not in json.dumps(kept_in(tmp_path))


def test_a_server_that_echoes_the_key_does_not_get_it_stored(monkeypatch, tmp_path):
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    with FakeServer(lambda request, n: completion(f"key {SECRET}", model=SECRET, reasoning=SECRET)) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        reply = made.complete(ASK)
    assert reply.content == "key [key]"
    assert SECRET not in str(reply) + str(made.served)
    assert SECRET not in json.dumps(kept_in(tmp_path))


def test_a_key_in_jsons_escapes_is_not_stored_either(monkeypatch, tmp_path):
    """Some servers write every slash and plus sign so."""
    key = "sk-proj-AbC+/123456789012345678901234567"
    monkeypatch.setenv("OPENAI_API_KEY", key)
    body = json.dumps(completion(f"key {key}", model=key, finish_reason="stop", reasoning=key, refusal=key))
    body = body.replace("/", "\\/").replace("+", "\\u002B")
    assert key not in body and key in json.loads(body)["model"]
    with FakeServer(sequence_of(Body(body.encode())), version=json.dumps({"version": key}).encode()) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        reply = made.complete(ASK)
        assert key not in str(reply) + str(made.served) + made.server_version() + json.dumps(kept_in(tmp_path))
    assert (reply.content, made.served) == ("key [key]", ("[key]",))


@pytest.mark.parametrize("key", [SECRET, "/" + SECRET])
@pytest.mark.parametrize("before", ["", "\\", "\\\\", "\n"])
@pytest.mark.parametrize("escape", [str, lambda body: body.replace("/", "\\/")])
def test_what_stands_before_the_key_stays(monkeypatch, key, before, escape):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    body = escape(json.dumps(completion(f"k {before}{key}"))).encode()
    with FakeServer(sequence_of(Body(body))) as server:
        assert client(server, retries=0)[0].complete(ASK).content == f"k {before}[key]"


def test_nothing_of_this_machine_is_told():
    with FakeServer(sequence_of("hi")) as server:
        client(server)[0].complete(ASK)
    (headers,) = server.headers
    assert headers["content-type"] == "application/json"
    assert set(headers) <= {
        "host",
        "accept",
        "accept-encoding",
        "connection",
        "user-agent",
        "content-type",
        "content-length",
    }


def test_a_key_that_is_a_word_leaves_replies_alone(monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", "EMPTY")
    with FakeServer(sequence_of("the room is EMPTY")) as server:
        assert client(server)[0].complete(ASK).content == "the room is EMPTY"


# -- what servers get wrong -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "usage",
    [[], "x", {"prompt_tokens": 10**30}, {"prompt_tokens": -1}, {"prompt_tokens": 5.5}, {"prompt_tokens": True}, None],
    ids=str,
)
def test_a_server_that_counts_nonsense_is_still_heard(usage):
    """Its tokens are estimated: five and two characters are one token each."""
    with FakeServer(lambda request, n: {**completion("hi"), "usage": usage}) as server:
        made, _ = client(server)
        assert made.complete(ASK) == Reply("hi", "", "stop", "fake-1", 1, 1, estimated=True)
        assert made.estimates == 1


@pytest.mark.parametrize(
    "note",
    [
        "NaN",
        "-Infinity",
        "1e999",
        r'"\ud83d"',
        r'"\ude00 \ud83d\ude00"',
        r'"\\ud83d \uD83D"',
        '"\xff"',
        r'{"\ud83d": [NaN]}',
    ],
)
def test_what_no_json_holds_is_no_fault_of_the_reply(note):
    """Neither in a field that is not read, nor in the reasoning."""
    body = json.dumps({**completion(OBJECT), "note": "NOTE"}).replace('"NOTE"', note).encode("latin-1")
    assert read_completion(body).content == OBJECT
    thought = json.dumps(completion(OBJECT, reasoning="NOTE")).replace('"NOTE"', note).encode("latin-1")
    reply = read_completion(thought)
    assert reply.content == OBJECT
    assert reply.reasoning.encode().decode() == reply.reasoning, "files can hold it"
    assert ("\U0001f600" in reply.reasoning) == ("\\ud83d\\ude00" in note)
    assert (r"\ud83d" in reply.reasoning) == (r"\\ud83d" in note), "an escaped backslash begins no surrogate"


@pytest.mark.parametrize(
    "usage",
    [
        {"input_tokens": 10, "output_tokens": 5},
        {"promptTokens": 10, "completionTokens": 5.0},
        {"promptTokenCount": 10, "candidates_token_count": 5},
        {"prompt_tokens": 10.0, "completion_tokens": 5.0},
        {"prompt_tokens": None, "input_tokens": 10.0, "completion_tokens": 5},
    ],
)
def test_counts_of_tokens_in_other_forms(usage):
    assert read_completion(json.dumps({**completion("hi"), "usage": usage}).encode()) == Reply(
        "hi", "", "stop", "fake-1", 10, 5
    )


@pytest.mark.parametrize("key", ["sk-abc\nX-Evil: y", "sk abc", "sk-abc\x1b", "sk-\xe4bc"])
def test_a_key_that_is_no_key_is_refused_without_showing_it(monkeypatch, key):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(EndpointError, match="OPENAI_API_KEY") as caught:
        Client("http://localhost:1/v1", "fake")
    assert "sk" not in str(caught.value)
    assert "bc" not in str(caught.value)


def test_no_part_of_the_key_is_left_where_a_message_is_cut(monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    with FakeServer(lambda request, n: Status(400, "x" * (250 + n) + SECRET)) as server:
        made, _ = client(server)
        for _ in range(50):
            with pytest.raises(EndpointError) as caught:
                made.complete(ASK)
            assert SECRET[:6] not in str(caught.value)


def test_a_probe_does_not_wait_as_long_as_a_question():
    with FakeServer(sequence_of(Slow(60, ""), Slow(60, ""), Slow(0.5, "hi"))) as server:
        made = Client(server.url, "fake", bounds=Bounds(probe_s=0.2), pause=lambda seconds: None)
        with pytest.raises(EndpointError, match="no whole reply within"):
            made.probe(ASK)
        assert made.complete(ASK).content == "hi"


def test_a_probe_that_fails_speaks_of_no_run_to_resume():
    """As llama.cpp without eyes refuses a picture: with a 500."""
    with FakeServer(sequence_of(Status(500, "image input is not supported"))) as server:
        made, _ = client(server)
        for send, said in ((made.probe, False), (made.complete, True)):
            with pytest.raises(EndpointError, match="image input is not supported") as told:
                send(ASK)
            assert ("--resume" in str(told.value)) == said


# -- who replies ------------------------------------------------------------------------------------------------------


def test_another_model_than_asked_is_told(tmp_path):
    with FakeServer(lambda request, n: completion("hi", model=["a", "a", "b", None][n])) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        for number in range(4):
            made.complete([Message("user", (f"q{number}",))])
        assert made.served == ("a", "b", "")
        again, _ = client(server, cache=tmp_path / CALLS)
        again.complete([Message("user", ("q0",))])
        assert again.served == ("a",)
    assert len(kept_in(tmp_path)) == 2, "of the model that the run is of, and of no other"


def test_a_kept_call_of_another_model_is_made_again(tmp_path):
    """A folder of calls may have outlived its run, or a server its model."""
    with FakeServer(lambda request, n: completion(f"reply {n}", model=["a", "b", "b"][n])) as server:
        client(server, cache=tmp_path / CALLS)[0].complete(ASK)
        made, _ = client(server, cache=tmp_path / CALLS)
        made.probe([Message("user", ("who are you",))])
        assert made.complete(ASK).content == "reply 2"
        assert made.served == ("b",)


@pytest.mark.parametrize("kept", ["{}", '{"content":"half","finish_reason":"length","model":"fake-1"}'])
def test_a_kept_call_that_is_no_finished_one_is_made_again(tmp_path, kept):
    with FakeServer(sequence_of("hi")) as server:
        made, _ = client(server, cache=tmp_path / CALLS)
        made.complete(ASK)
        (line,) = kept_in(tmp_path)
        (tmp_path / CALLS).write_text(json.dumps({**line, "reply": json.loads(kept)}) + "\n")
        assert made.complete(ASK).content == "hi"
        assert len(server.requests) == 2


@pytest.mark.parametrize(
    ("sent", "version"),
    [
        (b'{"version": "0.12.0"}', "0.12.0"),
        (b'{"version": 12}', ""),
        (b"[]", ""),
        (b"<html>", ""),
        (b"\xff", ""),
        (b'{"version": "a\\nb"}', "a b"),
        (None, ""),
    ],
)
def test_the_servers_version_if_it_tells_one(sent, version):
    with FakeServer(sequence_of("hi"), version=sent) as server:
        assert client(server)[0].server_version() == version


# -- what a completion may be -----------------------------------------------------------------------------------------

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
FIELDS = ("content", "reasoning", "reasoning_content", "refusal")


@given(st.binary() | JSON.map(lambda value: json.dumps(value).encode()))
def test_junk_is_no_completion(data):
    with pytest.raises(ValueError, match=r"\S"):
        read_completion(data)


@given(st.fixed_dictionaries({}, optional=dict.fromkeys(FIELDS, JSON)), JSON, JSON, JSON)
def test_whatever_stands_in_a_completion_is_a_reply_or_a_reason(message, finish_reason, model, usage):
    body = {"choices": [{"message": message, "finish_reason": finish_reason}], "model": model, "usage": usage}
    try:
        reply = read_completion(json.dumps(body).encode())
    except ValueError:
        return
    assert isinstance(reply, Reply)
    assert reply.prompt_tokens >= 0


def test_only_requests_of_simulated_runs_say_what_a_picture_shows():
    picture = Picture("s 000015 45", b"jpeg", {"sequence": "s", "frame": 15, "angle": 45.0})
    sent = []

    def script(request, n):
        sent.append(request)
        return completion("ready")

    with FakeServer(script) as server:
        for simulated in (False, True):
            Client(server.url, "m", EndpointOptions(simulated=simulated)).complete([Message("user", ("look", picture))])
    undeclared, declared = (request["messages"][0]["content"][1] for request in sent)
    assert undeclared.keys() == {"type", "image_url"} and "jrdb_avr" not in json.dumps(sent[0])
    assert declared["jrdb_avr"] == {"sequence": "s", "frame": 15, "angle": 45.0}
