"""One turn: the calls that a model makes, and the results and pictures that the model gets.

Replies are untrusted. A turn is an object with a list of calls, and each call is carried out or refused by itself.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.agent.methods.attempt import ImageFrame, on_crop, on_panoramas
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Part, Picture, metadata_of, picture_of
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.schemas import frame_schema
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama

MOST_CALLS: Final = 32
"""Maximum number of calls in a turn."""

LONGEST_CALL: Final = 12_000
"""Maximum number of characters of a call's JSON."""

_DEPTH: Final = 5
"""Maximum nesting of a call. A person's box in a list of people has this depth."""

WRITES: Final = ("add_people", "add_entity", "add_attribute", "add_relation")
"""Tools that write to the graph."""

FINAL: Final = "final_answer"

UNKNOWN: Final = "?"
"""Name of a call that names no known tool."""


@dataclass(frozen=True)
class Call:
    """One call. arguments: all keys beside "tool". fault: why the call is refused before it is tried, or ""."""

    tool: str
    arguments: Mapping[str, Any]
    fault: str = ""

    @property
    def text(self) -> str:
        """The call as JSON, as the transcript shows it."""
        return compact_json({"tool": self.tool, **self.arguments})


def read_calls(turn: Mapping[str, Any], tools: Collection[str]) -> list[Call]:
    """Read the calls of a turn.

    Args:
        turn: The object that the model sent.
        tools: The names of the tools of the turn.

    Returns:
        The calls in their order. A call that cannot be carried out has a fault.

    Raises:
        DecodeError: If the object is not a list of 1 to `MOST_CALLS` calls under the key "calls".
    """
    calls = decode.only_keys(turn, ("calls",), "a turn")["calls"]
    if not isinstance(calls, list) or not 1 <= len(calls) <= MOST_CALLS:
        raise DecodeError(f'"calls" must be a list of 1 to {MOST_CALLS} calls')
    return [_read_call(call, tools, last=number == len(calls)) for number, call in enumerate(calls, 1)]


def _read_call(call: object, tools: Collection[str], last: bool) -> Call:
    if not isinstance(call, dict) or not isinstance(call.get("tool"), str):
        return Call(UNKNOWN, {}, 'a call is an object that names its "tool"')
    tool = call["tool"]
    if tool not in tools:
        return Call(UNKNOWN, {}, f"there is no tool {compact_json(tool[:40])}; the tools are {', '.join(tools)}")
    if _depth(call) > _DEPTH or len(compact_json(call)) > LONGEST_CALL:
        return Call(tool, {}, "the call is nested too deeply or too long")
    arguments = {name: value for name, value in call.items() if name != "tool"}
    if tool == FINAL and not last:
        return Call(tool, arguments, "it must be the last call of its turn")
    return Call(tool, arguments)


def _depth(value: object, most: int = _DEPTH) -> int:
    """Return the levels of nesting, counted up to one level beyond `most`."""
    if most < 0 or not isinstance(value, dict | list):
        return 0
    parts = value.values() if isinstance(value, dict) else value
    return 1 + max((_depth(part, most - 1) for part in parts), default=0)


_COMPACT: Final = json.JSONEncoder(separators=(",", ":"), allow_nan=False)


def compact_json(value: object) -> str:
    """Write a value that was read from JSON as JSON.

    Args:
        value: The value.

    Returns:
        One line of ASCII. A number that is not finite becomes a text, because JSON has no such numbers.

    Raises:
        DecodeError: If the value is nested too deeply.
    """
    try:
        with contextlib.suppress(ValueError):
            return _COMPACT.encode(value)
        return _COMPACT.encode(json.loads(json.dumps(value), parse_constant=str))
    except (RecursionError, ValueError):
        raise DecodeError("the reply is nested too deeply or too long") from None


def printable(text: str) -> str:
    """Return a text on one line, without characters that UTF-8 cannot encode.

    Args:
        text: The text.

    Returns:
        The text.
    """
    return " ".join(text.split()).encode("utf-8", "backslashreplace").decode()


def call_schema(tool: str, properties: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a call.

    Args:
        tool: The name of the tool.
        properties: The schema of each argument.

    Returns:
        The schema.
    """
    return decode.closed_object({"tool": {"type": "string", "enum": [tool]}, **properties})


def turn_schema(calls: Collection[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the JSON Schema of a turn.

    Args:
        calls: The schemas of the calls.

    Returns:
        The schema.
    """
    return decode.closed_object(
        {"calls": {"type": "array", "minItems": 1, "maxItems": MOST_CALLS, "items": {"anyOf": list(calls)}}}
    )


def look_schema(frames: Sequence[int], advised: bool) -> dict[str, Any]:
    """Return the JSON Schema of a look.

    Args:
        frames: The frames that can be observed, ascending.
        advised: Whether frame and angle may be left out.

    Returns:
        The schema.
    """
    look = call_schema("observe", {"frame_id": frame_schema(frames), "angle_deg": {"type": "number"}})
    return look | {"required": ["tool"]} if advised else look


_STATED: Final = ("frame_id", "angle_deg", "left")
"""Metadata of a picture that a turn states."""


# -- what a turn shows ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class NamedView:
    """An observation under its name. image: its frame and its place in the panorama. line: its metadata."""

    name: str
    kind: str
    image: ImageFrame
    line: str
    picture: Picture


def named_view(name: str, observation: Observation | Panorama) -> NamedView:
    """Return an observation as a turn shows it.

    Args:
        name: The name, such as "o1".
        observation: A crop, or a panorama of a fixed context.

    Returns:
        The view.
    """
    if isinstance(observation, Panorama):
        kind, image = "Panorama", on_panoramas([observation])
    else:
        kind, image = "Picture", on_crop(observation)
    metadata = metadata_of(observation)
    # Each turn costs tokens, so the line has only what a call can use.
    line = {key: round(metadata[key], 1) if key == "angle_deg" else metadata[key] for key in _STATED if key in metadata}
    return NamedView(name, kind, image, compact_json(line), picture_of(observation))


def find_view(name: object, views: Mapping[str, NamedView]) -> NamedView:
    """Return the view that a call names.

    Args:
        name: The value in the call.
        views: All observations by name.

    Returns:
        The view.

    Raises:
        DecodeError: If no observation has the name.
    """
    view = views.get(name) if isinstance(name, str) else None
    if view is None:
        raise DecodeError("observation must name an observation that has been made")
    return view


def view_parts(views: Sequence[NamedView]) -> list[Part]:
    """Return views as parts of a message.

    Args:
        views: The views.

    Returns:
        The pictures. Before each picture is a line with its number, name and metadata.
    """
    parts: list[Part] = []
    for number, view in enumerate(views, 1):
        parts += [f"{view.kind} {number}, observation {view.name}: {view.line}", view.picture]
    return parts


@dataclass(frozen=True)
class Turn:
    """What the model gets in a turn.

    results: one text per call of the last turn. views: the pictures of the last turn. error: why the last turn could
    not be read, or "". looks, turns: how many are made and left.
    """

    results: Sequence[str]
    views: Sequence[NamedView]
    error: str
    looks: tuple[int, int]
    turns: tuple[int, int]

    def result_lines(self) -> str:
        """Return the results as numbered lines."""
        lines = [f"{number}. {result}" for number, result in enumerate(self.results, 1)]
        return "\n".join(["Results:", *(lines or ["none"])])

    def state(self) -> str:
        """Return the last lines of the turn's message."""
        return render(
            "agent_state",
            looks=self.looks[0],
            looks_left=self.looks[1],
            turns=self.turns[0],
            turns_left=self.turns[1],
            error=f"Your last turn could not be read: {self.error}" if self.error else "",
        )
