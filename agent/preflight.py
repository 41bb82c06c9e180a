"""Check a model's server before a run starts on it, each requirement by a small request.

    text      the model replies with text, and the reply ends by itself
    schema    the server follows the declared response format
    picture   the model sees pictures: in which corner of four drawn pictures is the marked rectangle?
    panoramas, crops, plan   the server takes the largest requests of the methods, and the model sees all their pictures
    thinking  replies hold thinking where it is declared on, and none where it is declared off
    finish    replies state why they ended: without that a reply that was cut off looks like any other
    tokens    the server counts tokens (a warning: the run's counts would be 0)
    model     replies name the requested model (a warning: the name is recorded)

The largest requests:

    panoramas   as many panoramas as a fixed context holds, the reference agent's own turn schema (`anyOf` in a list)
    crops       as many crops as a look budget allows, ReAct's own turn schema (`anyOf` at the root)
    plan        the plan's own schema (`$ref` at the root)

One of their pictures shows a marked rectangle, and the reply is a turn that names it: neither the first nor the last,
so that a server that passes only one of them on is found out. Every request is one user message. A server that follows
JSON schemas and reads `schema.markers` passes. A requirement of some methods is no reason to refuse a run of another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple

from jrdb_avr.agent.methods.attempt import PANORAMAS, panorama_parts
from jrdb_avr.agent.methods.episode import BUDGET
from jrdb_avr.agent.methods.react import react_turn_schema
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
from jrdb_avr.agent.model.reply import Reply, thought
from jrdb_avr.agent.reference.episode import LIMITS
from jrdb_avr.agent.reference.graph_memory import graph_turn_schema
from jrdb_avr.agent.reference.planning import plan_form
from jrdb_avr.agent.reference.tool_calls import LOOK_SCHEMA
from jrdb_avr.schema.errors import DecodeError, EndpointError
from jrdb_avr.schema.method import Panorama, Question
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan

CROPS: Final = max(BUDGET, LIMITS.looks)
"""Most crops in one request: ReAct and a chat show all of them, and all looks may be made in one turn."""

FIXED_CONTEXT: Final = ("monolithic", "chain-of-thought", "search-recognize", "agent-passive", "agent-passive-no-world")
"""The methods that send `PANORAMAS` panoramas at once."""

LOOKING: Final = ("react", "agent", "agent-no-world")
"""The methods that may send `CROPS` crops at once."""

AGENTS: Final = ("agent", "agent-passive", "agent-no-world", "agent-passive-no-world")
PLANNING: Final = ("agent", "agent-passive")

_IN_PANORAMA: Final = Box(1500, 130, 180, 240)
_FRAME_STEP: Final = 15
"""Frames between two pictures, which only give each picture its own frame id."""

_FRAMES: Final = tuple((number, number * _FRAME_STEP) for number in range(1, CROPS + 1))
"""Number and frame of each picture of a request."""

_SHAPE: Final = {"sea_state_q7": ["amber-41", "cobalt-17"]}
"""A key and its values that no prose and no habit would hold: a reply like it shows that the schema was followed."""

_SHAPE_SCHEMA: Final = closed_object({key: {"type": "string", "enum": values} for key, values in _SHAPE.items()})
_CORNER_SCHEMA: Final = closed_object({"corner": {"type": "string", "enum": list(CORNERS)}})
_SEEN_CORNERS: Final = 3
"""Corners that must be named right: a server that drops pictures gets four equal requests, and one right."""

_PICTURE_REMEDY: Final = "let the server take so many pictures and so long a request (vLLM: --limit-mm-per-prompt)"
_SCHEMA_REMEDY: Final = "use a server that keeps to such schemas, or declare --response-format json_object or none"


class Requirement(NamedTuple):
    """What a request requires of a server, in words; the methods that suffer where it is refused; what helps then."""

    what: str
    methods: tuple[str, ...]
    remedy: str


@dataclass(frozen=True)
class Demand:
    """A largest request of some methods.

    pictures, form: what it requires by its pictures, None without any, and by its schema. parts: the message for each
    place at which the marked rectangle may be; places: those that are tried until one is named right. place_of: the
    place that a reply names, None where the reply does not follow the schema; without pictures it is `places[0]`.
    """

    name: str
    pictures: Requirement | None
    form: Requirement
    parts: Callable[[int], tuple[Part, ...]]
    places: tuple[int, ...]
    schema: Mapping[str, Any]
    place_of: Callable[[Mapping[str, Any]], int | None]


@cache
def demands() -> tuple[Demand, ...]:
    """The largest requests of all methods, in the order in which they are sent."""
    question = Question("", "", "", "", "", tuple(map(str, range(1, PANORAMAS + 1))), "multiple_choice")
    return (
        Demand(
            "panoramas",
            Requirement(f"{PANORAMAS} panoramas in one request", FIXED_CONTEXT, _PICTURE_REMEDY),
            Requirement("the reference agent's turn schema (anyOf in a list)", AGENTS, _SCHEMA_REMEDY),
            _panoramas_request,
            (5, 3),
            graph_turn_schema(question, ("a", "b"), LOOK_SCHEMA),
            _named_panorama,
        ),
        Demand(
            "crops",
            Requirement(f"{CROPS} crops in one request", LOOKING, _PICTURE_REMEDY),
            Requirement("ReAct's turn schema (anyOf at the root)", ("react",), _SCHEMA_REMEDY),
            _crops_request,
            (14, 9),
            react_turn_schema(question),
            _named_crop,
        ),
        Demand(
            "plan",
            None,
            Requirement("the plan's schema ($ref at the root)", PLANNING, _SCHEMA_REMEDY),
            lambda _: (render("preflight_plan"),),
            (0,),
            plan_form(),
            lambda reply: 0 if set(reply) == set(Plan.__struct_fields__) else None,
        ),
    )


def _panoramas_request(place: int) -> tuple[Part, ...]:
    """Panoramas as a fixed context holds them, the one numbered `place`, from 1, with the marked rectangle."""
    boxes = {place: _IN_PANORAMA}
    panoramas = [
        Panorama("drawn", frame, f"{frame:06d}", float(number), drawn_picture(PANORAMA_SIZE, boxes.get(number)).data)
        for number, frame in _FRAMES[:PANORAMAS]
    ]
    return (render("preflight_panoramas", n=PANORAMAS), *panorama_parts(panoramas), PANORAMA_LINE)


def _crops_request(place: int) -> tuple[Part, ...]:
    """Crops, the one numbered `place`, from 1, with the marked rectangle."""
    boxes = {place: CORNERS["upper left"]}
    parts: list[Part] = [render("preflight_crops", n=CROPS)]
    for number, frame in _FRAMES[:CROPS]:
        parts += [f'Picture {number}: {{"frame_id": "{frame:06d}"}}', drawn_picture(CROP_SIZE, boxes.get(number))]
    return (*parts, CROP_LINE)


def _named_panorama(reply: Mapping[str, Any]) -> int | None:
    match reply:
        case {"calls": [*_, {"tool": "final_answer", "answer": int(number)}]} if not isinstance(number, bool):
            return number
        case {"calls": [{"tool": str()}, *_]}:
            return 0
    return None


def _named_crop(reply: Mapping[str, Any]) -> int | None:
    match reply:
        case {"action": "observe", "frame_id": str(frame)} if frame.isascii() and frame.isdigit():
            return int(frame[:6]) // _FRAME_STEP
        case {"action": "answer"}:
            return 0
    return None


# -- the checks -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Check:
    """The result of one check. `needed`: a failure refuses a run; else it is a warning. `methods`: the methods that
    need it, empty for all.
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
    """The warnings of the checks.

    Raises EndpointError in one line for the first failed check that `method` needs (None: any method).
    """
    for check in checks:
        if check.needed and not check.passed and (method is None or not check.methods or method in check.methods):
            raise EndpointError(f"preflight: {check.line}")
    return [check.line for check in checks if not check.passed]


def _checks(client: Client) -> Iterator[Check]:
    text = client.probe([Message("user", (render("preflight_text"),))])
    yield _text(client, text)
    strict = client.options.response_format == "json_schema"
    shaped = _probe(client, render("preflight_schema" if strict else "preflight_object"), schema=_SHAPE_SCHEMA)
    yield _schema(client, shaped)
    if strict and isinstance(shaped, EndpointError):
        # Each picture would be refused for the same reason.
        return
    picture = _picture(client)
    yield picture
    for demand in demands():
        # Where one picture is not seen, many are not; and a schema is only refused where it is sent.
        if picture.passed if demand.pictures else strict:
            yield _demand(client, demand)
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
        return Check("text", False, f"no word within {most} tokens", "give a larger --max-tokens")
    if reply.content.strip() and not reply.refusal:
        return Check("text", True, f"replied {reply.content.strip()[:40]!a}", "")
    if reply.reasoning:
        return Check("text", False, "nothing but reasoning", "switch thinking off, or give a larger --max-tokens")
    return Check("text", False, "an empty or refused reply", "use a chat model that follows instructions")


def _schema(client: Client, reply: Reply | EndpointError) -> Check:
    declared = client.options.response_format
    remedy = {
        "json_schema": "use a server that keeps to response_format json_schema, or declare --response-format "
        "json_object or none",
        "json_object": "declare --response-format none, or use a model that replies in JSON",
        "none": "use a model that replies in JSON, or declare --response-format json_schema",
    }[declared]
    match _object(client, reply):
        case EndpointError() as error:
            return Check("schema", False, f"{declared} is refused ({error})", remedy)
        case DecodeError() as error:
            return Check("schema", False, f"{declared} is not followed ({error})", remedy)
        case found:
            pairs = [(key, value in _SHAPE.get(key, ())) for key, value in found.items()]
            follows = declared != "json_schema" or pairs == [(key, True) for key in _SHAPE]
            seen = "followed" if follows else "ignored: another object came"
            return Check("schema", follows, f"{declared} is {seen}", remedy)


def _picture(client: Client) -> Check:
    remedy = "serve a model that sees, and check that the server passes image_url parts on"
    right = 0
    for corner, box in CORNERS.items():
        parts = (render("preflight_picture"), drawn_picture(CROP_SIZE, box), CORNER_LINE)
        found = _object(client, _probe(client, *parts, schema=_CORNER_SCHEMA))
        if isinstance(found, EndpointError):
            return Check("picture", False, f"a picture is refused ({found})", remedy)
        right += isinstance(found, dict) and found.get("corner") == corner
    seen = f"{right} of {len(CORNERS)} drawn pictures were seen right"
    return Check("picture", right >= _SEEN_CORNERS, seen, remedy)


def _demand(client: Client, demand: Demand) -> Check:
    strict = client.options.response_format == "json_schema"
    pictures, form = demand.pictures, demand.form
    for place in demand.places:
        found = _object(client, _probe(client, *demand.parts(place), schema=demand.schema))
        if isinstance(found, EndpointError):
            return _refused(client, demand, found)
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


def _refused(client: Client, demand: Demand, refusal: EndpointError) -> Check:
    """Find which of the two is refused, the number of pictures or the schema; both where each alone is taken."""
    parts = demand.parts(demand.places[0])
    sent = []
    if demand.pictures is not None:
        sent.append((demand.pictures, _probe(client, *parts)))
    if client.options.response_format == "json_schema":
        sent.append((demand.form, _probe(client, parts[0], schema=demand.schema)))
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
    replies = [text] if isinstance(shaped, EndpointError) else [text, shaped]
    thinks = [bool(thought(reply, client.convention)) for reply in replies]
    if declared is None:
        return Check("thinking", True, f"replies hold {'' if any(thinks) else 'no '}thinking; nothing is declared", "")
    if not declared:
        seen = "declared off, " + ("but there" if any(thinks) else "none there")
        return Check("thinking", not any(thinks), seen, "switch it off at the server, or declare --thinking on")
    # The run's replies have a response format, which may keep a model from thinking.
    remedy = "declare --thinking off, or give the server a reasoning parser and a template that thinks"
    return Check("thinking", thinks[-1], "declared on, " + ("and there" if thinks[-1] else "but not there"), remedy)


def _probe(client: Client, *parts: Part, schema: Mapping[str, Any] | None = None) -> Reply | EndpointError:
    """The reply to one user message, or the error in its place."""
    try:
        return client.probe([Message("user", parts)], schema)
    except EndpointError as error:
        return error


def _object(client: Client, reply: Reply | EndpointError) -> dict[str, Any] | EndpointError | DecodeError:
    """The JSON object of a reply, or the error in its place."""
    try:
        return reply if isinstance(reply, EndpointError) else reply_object(reply, client.convention)
    except DecodeError as error:
        return error
