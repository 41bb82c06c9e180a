"""What must hold of a server before a run is started on it, each asked for by a small request.

    text      the model replies with text, and the reply ends by itself
    schema    the response format that is declared is kept to
    picture   pictures are seen: where in four drawn pictures is the marked rectangle?
    panoramas, crops, plan   the largest requests of the methods are taken, and all of their pictures seen (`demands`)
    thinking  replies hold thinking where it is declared on, and none where it is declared off
    finish    replies say why they ended: without that a reply that was cut off looks like any other
    tokens    tokens are counted (a warning: the run's counts would be 0)
    model     the model is named, and is the one asked for (a warning: the name is recorded)

Every request is one user message. Whoever keeps to JSON schemas and reads `schema.marks` passes. What only
some methods need is no reason to refuse a run of another.

The largest requests that the methods make of a server, small enough to be tried out before a run.

    panoramas   as many panoramas as a fixed context holds, the reference agent's own turn schema (`anyOf` in a list)
    crops       as many crops as a look budget allows, ReAct's own turn schema (`anyOf` at the root)
    plan        the plan's own schema (`$ref` at the root)

Of the pictures one shows a marked rectangle, and the reply is a turn that says which: neither the first nor the last,
so that a server that passes only one of them on is found out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from jrdb_avr.agent.methods.attempt import PANORAMAS, panorama_parts
from jrdb_avr.agent.methods.react import BUDGET, turn_schema
from jrdb_avr.agent.model.calibrate import CORNERS, corner_picture, drawn_panorama, plain_crop
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.decode import closed_object, reply_object
from jrdb_avr.agent.model.messages import Message, Part
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply, thought
from jrdb_avr.agent.reference.episode import LOOK_SCHEMA
from jrdb_avr.agent.reference.graph_memory import graph_turn_schema
from jrdb_avr.agent.reference.limits import LIMITS
from jrdb_avr.agent.reference.planning import plan_form
from jrdb_avr.schema.errors import DecodeError, EndpointError
from jrdb_avr.schema.method import Panorama, Question

CROPS: Final = max(BUDGET, LIMITS.looks)
"""Crops in one request at most: ReAct and a chat show all of them, and all looks may be made in one turn."""

PANORAMA_LINE: Final = "The panorama's number, as one JSON object:"
CROP_LINE: Final = "The picture's frame, as one JSON object:"

FIXED_CONTEXT: Final = (
    "monolithic",
    "chain-of-thought",
    "search-recognize",
    "agent-passive",
    "agent-passive-no-world",
)
"""The methods that send `PANORAMAS` panoramas at once."""

LOOKING: Final = ("react", "agent", "agent-no-world")
"""Those that may send `CROPS` crops at once."""

AGENTS: Final = ("agent", "agent-passive", "agent-no-world", "agent-passive-no-world")
PLANNING: Final = ("agent", "agent-passive")

_FRAME_STEP: Final = 15
"""Frames between two pictures: of no meaning but to give each its own frame id."""

PLAN: Final = {
    "root": "a",
    "target": "a",
    "times": {"t0": {"frame": 0}},
    "nodes": [{"id": "a", "conditions": [{"action": "sitting", "at": "t0"}]}],
    "edges": [],
    "answer": {"mode": "multiple_choice", "read": "action", "of": "a", "at": "t0"},
}
"""The plan that is asked for by its own words."""


@dataclass(frozen=True)
class Demand:
    """A request that some methods make.

    shown, kept: what is sent and which schema, in words, and `senders`, `keepers` the methods that suffer where the
    server refuses the one or the other; no pictures and no senders where there is none. parts: the message for each
    place at which the marked rectangle may be; places: those that are tried, until one is told right. told: what a
    reply says, None where it is none of the schema's; it is `place`, or for a request without pictures `places[0]`.
    """

    name: str
    shown: str
    kept: str
    parts: Callable[[int], tuple[Part, ...]]
    places: tuple[int, ...]
    schema: Mapping[str, Any]
    told: Callable[[Mapping[str, Any]], int | None]
    senders: tuple[str, ...]
    keepers: tuple[str, ...]


@cache
def demands() -> tuple[Demand, ...]:
    """Those of the methods, in the order in which a server is asked."""
    question = Question("", "", "", "", "", tuple(map(str, range(1, PANORAMAS + 1))), "multiple_choice")
    return (
        Demand(
            "panoramas",
            f"{PANORAMAS} panoramas in one request",
            "the reference agent's turn schema (anyOf in a list)",
            panoramas_request,
            (5, 3),
            graph_turn_schema(question, ("a", "b"), LOOK_SCHEMA),
            _number,
            FIXED_CONTEXT,
            AGENTS,
        ),
        Demand(
            "crops",
            f"{CROPS} crops in one request",
            "ReAct's turn schema (anyOf at the root)",
            crops_request,
            (14, 9),
            turn_schema(question),
            _crop,
            LOOKING,
            ("react",),
        ),
        Demand(
            "plan", "", "the plan's schema ($ref at the root)", plan_request, (0,), plan_form(), _plan, (), PLANNING
        ),
    )


def panoramas_request(place: int) -> tuple[Part, ...]:
    """Panoramas as a fixed context holds them, the one numbered `place`, from 1, with the marked rectangle."""
    shown = [
        Panorama("drawn", frame, f"{frame:06d}", float(number), drawn_panorama(number == place).data)
        for number in range(1, PANORAMAS + 1)
        for frame in [number * _FRAME_STEP]
    ]
    return (render("preflight_panoramas", n=PANORAMAS), *panorama_parts(shown), PANORAMA_LINE)


def crops_request(place: int) -> tuple[Part, ...]:
    """Crops, the one numbered `place`, from 1, with the marked rectangle."""
    parts: list[Part] = [render("preflight_crops", n=CROPS)]
    for number in range(1, CROPS + 1):
        line = f'Picture {number}: {{"frame_id": "{number * _FRAME_STEP:06d}"}}'
        parts += [line, corner_picture("upper left") if number == place else plain_crop()]
    return (*parts, CROP_LINE)


def plan_request(place: int) -> tuple[Part, ...]:
    """A plan, to be said again."""
    return (render("preflight_plan", plan=_json(PLAN)),)


def _number(reply: Mapping[str, Any]) -> int | None:
    match reply:
        case {"calls": [*_, {"tool": "final_answer", "answer": int(number)}]} if not isinstance(number, bool):
            return number
        case {"calls": [{"tool": str()}, *_]}:
            return 0
    return None


def _crop(reply: Mapping[str, Any]) -> int | None:
    match reply:
        case {"action": "observe", "frame_id": str(frame)} if frame.isascii() and frame.isdigit():
            return int(frame[:6]) // _FRAME_STEP
        case {"action": "answer"}:
            return 0
    return None


def _plan(reply: Mapping[str, Any]) -> int | None:
    return 0 if set(reply) == set(PLAN) else None


def _json(value: object) -> str:
    import msgspec

    return msgspec.json.encode(value).decode()


SHAPE_SCHEMA: Final = closed_object({"sea_state_q7": {"type": "string", "enum": ["amber-41", "cobalt-17"]}})
"""What no prose and no habit would hold: a reply like it shows that the schema was kept to."""

CORNER_SCHEMA: Final = closed_object({"corner": {"type": "string", "enum": list(CORNERS)}})

CORNER_LINE: Final = "The corner, as one JSON object:"

SEEN_CORNERS: Final = 3
"""Of the four corners, those that must be named right: a server that drops pictures gets the same request four times,
and one right."""


_PICTURE_REMEDY: Final = "let the server take so many pictures and so long a request (vLLM: --limit-mm-per-prompt)"
_SCHEMA_REMEDY: Final = "use a server that keeps to such schemas, or declare --response-format json_object or none"


@dataclass(frozen=True)
class Check:
    """One thing that was looked at. `needed`: a run is refused where it fails; else it is a warning. `methods`: those
    that need it, all where there are none.
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
    """Ask a server for small things and for the largest. Raises EndpointError where it does not answer at all."""
    return list(_checks(client))


def require(checks: Sequence[Check], method: str | None = None) -> list[str]:
    """The warnings. Raises EndpointError in one line for the first needed check that failed, of those that `method`
    needs (None: any).
    """
    for check in checks:
        if check.needed and not check.passed and (method is None or not check.methods or method in check.methods):
            raise EndpointError(f"preflight: {check.line}")
    return [check.line for check in checks if not check.passed]


def _checks(client: Client) -> Iterator[Check]:
    text = client.probe(_message(render("preflight_text")))
    yield _text(client, text)
    shaped = _asked(client, *_shape_request(client))
    yield _schema(client, shaped)
    if client.options.response_format == "json_schema" and isinstance(shaped, EndpointError):
        # Each picture would be refused for the same reason.
        return
    picture = _picture(client, [_asked(client, *_corner_request(corner)) for corner in CORNERS])
    yield picture
    for demand in demands():
        # Where one picture is not seen, many are not; and a schema is only refused where it is sent.
        if picture.passed if demand.senders else client.options.response_format == "json_schema":
            yield _demand(client, demand)
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


def _demand(client: Client, demand: Demand) -> Check:
    strict = client.options.response_format == "json_schema"
    what = demand.shown or demand.kept
    for place in demand.places:
        reply = _asked(client, _message(*demand.parts(place)), demand.schema)
        if isinstance(reply, EndpointError):
            return _refused(client, demand, reply)
        try:
            told = demand.told(reply_object(reply, client.convention))
            fault = "another object came" if told is None else ""
        except DecodeError as error:
            told, fault = None, str(error)
        if fault:
            remedy = _without(
                demand.keepers, _SCHEMA_REMEDY if strict else "use a model that replies in the form asked"
            )
            return Check(demand.name, False, f"{demand.kept} is not kept to ({fault})", remedy, strict, demand.keepers)
        if told == place:
            return Check(demand.name, True, f"{what}: taken" + (" and seen" if demand.senders else ""), "")
    seen = f"of {demand.shown} the one with the marked rectangle was not found"
    remedy = _without(demand.senders, "check that the server passes every picture on, and in its size")
    # So many crops are no reason to refuse a run to a model that loses count: most questions need a few.
    return Check(demand.name, False, seen, remedy, demand.name == "panoramas", demand.senders)


def _refused(client: Client, demand: Demand, refusal: EndpointError) -> Check:
    """Which of the two is refused: so many pictures, or the schema. Where either alone is taken, both are blamed."""
    parts = demand.parts(demand.places[0])
    strict, many = client.options.response_format == "json_schema", bool(demand.senders)
    schema = strict and isinstance(_asked(client, _message(parts[0]), demand.schema), EndpointError)
    pictures = many and isinstance(_asked(client, _message(*parts)), EndpointError)
    if not (schema or pictures):
        schema, pictures = strict, many
    refused = [
        *([(demand.shown, _PICTURE_REMEDY, demand.senders)] if pictures else ()),
        *([(demand.kept, _SCHEMA_REMEDY, demand.keepers)] if schema else ()),
    ]
    what, remedies, methods = zip(*refused, strict=True)
    hurt = tuple(dict.fromkeys(method for some in methods for method in some))
    seen = f"{' and '.join(what)} refused ({refusal})"
    return Check(demand.name, False, seen, _without(hurt, "; ".join(remedies)), True, hurt)


def _without(methods: Sequence[str], remedy: str) -> str:
    return f"{remedy}; else do without {', '.join(methods)}"


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


def _asked(
    client: Client, messages: Sequence[Message], schema: Mapping[str, Any] | None = None
) -> Reply | EndpointError:
    try:
        return client.probe(messages, schema)
    except EndpointError as error:
        return error


def _message(*parts: Part) -> list[Message]:
    return [Message("user", parts)]
