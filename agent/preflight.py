"""Check a model's server before a run, by small requests and by the largest requests that methods send.

    text      the model replies with text, and the reply ends by itself
    system    the server takes a system message, which every method sends
    schema    the server follows the declared response format
    picture   the model sees pictures: it names the corner of the marked rectangle in four drawn pictures
    panoramas, crops   the server takes the largest number of pictures that a method sends, with the method's own
              schema, and the model finds the marked rectangle among them
    plan      the server takes the schema of a plan (only if schemas are sent)
    thinking  replies hold thinking if the options declare thinking on, and none if they declare thinking off
    finish    replies state why they ended, so that a reply that was cut off can be recognized
    tokens    the server counts tokens (a warning: the run's counts would be estimates)
    model     replies name the requested model (a warning: the run records the name)

By default, a failed check is only a warning in the manifest of the run, so that weak models are scored too. `require`
refuses a run only if the method of the run needs a check that failed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, get_args

from jrdb_avr.agent.methods.episode import BUDGET
from jrdb_avr.agent.methods.react import react_turn_schema
from jrdb_avr.agent.methods.requests import PANORAMAS, panorama_parts
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.decode import closed_object, reply_object
from jrdb_avr.agent.model.messages import Message, Part
from jrdb_avr.agent.model.options import ResponseFormat
from jrdb_avr.agent.model.probes import (
    CORNER_LINE,
    CORNERS,
    CROP_LINE,
    CROP_SIZE,
    PANORAMA_LINE,
    PANORAMA_SIZE,
    drawn_picture,
)
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply, thinking_text
from jrdb_avr.agent.model.schemas import MOST_LISTED, answer_schema, evidence_schema, frame_schema
from jrdb_avr.agent.reference.loop import LIMITS
from jrdb_avr.agent.reference.planning import plan_form
from jrdb_avr.agent.reference.tools import world_schema
from jrdb_avr.agent.reference.turns import look_schema
from jrdb_avr.schema.errors import DecodeError, EndpointError, RunStoppedError
from jrdb_avr.schema.method import DIAGNOSTIC, Panorama
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan

CROPS: Final = max(BUDGET, LIMITS.looks)
"""Number of crops in the request of the check `crops`, and of the largest request of a method with the usual budget."""

SENDERS: Final = {
    "panoramas": ("monolithic", "chain-of-thought", "search-recognize", "agent-passive", "agent-passive-no-world"),
    "crops": ("react", "agent-no-world", *DIAGNOSTIC),
    "plan": ("agent", "agent-passive"),
}
"""The methods that need a check, by name of the check."""

_LONGER_REMEDY: Final = "give a larger --max-tokens"
_KEY: Final = "sea_state_q7"
_VALUES: Final = ["amber-41", "cobalt-17"]
"""Values that no model would write by itself. A reply with such a value shows that the server enforces the schema."""

_KEY_SCHEMA: Final = closed_object({_KEY: {"type": "string", "enum": _VALUES}})
_CORNER_SCHEMA: Final = closed_object({"corner": {"type": "string", "enum": list(CORNERS)}})
_SEEN_CORNERS: Final = 3
"""Minimum number of right corners. If the server drops pictures, all four replies are equal, so only one is right."""


@dataclass(frozen=True)
class Check:
    """The result of one check.

    needed: whether a run needs the check. If not, a failed check is only a warning. methods: the methods that need the
    check. Empty means all methods.
    """

    name: str
    passed: bool
    result: str
    remedy: str
    needed: bool = True
    methods: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """The result of the check in one line."""
        return f"{self.name}: {self.result}" + ("" if self.passed else f": {self.remedy}")


def preflight(client: Client, crops: int = CROPS) -> list[Check]:
    """Check a server.

    Args:
        client: The client of the server.
        crops: Number of crops in the request of the check `crops`.

    Returns:
        The checks, in the order of their requests.

    Raises:
        EndpointError: If the server sends no reply.
        RunStoppedError: If the server refuses the key, if no credit is left, or if `max_cost` is spent.
    """
    return list(_checks(client, crops))


def require(checks: Sequence[Check], method: str | None = None) -> list[str]:
    """Refuse a server that a run cannot use.

    Args:
        checks: The checks of the server.
        method: The method of the run. If it is None, each needed check must have passed.

    Returns:
        One line for each failed check.

    Raises:
        EndpointError: If a check that the method needs has failed.
    """
    for check in checks:
        if check.needed and not check.passed and (method is None or not check.methods or method in check.methods):
            raise EndpointError(f"preflight: {check.line}")
    return [check.line for check in checks if not check.passed]


class _Probe(NamedTuple):
    """The result of a request.

    reply: the reply, None if the server refuses the request. value: the JSON object of the reply, empty if the reply
    cannot be read. fault: why the request was refused or the reply cannot be read, or "". remedy: the only remedy of
    the fault, or "" if several remedies may help.
    """

    reply: Reply | None
    value: Mapping[str, Any] = {}
    fault: str = ""
    remedy: str = ""


def _send(client: Client, system: bool, *parts: Part, schema: Mapping[str, Any] | None = None) -> _Probe:
    """Send a system message if `system` is true, and a user message. Return the result of the request."""
    before = [Message("system", (render("preflight_system"),))] if system else []
    try:
        reply = client.probe([*before, Message("user", parts)], schema)
    except RunStoppedError:
        raise
    except EndpointError as error:
        return _Probe(None, fault=f"refused ({error})")
    try:
        return _Probe(reply, reply_object(reply, client.convention))
    except DecodeError as error:
        # A reply that ends at the token limit is a fault of neither the server nor the schema.
        cut = reply.finish_reason == "length"
        return _Probe(reply, {}, str(error) if cut else f"not followed ({error})", _LONGER_REMEDY if cut else "")


def _checks(client: Client, crops: int) -> Iterator[Check]:
    text = client.probe([Message("user", (render("preflight_text"),))])
    yield _text(text)
    answered = _send(client, True, render("preflight_text"))
    system = answered.reply is not None
    send = functools.partial(_send, client, system)
    yield Check(
        "system",
        system,
        "a system message is " + ("taken" if system else answered.fault),
        "give the server a chat template that takes the system role: every method sends a system message",
    )
    strict = client.options.response_format == "json_schema"
    shaped = send(render("preflight_schema" if strict else "preflight_object"), schema=_KEY_SCHEMA)
    yield _schema(client, shaped)
    if strict and shaped.reply is None:
        # The server would refuse each further picture for the same reason.
        return
    picture = _picture(send)
    yield picture
    if picture.passed:
        yield from _many_pictures(send, crops)
    # A server can refuse a schema only if requests have one.
    if strict:
        content, keys = "the schema of a plan ($ref at the root)", set(Plan.__struct_fields__)
        probe = send(render("preflight_plan"), schema=plan_form())
        yield _largest_request("plan", content, probe, set(probe.value) == keys)
    yield _thinking(client, text, shaped.reply)
    yield Check(
        "finish",
        bool(text.finish_reason),
        f"finish_reason {text.finish_reason!a}"[:80],
        "use a server that sends finish_reason: without it a reply that was cut off looks like any other",
    )
    yield Check(
        "tokens",
        not text.estimated,
        "the server counts none" if text.estimated else f"{text.prompt_tokens} + {text.completion_tokens} tokens",
        "have the server send usage; until then the tokens and the costs of the run are estimates",
        needed=False,
    )
    yield Check(
        "model",
        text.model == client.model,
        f"the server names {text.model!a}"[:120],
        f"the request names {client.model!a}; the run records the server's name",
        needed=False,
    )


def _text(reply: Reply) -> Check:
    cut, content = reply.finish_reason == "length", reply.content.strip()
    remedy = "use a chat model that follows instructions"
    if cut or reply.reasoning:
        remedy = _LONGER_REMEDY if cut else f"switch thinking off at the server, or {_LONGER_REMEDY}"
    result = f"replied {content[:40]!a}" + (" after its reasoning" if reply.reasoning else "")
    return Check("text", bool(content) and not cut and not reply.refusal, result, remedy)


def _schema(client: Client, shaped: _Probe) -> Check:
    declared = client.options.response_format
    others = " or ".join(form for form in get_args(ResponseFormat) if form != declared)
    remedy = f"use a model and a server that keep to {declared}, or declare --response-format {others}"
    if shaped.reply is None and declared != "none" and client.options.thinks(client.convention):
        # If the template turns thinking on, llama.cpp refuses a schema unless it can separate thinking from the reply.
        remedy = f"declare --thinking off; else {remedy}"
    ignored = declared == "json_schema" and (list(shaped.value) != [_KEY] or shaped.value[_KEY] not in _VALUES)
    fault = shaped.fault or ("ignored: another object came" if ignored else "")
    return Check("schema", not fault, f"{declared} is {fault or 'followed'}", shaped.remedy or remedy)


def _picture(send: Callable[..., _Probe]) -> Check:
    remedy = "serve a model that sees, and check that the server passes image_url parts on"
    right = 0
    for corner, box in CORNERS.items():
        parts = (render("preflight_picture"), drawn_picture(CROP_SIZE, box), CORNER_LINE)
        probe = send(*parts, schema=_CORNER_SCHEMA)
        if probe.remedy or probe.reply is None:
            return Check("picture", False, f"a picture is {probe.fault}", probe.remedy or remedy)
        right += probe.value.get("corner") == corner
    result = f"{right} of {len(CORNERS)} drawn pictures were seen right"
    return Check("picture", right >= _SEEN_CORNERS, result, remedy)


def _many_pictures(send: Callable[..., _Probe], crops: int) -> Iterator[Check]:
    """Send one request with many panoramas and one request with many crops. Yield the check of each request.

    The marked picture is not at the ends, because a server may pass only the first or the last picture to the model.
    """
    frames = range(MOST_LISTED)
    answer = answer_schema("multiple_choice", tuple(map(str, range(1, PANORAMAS + 1))), frames)
    boxes = [Box(1500, 130, 180, 240) if n == 5 else None for n in range(1, PANORAMAS + 1)]
    drawn = [drawn_picture(PANORAMA_SIZE, box) for box in boxes]
    panoramas = [Panorama("drawn", n, float(n), picture.data) for n, picture in enumerate(drawn, 1)]
    pictures = iter(drawn)
    content = f"{PANORAMAS} panoramas in one request, with the schema of the agent's turns (anyOf in a list)"
    shown = (part if isinstance(part, str) else next(pictures) for part in panorama_parts(panoramas))
    probe = send(
        render("preflight_panoramas", n=PANORAMAS),
        *shown,
        PANORAMA_LINE,
        schema=world_schema(answer, (), look_schema(frames, advised=True)),
    )
    calls = probe.value.get("calls")
    last = calls[-1] if isinstance(calls, list) and calls else None
    yield _largest_request("panoramas", content, probe, isinstance(last, dict) and last.get("answer") == 5)
    marked = crops // 2 + 1
    content = f"{crops} crops in one request, with the schema of ReAct's turns (anyOf at the root)"
    parts: list[Part] = [render("preflight_crops", n=crops)]
    for n in range(1, crops + 1):
        box = CORNERS["upper left"] if n == marked else None
        parts += [f'Picture {n}: {{"frame_id": "{n:06d}"}}', drawn_picture(CROP_SIZE, box)]
    final = {"answer": answer, "evidence_bboxes": evidence_schema(frame_schema(frames))}
    probe = send(*parts, CROP_LINE, schema=react_turn_schema(frames, closed_object(final)))
    # A model that loses count among many crops can still answer, because most questions need only a few crops.
    right = probe.value.get("frame_id") == f"{marked:06d}"
    yield _largest_request("crops", content, probe, right, needed=bool(probe.fault))


def _largest_request(name: str, content: str, probe: _Probe, right: bool, needed: bool = True) -> Check:
    remedy = "use a model that replies in the form of the prompt"
    if probe.reply is None:
        remedy = "let the server take such requests (vLLM: --limit-mm-per-prompt), or declare --response-format none"
    remedy = probe.remedy or f"{remedy}; else do without {', '.join(SENDERS[name])}"
    result = f"{content}: {probe.fault or ('taken' if right else 'taken, but the reply is wrong')}"
    return Check(name, right, result, remedy, needed, SENDERS[name])


def _thinking(client: Client, text: Reply, shaped: Reply | None) -> Check:
    declared = client.options.thinks(client.convention)
    free = bool(thinking_text(text, client.convention))
    # The response format of a run's requests may keep a model from thinking.
    thinks = free if shaped is None else bool(thinking_text(shaped, client.convention))
    if declared is None:
        return Check("thinking", True, "nothing is declared", "")
    result = "declared " + ("on" if declared else "off")
    result += ", and there" if thinks else ", there in free text alone" if free else ", none there"
    remedy = "declare --thinking off, or give the server a reasoning parser and a template that thinks"
    if not declared:
        remedy = "switch it off at the server, or declare --thinking on"
    elif free:
        remedy = "the response format keeps the model from thinking: declare --thinking off, or --response-format none"
    return Check("thinking", thinks == declared, result, remedy)
