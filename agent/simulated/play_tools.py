"""Play the turns of an agent with a world model: write what new pictures show, look on, and answer by the graph."""

from __future__ import annotations

import re
from typing import Any, Final

import msgspec

from jrdb_avr.agent.simulated.fields import NEAREST, START, describe, read_fields
from jrdb_avr.agent.simulated.requests import Look, PlayedReply, Request
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import angle_error

_AROUND: Final = tuple(45.0 * eighth for eighth in range(8))
"""Angles of the looks that show a whole frame, in degrees."""


class _Supported(msgspec.Struct):
    answer: Any
    entity: str


class _World(msgspec.Struct):
    people: dict[str, str] = {}
    open: list[str] = []
    supported: _Supported | None = None
    looks: dict[str, list[float]] = {}


# Made at import, because threads that create the decoder of a type at the same time crash it.
_WORLD: Final = msgspec.json.Decoder(_World)
_LOOKS: Final = msgspec.json.Decoder(list[Any])
_WRITTEN: Final = re.compile(r"\d+\. add_people: (o\d+): ")


def tools_turn(request: Request) -> PlayedReply:
    """Play a turn.

    Args:
        request: The request, which has the lines `World`, `Fields` and, with advice, `Looks`.

    Returns:
        The calls.

    Raises:
        DecodeError: If a line is missing or cannot be read.
    """
    world, advised = _lines(request)
    passive = any(look.panorama for look in request.looks)
    written = {found[1] for line in request.lines if (found := _WRITTEN.match(line))}
    calls = [_add_people(request, look) for look in request.looks if look.name not in written]
    look = None if passive else _next_look(request, world, advised)
    if look is not None:
        return {"calls": [*calls, look]}
    if calls:
        # The answer that the graph supports is known after these writes.
        return {"calls": calls}
    return {"calls": [_final(request, world)]}


def _lines(request: Request) -> tuple[_World, list[Any] | None]:
    """Return the content of the lines `World` and `Looks`. The second is None without advice."""
    looks = request.line("Looks: ")
    try:
        return _WORLD.decode(request.line("World: ") or ""), None if looks is None else _LOOKS.decode(looks)
    except msgspec.DecodeError as error:
        raise DecodeError(f"the line World or Looks cannot be read: {error}") from None


def _add_people(request: Request, look: Look) -> dict[str, Any]:
    """Write the people of a picture, the nearest first."""
    people = sorted(look.people, key=lambda person: -person.box.h)[:NEAREST]
    said = describe(people, read_fields(request.line(START) or ""), look.view.size)
    listed = [{"id": entity, **value} for entity, value in said.items()]
    return {"tool": "add_people", "observation": look.name, "people": listed}


def _next_look(request: Request, world: _World, advised: list[Any] | None) -> dict[str, Any] | None:
    """Return the next look, or None if no further look helps."""
    if not request.left("Looks made: "):
        return None
    if advised is not None:
        return {"tool": "observe"} if advised else None
    # Without advice, look round at the times of the plan in turn.
    frames = [time.frame for time in request.plan.times.values() if time.frame is not None]
    legal = request.legal()
    for frame in dict.fromkeys(min(legal, key=lambda other: abs(other - at)) for at in frames):
        made = world.looks.get(f"{frame:06d}", [])
        for angle in _AROUND:
            if all(float(angle_error(angle, other)) > 1.0 for other in made):
                return {"tool": "observe", "frame_id": f"{frame:06d}", "angle_deg": angle}
    return None


def _final(request: Request, world: _World) -> dict[str, Any]:
    """Return the final answer that the graph supports, or a guess."""
    if world.supported is not None:
        return {"tool": "final_answer", "answer": world.supported.answer, "entity": world.supported.entity}
    return {"tool": "final_answer", "answer": request.guess(), "entity": next(iter(world.people), "p1")}
