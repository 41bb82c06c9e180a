"""Decode a model's reply: one strict contract, the same for every method.

A reply is one JSON object, in at most one code fence, after any thinking in declared delimiters. A box is four numbers
under a key, read by the backbone's convention, which is fixed before the first reply. Decoding repairs and guesses
nothing: a part that does not fit raises DecodeError with the reason, which the prediction stores, and reversed corners
are never swapped. No function here takes the true answer or box. Answer and evidence are read independently, so one may
be valid where the other is not.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.agent.model.conventions import CONTRACT, CONTRACT_KEY, SCALE, TOLERANCE, Convention, Reading
from jrdb_avr.agent.model.reply import Reply, answer_text
from jrdb_avr.schema.answers import ANSWER_TYPES, Answer, AnswerMode, Choice, Span
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box

Size = tuple[int, int]
"""Width and height of an image in pixels."""

# The numbers are not bounded: a server that keeps to the schema would bend a box of another scale into a wrong one,
# where the decoder says that it lies outside.
BOX_SCHEMA: Final[dict[str, Any]] = {"type": "array", "minItems": 4, "maxItems": 4, "items": {"type": "integer"}}


def box_key(entry: object, convention: Convention = CONTRACT, requested: str = CONTRACT_KEY) -> str:
    """The key under which an object holds its box: the requested one, or the convention's alias if only that is there.

    For an object without one, or with several, this is the requested key, and `only_keys` refuses the object.
    """
    keys = [key for key in {requested: "", **convention.boxes} if isinstance(entry, dict) and key in entry]
    return keys[0] if len(keys) == 1 else requested


def read_box(
    value: object, size: Size, convention: Convention = CONTRACT, key: str = CONTRACT_KEY, what: str = "box"
) -> Box:
    """Four numbers, written under `key`, as a box in pixels of an image of this size. Raises DecodeError.

    Numbers outside the image by up to 2 % of its side are clipped; farther ones, and reversed or empty boxes, are
    refused. A key that the convention does not know is read as the contract's own.
    """
    reading = convention.reading(key)
    return place_box(_numbers(value, reading, what), size, reading, convention, what)


def place_box(numbers: Sequence[float], size: Size, reading: Reading, convention: Convention, what: str = "box") -> Box:
    """Four numbers under one reading as a box in pixels of the image. Raises DecodeError, as `read_box`."""
    (width, height), (across, down) = size, full_sides(reading, convention, size)
    sides = (across, down) * 2 if reading.order == "xyxy" else (down, across) * 2
    pairs = list(zip(numbers, sides, strict=True))
    if any(not -TOLERANCE * side <= number <= (1 + TOLERANCE) * side for number, side in pairs):
        other = f" or 0..{down:g}" if down != across else ""
        raise DecodeError(f"{what} has a coordinate outside 0..{across:g}{other}")
    a, b, c, d = (min(max(number, 0), side) for number, side in pairs)
    left, top, right, bottom = (a, b, c, d) if reading.order == "xyxy" else (b, a, d, c)
    if left >= right or top >= bottom:
        raise DecodeError(f"{what} has no area or reversed corners: the first corner is the upper left one")
    return Box(
        left * width / across, top * height / down, (right - left) * width / across, (bottom - top) * height / down
    )


def full_sides(reading: Reading, convention: Convention, size: Size) -> tuple[float, float]:
    """The numbers that stand for the right and the lower edge of an image of this size."""
    if reading.scale == "resized":
        return convention.resized(*size)
    return {"thousandths": (SCALE, SCALE), "unit": (1, 1), "pixels": size}[reading.scale]


def _numbers(value: object, reading: Reading, what: str) -> list[float]:
    """Whole numbers, as the contract asks; any finite ones where the convention's scale is 0..1."""
    whole = reading.scale != "unit"
    kinds = (int,) if whole else (int, float)
    numbers: list[Any] = value if isinstance(value, list) and len(value) == 4 else [None]
    if any(type(number) not in kinds for number in numbers):
        raise DecodeError(f"{what} must be a list of four {'integers' if whole else 'numbers'}")
    # An integer that no float holds is finite, and told to lie outside.
    if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
        raise DecodeError(f"{what} must be a list of four finite numbers")
    return numbers


def write_box(box: Box, size: Size) -> list[int]:
    """A box in image pixels as the four integers of the contract, clipped to the image."""
    corners = zip((box.x, box.y, box.x + box.w, box.y + box.h), size * 2, strict=True)
    return [min(max(round(v * SCALE / side), 0), SCALE) for v, side in corners]


VERSION: Final = 1
"""Of the contract and its reading, in every run's manifest: raised when a reply is read otherwise than before."""

# -- the reply as one object ------------------------------------------------------------------------------------------

_FENCE: Final = re.compile(r"```(?:json)?[ \t]*\r?\n", re.IGNORECASE)


def reply_object(reply: Reply, convention: Convention = CONTRACT) -> dict[str, Any]:
    """The one JSON object of a reply. Raises DecodeError."""
    if reply.refusal:
        raise DecodeError(f"the model refused: {_plain(reply.refusal)}")
    if reply.finish_reason == "length":
        raise DecodeError("the reply was cut off at the token limit (finish_reason length)")
    if reply.finish_reason not in ("stop", ""):
        raise DecodeError(f"the reply ended with finish_reason {_plain(reply.finish_reason)!r}, not 'stop'")
    text = answer_text(reply, convention)
    if not text:
        raise DecodeError(f"the reply is empty{_instead(reply)}")
    # No pattern over the whole text: one that looks for the end from every blank takes hours over a long reply.
    fence = _FENCE.match(text)
    if fence and text.endswith("```"):
        text = text[fence.end() : max(fence.end(), len(text) - 3)]
    return _object(text)


def _instead(reply: Reply) -> str:
    """What an empty reply holds in place of an answer."""
    if reply.content.strip():
        return " after its thinking"
    if reply.reasoning.strip():
        return ": everything stands in its reasoning, out of which no answer is taken"
    return ""


def _object(text: str) -> dict[str, Any]:
    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(items)
        if len(found) != len(items):
            raise DecodeError("the reply names a key twice")
        return found

    def constant(name: str) -> Any:
        raise DecodeError(f"{name} is not JSON")

    try:
        value = json.loads(text, object_pairs_hook=pairs, parse_constant=constant)
    except (ValueError, RecursionError) as error:
        reason = getattr(error, "msg", "too long or too deep")
        raise DecodeError(f"the reply is not one JSON object: {reason}") from None
    if not isinstance(value, dict):
        raise DecodeError("the reply is not one JSON object")
    return value


def only_keys(value: object, keys: Collection[str], what: str) -> dict[str, Any]:
    """The value as an object with exactly these keys. Raises DecodeError naming the missing or extra ones."""
    if not isinstance(value, dict):
        raise DecodeError(f"{what} must be an object with the keys {_listed(keys)}")
    missing, extra = sorted(set(keys) - set(value)), sorted(set(value) - set(keys))
    if missing:
        raise DecodeError(f"{what} lacks {_listed(missing)}")
    if extra:
        raise DecodeError(f"{what} has keys that the contract does not know: {_listed(extra)}")
    return value


def _listed(names: Collection[str]) -> str:
    return ", ".join(_plain(name) for name in list(names)[:5])


def _plain(text: str) -> str:
    """A model's word for a message: short, and printable ASCII whatever it holds."""
    return text[:40].encode("unicode_escape").decode()


def read_each(*parts: Callable[[], Any]) -> tuple[tuple[Any, ...], tuple[str, ...]]:
    """What each part of a reply is read as, None where it raises DecodeError, and the reasons of those."""
    values, faults = [], []
    for read in parts:
        try:
            values.append(read())
        except DecodeError as error:
            values.append(None)
            faults.append(str(error))
    return tuple(values), tuple(faults)


# -- parts of the contract --------------------------------------------------------------------------------------------

_FRAME_ID: Final = re.compile(r"[0-9]{6}")
_DECIMAL: Final = re.compile(r"-?[0-9]{1,12}(\.[0-9]{1,12})?")


def finite(value: object) -> float | None:
    """A number of JSON; None for anything else, and for a number that is not finite or too large."""
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    except OverflowError:
        number = math.inf
    return number if math.isfinite(number) else None


def frame_id(value: object, what: str = "frame_id") -> int:
    """The frame of a six-digit frame id."""
    if not (isinstance(value, str) and _FRAME_ID.fullmatch(value)):
        raise DecodeError(f'{what} must be a string of six digits, like "000150"')
    return int(value)


def angle(value: object) -> float:
    """A finite angle in degrees, wrapped to [0, 360)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DecodeError("angle_deg must be a number of degrees")
    degrees = finite(value)
    if degrees is None:
        raise DecodeError("angle_deg must be a finite number of degrees")
    return degrees % 360.0 % 360.0


def read_answer(value: object, mode: AnswerMode, n_choices: int, frame_count: int) -> Answer:
    """The `answer` part of a reply. Raises DecodeError.

    multiple_choice: an integer 1..n_choices; frames: six digits below `frame_count`; value: a string such as "12.5".
    """
    if mode == "multiple_choice":
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= n_choices:
            raise DecodeError(f"answer must be the number of a choice, an integer from 1 to {n_choices}")
        return Choice(value)
    part = only_keys(value, _ANSWER_KEYS[mode], "answer")
    answer = ANSWER_TYPES[mode](*(_answer_value(key, part[key], frame_count) for key in _ANSWER_KEYS[mode]))
    if isinstance(answer, Span) and answer.end_frame < answer.start_frame:
        raise DecodeError("answer.end_frame must not lie before answer.start_frame")
    return answer


def _answer_value(key: str, value: object, frame_count: int) -> Any:
    """The value under a key of an answer: degrees, a decimal number, or a frame."""
    match key:
        case "angle_deg":
            return angle(value)
        case "value":
            if not (isinstance(value, str) and _DECIMAL.fullmatch(value)):
                raise DecodeError('answer.value must be a string with a decimal number, like "12.5"')
            return float(value)
    frame = frame_id(value, f"answer.{key}")
    if frame >= frame_count:
        raise DecodeError(f"answer.{key} must be below {frame_count:06d}")
    return frame


@dataclass(frozen=True)
class ImageBox:
    """A box in an image that the model got: its frame, pixels of that image, and the key it was written under."""

    frame: int
    box: Box
    key: str


def read_evidence(value: object, frames: Collection[int], size: Size, convention: Convention = CONTRACT) -> ImageBox:
    """The one box of `evidence_bboxes`, in pixels of an image of this size. Raises DecodeError.

    Its frame must be one of `frames`. Corners outside by up to 2 % are clipped; reversed or empty boxes are refused.
    """
    if not isinstance(value, list) or len(value) != 1:
        raise DecodeError("evidence_bboxes must be a list of exactly one box")
    what, key = "evidence_bboxes[0]", box_key(value[0], convention)
    part = only_keys(value[0], ("frame_id", key), what)
    frame = frame_id(part["frame_id"], f"{what}.frame_id")
    if frame not in frames:
        allowed = ", ".join(f"{f:06d}" for f in sorted(frames)[:8])
        raise DecodeError(f"{what}.frame_id {frame:06d} is not a frame of the image at hand ({allowed})")
    return ImageBox(frame, read_box(part[key], size, convention, key, f"{what}.{key}"), key)


# -- the contract as JSON Schema --------------------------------------------------------------------------------------


def closed_object(properties: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of an object with exactly these keys."""
    names = list(properties)
    return {"type": "object", "properties": properties, "required": names, "additionalProperties": False}


FRAME_ID_SCHEMA: Final[dict[str, Any]] = {"type": "string", "pattern": "^[0-9]{6}$"}

EVIDENCE_SCHEMA: Final[dict[str, Any]] = {
    "type": "array",
    "minItems": 1,
    "maxItems": 1,
    "items": closed_object({"frame_id": FRAME_ID_SCHEMA, CONTRACT_KEY: BOX_SCHEMA}),
}


_ANSWER_KEYS: Final[dict[AnswerMode, dict[str, Any]]] = {
    "frame": {"frame_id": FRAME_ID_SCHEMA},
    "span": {"start_frame": FRAME_ID_SCHEMA, "end_frame": FRAME_ID_SCHEMA},
    "frame_viewpoint": {"frame_id": FRAME_ID_SCHEMA, "angle_deg": {"type": "number"}},
    "number": {"value": {"type": "string", "pattern": r"^-?[0-9]+(\.[0-9]+)?$"}},
}
"""The keys of an answer that is an object, in the order of its type's fields."""


def answer_schema(mode: AnswerMode, choices: Sequence[str]) -> dict[str, Any]:
    """The JSON Schema of `answer` in a mode."""
    if mode == "multiple_choice":
        return {"type": "integer", "minimum": 1, "maximum": len(choices)}
    return closed_object(_ANSWER_KEYS[mode])
