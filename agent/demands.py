"""The largest requests of the methods, by which a server is checked before a run.

    panoramas   as many panoramas as a fixed context holds, the reference agent's own turn schema (`anyOf` in a list)
    crops       as many crops as a look budget allows, ReAct's own turn schema (`anyOf` at the root)
    plan        the plan's own schema (`$ref` at the root)
    perception  one crop and the prompt and schema of the policy `driven` (labels, statements, relations, metres, words)

One of their pictures shows a marked rectangle, and the reply is a turn that names it: neither the first nor the last,
so that a server that passes only one of them on is found out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple

from jrdb_avr.agent.methods.attempt import PANORAMAS, panorama_parts
from jrdb_avr.agent.methods.episode import BUDGET
from jrdb_avr.agent.methods.react import react_turn_schema
from jrdb_avr.agent.model.messages import Part, Picture
from jrdb_avr.agent.model.probes import (
    CORNERS,
    CROP_LINE,
    CROP_SIZE,
    PANORAMA_LINE,
    PANORAMA_SIZE,
    drawn_picture,
)
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.reference.episode import LIMITS
from jrdb_avr.agent.reference.graph_memory import graph_turn_schema
from jrdb_avr.agent.reference.perceive import PEOPLE_LINE, Field, field_line, perceive_prompt, perceive_schema
from jrdb_avr.agent.reference.planning import plan_form
from jrdb_avr.agent.reference.tool_calls import LOOK_SCHEMA
from jrdb_avr.schema.method import Panorama, Question
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import SAME_GROUP

CROPS: Final = max(BUDGET, LIMITS.looks)
"""Most crops in one request: ReAct and a chat show all of them, and all looks may be made in one turn."""

FIXED_CONTEXT: Final = ("monolithic", "chain-of-thought", "search-recognize", "agent-passive", "agent-passive-no-world")
"""The methods that send `PANORAMAS` panoramas at once."""

LOOKING: Final = ("react", "agent-model", "agent-no-world-model")
"""The methods that may send `CROPS` crops at once; an agent's policy stands behind its name where it is not its own."""

AGENTS: Final = ("agent-model", "agent-passive", "agent-no-world-model", "agent-passive-no-world")
"""The agents that make every call themselves."""

DRIVEN: Final = ("agent", "agent-no-world", "agent-guided", "agent-no-world-guided")
"""The agents for which the program finds the looks."""

PLANNING: Final = ("agent-model", "agent-passive", *DRIVEN)

_IN_PANORAMA: Final = Box(1500, 130, 180, 240)
_FRAME_STEP: Final = 15
"""Frames between two pictures, which only give each picture its own frame id."""

_FRAMES: Final = tuple((number, number * _FRAME_STEP) for number in range(1, CROPS + 1))
"""Number and frame of each picture of a request."""

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
    system: str = ""
    """The system message, if it is of the methods' own."""

    @property
    def shows(self) -> bool:
        """Whether its message holds a picture."""
        return any(isinstance(part, Picture) for part in self.parts(self.places[0]))


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
        Demand(
            "perception",
            None,
            Requirement("the schema of perception (an object of each person)", DRIVEN, _SCHEMA_REMEDY),
            _perception_request,
            (0,),
            perceive_schema(_FIELDS),
            lambda reply: 0 if set(reply) == {"people"} and isinstance(reply["people"], list) else None,
            perceive_prompt(_FIELDS),
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


_FIELDS: Final = (
    Field("labels", "gender"),
    Field("labels", "age"),
    Field("words", "clothing"),
    Field("metres", "distance"),
    Field("statement", "action", "walking"),
    Field("relation", "relation", SAME_GROUP),
)
"""A field of each kind."""


def _perception_request(_: int) -> tuple[Part, ...]:
    picture = drawn_picture(CROP_SIZE, CORNERS["upper left"])
    return (field_line(_FIELDS), 'Picture: {"frame_id": "000000"}', picture, PEOPLE_LINE)


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
