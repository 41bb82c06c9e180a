"""JSON Schemas of the parts of a reply: frame ids, the box of the evidence, and the answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.agent.model.conventions import CONTRACT_KEY
from jrdb_avr.agent.model.decode import BOX_SCHEMA, closed_object
from jrdb_avr.schema.answer_modes import MODES, Kind
from jrdb_avr.schema.answers import AnswerMode

FRAME_ID_SCHEMA: Final[dict[str, Any]] = {"type": "string", "pattern": "^[0-9]{6}$"}
"""Schema of a frame id if the legal frames are not known."""

MOST_LISTED: Final = 200
"""Maximum number of frames that a schema lists. Servers compile a long list slowly, or refuse it."""


def frame_schema(frames: Sequence[int]) -> dict[str, Any]:
    """Return the JSON Schema of the id of a legal frame.

    Args:
        frames: The legal frames, ascending.

    Returns:
        The list of the ids. If there are more than `MOST_LISTED`: six digits, from 0 to the last frame.

    >>> frame_schema(range(235))["pattern"]
    '^(000[0-1][0-9][0-9]|0002[0-2][0-9]|00023[0-3]|000234)$'
    """
    if len(frames) <= MOST_LISTED:
        return {"type": "string", "enum": [f"{frame:06d}" for frame in frames]}
    last = f"{frames[-1]:06d}"
    lower = [f"{last[:i]}[0-{int(d) - 1}]{'[0-9]' * (5 - i)}" for i, d in enumerate(last) if d != "0"]
    return {"type": "string", "pattern": f"^({'|'.join([*lower, last])})$"}


def evidence_schema(frame: Mapping[str, Any] = FRAME_ID_SCHEMA) -> dict[str, Any]:
    """Return the JSON Schema of the `evidence_bboxes` part of a reply.

    Args:
        frame: The schema of the box's frame id.

    Returns:
        The schema.
    """
    items = closed_object({"frame_id": frame, CONTRACT_KEY: BOX_SCHEMA})
    return {"type": "array", "minItems": 1, "maxItems": 1, "items": items}


def answer_schema(mode: AnswerMode, choices: Sequence[str], frames: Sequence[int]) -> dict[str, Any]:
    """Return the JSON Schema of the `answer` part of a reply.

    Args:
        mode: The question's answer mode.
        choices: The question's choices.
        frames: The frames that an answer may name, ascending.

    Returns:
        The schema.
    """
    record = MODES[mode]
    if record.is_choice:
        return {"type": "integer", "minimum": 1, "maximum": len(choices)}
    schemas: dict[Kind, dict[str, Any]] = {
        "frame": frame_schema(frames),
        "angle": {"type": "number"},
        "decimal": {"type": "string", "pattern": r"^-?[0-9]+(\.[0-9]+)?$"},
    }
    return closed_object({part.key: schemas[part.kind] for part in record.parts})
