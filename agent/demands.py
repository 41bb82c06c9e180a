"""The largest requests that the methods make of a server, small enough to be tried out before a run.

    panoramas   as many panoramas as a fixed context holds, the reference agent's own turn schema (`anyOf` in a list)
    crops       as many crops as a look budget allows, ReAct's own turn schema (`anyOf` at the root)
    plan        the plan's own schema (`$ref` at the root)

Of the pictures one shows a marked rectangle, and the reply is a turn that says which: neither the first nor the last,
so that a server that passes only one of them on is found out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from jrdb_avr.schema.method import Panorama, Question

from .drawn import corner_picture, drawn_panorama, plain_crop
from .messages import Part
from .panoramas import PANORAMAS, panorama_parts
from .prompt import render
from .react import BUDGET, turn_schema
from .reference.episode import LOOK_SCHEMA
from .reference.limits import LIMITS
from .reference.planning import plan_form
from .reference.remembering import graph_turn_schema

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
