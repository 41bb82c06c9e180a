"""Play the turns of an agent without a world model: all pictures so far are in the chat."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.policy.explorer import FixedExplorer, Look, NeedObservation, RestoredExplorer, Sighting
from jrdb_avr.agent.policy.policy import find_answer, find_target
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.agent.simulated.play_tools import tools_turn
from jrdb_avr.agent.simulated.requests import Request, StageReply

_REFUSED: Final = re.compile(r"\d+\. final_answer: refused")


def agent_turn(request: Request) -> StageReply:
    """Play a turn of an agent, with or without a world model."""
    if request.line("World: ") is not None:
        return tools_turn(request)
    return _chat(request, any(look.panorama for look in request.looks))


def _chat(request: Request, passive: bool) -> StageReply:
    """The next look, or the final answer."""
    explorer: FixedExplorer | RestoredExplorer
    if passive:
        explorer = FixedExplorer(request.looks)
    else:
        left, rounds = request.left("Looks made: "), len(request.plan.answer.times)
        explorer = RestoredExplorer(request.legal(), request.looks, left, rounds=rounds)
    state = EpisodeState(request.plan, request.choices, explorer, beside=not passive)
    try:
        person = find_target(state)
        answer = find_answer(state, person)
        if passive:
            state.note_unseen()
        box = _evidence(state, person)
    except NeedObservation as need:
        return StageReply({"calls": [_observe(need.frame, need.angles[0])]})
    refused = any(_REFUSED.match(line) for line in request.lines)
    calls = [{"tool": "final_answer", "answer": answer, **box}]
    return StageReply({"calls": calls}, None if refused else state.missing)


def _evidence(state: EpisodeState, person: Sighting | None) -> dict[str, Any]:
    """Observation and box of a look that shows the person whole, the newest of them; looks once more for one.

    No box where the person was never found: the call is refused, and the question ends with an answer alone.
    """
    if person is None:
        return {"observation": state.explorer.looks[-1].name, "box": []}
    look, seen = _newest(state.explorer.looks, person.identity)
    if not seen.whole:
        with state.budget("no look was left to show the person again"):
            again = state.explorer.again(seen.frame, seen.angle)
            look, seen = (again, better) if (better := again.of(person.identity)) else (look, seen)
    return {"observation": look.name, "box": write_box(look.box_inside(seen), look.size)}


def _newest(looks: Sequence[Look], identity: int) -> tuple[Look, Sighting]:
    found = [(look, seen) for look in reversed(looks) if (seen := look.of(identity)) is not None]
    return max(found, key=lambda entry: entry[1].whole)


def _observe(frame: int, angle: float) -> dict[str, Any]:
    return {"tool": "observe", "frame_id": f"{frame:06d}", "angle_deg": round(angle % 360.0, 3)}
