"""One turn: the calls that the model makes, and the results and pictures that it is sent.

A turn of the model is an object with a list of calls, of which each is carried out or refused by itself.

It is taken for hostile: what is no such object is malformed (DecodeError), a call in it
that cannot be carried out carries its fault, and what is handed on is small and shallow whatever was sent.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.agent.beliefs.arguments import printable
from jrdb_avr.agent.methods.attempt import ImageFrame, on_crop, on_panoramas
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Part, Picture, metadata_line, picture_of
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama

MOST_PER_TURN: Final = 32
"""Calls in one turn."""

LONGEST_CALL: Final = 2000
"""Characters of a call's JSON."""

_DEPTH: Final = 4

WRITING: Final = ("add_entity", "add_attribute", "add_relation")
FINAL: Final = "final_answer"


@dataclass(frozen=True)
class Call:
    """One call. arguments: what stood beside "tool"; fault: why it is refused before anything is tried, or ""."""

    tool: str
    arguments: Mapping[str, Any]
    fault: str = ""

    @property
    def text(self) -> str:
        """The call as the transcript shows it."""
        return compact_json({"tool": self.tool, **self.arguments})


def read_calls(turn: Mapping[str, Any], tools: Collection[str]) -> list[Call]:
    """The calls of a turn, in order. Raises DecodeError for what is no list of 1 to `MOST_PER_TURN` calls."""
    value = decode.only_keys(turn, ("calls",), "a turn")["calls"]
    if not isinstance(value, list) or not 1 <= len(value) <= MOST_PER_TURN:
        raise DecodeError(f'"calls" must be a list of 1 to {MOST_PER_TURN} calls')
    return [_read_call(call, tools, last=place == len(value)) for place, call in enumerate(value, 1)]


def _read_call(call: object, tools: Collection[str], last: bool) -> Call:
    if not isinstance(call, dict) or not isinstance(call.get("tool"), str):
        return Call("?", {}, 'a call is an object that names its "tool"')
    tool = call["tool"]
    if tool not in tools:
        return Call("?", {}, f"there is no tool {compact_json(tool[:40])}; there are {', '.join(tools)}")
    if _depth(call) > _DEPTH or len(compact_json(call)) > LONGEST_CALL:
        return Call(tool, {}, "the call is too deep or too long")
    arguments = {name: value for name, value in call.items() if name != "tool"}
    if tool == FINAL and not last:
        return Call(tool, arguments, "it must be the last call of its turn")
    return Call(tool, arguments)


def _depth(value: object, most: int = _DEPTH) -> int:
    """Levels of nesting, counted to one beyond `most`."""
    if most < 0 or not isinstance(value, dict | list):
        return 0
    parts = value.values() if isinstance(value, dict) else value
    return 1 + max((_depth(part, most - 1) for part in parts), default=0)


_COMPACT: Final = json.JSONEncoder(separators=(",", ":"))


def compact_json(value: object) -> str:
    """A value that was read from JSON as JSON on one line, in ASCII."""
    try:
        return _COMPACT.encode(value)
    except (RecursionError, ValueError):
        raise DecodeError("the reply is too deep or too long") from None


def refusal(reason: str) -> str:
    """The result of a call that is refused."""
    return f"refused: {printable(reason)}"


def call_schema(tool: str, properties: Mapping[str, Any], optional: Collection[str] = ()) -> dict[str, Any]:
    """The JSON Schema of a tool's call."""
    schema = decode.closed_object({"tool": {"type": "string", "enum": [tool]}, **properties})
    schema["required"] = [name for name in schema["required"] if name not in optional]
    return schema


def turn_schema(calls: Collection[Mapping[str, Any]]) -> dict[str, Any]:
    """The JSON Schema of a turn whose calls have these schemas."""
    return decode.closed_object(
        {"calls": {"type": "array", "minItems": 1, "maxItems": MOST_PER_TURN, "items": {"anyOf": list(calls)}}}
    )


LOOK_SCHEMA: Final = call_schema("observe", {"frame_id": decode.FRAME_ID_SCHEMA, "angle_deg": {"type": "number"}})


# -- what a turn shows ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class View:
    """An observation under its name, for a turn. image: its frame and place in the panorama; line: its metadata."""

    name: str
    kind: str
    image: ImageFrame
    line: str
    picture: Picture


def view_of(name: str, seen: Observation | Panorama) -> View:
    """An observation under its name: a look, or a panorama of a fixed context."""
    kind, image = ("Panorama", on_panoramas([seen])) if isinstance(seen, Panorama) else ("Picture", on_crop(seen))
    return View(name, kind, image, metadata_line(seen), picture_of(seen))


def view_parts(views: Sequence[View]) -> list[Part]:
    """Each picture behind the line that numbers, names and places it."""
    parts: list[Part] = []
    for number, view in enumerate(views, 1):
        parts += [f"{view.kind} {number}, observation {view.name}: {view.line}", view.picture]
    return parts


@dataclass(frozen=True)
class Turn:
    """What has changed since the last turn, and what is left.

    results: of the last turn's calls; fresh: the pictures that they made; looks, calls: made and left.
    """

    results: Sequence[str]
    fresh: Sequence[View]
    error: str
    looks: tuple[int, int]
    calls: tuple[int, int]

    def result_lines(self) -> str:
        """The results as numbered lines."""
        lines = [f"{number}. {result}" for number, result in enumerate(self.results, 1)]
        return "\n".join(["Results of your last calls:", *(lines or ["none"])])

    def state(self) -> str:
        """The lines that close every turn."""
        error = f"Your last turn was malformed, and cost a call: {self.error}"
        return render(
            "agent_state",
            looks=self.looks[0],
            looks_left=self.looks[1],
            calls=self.calls[0],
            calls_left=self.calls[1],
            error=error if self.error else "",
        )
