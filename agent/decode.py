"""Reading a model's reply: one strict contract, the same for every method.

A reply is one JSON object, in at most one code fence, after any thinking in declared delimiters. Nothing is repaired
and nothing guessed: what does not fit raises DecodeError with the reason, which the prediction stores. No function
here can be given the true answer or box. Answer and evidence are read apart, so one may stand where the other falls.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.schema.answers import Answer, AnswerMode, Choice, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box

from .boxes import BOX_SCHEMA
from .boxes import box_key as box_key
from .boxes import read_box as read_box
from .boxes import write_box as write_box
from .conventions import CONTRACT as CONTRACT
from .conventions import CONTRACT_KEY
from .conventions import Convention as Convention
from .conventions import convention_of as convention_of
from .replies import Reply, spoken

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
    text = spoken(reply, convention)
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
    """A model's word in a message of ours: short, and printable ASCII whatever it holds."""
    return text[:40].encode("unicode_escape").decode()


# -- parts of the contract --------------------------------------------------------------------------------------------

_FRAME_ID: Final = re.compile(r"[0-9]{6}")
_DECIMAL: Final = re.compile(r"-?[0-9]{1,12}(\.[0-9]{1,12})?")


def frame_id(value: object, what: str = "frame_id") -> int:
    """The frame of a six-digit frame id."""
    if not (isinstance(value, str) and _FRAME_ID.fullmatch(value)):
        raise DecodeError(f'{what} must be a string of six digits, like "000150"')
    return int(value)


def angle(value: object) -> float:
    """A finite angle in degrees, wrapped to [0, 360)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DecodeError("angle_deg must be a number of degrees")
    try:
        degrees = float(value)
    except OverflowError:
        degrees = math.inf
    if not math.isfinite(degrees):
        raise DecodeError("angle_deg must be a finite number of degrees")
    return degrees % 360.0 % 360.0


def read_answer(value: object, mode: AnswerMode, n_choices: int, frame_count: int) -> Answer:
    """The `answer` part of a reply. Raises DecodeError.

    multiple_choice: an integer 1..n_choices; frames: six digits below `frame_count`; value: a string such as "12.5".
    """

    def frame(key: str, part: dict[str, Any]) -> int:
        number = frame_id(part[key], f"answer.{key}")
        if number >= frame_count:
            raise DecodeError(f"answer.{key} must be below {frame_count:06d}")
        return number

    match mode:
        case "multiple_choice":
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= n_choices:
                raise DecodeError(f"answer must be the number of a choice, an integer from 1 to {n_choices}")
            return Choice(value)
        case "frame":
            return FrameAnswer(frame("frame_id", only_keys(value, ("frame_id",), "answer")))
        case "span":
            part = only_keys(value, ("start_frame", "end_frame"), "answer")
            span = Span(frame("start_frame", part), frame("end_frame", part))
            if span.end_frame < span.start_frame:
                raise DecodeError("answer.end_frame must not lie before answer.start_frame")
            return span
        case "frame_viewpoint":
            part = only_keys(value, ("frame_id", "angle_deg"), "answer")
            return FrameViewpoint(frame("frame_id", part), angle(part["angle_deg"]))
        case "number":
            text = only_keys(value, ("value",), "answer")["value"]
            if not (isinstance(text, str) and _DECIMAL.fullmatch(text)):
                raise DecodeError('answer.value must be a string with a decimal number, like "12.5"')
            return Number(float(text))


@dataclass(frozen=True)
class ImageBox:
    """A box in an image the model was shown: its frame, pixels of that image, and the key it was written under."""

    frame: int
    box: Box
    key: str


def read_evidence(
    value: object,
    shown: Collection[int],
    width: int,
    height: int,
    convention: Convention = CONTRACT,
    what: str = "evidence_bboxes",
) -> ImageBox:
    """The one box of `evidence_bboxes`, in pixels of an image of `width` x `height`. Raises DecodeError.

    Its frame must be one of `shown`. Corners outside by up to 2 % are clipped; reversed or empty boxes are refused.
    """
    if not isinstance(value, list) or len(value) != 1:
        raise DecodeError(f"{what} must be a list of exactly one box")
    entry = value[0]
    key = box_key(entry, convention)
    part = only_keys(entry, ("frame_id", key), f"{what}[0]")
    frame = frame_id(part["frame_id"], f"{what}[0].frame_id")
    if frame not in shown:
        allowed = ", ".join(f"{f:06d}" for f in sorted(shown)[:8])
        raise DecodeError(f"{what}[0].frame_id {frame:06d} is not a frame of the image at hand ({allowed})")
    return ImageBox(frame, read_box(part[key], width, height, convention, key, f"{what}[0].{key}"), key)


# -- the contract as JSON Schema --------------------------------------------------------------------------------------


def closed_object(properties: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of an object with exactly these keys."""
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


FRAME_ID_SCHEMA: Final[dict[str, Any]] = {"type": "string", "pattern": "^[0-9]{6}$"}

EVIDENCE_SCHEMA: Final[dict[str, Any]] = {
    "type": "array",
    "minItems": 1,
    "maxItems": 1,
    "items": closed_object(
        {
            "frame_id": FRAME_ID_SCHEMA,
            CONTRACT_KEY: BOX_SCHEMA,
        }
    ),
}


def answer_schema(mode: AnswerMode, choices: Sequence[str]) -> dict[str, Any]:
    """The JSON Schema of `answer` in a mode."""
    number = {"type": "number"}
    decimal = {"type": "string", "pattern": r"^-?[0-9]+(\.[0-9]+)?$"}
    match mode:
        case "multiple_choice":
            return {"type": "integer", "minimum": 1, "maximum": len(choices)}
        case "frame":
            return closed_object({"frame_id": FRAME_ID_SCHEMA})
        case "span":
            return closed_object({"start_frame": FRAME_ID_SCHEMA, "end_frame": FRAME_ID_SCHEMA})
        case "frame_viewpoint":
            return closed_object({"frame_id": FRAME_ID_SCHEMA, "angle_deg": number})
        case "number":
            return closed_object({"value": decimal})
