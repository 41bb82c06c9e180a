"""Check a model's server before a run with a series of small requests and the largest ones.

    text      the model replies with text, and the reply ends by itself
    system    the server takes a system message, which every method sends
    schema    the server follows the declared response format
    picture   the model sees pictures: it names the corner of the marked rectangle in four drawn pictures
    panoramas, crops   the server takes the largest number of pictures that a method sends, with the method's own
              schema, and the model finds the marked rectangle among them
    plan      the server takes the schema of a plan (only if schemas are sent)
    thinking  replies hold thinking if it is declared on, and none if it is declared off
    finish    replies state why they ended: a reply that was cut off must not look like any other
    tokens    the server counts tokens (a warning: the run's counts would be 0)
    model     replies name the requested model (a warning: the run records the name)

A failed check is a warning that the run records, because a weak model is scored as well. `require` refuses a run for a
failed check only if the run's method needs it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

from jrdb_avr.agent.methods.episode import BUDGET
from jrdb_avr.agent.methods.react import react_turn_schema
from jrdb_avr.agent.methods.requests import PANORAMAS, panorama_parts
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.decode import closed_object, reply_object
from jrdb_avr.agent.model.messages import Message, Part
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
from jrdb_avr.agent.reference.episode import LIMITS
from jrdb_avr.agent.reference.graph_memory import graph_turn_schema
from jrdb_avr.agent.reference.planning import plan_form
from jrdb_avr.agent.reference.tool_calls import LOOK_SCHEMA
from jrdb_avr.schema.errors import DecodeError, EndpointError
from jrdb_avr.schema.method import Panorama, Question
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan

CROPS: Final = max(BUDGET, LIMITS.looks)
"""Maximum number of crops in one request."""

SENDERS: Final = {
    "panoramas": ("monolithic", "chain-of-thought", "search-recognize", "agent-passive", "agent-passive-no-world"),
    "crops": ("react", "agent-model", "agent-no-world-model"),
    "plan": ("agent-model", "agent-passive", "agent", "agent-no-world", "agent-guided", "agent-no-world-guided"),
}
"""The methods that need each of the largest requests. A policy other than the method's own is part of the name."""

_LONGER_REMEDY: Final = "give a larger --max-tokens"
_SHAPE: Final = {"sea_state_q7": ["amber-41", "cobalt-17"]}
"""A key and its values that no model would write by itself: such a reply shows that the schema was followed."""

_SHAPE_SCHEMA: Final = closed_object({key: {"type": "string", "enum": values} for key, values in _SHAPE.items()})
_CORNER_SCHEMA: Final = closed_object({"corner": {"type": "string", "enum": list(CORNERS)}})
_SEEN_CORNERS: Final = 3
"""Minimum of corners to name right. A server that drops pictures gets four equal requests, so one reply is right."""


@dataclass(frozen=True)
class Check:
    """The result of one check.

    needed: whether a run suffers if the check fails. methods: the methods that need it, empty for all.
    """

    name: str
    passed: bool
    seen: str
    remedy: str
    needed: bool = True
    methods: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """The check in one line."""
        return f"{self.name}: {self.seen}" + ("" if self.passed else f": {self.remedy}")


def preflight(client: Client) -> list[Check]:
    """Check a server.

    Args:
        client: The client of the server.

    Returns:
        The checks, in the order of their requests.

    Raises:
        EndpointError: The server does not reply at all.
    """
    return list(_checks(client))


def require(checks: Sequence[Check], method: str | None = None) -> list[str]:
    """Refuse a server that a run cannot use.

    Args:
        checks: The checks of the server.
        method: The run's method; None stands for any.

    Returns:
        The lines of the failed checks.

    Raises:
        EndpointError: The method needs a check that failed.
    """
    for check in checks:
        if check.needed and not check.passed and (method is None or not check.methods or method in check.methods):
            raise EndpointError(f"preflight: {check.line}")
    return [check.line for check in checks if not check.passed]


@dataclass(frozen=True)
class _Prober:
    """Sends requests, with a system message if the server takes one."""

    client: Client
    system: bool = True

    def send(self, *parts: Part, schema: Mapping[str, Any] | None = None) -> Reply | EndpointError:
        """Send one user message. Return the reply or the error."""
        before = [Message("system", (render("preflight_system"),))] if self.system else []
        try:
            return self.client.probe([*before, Message("user", parts)], schema)
        except EndpointError as error:
            return error

    def read(self, reply: Reply | EndpointError) -> dict[str, Any] | _Fault:
        """Read the JSON object of a reply. Return the object or the fault."""
        if isinstance(reply, EndpointError):
            return _Fault(f"refused ({reply})")
        try:
            return reply_object(reply, self.client.convention)
        except DecodeError as error:
            # A reply that ends at the token limit is a fault of neither the server nor the schema.
            cut = reply.finish_reason == "length"
            return _Fault(str(error), _LONGER_REMEDY) if cut else _Fault(f"not followed ({error})")


class _Fault(NamedTuple):
    """The fault of a reply in words, and its remedy if only one can help."""

    seen: str
    remedy: str = ""


def _checks(client: Client) -> Iterator[Check]:
    text = client.probe([Message("user", (render("preflight_text"),))])
    yield _text(client, text)
    prober = _Prober(client)
    answered = prober.send(render("preflight_text"))
    prober = replace(prober, system=isinstance(answered, Reply))
    yield Check(
        "system",
        prober.system,
        "a system message is " + ("taken" if prober.system else f"refused ({answered})"),
        "give the server a chat template that takes the system role: every method sends a system message",
    )
    strict = client.options.response_format == "json_schema"
    shaped = prober.send(render("preflight_schema" if strict else "preflight_object"), schema=_SHAPE_SCHEMA)
    yield _schema(prober, shaped)
    if strict and isinstance(shaped, EndpointError):
        # Each picture would be refused for the same reason.
        return
    picture = _picture(prober)
    yield picture
    yield from _largest_requests(prober, picture.passed, strict)
    yield _thinking(client, text, shaped)
    yield Check(
        "finish",
        bool(text.finish_reason),
        f"finish_reason {text.finish_reason!a}"[:80] if text.finish_reason else "no finish_reason",
        "use a server that sends finish_reason: without it a reply that was cut off looks like any other",
    )
    counted = text.prompt_tokens > 0 and text.completion_tokens > 0
    yield Check(
        "tokens",
        counted,
        f"{text.prompt_tokens} + {text.completion_tokens} tokens" if counted else "no token counts",
        "have the server send usage; until then the run counts 0 tokens",
        needed=False,
    )
    yield Check(
        "model",
        text.model == client.model,
        f"the server names {text.model!a}"[:120] if text.model else "the server names no model",
        f"the request names {client.model!a}; the run records the server's name",
        needed=False,
    )


def _text(client: Client, reply: Reply) -> Check:
    if reply.finish_reason == "length":
        most = client.options.max_tokens
        return Check("text", False, f"no word within {most} tokens", _LONGER_REMEDY)
    if reply.content.strip() and not reply.refusal:
        return Check("text", True, f"replied {reply.content.strip()[:40]!a}", "")
    if reply.reasoning:
        where = " at the server" if client.options.thinking == "off" else ""
        return Check("text", False, "nothing but reasoning", f"switch thinking off{where}, or {_LONGER_REMEDY}")
    return Check("text", False, "an empty or refused reply", "use a chat model that follows instructions")


def _schema(prober: _Prober, reply: Reply | EndpointError) -> Check:
    declared = prober.client.options.response_format
    remedy = {
        "json_schema": "use a server that keeps to response_format json_schema, or declare --response-format "
        "json_object or none",
        "json_object": "declare --response-format none, or use a model that replies in JSON",
        "none": "use a model that replies in JSON, or declare --response-format json_schema",
    }[declared]
    client, read = prober.client, prober.read(reply)
    if isinstance(read, _Fault):
        if isinstance(reply, EndpointError) and declared != "none" and client.options.thinks(client.convention):
            # llama.cpp refuses a schema if it cannot separate the template's thinking from the reply.
            remedy = f"declare --thinking off; else {remedy}"
        return Check("schema", False, f"{declared} is {read.seen}", read.remedy or remedy)
    pairs = [(key, value in _SHAPE.get(key, ())) for key, value in read.items()]
    follows = declared != "json_schema" or pairs == [(key, True) for key in _SHAPE]
    return Check(
        "schema", follows, f"{declared} is {'followed' if follows else 'ignored: another object came'}", remedy
    )


def _picture(prober: _Prober) -> Check:
    remedy = "serve a model that sees, and check that the server passes image_url parts on"
    right = 0
    for corner, box in CORNERS.items():
        parts = (render("preflight_picture"), drawn_picture(CROP_SIZE, box), CORNER_LINE)
        reply = prober.send(*parts, schema=_CORNER_SCHEMA)
        read = prober.read(reply)
        if isinstance(read, _Fault) and (read.remedy or isinstance(reply, EndpointError)):
            return Check("picture", False, f"a picture is {read.seen}", read.remedy or remedy)
        right += isinstance(read, dict) and read.get("corner") == corner
    seen = f"{right} of {len(CORNERS)} drawn pictures were seen right"
    return Check("picture", right >= _SEEN_CORNERS, seen, remedy)


def _largest_requests(prober: _Prober, sees: bool, strict: bool) -> Iterator[Check]:
    question = Question("", "", "", tuple(map(str, range(1, PANORAMAS + 1))), "multiple_choice")
    # A model that does not see one picture does not see many. The marked one is neither the first nor the last, because
    # a server may pass only one of them on.
    if sees:
        panoramas = [
            Panorama("drawn", n, f"{n:06d}", float(n), drawn_picture(PANORAMA_SIZE, box).data)
            for n in range(1, PANORAMAS + 1)
            for box in [Box(1500, 130, 180, 240) if n == 5 else None]
        ]
        yield _largest_request(
            prober,
            "panoramas",
            f"{PANORAMAS} panoramas in one request, with the schema of the agent's turns (anyOf in a list)",
            (render("preflight_panoramas", n=PANORAMAS), *panorama_parts(panoramas), PANORAMA_LINE),
            graph_turn_schema(question, ("a", "b"), LOOK_SCHEMA),
            lambda reply: _last_answer(reply) == 5,
        )
        crops: list[Part] = []
        for n in range(1, CROPS + 1):
            box = CORNERS["upper left"] if n == 14 else None
            crops += [f'Picture {n}: {{"frame_id": "{n:06d}"}}', drawn_picture(CROP_SIZE, box)]
        yield _largest_request(
            prober,
            "crops",
            f"{CROPS} crops in one request, with the schema of ReAct's turns (anyOf at the root)",
            (render("preflight_crops", n=CROPS), *crops, CROP_LINE),
            react_turn_schema(question),
            lambda reply: reply.get("frame_id") == "000014",
        )
    # A schema is refused only if it is sent.
    if strict:
        content, parts, keys = (
            "the schema of a plan ($ref at the root)",
            (render("preflight_plan"),),
            Plan.__struct_fields__,
        )
        yield _largest_request(prober, "plan", content, parts, plan_form(), lambda reply: set(reply) == set(keys))


def _last_answer(reply: Mapping[str, Any]) -> object:
    match reply:
        case {"calls": [*_, {"answer": answer}]}:
            return answer
    return None


def _largest_request(
    prober: _Prober,
    name: str,
    content: str,
    parts: Sequence[Part],
    schema: Mapping[str, Any],
    is_right: Callable[[Mapping[str, Any]], bool],
) -> Check:
    reply, methods = prober.send(*parts, schema=schema), SENDERS[name]
    read = prober.read(reply)
    if isinstance(read, dict) and is_right(read):
        return Check(name, True, f"{content}: taken", "")
    remedy = "use a model that replies in the form of the prompt"
    if isinstance(reply, EndpointError):
        remedy = "let the server take such requests (vLLM: --limit-mm-per-prompt), or declare --response-format none"
    fault = read if isinstance(read, _Fault) else _Fault("taken, but the reply is wrong")
    remedy = fault.remedy or f"{remedy}; else do without {', '.join(methods)}"
    # A model that loses count among many crops can still answer: most questions need a few.
    needed = name != "crops" or isinstance(read, _Fault)
    return Check(name, False, f"{content}: {fault.seen}", remedy, needed, methods)


def _thinking(client: Client, text: Reply, shaped: Reply | EndpointError) -> Check:
    declared = client.options.thinks(client.convention)
    free = bool(thinking_text(text, client.convention))
    # The run's replies have a response format, which may keep a model from thinking.
    thinks = free if isinstance(shaped, EndpointError) else bool(thinking_text(shaped, client.convention))
    kept = free and not thinks
    if declared is None:
        seen = f"replies hold {'' if free or thinks else 'no '}thinking; nothing is declared"
        return Check("thinking", True, seen, "")
    if not declared:
        seen = "declared off, " + ("but there" if thinks else "there in free text alone" if kept else "none there")
        return Check("thinking", not thinks, seen, "switch it off at the server, or declare --thinking on")
    remedy = "declare --thinking off, or give the server a reasoning parser and a template that thinks"
    if kept:
        remedy = "the response format keeps the model from thinking: declare --thinking off, or --response-format none"
    return Check("thinking", thinks, "declared on, " + ("and there" if thinks else "but not there"), remedy)
