"""What must hold of a server before a run is started on it, each asked for by a small request.

    text      the model replies with text, and the reply ends by itself
    schema    the response format that is declared is kept to
    picture   pictures are seen: where in four drawn pictures is the marked rectangle?
    thinking  replies hold thinking where it is declared on, and none where it is declared off
    finish    replies say why they ended: without that a reply that was cut off looks like any other
    tokens    tokens are counted (a warning: the run's counts would be 0)
    model     the model is named, and is the one asked for (a warning: the name is recorded)

Every request is one user message. Whoever keeps to JSON schemas and reads `schema.marks` passes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.schema.errors import DecodeError, EndpointError

from .client import Client
from .decode import closed_object, reply_object
from .drawn import CORNERS, corner_picture
from .messages import Message, Part
from .prompt import render
from .replies import Reply, thought

SHAPE_SCHEMA: Final = closed_object({"sea_state_q7": {"type": "string", "enum": ["amber-41", "cobalt-17"]}})
"""What no prose and no habit would hold: a reply like it shows that the schema was kept to."""

CORNER_SCHEMA: Final = closed_object({"corner": {"type": "string", "enum": list(CORNERS)}})

CORNER_LINE: Final = "The corner, as one JSON object:"

SEEN_CORNERS: Final = 3
"""Of the four corners, those that must be named right: a server that drops pictures gets the same request four times,
and one right."""


@dataclass(frozen=True)
class Check:
    """One thing that was looked at. `needed`: a run is refused where it fails; else it is a warning."""

    name: str
    passed: bool
    seen: str
    remedy: str
    needed: bool = True

    @property
    def line(self) -> str:
        """The check in one line."""
        return f"{self.name}: {self.seen}" + ("" if self.passed else f": {self.remedy}")


def preflight(client: Client) -> list[Check]:
    """Ask a server seven small things. Raises EndpointError where it does not answer at all."""
    return list(_checks(client))


def require(checks: Sequence[Check]) -> list[str]:
    """The warnings. Raises EndpointError in one line for the first needed check that failed."""
    for check in checks:
        if check.needed and not check.passed:
            raise EndpointError(f"preflight: {check.line}")
    return [check.line for check in checks if not check.passed]


def _checks(client: Client) -> Iterator[Check]:
    text = client.ask(_message(render("preflight_text")))
    yield _text(client, text)
    shaped = _asked(client, *_shape_request(client))
    yield _schema(client, shaped)
    if client.options.response_format == "json_schema" and isinstance(shaped, EndpointError):
        # Each picture would be refused for the same reason.
        return
    yield _picture(client, [_asked(client, *_corner_request(corner)) for corner in CORNERS])
    yield _thinking(client, text, shaped)
    yield Check(
        "finish",
        bool(text.finish_reason),
        f"finish_reason {text.finish_reason!a}"[:80] if text.finish_reason else "no finish_reason",
        "use a server that sends finish_reason: without it a reply that was cut off cannot be told",
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
        f"it was asked for {client.model!a}; the name given is recorded with the run",
        needed=False,
    )


def _text(client: Client, reply: Reply) -> Check:
    if reply.finish_reason == "length":
        most = client.options.max_tokens
        return Check("text", False, f"one word was not told within {most} tokens", "give a larger --max-tokens")
    said = bool(reply.content.strip()) and not reply.refusal
    seen = f"replied {reply.content.strip()[:40]!a}" if said else "an empty or refused reply"
    if not said and reply.reasoning:
        return Check("text", False, "nothing but reasoning", "switch thinking off, or give a larger --max-tokens")
    return Check("text", said, seen, "use a chat model that follows instructions")


def _shape_request(client: Client) -> tuple[list[Message], Mapping[str, Any]]:
    prompt = "preflight_schema" if client.options.response_format == "json_schema" else "preflight_object"
    return _message(render(prompt)), SHAPE_SCHEMA


def _schema(client: Client, reply: Reply | EndpointError) -> Check:
    declared = client.options.response_format
    remedy = {
        "json_schema": "use a server that keeps to response_format json_schema, or declare --response-format "
        "json_object or none",
        "json_object": "declare --response-format none, or use a model that replies in JSON",
        "none": "use a model that replies in JSON, or declare --response-format json_schema",
    }[declared]
    if isinstance(reply, EndpointError):
        return Check("schema", False, f"{declared} is refused ({reply})", remedy)
    try:
        found = reply_object(reply, client.convention)
    except DecodeError as error:
        return Check("schema", False, f"{declared} is not kept to ({error})", remedy)
    kept = declared != "json_schema" or (
        list(found) == ["sea_state_q7"] and found["sea_state_q7"] in ("amber-41", "cobalt-17")
    )
    return Check("schema", kept, f"{declared} is " + ("kept to" if kept else "ignored: another object came"), remedy)


def _corner_request(corner: str) -> tuple[list[Message], Mapping[str, Any]]:
    return _message(render("preflight_picture"), corner_picture(corner), CORNER_LINE), CORNER_SCHEMA


def _picture(client: Client, replies: Sequence[Reply | EndpointError]) -> Check:
    remedy = "serve a model that sees, and check that the server passes image_url parts on"
    refused = next((reply for reply in replies if isinstance(reply, EndpointError)), None)
    if refused is not None:
        return Check("picture", False, f"a picture is refused ({refused})", remedy)
    right = sum(
        _corner(client, reply) == corner
        for corner, reply in zip(CORNERS, replies, strict=True)
        if isinstance(reply, Reply)
    )
    seen = f"{right} of {len(CORNERS)} drawn pictures were seen right"
    return Check("picture", right >= SEEN_CORNERS, seen, remedy)


def _corner(client: Client, reply: Reply) -> object:
    try:
        return reply_object(reply, client.convention).get("corner")
    except DecodeError:
        return None


def _thinking(client: Client, text: Reply, shaped: Reply | EndpointError) -> Check:
    declared = client.options.thinks(client.convention)
    replies = [text] if isinstance(shaped, EndpointError) else [text, shaped]
    thinks = [bool(thought(reply, client.convention)) for reply in replies]
    if declared is None:
        return Check("thinking", True, f"replies hold {'' if any(thinks) else 'no '}thinking; nothing is declared", "")
    if not declared:
        remedy = "switch it off at the server, or declare --thinking on"
        return Check(
            "thinking", not any(thinks), "declared off, " + ("but there" if any(thinks) else "none there"), remedy
        )
    # The run's replies have a response format, which may keep a model from thinking.
    remedy = "declare --thinking off, or give the server a reasoning parser and a template that thinks"
    return Check("thinking", thinks[-1], "declared on, " + ("and there" if thinks[-1] else "but not there"), remedy)


def _asked(client: Client, messages: Sequence[Message], schema: Mapping[str, Any]) -> Reply | EndpointError:
    try:
        return client.ask(messages, schema)
    except EndpointError as error:
        return error


def _message(*parts: Part) -> list[Message]:
    return [Message("user", parts)]
