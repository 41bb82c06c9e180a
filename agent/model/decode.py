"""Decode a model's reply. The rules are strict, and the same for every method.

A reply must be one JSON object. The object may be in a code fence. Thinking may come before the object if declared
delimiters enclose the thinking. Other declared delimiters may begin and end the object. A box is four numbers under a
key. The model's convention, which is fixed before the first reply, says how to read the four numbers. Decoding repairs
and guesses nothing. For example, reversed corners are not swapped. An invalid part raises a DecodeError with the
reason. The answer and the evidence are decoded independently, so one of them can be valid even if the other is not. No
function here gets a true answer or a true box.
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
from jrdb_avr.schema.answer_modes import MODES, Kind, frames_of_answer
from jrdb_avr.schema.answers import Answer, AnswerMode
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box

Size = tuple[int, int]
"""Width and height of an image in pixels."""

# The schema sets no bounds on the numbers. A server that enforces bounds would turn a box in another scale into a wrong
# box. Without bounds, the decoder reports that such a box is outside the image.
BOX_SCHEMA: Final[dict[str, Any]] = {"type": "array", "minItems": 4, "maxItems": 4, "items": {"type": "integer"}}


def box_key(entry: object, convention: Convention = CONTRACT, requested: str = CONTRACT_KEY) -> str:
    """Return the key under which an object holds its box.

    Args:
        entry: An object of a reply.
        convention: The convention of the model, which lists further accepted keys.
        requested: The key that the prompt requests.

    Returns:
        The only accepted key in the object. If the object has no accepted key or several accepted keys, the requested
        key, so that `only_keys` refuses the object.
    """
    keys = [key for key in {requested: "", **convention.boxes} if isinstance(entry, dict) and key in entry]
    return keys[0] if len(keys) == 1 else requested


def read_box(
    value: object, size: Size, convention: Convention = CONTRACT, key: str = CONTRACT_KEY, what: str = "box"
) -> Box:
    """Read a box of a reply.

    Args:
        value: Four numbers.
        size: Width and height of the image in pixels.
        convention: The convention of the model.
        key: The key of the box in the reply. An unknown key is read like the contract's key.
        what: The name of the box in errors.

    Returns:
        The box in pixels of the image. A corner outside the image by at most 2 % of a side is moved to the edge.

    Raises:
        DecodeError: If the value is not four numbers, or the box is outside, reversed or empty.
    """
    reading = convention.reading(key)
    return place_box(_numbers(value, reading, what), size, reading, convention, what)


def place_box(numbers: Sequence[float], size: Size, reading: Reading, convention: Convention, what: str = "box") -> Box:
    """Convert four numbers to a box.

    Args:
        numbers: Four numbers.
        size: Width and height of the image in pixels.
        reading: The order and the scale of the numbers.
        convention: The convention of the model, which states how the model resizes images.
        what: The name of the box in errors.

    Returns:
        The box in pixels of the image.

    Raises:
        DecodeError: If the box is outside, reversed or empty.
    """
    width, height = size
    units = {"thousandths": (SCALE, SCALE), "unit": (1, 1), "pixels": size, "resized": convention.resized(*size)}
    across, down = units[reading.scale]
    order = (0, 1, 2, 3) if reading.order == "xyxy" else (1, 0, 3, 2)
    pairs = [(numbers[index], side) for index, side in zip(order, (across, down) * 2, strict=True)]
    if any(not -TOLERANCE * side <= coordinate <= (1 + TOLERANCE) * side for coordinate, side in pairs):
        second_range = f" or 0..{down:g}" if down != across else ""
        raise DecodeError(f"{what} has a coordinate outside 0..{across:g}{second_range}")
    left, top, right, bottom = (min(max(coordinate, 0), side) for coordinate, side in pairs)
    if left >= right or top >= bottom:
        raise DecodeError(f"{what} has no area or reversed corners: the first corner is the upper left one")
    return Box(
        left * width / across, top * height / down, (right - left) * width / across, (bottom - top) * height / down
    )


def _numbers(value: object, reading: Reading, what: str) -> list[float]:
    """Check four numbers and return them. If the scale is not "unit", they must be whole."""
    whole = reading.scale != "unit"
    kinds = (int,) if whole else (int, float)
    numbers: list[Any] = value if isinstance(value, list) and len(value) == 4 else [None]
    # Whole floats are integers. Floats up to 1 stay, because they may be fractions of the image.
    if whole and any(type(item) in (int, float) and item > 1 for item in numbers):
        numbers = [int(item) if type(item) is float and item.is_integer() else item for item in numbers]
    if any(type(item) not in kinds for item in numbers):
        raise DecodeError(f"{what} must be a list of four {'integers' if whole else 'numbers'}")
    return numbers


def write_box(box: Box, size: Size) -> list[int]:
    """Convert a box to the form that the prompts request.

    Args:
        box: The box in pixels of the image.
        size: Width and height of the image in pixels.

    Returns:
        Left, top, right and bottom in thousandths of the image. They are clipped to the image.
    """
    corners = zip((box.x, box.y, box.x + box.w, box.y + box.h), size * 2, strict=True)
    return [min(max(round(v * SCALE / side), 0), SCALE) for v, side in corners]


VERSION: Final = 2
"""Version of the contract in every run's manifest. It is increased when the way of reading replies changes."""

# -- the reply as one object ------------------------------------------------------------------------------------------

_FENCE: Final = re.compile(r"```(?:json)?[ \t]*\r?\n", re.IGNORECASE)


def reply_object(reply: Reply, convention: Convention = CONTRACT) -> dict[str, Any]:
    """Read the JSON object of a reply.

    Args:
        reply: The reply.
        convention: The convention of the model, which declares the delimiters of thinking.

    Returns:
        The object.

    Raises:
        DecodeError: If the reply is refused, cut off, empty, or not one JSON object.
    """
    if reply.refusal:
        raise DecodeError(f"the model refused: {_plain(reply.refusal)}")
    if reply.finish_reason == "length":
        raise DecodeError("the reply was cut off at the token limit (finish_reason length)")
    if reply.finish_reason == "content_filter":
        raise DecodeError("refused: content filter")
    text = answer_text(reply, convention)
    if not text:
        raise DecodeError(f"the reply is empty{_instead(reply)}")
    # No regular expression matches the end of the fence. It would start at every blank, which takes hours for a long
    # reply.
    fence = _FENCE.match(text)
    if fence and text.endswith("```"):
        text = text[fence.end() : max(fence.end(), len(text) - 3)]
    return _object(text)


def _instead(reply: Reply) -> str:
    """Return what an empty reply holds instead of an answer, as the end of an error message."""
    if reply.content.strip():
        return " after its thinking"
    if reply.reasoning.strip():
        return ": everything stands in its reasoning, out of which no answer is taken"
    return "" if reply.finish_reason in ("stop", "") else f" (finish_reason {_plain(reply.finish_reason)!r})"


def _object(text: str) -> dict[str, Any]:
    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        fields = dict(items)
        if len(fields) != len(items):
            raise DecodeError("the reply names a key twice")
        return fields

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
    """Check that a value is an object with exactly the given keys.

    Args:
        value: A value of a reply.
        keys: The keys.
        what: The name of the value in errors.

    Returns:
        The object.

    Raises:
        DecodeError: If the value is not an object, or if keys are missing or extra. The message names these keys.
    """
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
    """Return a model's text for an error message, shortened and escaped to printable ASCII."""
    return text[:40].encode("unicode_escape").decode()


def read_each(*parts: Callable[[], Any]) -> tuple[tuple[Any, ...], tuple[str, ...]]:
    """Decode the parts of a reply independently.

    Args:
        parts: One function per part. Each reads its part and may raise DecodeError.

    Returns:
        The value of each part (None if its function failed), and the messages of the failures.
    """
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
    """Return a JSON value as a finite number.

    Args:
        value: Any value of a reply.

    Returns:
        The number. None if the value is not a number, is not finite, or is too large.
    """
    try:
        converted = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    except OverflowError:
        converted = math.inf
    return converted if math.isfinite(converted) else None


def frame_id(value: object, what: str = "frame_id") -> int:
    """Read a frame id.

    Args:
        value: A value of a reply.
        what: The name of the value in errors.

    Returns:
        The index of the frame.

    Raises:
        DecodeError: If the value is not a string of six digits.
    """
    if not (isinstance(value, str) and _FRAME_ID.fullmatch(value)):
        raise DecodeError(f'{what} must be a string of six digits, like "000150"')
    return int(value)


def angle(value: object) -> float:
    """Read an angle.

    Args:
        value: A value of a reply.

    Returns:
        The angle in degrees, wrapped to [0, 360).

    Raises:
        DecodeError: If the value is not a finite number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DecodeError("angle_deg must be a number of degrees")
    degrees = finite(value)
    if degrees is None:
        raise DecodeError("angle_deg must be a finite number of degrees")
    return degrees % 360.0 % 360.0


def read_answer(value: object, mode: AnswerMode, n_choices: int, frame_count: int) -> Answer:
    """Read the `answer` part of a reply.

    Args:
        value: The part: a choice, counted from 1, or an object with the fields of the answer mode.
        mode: The question's answer mode.
        n_choices: The number of choices.
        frame_count: The number of frames of the sequence.

    Returns:
        The answer.

    Raises:
        DecodeError: If the part does not fit the mode, the choices or the frames.
    """
    record = MODES[mode]
    if record.is_choice:
        choice = finite(value)
        if choice is None or not choice.is_integer() or not 1 <= choice <= n_choices:
            raise DecodeError(f"answer must be the number of a choice, an integer from 1 to {n_choices}")
        return record.build(int(choice))
    keys = {part.key: part.kind for part in record.parts}
    written = only_keys(value, keys, "answer")
    answer = record.build(*(_answer_part(key, kind, written[key], frame_count) for key, kind in keys.items()))
    frames = frames_of_answer(answer)
    if frames != sorted(frames):
        first, last = (key for key, kind in keys.items() if kind == "frame")
        raise DecodeError(f"answer.{last} must not lie before answer.{first}")
    return answer


def _answer_part(key: str, kind: Kind, value: object, frame_count: int) -> Any:
    if kind == "angle":
        return angle(value)
    if kind == "decimal":
        if not (isinstance(value, str) and _DECIMAL.fullmatch(value)):
            raise DecodeError(f'answer.{key} must be a string with a decimal number, like "12.5"')
        return float(value)
    frame = frame_id(value, f"answer.{key}")
    if frame >= frame_count:
        raise DecodeError(f"answer.{key} must be below {frame_count:06d}")
    return frame


@dataclass(frozen=True)
class ImageBox:
    """A box of a reply, in an image that the model got.

    frame: the frame of the image. box: the box in pixels of the image. key: the key of the box in the reply.
    """

    frame: int
    box: Box
    key: str


def read_evidence(value: object, frames: Collection[int], size: Size, convention: Convention = CONTRACT) -> ImageBox:
    """Read the box of `evidence_bboxes`.

    Args:
        value: The part of the reply.
        frames: The frames of the images that the box may refer to.
        size: Width and height of these images in pixels.
        convention: The convention of the model.

    Returns:
        The box.

    Raises:
        DecodeError: If the part is not a list of one box, or if the box is invalid or its frame is not one of `frames`.
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
    """Return the JSON Schema of an object with exactly the given keys.

    Args:
        properties: The schema of each key.

    Returns:
        The schema.
    """
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}
