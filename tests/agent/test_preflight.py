"""Preflight: a server is spoiled in one way at a time, and the one check that is about it fails, with a remedy."""

import json

import pytest
from click.testing import CliRunner
from fake_server import FakeServer, Status, completion, images, schema_of, seeing, texts

from jrdb_avr.agent.methods.requests import PANORAMAS
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.prices import Price
from jrdb_avr.agent.preflight import CROPS, SENDERS, preflight, require
from jrdb_avr.agent.simulated.server import simulated_server
from jrdb_avr.engine.cli import group
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.methods import METHODS
from jrdb_avr.engine.run.options import EvaluateOptions, MethodOptions, QuestionSelection
from jrdb_avr.schema.errors import EndpointError, RunStoppedError
from jrdb_avr.schema.method import DIAGNOSTIC

NAMES = ["text", "system", "schema", "picture", "panoramas", "crops", "plan", "thinking"]
NAMES += ["finish", "tokens", "model"]


def checks(script, model="fake", **options):
    with FakeServer(script) as server:
        client = Client(
            server.url, model, EndpointOptions(**options), convention=convention_of(model), pause=lambda s: None
        )
        found = preflight(client)
    return {check.name: check for check in found}, server


def failed(found):
    return [name for name, check in found.items() if not check.passed]


def changed(change):
    """A sound server whose replies go through `change(request, reply)`."""
    return lambda request, n: change(request, seeing(request, model=request["model"]))


def said(text, **message):
    """Of the one check that asks for a word."""
    return lambda q, r: completion(text, model=q["model"], **message) if texts(q).endswith("one word: ready") else r


@pytest.mark.parametrize("response_format", ["json_schema", "json_object", "none"])
def test_a_sound_server_passes(response_format):
    found, server = checks(seeing, response_format=response_format)
    strict = response_format == "json_schema"
    assert list(found) == [name for name in NAMES if strict or name != "plan"]
    assert failed(found) == []
    assert require(list(found.values())) == []
    assert len(server.requests) == 9 + strict
    assert [len(images(request)) for request in server.requests[3:9]] == [1, 1, 1, 1, PANORAMAS, CROPS]
    roles = [[message["role"] for message in request["messages"]] for request in server.requests]
    assert roles == [["user"], *[["system", "user"]] * (len(roles) - 1)]
    formats = sum("response_format" in request for request in server.requests)
    assert formats == {"json_schema": 8, "json_object": 7, "none": 0}[response_format]


@pytest.mark.parametrize(
    ("method", "options", "crops"),
    [
        ("react", MethodOptions(looks=48), 48),
        ("react", MethodOptions(looks=8), 8),
        ("agent-no-world", MethodOptions(history=1), 1),
        ("agent-no-world", MethodOptions(looks=30, history=40), 30),
        ("monolithic", MethodOptions(), CROPS),
    ],
)
def test_a_run_checks_as_many_crops_as_it_can_send(store, method, options, crops):
    with FakeServer(seeing) as server:
        endpoint = EndpointOptions(base_url=server.url)
        chosen = QuestionSelection(limit=1)
        evaluate(store, method, "fake", EvaluateOptions(endpoint=endpoint, selection=chosen, method=options))
    assert len(images(server.requests[8])) == crops


def is_picture(request):
    return bool(images(request))


def is_schema(request):
    return "prose" in texts(request)


def dropping_pictures(request, reply):
    """It never sees one, so it says the same of each."""
    return completion('{"corner": "lower left"}', model=request["model"]) if is_picture(request) else reply


def prose(request, reply):
    return completion("The sea is grey.", model=request["model"]) if is_schema(request) else reply


def habit(request, reply):
    return completion('{"text": "The sea is grey."}', model=request["model"]) if is_schema(request) else reply


def half_the_schema(request, reply):
    """The key without its values: some servers keep to properties and not to enums."""
    if not is_schema(request):
        return reply
    (key,) = schema_of(request)["required"]
    return completion(json.dumps({key: "The sea is grey."}), model=request["model"])


def no_finish_reason(request, reply):
    reply["choices"][0]["finish_reason"] = None
    return reply


def no_usage(request, reply):
    del reply["usage"]
    return reply


def other_model(request, reply):
    return {**reply, "model": "fake-AWQ"}


def no_model(request, reply):
    del reply["model"]
    return reply


def thinking(opening="<think>", closing="</think>", words="The user wants it."):
    def change(request, reply):
        text = reply["choices"][0]["message"]["content"]
        reply["choices"][0]["message"]["content"] = f"{opening}{words}{closing}\n{text}"
        return reply

    return change


def reasoning(field):
    def change(request, reply):
        reply["choices"][0]["message"][field] = "The user wants it."
        return reply

    return change


@pytest.mark.parametrize(
    ("change", "check", "remedy"),
    [
        (said(""), "text", "chat model"),
        (said("I cannot.", refusal="no"), "text", "chat model"),
        (said("re", finish_reason="length"), "text", "--max-tokens"),
        (said("", reasoning="hm, ready"), "text", "switch thinking off"),
        (prose, "schema", "--response-format"),
        (habit, "schema", "--response-format"),
        (half_the_schema, "schema", "--response-format"),
        (dropping_pictures, "picture", "a model that sees"),
        (thinking(), "thinking", "--thinking on"),
        (thinking(opening=""), "thinking", "--thinking on"),
        (thinking("<|channel>thought", "<channel|>"), "thinking", "--thinking on"),
        (reasoning("reasoning"), "thinking", "--thinking on"),
        (reasoning("reasoning_content"), "thinking", "--thinking on"),
        (no_finish_reason, "finish", "finish_reason"),
    ],
)
def test_a_server_that_is_refused(change, check, remedy):
    found, _ = checks(changed(change))
    assert failed(found)[0] == check
    assert len(failed(found)) == 1 or "reasoning" in found["text"].result, "where it only thinks, that is told as well"
    with pytest.raises(EndpointError) as caught:
        require(list(found.values()))
    line = str(caught.value)
    assert line.startswith(f"preflight: {check}: ")
    assert remedy in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("change", "check"),
    [(no_usage, "tokens"), (other_model, "model"), (no_model, "model")],
    ids=lambda v: getattr(v, "__name__", v),
)
def test_a_server_that_is_only_warned_of(change, check):
    found, _ = checks(changed(change))
    assert failed(found) == [check]
    (warning,) = require(list(found.values()))
    assert warning.startswith(f"{check}: ")


def test_a_spent_cost_is_not_blamed_on_the_pictures():
    """The fourth request is the first with a picture. Each costs 20 dollars."""
    with pytest.raises(RunStoppedError, match=r"^the calls have cost 60 dollars, and --max-cost is 60"):
        checks(seeing, price=Price(2e6, 0.0), max_cost=60.0)


def test_an_empty_block_is_no_thinking():
    found, _ = checks(changed(thinking(words="\n\n")))
    assert failed(found) == []


@pytest.mark.parametrize(
    ("model", "declared", "thinks", "passes"),
    [
        ("gemma-4-e4b", "on", True, True),
        ("gemma-4-e4b", "on", False, False),
        ("gemma-4-e4b", "off", True, False),
        ("gemma-4-e4b", "template", True, False),
        ("gemma-4-e4b", "template", False, True),
        ("qwen3.5-9b", "template", True, True),
        ("qwen3.5-9b", "template", False, False),
        ("qwen3.5-9b", "off", False, True),
        ("fake", "template", True, True),
        ("fake", "template", False, True),
        ("fake", "on", False, False),
    ],
)
def test_thinking_is_as_declared(model, declared, thinks, passes):
    gemma = model.startswith("gemma")
    think = thinking(*(("<|channel>thought\n", "<channel|>") if gemma else ("<think>", "</think>")))
    found, _ = checks(changed(think if thinks else lambda request, reply: reply), model, thinking=declared)
    assert found["thinking"].passed == passes
    assert failed(found) == ([] if passes else ["thinking"])


def test_a_format_without_thinking_is_what_is_declared_off():
    """Its free text alone thinks. What helps where thinking is declared on ends in a server that passes."""
    script = changed(lambda q, r: r if "response_format" in q else thinking()(q, r))
    assert failed(checks(script, "fake", thinking="off")[0]) == []
    found, _ = checks(script, "fake", thinking="on")
    assert failed(found) == ["thinking"]
    assert "--thinking off, or --response-format none" in found["thinking"].remedy
    assert failed(checks(script, "fake", thinking="on", response_format="none")[0]) == []


def test_a_server_that_takes_no_schema_from_a_model_that_thinks():
    """As llama.cpp does where it cannot tell the template's thinking from the reply: its grammar fits neither."""

    def script(request, n):
        thinks = request.get("chat_template_kwargs", {}).get("enable_thinking", True)
        no = thinks and "response_format" in request
        return Status(400, "Failed to initialize samplers") if no else seeing(request, model="qwen3.5-9b")

    found, _ = checks(script, "qwen3.5-9b", thinking="on")
    assert failed(found) == ["schema"] and "--thinking off" in found["schema"].remedy
    assert failed(checks(script, "qwen3.5-9b", thinking="off")[0]) == []
    found, _ = checks(refuses("sea_state_q7"))
    assert "--thinking" not in found["schema"].remedy


@pytest.mark.parametrize(("cut", "name"), [("prose", "schema"), ("The corner", "picture"), ('"root"', "plan")])
def test_a_reply_that_was_cut_off_is_not_blamed_on_the_server(cut, name):
    found, _ = checks(changed(lambda q, r: completion('{"a', "length", "fake") if cut in texts(q) else r))
    assert failed(found) == [name]
    assert "cut off" in found[name].result and found[name].remedy == "give a larger --max-tokens"


def test_a_chat_template_without_a_system_role():
    """As some templates refuse it: each question of a run would end in this error."""

    def script(request, n):
        no = request["messages"][0]["role"] == "system"
        return Status(400, "System role not supported") if no else seeing(request)

    found, _ = checks(script)
    assert failed(found) == ["system"]
    assert "System role not supported" in found["system"].result
    with pytest.raises(EndpointError, match="chat template"):
        require(list(found.values()), "monolithic")


def test_a_server_without_json_schema_is_refused_at_once():
    def script(request, n):
        return Status(400, "response_format is not supported") if "response_format" in request else seeing(request)

    found, server = checks(script)
    assert failed(found) == ["schema"]
    assert len(server.requests) == 3, "each picture would be refused for the same reason"
    with pytest.raises(EndpointError, match="--response-format json_object"):
        require(list(found.values()))
    found, _ = checks(script, response_format="none")
    assert failed(found) == []


def test_a_server_that_takes_no_pictures():
    found, _ = checks(lambda request, n: Status(400, "no images") if is_picture(request) else seeing(request))
    assert failed(found) == ["picture"]
    assert "no images" in found["picture"].result


def test_one_corner_may_be_missed():
    def one_wrong(request, n):
        reply = seeing(request)
        return completion('{"corner": "upper left"}') if "lower right" in json.dumps(reply) else reply

    found, _ = checks(one_wrong)
    assert found["picture"].passed
    assert "3 of 4" in found["picture"].result


@pytest.mark.parametrize("corner", ["left", 5, None, ["upper left"]])
def test_junk_for_a_corner_is_a_wrong_one(corner):
    found, _ = checks(lambda q, n: completion(json.dumps({"corner": corner})) if is_picture(q) else seeing(q))
    assert failed(found) == ["picture"]


def test_a_server_that_does_not_answer():
    with pytest.raises(EndpointError, match=r"HTTP 500"):
        checks(lambda request, n: Status(500))


# -- the largest requests of the methods ------------------------------------------------------------------------------


def takes(most):
    """Refuses more pictures than so many in one request, as vLLM does."""
    no = Status(400, f"At most {most} image(s) may be provided in one request.")
    return lambda request, n: no if len(images(request)) > most else seeing(request)


def takes_bytes(most):
    """Behind a proxy that bounds requests."""
    no = Status(413, "Request Entity Too Large")
    return lambda request, n: no if len(json.dumps(request)) > most else seeing(request)


def refuses(*words):
    """Schemas that hold one of these words anywhere."""

    def script(request, n):
        sent = json.dumps(request.get("response_format"))
        return Status(400, "schema not supported") if any(f'"{word}"' in sent for word in words) else seeing(request)

    return script


def plain_roots(request, n):
    shape = schema_of(request)
    return Status(400, "root must be an object") if shape and shape.get("type") != "object" else seeing(request)


def passing_on(kept):
    """Pictures beyond those of the places `kept` are dropped on the way, without a word."""

    def script(request, n):
        messages = []
        for message in request["messages"]:
            parts = message["content"]
            if not isinstance(parts, str):
                shown = [part for part in parts if part["type"] == "image_url"]
                parts = [part for part in parts if part["type"] == "text" or any(part is one for one in shown[kept])]
            messages.append({**message, "content": parts})
        return seeing({**request, "messages": messages})

    return script


def dull(request, n):
    """Another object, whatever the schema."""
    return completion('{"answer": 5}') if '"anyOf"' in json.dumps(request) else seeing(request)


PANORAMAS_CROPS, ALL = ["panoramas", "crops"], ["panoramas", "crops", "plan"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "refused"),
    [
        (takes(1), PANORAMAS_CROPS),
        (takes(PANORAMAS - 1), PANORAMAS_CROPS),
        (takes(PANORAMAS), ["crops"]),
        (takes(CROPS - 1), ["crops"]),
        (takes(CROPS), []),
        (takes_bytes(1 << 20), ["panoramas"]),
        (refuses("anyOf"), ALL),
        (refuses("$ref"), ["plan"]),
        (plain_roots, ["crops", "plan"]),
        (passing_on(slice(1)), ["panoramas"]),
        (passing_on(slice(-1, None)), ["panoramas"]),
        (dull, ["panoramas", "plan"]),
    ],
)
def test_a_server_that_the_largest_requests_are_too_much_for(script, refused):
    """It is refused in one line that names the methods that would suffer, and a run of any other is not."""
    found, _ = checks(script)
    checked = list(found.values())
    assert [name for name in failed(found) if found[name].needed] == refused
    for method in {*METHODS, *(method for methods in SENDERS.values() for method in methods)}:
        needs = [name for name in refused if method in SENDERS[name]]
        if not needs:
            require(checked, method)
            continue
        with pytest.raises(EndpointError) as caught:
            require(checked, method)
        line = str(caught.value)
        assert line.startswith(f"preflight: {needs[0]}: ")
        assert "\n" not in line and "do without " in line
        assert method in line.rpartition("do without ")[2].split(", ")


def test_a_model_that_loses_count_among_many_crops_is_only_warned_of():
    found, _ = checks(passing_on(slice(6)))
    assert failed(found) == ["crops"]
    (warning,) = require(list(found.values()))
    assert warning.startswith("crops: 24 crops in one request")


def test_every_method_has_its_largest_request_tried():
    senders = [*SENDERS["panoramas"], *SENDERS["crops"]]
    # The agent with a world model sends the pictures of one turn at most.
    assert sorted([*senders, "agent"]) == sorted([*METHODS, *DIAGNOSTIC])


# -- the command ------------------------------------------------------------------------------------------------------


def run(server, *more):
    arguments = ["preflight", "--model", "fake", "--base-url", server.url, *more]
    return CliRunner().invoke(group, arguments)


def test_the_command_tells_every_check():
    with FakeServer(seeing) as server:
        table = run(server)
        rows = json.loads(run(server, "--json").stdout)
    assert table.exit_code == 0
    assert [row["check"] for row in rows] == NAMES
    assert all(row["passed"] and row["remedy"] == "" for row in rows)
    for name in NAMES:
        assert name in table.output


def test_the_command_fails_in_one_line():
    with FakeServer(changed(prose)) as server:
        result = run(server, "--json")
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith("jrdb-avr: preflight: schema: ")
    assert [row["check"] for row in json.loads(result.stdout) if not row["passed"]] == ["schema"]


@pytest.mark.parametrize("seconds", ["nan", "0", "inf", "soon"])
def test_a_timeout_that_is_none_is_a_usage_error(seconds):
    arguments = ["preflight", "--model", "x", "--base-url", "http://localhost:1/v1", "--timeout", seconds]
    result = CliRunner().invoke(group, arguments)
    assert result.exit_code == 2
    assert "--timeout" in result.stderr


def test_a_hostile_server_cannot_move_the_cursor():
    with FakeServer(changed(said("\x1b[2Jready\x9b31m", refusal=None))) as server:
        result = run(server)
    assert "\x1b" not in result.output and "\x9b" not in result.output


# -- the simulated model ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        ({}, []),
        ({"response_format": "json_object"}, []),
        ({"response_format": "none"}, []),
        ({"thinking": "on"}, ["thinking"]),
    ],
)
def test_the_simulated_model_passes_by_references(options, wrong):
    with simulated_server(None, None) as url:
        found = preflight(Client(url, "simulated", EndpointOptions(simulated=True, **options)))
    assert [check.name for check in found if not check.passed] == wrong
