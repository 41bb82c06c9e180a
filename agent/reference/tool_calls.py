"""Reading one turn: an object with a list of calls, of which each is carried out or refused by itself.

The turn is the model's, so it is taken for hostile: what is no such object is malformed (DecodeError), a call in it
that cannot be carried out carries its fault, and what is handed on is small and shallow whatever was sent.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.agent.model import decode
from jrdb_avr.schema.errors import DecodeError

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
    def said(self) -> str:
        """The call as the transcript shows it."""
        return one_line({"tool": self.tool, **self.arguments})


def read_calls(turn: Mapping[str, Any], tools: Collection[str]) -> list[Call]:
    """The calls of a turn, in order. Raises DecodeError for what is no list of 1 to `MOST_PER_TURN` calls."""
    given = decode.only_keys(turn, ("calls",), "a turn")["calls"]
    if not isinstance(given, list) or not 1 <= len(given) <= MOST_PER_TURN:
        raise DecodeError(f'"calls" must be a list of 1 to {MOST_PER_TURN} calls')
    return [_read_call(call, tools, last=place == len(given)) for place, call in enumerate(given, 1)]


def _read_call(given: object, tools: Collection[str], last: bool) -> Call:
    if not isinstance(given, dict) or not isinstance(given.get("tool"), str):
        return Call("?", {}, 'a call is an object that names its "tool"')
    tool = given["tool"]
    if tool not in tools:
        return Call("?", {}, f"there is no tool {one_line(tool[:40])}; there are {', '.join(tools)}")
    if _depth(given) > _DEPTH or len(one_line(given)) > LONGEST_CALL:
        return Call(tool, {}, "the call is too deep or too long")
    arguments = {name: value for name, value in given.items() if name != "tool"}
    if tool == FINAL and not last:
        return Call(tool, arguments, "it must be the last call of its turn")
    return Call(tool, arguments)


def _depth(value: object, most: int = _DEPTH) -> int:
    """Levels of nesting, counted to one beyond `most`."""
    if most < 0 or not isinstance(value, dict | list):
        return 0
    parts = value.values() if isinstance(value, dict) else value
    return 1 + max((_depth(part, most - 1) for part in parts), default=0)


def read_look(arguments: Mapping[str, Any], legal: Collection[int]) -> tuple[int, float]:
    """Frame and angle of a look. Raises DecodeError."""
    decode.only_keys(arguments, ("frame_id", "angle_deg"), "the call")
    frame, angle = decode.frame_id(arguments["frame_id"]), decode.angle(arguments["angle_deg"])
    if frame not in legal:
        raise DecodeError(f"frame_id {frame:06d} is none of the legal frames")
    return frame, angle


_COMPACT: Final = json.JSONEncoder(separators=(",", ":"))


def one_line(value: object) -> str:
    """A value that was read from JSON as JSON on one line, in ASCII."""
    try:
        return _COMPACT.encode(value)
    except (RecursionError, ValueError):
        raise DecodeError("the reply is too deep or too long") from None


def printable(text: str) -> str:
    """A text as a message can hold it: on one line, and with what UTF-8 cannot hold written out."""
    return " ".join(text.split()).encode("utf-8", "backslashreplace").decode()


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
