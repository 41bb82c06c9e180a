"""The policy `guided`: the model picks one of the looks that attention proposes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.methods.requests import heading
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.look.attention import NextLook
from jrdb_avr.agent.look.ranking import RankedHypothesis
from jrdb_avr.schema.errors import DecodeError

MOST_LOOKS: Final = 3
"""Looks to pick from."""

PICK_LINE: Final = "Your choice of look, as one JSON object:"
_SCHEMA: Final = decode.closed_object({"look": {"type": "integer"}})


def pick_look(attempt: Attempt, looks: Sequence[NextLook], best: RankedHypothesis | None, left: int) -> NextLook:
    """The look that the model picks of at least two; the first where neither of two replies can be read.

    best: the likeliest hypothesis, None where nobody was seen; left: looks that may still be made.
    """
    lines = [
        heading(attempt.task.question),
        f"Looks left: {left}",
        f"Most likely so far: {json.dumps({} if best is None else dict(best.nodes))}",
        *(f"Look {number}: {_described(look)}" for number, look in enumerate(looks, 1)),
    ]

    def messages(faults: Sequence[str]) -> list[Message]:
        text = "\n".join((*lines, *faults, PICK_LINE))
        return [Message("system", (render("agent_guided"),)), Message("user", (text,))]

    try:
        return looks[attempt.ask_twice(messages, _SCHEMA, lambda reply: _read(reply, len(looks))) - 1]
    except DecodeError:
        return looks[0]


def _described(look: NextLook) -> str:
    return json.dumps({"frame_id": f"{look.frame:06d}", "angle_deg": round(look.angle, 1), "to": look.purpose})


def _read(reply: Mapping[str, Any], count: int) -> int:
    number = decode.only_keys(reply, ("look",), "the reply")["look"]
    if type(number) is not int or not 1 <= number <= count:
        raise DecodeError(f"look must be a number from 1 to {count}")
    return number
