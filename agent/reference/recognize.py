"""Recognition by the model: which of the people read in a picture is a person of an earlier one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.model.messages import Message, Part, metadata_line, picture_of
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.perceive.association import NOBODY
from jrdb_avr.agent.perceive.readings import PersonReading
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation
from jrdb_avr.schema.panorama import CROP, Box

SAME_LINE: Final = "Which of them is the person, as one JSON object:"
_SCHEMA: Final = decode.closed_object({"person": {"type": ["integer", "null"]}})


def recognize(
    attempt: Attempt, known: PersonReading, then: Observation, seen: Observation, people: Sequence[PersonReading]
) -> int | None:
    """The number of whoever of the people read in a picture is a known one, read in an earlier picture.

    `NOBODY` where it is none of them; None where the model cannot tell, or neither of two replies can be read.
    """
    boxes = [_inside(one, seen) for one in people]
    user: tuple[Part, ...] = (
        *(f"Picture 1: {metadata_line(then)}", picture_of(then)),
        *(f"Picture 2: {metadata_line(seen)}", picture_of(seen)),
        f"Person in picture 1: {json.dumps(_inside(known, then))}",
        f"People in picture 2: {json.dumps({str(one.number): box for one, box in zip(people, boxes, strict=True)})}",
    )

    def messages(faults: Sequence[str]) -> list[Message]:
        return [Message("system", (render("agent_same"),)), Message("user", (*user, *faults, SAME_LINE))]

    try:
        return attempt.ask_twice(messages, _SCHEMA, lambda reply: _read(reply, [one.number for one in people]))
    except DecodeError:
        return None


def _inside(one: PersonReading, seen: Observation) -> list[int]:
    return write_box(Box(one.box.x - seen.left, *one.box[1:]), (CROP, CROP))


def _read(reply: Mapping[str, Any], numbers: Sequence[int]) -> int | None:
    number = decode.only_keys(reply, ("person",), "the reply")["person"]
    if number is None:
        return None
    # Of people with one box none is left, so that numbers may be missing.
    if type(number) is not int or number not in (NOBODY, *numbers):
        raise DecodeError(f"person must be one of {', '.join(map(str, (NOBODY, *numbers)))}, or null")
    return number
