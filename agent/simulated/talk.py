"""Requests that are no stage of a question: those by which a server is tried out before a run.

The marker does what they ask as far as marks and JSON go: it says a word, fills in the schema that it is given, and
finds the rectangle with a mark in a drawn picture.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.calibrate import BOX_LINE
from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.model.preflight import CORNER_LINE, CROP_LINE, PANORAMA_LINE
from jrdb_avr.agent.simulated.requests import Picture, Reader, lines_of, uri_of, user_parts
from jrdb_avr.schema.errors import DecodeError

_WORD: Final = re.compile(r"Reply with the one word: (\w{1,40})")
_OBJECT: Final = re.compile(r"Reply with the JSON object (\{.*\}) and nothing else\.")
_FRAME: Final = re.compile(r'Picture \d+: \{"frame_id": ?"(\d{6})"\}')
_DEEPEST: Final = 6
_MOST_ITEMS: Final = 4
_LONGEST: Final = 100
"""A schema cannot ask for more than so much: lists of lists grow fast."""


def talk(messages: Sequence[Mapping[str, Any]], response_format: object, reader: Reader) -> str:
    """The reply's text. Raises DecodeError for a picture asked about that cannot be read."""
    parts = next((found for message in reversed(messages) if (found := user_parts(message)) is not None), [])
    lines = lines_of(parts)
    match lines[-1:]:
        case (last,) if last == CORNER_LINE:
            return _json({"corner": _corner(_picture(parts, reader))})
        case (last,) if last == BOX_LINE:
            return _json({"evidence_bboxes": [_box("\n".join(lines), _picture(parts, reader))]})
        case (last,) if last == PANORAMA_LINE:
            number, _ = _marked(parts, reader)
            return _json({"calls": [{"tool": "final_answer", "answer": number, "entity": "p1"}]})
        case (last,) if last == CROP_LINE:
            return _json({"action": "observe", "frame_id": _frame(_marked(parts, reader)[1]), "angle_deg": 180})
    if asked := _OBJECT.search("\n".join(lines)):
        return asked[1]
    if (schema := _schema(response_format)) is not None:
        return _json(instance(schema))
    asked = _WORD.search("\n".join(lines))
    return asked[1] if asked else _json({"ok": True})


def _json(value: object) -> str:
    return msgspec.json.encode(value).decode()


def _picture(parts: Sequence[Mapping[str, Any]], reader: Reader) -> Picture:
    """The newest picture, which shows one mark. Raises DecodeError."""
    images = [part for part in parts if part.get("type") == "image_url"]
    picture = reader.picture(uri_of(images[-1]), wrap=False) if images else None
    if picture is None or len(picture.readings) != 1:
        raise DecodeError("the request lacks a picture with one mark")
    return picture


def _marked(parts: Sequence[Mapping[str, Any]], reader: Reader) -> tuple[int, str]:
    """Of the first picture that shows a mark: its number, from 1, and the text before it. Raises DecodeError."""
    images = [place for place, part in enumerate(parts) if part.get("type") == "image_url"]
    for number, place in enumerate(images, 1):
        if reader.picture(uri_of(parts[place]), wrap=False).readings:
            return number, str(parts[place - 1].get("text", "")) if place else ""
    raise DecodeError("none of the pictures shows a mark")


def _corner(picture: Picture) -> str:
    box = picture.readings[0].box
    down = "upper" if box.y + box.h / 2 < picture.height / 2 else "lower"
    across = "left" if box.x + box.w / 2 < picture.width / 2 else "right"
    return f"{down} {across}"


def _box(text: str, picture: Picture) -> dict[str, Any]:
    return {"frame_id": _frame(text), "bbox": write_box(picture.readings[0].box, picture.width, picture.height)}


def _frame(text: str) -> str:
    frame = _FRAME.search(text)
    if frame is None:
        raise DecodeError("the request does not name its picture's frame")
    return frame[1]


def _schema(response_format: object) -> Mapping[Any, Any] | None:
    """The schema of a response format."""
    match response_format:
        case {"type": "json_schema", "json_schema": {"schema": {**schema}}}:
            return schema
    return None


def instance(schema: object, depth: int = 0) -> Any:
    """The simplest value that keeps to a JSON Schema made of types, enumerations, and least lengths and numbers."""
    if depth > _DEEPEST:
        return None
    match schema:
        case {"enum": [first, *_]}:
            return first
        case {"anyOf": [first, *_]}:
            return instance(first, depth + 1)
        case {"type": "object", "properties": {**properties}}:
            return {str(name): instance(form, depth + 1) for name, form in properties.items()}
        case {"type": "array", "items": items, **rest}:
            return [instance(items, depth + 1)] * _least(rest, "minItems", _MOST_ITEMS)
        case {"type": "string", **rest}:
            return "-" * _least(rest, "minLength")
        case {"type": "integer" | "number", **rest}:
            return _least(rest, "minimum")
        case {"type": "boolean"}:
            return True
        case {"type": "object"}:
            return {}
    return None


def _least(schema: Mapping[Any, Any], key: str, most: int = _LONGEST) -> int:
    least = schema.get(key, 0)
    return least if isinstance(least, int) and 0 <= least <= most else 0
