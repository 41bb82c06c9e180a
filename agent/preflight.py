"""Check a model's server before a run starts on it, each requirement by a small request.

    text      the model replies with text, and the reply ends by itself
    system    the server takes a system message, which every method sends
    schema    the server follows the declared response format
    picture   the model sees pictures: in which corner of four drawn pictures is the marked rectangle?
    panoramas, crops, plan, perception   the server takes the largest requests of the methods (`demands`), and the model
              sees all their pictures
    thinking  replies hold thinking where it is declared on, and none where it is declared off
    finish    replies state why they ended: without that a reply that was cut off looks like any other
    tokens    the server counts tokens (a warning: the run's counts would be 0)
    model     replies name the requested model (a warning: the name is recorded)

A request is a system and a user message, as those of the methods are, or a user message alone where the server refuses
the former. A server that follows JSON schemas and reads `schema.markers` passes. A fault is a warning that the run
records: a weak model is scored as well. Where faults are to refuse a run (`require`), a requirement of some methods is
no reason to refuse a run of another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from jrdb_avr.agent.demands import Demand, demands
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.decode import closed_object, reply_object
from jrdb_avr.agent.model.messages import Message, Part
from jrdb_avr.agent.model.probes import CORNER_LINE, CORNERS, CROP_SIZE, drawn_picture
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply, thought
from jrdb_avr.schema.errors import DecodeError, EndpointError

_LONGER_REMEDY: Final = "give a larger --max-tokens"
_SHAPE: Final = {"sea_state_q7": ["amber-41", "cobalt-17"]}
"""A key and its values that no prose and no habit would hold: a reply like it shows that the schema was followed."""

_SHAPE_SCHEMA: Final = closed_object({key: {"type": "string", "enum": values} for key, values in _SHAPE.items()})
_CORNER_SCHEMA: Final = closed_object({"corner": {"type": "string", "enum": list(CORNERS)}})
_SEEN_CORNERS: Final = 3
"""Corners that must be named right: a server that drops pictures gets four equal requests, and one right."""


@dataclass(frozen=True)
class Check:
    """The result of one check. `needed`: whether a run suffers from a failure. `methods`: the methods that need it,
    empty for all; a policy other than the model's is part of the name.
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
    """Send a server small requests and the largest ones. Raises EndpointError where it does not reply at all."""
    return list(_checks(client))


def require(checks: Sequence[Check], method: str | None = None) -> list[str]:
    """The lines of the failed checks.

    Raises EndpointError in one line for the first failed check that `method` needs (None: any method).
    """
    for check in checks:
        if check.needed and not check.passed and (method is None or not check.methods or method in check.methods):
            raise EndpointError(f"preflight: {check.line}")
    return [check.line for check in checks if not check.passed]


@dataclass(frozen=True)
class _Prober:
    """Sends requests with a system message where the server takes one."""

    client: Client
    system: bool = True

    def send(self, *parts: Part, schema: Mapping[str, Any] | None = None, system: str = "") -> Reply | EndpointError:
        """The reply to one user message, or the error in its place."""
        before = [Message("system", (system or render("preflight_system"),))] if self.system else []
        try:
            return self.client.probe([*before, Message("user", parts)], schema)
        except EndpointError as error:
            return error

    def read(self, reply: Reply | EndpointError) -> dict[str, Any] | EndpointError | DecodeError:
        """The JSON object of a reply, or the error in its place."""
        try:
            return reply if isinstance(reply, EndpointError) else reply_object(reply, self.client.convention)
        except DecodeError as error:
            cut = isinstance(reply, Reply) and reply.finish_reason == "length"
            return _CutOffError(str(error)) if cut else error


class _CutOffError(DecodeError):
    """A reply ended at the token limit: the fault is of neither the server nor the form."""


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
    for demand in demands():
        # Where one picture is not seen, many are not; and a schema is only refused where it is sent.
        if (picture.passed or not demand.shows) and (strict or demand.pictures):
            yield _demand(prober, demand)
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
    match prober.read(reply):
        case EndpointError() as error:
            client = prober.client
            if declared != "none" and client.options.thinks(client.convention):
                # llama.cpp takes no schema with a template whose thinking it cannot tell from the reply.
                remedy = f"declare --thinking off; else {remedy}"
            return Check("schema", False, f"{declared} is refused ({error})", remedy)
        case _CutOffError() as error:
            return Check("schema", False, str(error), _LONGER_REMEDY)
        case DecodeError() as error:
            return Check("schema", False, f"{declared} is not followed ({error})", remedy)
        case found:
            pairs = [(key, value in _SHAPE.get(key, ())) for key, value in found.items()]
            follows = declared != "json_schema" or pairs == [(key, True) for key in _SHAPE]
            seen = "followed" if follows else "ignored: another object came"
            return Check("schema", follows, f"{declared} is {seen}", remedy)


def _picture(prober: _Prober) -> Check:
    remedy = "serve a model that sees, and check that the server passes image_url parts on"
    right = 0
    for corner, box in CORNERS.items():
        parts = (render("preflight_picture"), drawn_picture(CROP_SIZE, box), CORNER_LINE)
        found = prober.read(prober.send(*parts, schema=_CORNER_SCHEMA))
        if isinstance(found, EndpointError):
            return Check("picture", False, f"a picture is refused ({found})", remedy)
        if isinstance(found, _CutOffError):
            return Check("picture", False, str(found), _LONGER_REMEDY)
        right += isinstance(found, dict) and found.get("corner") == corner
    seen = f"{right} of {len(CORNERS)} drawn pictures were seen right"
    return Check("picture", right >= _SEEN_CORNERS, seen, remedy)


def _demand(prober: _Prober, demand: Demand) -> Check:
    strict = prober.client.options.response_format == "json_schema"
    pictures, form = demand.pictures, demand.form
    for place in demand.places:
        found = prober.read(prober.send(*demand.parts(place), schema=demand.schema, system=demand.system))
        if isinstance(found, EndpointError):
            return _refused(prober, demand, found)
        if isinstance(found, _CutOffError):
            return Check(demand.name, False, f"{form.what}: {found}", _LONGER_REMEDY, strict, form.methods)
        named = demand.place_of(found) if isinstance(found, dict) else None
        if named is None:
            fault = found if isinstance(found, DecodeError) else "another object came"
            remedy = form.remedy if strict else "use a model that replies in the form of the prompt"
            seen = f"{form.what} is not followed ({fault})"
            return Check(demand.name, False, seen, _without(form.methods, remedy), strict, form.methods)
        if named == place:
            seen = f"{pictures.what}: taken and seen" if pictures else f"{form.what}: taken"
            return Check(demand.name, True, seen, "")
    assert pictures is not None, "without pictures the first place is named"
    seen = f"of {pictures.what} the one with the marked rectangle was not found"
    remedy = _without(pictures.methods, "check that the server passes every picture on, and in its size")
    # So many crops are no reason to refuse a run to a model that loses count: most questions need a few.
    return Check(demand.name, False, seen, remedy, demand.name == "panoramas", pictures.methods)


def _refused(prober: _Prober, demand: Demand, refusal: EndpointError) -> Check:
    """Find which of the two is refused, the number of pictures or the schema; both where each alone is taken."""
    parts = demand.parts(demand.places[0])
    sent = []
    if demand.pictures is not None:
        sent.append((demand.pictures, prober.send(*parts)))
    if prober.client.options.response_format == "json_schema":
        sent.append((demand.form, prober.send(parts[0], schema=demand.schema)))
    alone = [required for required, reply in sent if isinstance(reply, EndpointError)]
    refused = alone or [required for required, _ in sent]
    hurt = tuple(dict.fromkeys(method for required in refused for method in required.methods))
    seen = f"{' and '.join(required.what for required in refused)} refused ({refusal})"
    remedy = _without(hurt, "; ".join(required.remedy for required in refused))
    return Check(demand.name, False, seen, remedy, True, hurt)


def _without(methods: Sequence[str], remedy: str) -> str:
    return f"{remedy}; else do without {', '.join(methods)}"


def _thinking(client: Client, text: Reply, shaped: Reply | EndpointError) -> Check:
    declared = client.options.thinks(client.convention)
    free = bool(thought(text, client.convention))
    # The run's replies have a response format, which may keep a model from thinking.
    thinks = free if isinstance(shaped, EndpointError) else bool(thought(shaped, client.convention))
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
