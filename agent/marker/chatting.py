"""The marker plays the reference agent without a world model: all pictures so far are in the chat."""

from __future__ import annotations

from typing import Any

from .eyes import Eyes, Spent, Want
from .game import Game
from .memory import Memory
from .policy import find_target, read_answer
from .reading import Look, Request, Sighting
from .remembering import LEFT, refused
from .shown import Shown
from .turn import Turn
from .writing import placed


def chat(request: Request) -> Turn:
    """A turn of the chat: the next look, or the final answer. Raises DecodeError for a prompt that lacks a line."""
    if refused(request):
        return Turn({"calls": []}, ["the answer was refused"])
    passive = any(look.panorama for look in request.looks)
    eyes = Shown(request.looks) if passive else _eyes(request)
    game = Game(request.plan, request.choices, eyes, beside=not passive)
    try:
        person = find_target(game)
        answer = read_answer(game, person)
        if passive:
            game.note_unseen()
        box = _evidence(game, person)
    except Want as want:
        call = {"tool": "observe", "frame_id": f"{want.frame:06d}", "angle_deg": round(want.angle % 360.0, 3)}
        return Turn({"calls": [call]})
    return Turn({"calls": [{"tool": "final_answer", "answer": answer, **box}]}, game.missing)


def _eyes(request: Request) -> Eyes:
    left = request.number("Looks made: ", LEFT)
    return Memory(request.legal(), request.looks, left, rounds=len(request.plan.asked()))


def _evidence(game: Game, person: Sighting | None) -> dict[str, Any]:
    """Observation and box of a look that shows the person whole, the newest of them; looks once more for one.

    No box where the person was never found: the call is refused, and the question ends with an answer alone.
    """
    if person is None:
        return {"observation": game.eyes.looks[-1].name, "box": []}
    identity = person.mark.identity
    found = _newest(game.eyes.looks, identity)
    if not found[1].whole:
        try:
            again = game.eyes.again(found[1].frame, found[1].angle)
            seen = again.of(identity)
            found = (again, seen) if seen is not None else found
        except Spent:
            game.note("budget: no look was left to show the person again")
    return placed(*found)


def _newest(looks: list[Look], identity: int) -> tuple[Look, Sighting]:
    found = [(look, seen) for look in looks if (seen := look.of(identity)) is not None]
    return max(enumerate(found), key=lambda entry: (entry[1][1].whole, entry[0]))[1]
