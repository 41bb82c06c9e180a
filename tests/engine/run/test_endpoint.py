"""Connecting: what a run is told of its server, and what it is refused for."""

import json

import pytest
from fake_server import FakeServer, completion, sound, texts

from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.engine.run.endpoint import Endpoint, serving
from jrdb_avr.engine.run.run import check_manifest
from jrdb_avr.queries.runs import RunManifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import EndpointError, StoreError

ASK = [Message("user", ("hello",))]


def test_what_a_run_is_told(tmp_path):
    with FakeServer(sound(lambda request, n: "hi"), version=b'{"version": "0.12.0"}') as server:
        endpoint = Endpoint(None, "fake", server.url, EndpointOptions(max_tokens=99), tmp_path / "calls.jsonl")
        assert endpoint.client.complete(ASK).content == "hi"
        assert endpoint.client.complete(ASK).content == "hi"
        assert sum(texts(request) == "hello" for request in server.requests) == 1
    assert endpoint.convention == CONTRACT
    assert endpoint.served == "fake"
    assert endpoint.warnings == []
    settings = endpoint.settings
    assert json.loads(json.dumps(settings)) == settings
    assert settings["served_model"] == "fake"
    assert settings["server_version"] == "0.12.0"
    assert settings["endpoint"]["max_tokens"] == 99
    assert settings["endpoint"]["temperature"] == 0
    assert settings["convention"] == CONTRACT.settings()
    assert not settings["convention"]["calibrated"]
    kept = (tmp_path / "calls.jsonl").read_text().split()
    assert len(kept) == 1, "nothing of the preflight is kept"


def test_a_run_is_resumed_with_a_server_that_once_did_not_tell_its_version(tmp_path):
    store = Store(tmp_path)

    def terms(version, model="fake", lines=()):
        settings = {"server_version": version, "served_model": model, "preflight": lines}
        return RunManifest("r", "react", "fake", "0", (), False, settings, "")

    check_manifest(store, terms(""))
    check_manifest(store, terms("0.12.0"))
    check_manifest(store, terms("", lines=["picture: 2 of 4 drawn pictures were seen right"]))
    with pytest.raises(StoreError, match="differs in the served model"):
        check_manifest(store, terms("", ""))
    (tmp_path / "runs" / "r" / "run.json").unlink()
    check_manifest(store, terms("0.12.0"))
    with pytest.raises(StoreError, match="differs in the server version"):
        check_manifest(store, terms("0.13.0"))


def test_the_declared_convention_goes_with_the_model():
    with FakeServer(sound(lambda request, n: "hi", model="Qwen/Qwen3.5-9B")) as server:
        endpoint = Endpoint(None, "Qwen/Qwen3.5-9B", server.url)
    assert endpoint.convention.name == "qwen3.5"
    assert endpoint.settings["endpoint"]["chat_template_kwargs"] == {"enable_thinking": False}
    assert all(request["chat_template_kwargs"] == {"enable_thinking": False} for request in server.requests)


def test_a_change_of_model_while_it_is_asked_is_said():
    with FakeServer(sound(lambda request, n: completion("hi", model=["fake", "other\x1b[2J"][n]))) as server:
        endpoint = Endpoint(None, "fake", server.url)
        assert endpoint.client.complete(ASK)
        assert endpoint.changed() == []
        assert endpoint.client.complete(ASK)
        (line,) = endpoint.changed()
    assert "'fake'" in line and "'other" in line
    assert line.isprintable()


def test_estimated_tokens_are_said_at_the_end():
    with FakeServer(sound(lambda request, n: {**completion("hi", model="fake"), "usage": {}})) as server:
        endpoint = Endpoint(None, "fake", server.url)
        assert endpoint.client.complete(ASK).estimated
    assert endpoint.changed() == ["the server counted no tokens in 1 replies: tokens and costs are estimates"]


def test_another_model_than_asked_is_a_warning():
    with FakeServer(sound(lambda request, n: "hi", model="fake-AWQ")) as server:
        endpoint = Endpoint(None, "fake", server.url)
    assert endpoint.served == "fake-AWQ"
    (warning,) = endpoint.warnings
    assert "fake-AWQ" in warning


def test_a_server_that_fails_a_check_is_warned_of_and_refused_only_where_it_is_wanted():
    with FakeServer(lambda request, n: "I would rather talk.") as server:
        endpoint = Endpoint(None, "fake", server.url)
        with pytest.raises(EndpointError) as caught:
            Endpoint(None, "fake", server.url, strict=True)
    assert endpoint.warnings[0].startswith("schema: json_schema is not followed")
    assert endpoint.settings["preflight"] == endpoint.warnings
    assert str(caught.value).startswith("preflight: schema: json_schema is not followed")


def test_no_address_is_an_address_of_the_marker_alone():
    with serving("fake", "http://localhost:1/v1") as url:
        assert url == "http://localhost:1/v1"
    with pytest.raises(EndpointError, match="--base-url"), serving("fake", None):
        pass
