"""Request settings: what each puts into a request, what a manifest holds of it, and what is never stored."""

import json
from itertools import pairwise

import pytest
from fake_server import FakeServer, Status, completion

from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT, convention_of
from jrdb_avr.agent.model.limits import RateLimit
from jrdb_avr.agent.model.messages import Message, Picture
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.prices import Price, estimate_tokens, read_price
from jrdb_avr.agent.model.probes import drawn_picture
from jrdb_avr.engine.run.options import QuestionSelection, RunOptions
from jrdb_avr.schema.errors import EndpointError, InputError, RunStoppedError

ASK = [Message("user", ("hello",))]
SECRET = "header-secret-0123456789"


def sent(options, url=lambda url: url, **more):
    """The one request that these options make, and its headers and path."""
    with FakeServer(lambda request, n: "hi") as server:
        Client(url(server.url), "fake", options, **more).complete(ASK, {"type": "object"})
    return server.requests[0], server.headers[0], server.paths[0]


# -- the request ------------------------------------------------------------------------------------------------------


def test_the_defaults_make_the_request_that_they_always_made():
    body, headers, path = sent(EndpointOptions(response_format="none"))
    message = {"role": "user", "content": "hello"}
    assert body == {"model": "fake", "temperature": 0, "max_tokens": 2048, "messages": [message]}
    assert type(body["temperature"]) is int
    assert path == "/v1/chat/completions"
    assert "authorization" not in headers


@pytest.mark.parametrize(("temperature", "key"), [(None, {}), (0.7, {"temperature": 0.7}), (1.0, {"temperature": 1})])
def test_temperature(temperature, key):
    body, _, _ = sent(EndpointOptions(temperature=temperature))
    assert {name: value for name, value in body.items() if name == "temperature"} == key
    assert EndpointOptions(temperature=temperature).settings(CONTRACT)["temperature"] == temperature


@pytest.mark.parametrize("temperature", [-1, float("nan"), float("inf")])
def test_no_temperature(temperature):
    with pytest.raises(InputError, match="--temperature"):
        EndpointOptions(temperature=temperature)


def test_a_refused_temperature_has_a_remedy():
    no = Status(400, "Unsupported value: 'temperature' does not support 0 with this model.")
    with FakeServer(lambda request, n: no) as server, pytest.raises(EndpointError, match="--temperature none"):
        Client(server.url, "fake").complete(ASK)


def picky(request, n):
    """As reasoning models behind OpenAI's own server."""
    if "max_tokens" in request:
        return Status(400, "Unsupported parameter: 'max_tokens'. Use 'max_completion_tokens' instead.")
    return "hi"


def test_the_name_of_the_limit_is_found_once_and_shapes_no_key(tmp_path):
    with FakeServer(picky) as server:
        made = Client(server.url, "fake", EndpointOptions(max_tokens=99), cache=tmp_path / "calls")
        assert made.complete(ASK).content == "hi"
        made.complete([Message("user", ("again",))])
    assert [request.get("max_completion_tokens") for request in server.requests] == [None, 99, 99]
    with FakeServer(lambda request, n: "other") as server:
        again = Client(server.url, "fake", EndpointOptions(max_tokens=99), cache=tmp_path / "calls")
        assert again.complete(ASK).content == "hi"
    assert server.requests == []


def test_the_name_of_the_limit_as_declared():
    body, _, _ = sent(EndpointOptions(token_parameter="max_completion_tokens", max_tokens=99))
    assert body["max_completion_tokens"] == 99 and "max_tokens" not in body
    with FakeServer(picky) as server, pytest.raises(EndpointError, match="max_completion_tokens"):
        Client(server.url, "fake", EndpointOptions(token_parameter="max_tokens")).complete(ASK)
    assert len(server.requests) == 1
    neither = Status(400, "no max_completion_tokens, no max_tokens")
    with FakeServer(lambda request, n: neither) as server, pytest.raises(EndpointError, match="no max_tokens"):
        Client(server.url, "fake").complete(ASK)
    assert len(server.requests) == 2, "a server that takes neither is not tried for ever"


@pytest.mark.parametrize("key", ["model", "messages", "stream", "n", "temperature", "max_tokens", "response_format"])
def test_an_extra_body_overrides_nothing_that_has_an_option(key):
    with pytest.raises(InputError, match=repr(key)):
        EndpointOptions(extra_body={key: 1})


# -- keys, headers, addresses -----------------------------------------------------------------------------------------


def test_headers_and_key_come_from_the_environment_and_stay_out_of_the_record(monkeypatch, tmp_path):
    monkeypatch.setenv("MY_HEADER", SECRET)
    monkeypatch.setenv("MY_KEY", "sk-key-0123456789abcdef")
    options = EndpointOptions(headers={"api-key": "MY_HEADER", "X-Title": "MY_KEY"}, api_key_env="MY_KEY")
    with FakeServer(lambda request, n: completion(f"you sent {SECRET}")) as server:
        made = Client(server.url, "fake", options, cache=tmp_path / "calls")
        reply = made.complete(ASK)
    assert server.headers[0]["api-key"] == SECRET
    assert server.headers[0]["authorization"] == "Bearer sk-key-0123456789abcdef"
    assert reply.content == "you sent [key]"
    stored = json.dumps(made.settings()) + (tmp_path / "calls").read_text()
    assert SECRET not in stored and "sk-key" not in stored
    assert made.settings()["headers"] == {"api-key": "MY_HEADER", "X-Title": "MY_KEY"}
    words = r"bad \[key\]; put the server's key into \$MY_KEY"
    with FakeServer(lambda request, n: Status(401, f"bad {SECRET}")) as server:
        made = Client(server.url, "fake", options)
        with pytest.raises(EndpointError, match=words):
            made.complete(ASK)


def test_an_authorization_header_stands_in_for_the_key(monkeypatch):
    monkeypatch.setenv("OPENAI_API_KEY", "sk-key-0123456789abcdef")
    monkeypatch.setenv("BASIC", f"Basic {SECRET}")
    _, headers, _ = sent(EndpointOptions(headers={"authorization": "BASIC"}))
    assert headers["authorization"] == f"Basic {SECRET}"
    with FakeServer(lambda request, n: completion(SECRET)) as server:
        made = Client(server.url, "fake", EndpointOptions(headers={"authorization": "BASIC"}))
        assert made.complete(ASK).content == "[key]", "a word of the value is as secret"


@pytest.mark.parametrize("value", [None, "", "two\nlines", "é"])
def test_a_header_without_a_value_is_told(monkeypatch, value):
    monkeypatch.setenv("MINE", value) if value is not None else monkeypatch.delenv("MINE", raising=False)
    with pytest.raises(EndpointError, match=r"\$MINE holds no value"):
        Client("http://localhost:1/v1", "fake", EndpointOptions(headers={"api-key": "MINE"}))


@pytest.mark.parametrize("name", ["Content-Length", "host", "a b", "", "x\n"])
def test_no_header(name):
    with pytest.raises(InputError, match="--header"):
        EndpointOptions(headers={name: "MINE"})


def test_an_address_with_a_query():
    """As Azure's: the path is put before the query."""
    _, _, path = sent(EndpointOptions(), lambda url: f"{url}/deployments/gpt/?api-version=2024-10-21")
    assert path == "/v1/deployments/gpt/chat/completions?api-version=2024-10-21"


@pytest.mark.parametrize("query", ["code=abc", "a=1&api_key=abc", "x=" + "a" * 64, "sig=1", "Token=1"])
def test_a_query_that_may_hold_a_key_is_refused(query):
    with pytest.raises(EndpointError, match="--header") as caught:
        Client(f"http://localhost:1/v1?{query}", "fake")
    assert query not in str(caught.value)


# -- limits and costs -------------------------------------------------------------------------------------------------


class Clock:
    """A clock that moves only where somebody waits."""

    def __init__(self):
        self.now = 1000.0

    def read(self):
        return self.now

    def wait(self, seconds):
        assert seconds > 0
        self.now += seconds


def most_in_a_minute(times, amounts):
    """The largest sum of amounts in any window of a minute."""
    return max(
        sum(b for other, b in zip(times, amounts, strict=True) if time - 60 < other <= time)
        for time, _ in zip(times, amounts, strict=True)
    )


def test_requests_a_minute():
    clock, times = Clock(), []

    def script(request, n):
        times.append(clock.now)
        clock.now += 0.5
        return "hi"

    with FakeServer(script) as server:
        made = Client(server.url, "fake", EndpointOptions(rpm=7), pause=clock.wait, clock=clock.read)
        for _ in range(40):
            made.complete(ASK)
    assert most_in_a_minute(times, [1] * 40) == 7
    assert times[-1] - times[0] < 60 * 6, "no slower than it has to be"


def test_tokens_a_minute():
    clock, times, tokens = Clock(), [], []

    def script(request, n):
        times.append(clock.now)
        clock.now += 1.0
        tokens.append(100 + 10 * (n % 3))
        return completion("hi") | {"usage": {"prompt_tokens": tokens[-1] - 5, "completion_tokens": 5}}

    with FakeServer(script) as server:
        made = Client(server.url, "fake", EndpointOptions(tpm=1000), pause=clock.wait, clock=clock.read)
        for _ in range(60):
            made.complete(ASK)
    # The last request of a minute was expected to be of mean length.
    assert 880 < most_in_a_minute(times, tokens) <= 1010
    assert times[-1] - times[0] < 60 * 60 * 110 / 880


def test_requests_in_flight_count_for_the_mean_of_replies():
    clock = Clock()
    limit = RateLimit(None, 100, clock.read, clock.wait)
    limit.count(limit.admit(), 40)
    limit.admit()
    began = clock.now
    limit.admit()
    assert clock.now >= began + 59, "40 that are counted and 40 expected leave no room"


def test_a_limit_below_one_request_admits_one_at_a_time():
    clock = Clock()
    limit = RateLimit(None, 10, clock.read, clock.wait)
    starts = []
    for _ in range(4):
        sent_ = limit.admit()
        starts.append(clock.now)
        limit.count(sent_, 40)
    assert all(later - earlier == 60 for earlier, later in pairwise(starts))


def test_a_run_stops_at_its_cost_and_goes_on_with_more(tmp_path):
    """Ten tokens read at 2 dollars a million and five written at 4: 40 millionths of a dollar a call."""
    price = Price(2.0, 4.0)
    asks = [[Message("user", (str(n),))] for n in range(20)]

    def client(server, most):
        return Client(server.url, "fake", EndpointOptions(price=price, max_cost=most), cache=tmp_path / "calls")

    with FakeServer(lambda request, n: "hi") as server:
        made = client(server, 200e-6)
        for ask in asks[:5]:
            made.complete(ask)
        with pytest.raises(RunStoppedError, match=r"cost 0\.0002 dollars, and --max-cost is 0\.0002: .*--resume"):
            made.complete(asks[5])
        assert made.complete(asks[0]).content == "hi", "what is stored costs nothing"
        with pytest.raises(RunStoppedError):
            client(server, 200e-6).complete(asks[5])
        assert len(server.requests) == 5, "what the calls before have cost counts"
        assert client(server, 210e-6).complete(asks[5]).content == "hi"


def test_a_run_stops_at_its_cost_if_the_server_counts_no_tokens():
    """400 characters are 100 tokens, and a crop of Qwen3-VL is one of 32 x 32 pixels each."""
    picture = drawn_picture((640, 480), None)
    ask = [Message("user", ("x" * 400, picture))]
    assert estimate_tokens(ask, convention_of("Qwen3-VL-8B")) == 100 + 20 * 15
    assert estimate_tokens(ask, CONTRACT) == round(100 + 640 * 480 / 784)
    assert estimate_tokens([Message("user", (Picture("x", b"broken"),))], CONTRACT) == 0
    options = EndpointOptions(price=Price(1000.0, 0.0), max_cost=1.0)
    with FakeServer(lambda request, n: {**completion("hi"), "usage": None}) as server:
        made = Client(server.url, "fake", options)
        for _ in range(3):
            made.complete(ask)
        with pytest.raises(RunStoppedError, match=r"cost 1\.4\d* dollars by estimated tokens"):
            made.complete(ask)


def test_prices_come_from_a_file(tmp_path):
    path = tmp_path / "prices.toml"
    text = b'["org/model-1.5"]\ninput = 2\noutput = 0.5\n[broken]\ninput = -1\noutput = true\n'
    assert read_price(text, path, "org/model-1.5") == Price(2.0, 0.5)
    assert read_price(text, path, "org/model-1.5").cost(1_000_000, 2_000_000) == 3.0
    for model in ("broken", "other"):
        with pytest.raises(InputError, match="has no price of"):
            read_price(text, path, model)
    for text in (b"[", b"\xff"):
        with pytest.raises(InputError, match=r"cannot read the prices in .*prices.toml"):
            read_price(text, path, "x")


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (EndpointOptions, "thinking", "maybe"),
        (EndpointOptions, "retries", -1),
        (EndpointOptions, "timeout_s", float("nan")),
        (EndpointOptions, "max_tokens", True),
        (QuestionSelection, "limit", 0),
        (QuestionSelection, "families", "x"),
        (QuestionSelection, "shard", (1,)),
        (RunOptions, "concurrency", 65),
    ],
)
def test_a_value_that_the_declaration_excludes_is_refused(kind, name, value):
    with pytest.raises(InputError, match=r"^--[a-z-]+: ") as caught:
        kind(**{name: value})
    assert caught.value.field == name
