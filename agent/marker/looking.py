"""The marker's ReAct turns: the next look, or the answer with the person's box in the newest picture."""

from __future__ import annotations

from typing import Any, Final

from jrdb_avr.schema.panorama import CROP

from ..boxes import write_box
from .eyes import Eyes, Spent, Want
from .game import Game
from .policy import find_target, read_answer
from .reading import Request, Sighting
from .turn import Turn

REACT: Final = "Your next turn, as one JSON object:"

_LEFT: Final = r"\d+, left: (\d{1,9})$"


def react(request: Request) -> Turn:
    """A turn of ReAct. Raises DecodeError where the prompt names no legal frame or no count of looks."""
    eyes = Eyes(request.legal(), request.looks, request.number("Looks made: ", _LEFT))
    game = Game(request.plan, request.choices, eyes, beside=True)
    try:
        person = find_target(game)
        answer = read_answer(game, person)
        evidence = _evidence(game, person)
    except Want as want:
        return Turn({"action": "observe", "frame_id": f"{want.frame:06d}", "angle_deg": round(want.angle, 3)})
    return Turn({"action": "answer", "answer": answer, "evidence_bboxes": evidence}, game.missing)


def _evidence(game: Game, person: Sighting | None) -> list[dict[str, Any]]:
    """The person's box in the newest picture; looks once more where that picture does not show it whole.

    Empty where the person was never found.
    """
    if person is None:
        return []
    identity = person.mark.identity
    newest = game.eyes.looks[-1]
    shown = newest.of(identity)
    if shown is None or not shown.whole:
        best = max(game.eyes.sightings(identity), key=lambda seen: (seen.whole, seen.frame))
        try:
            again = game.eyes.again(best.frame, best.angle).of(identity)
            shown = again or shown
        except Spent:
            game.note("budget: no look was left to show the person again")
    if shown is None:
        game.note("mark unreadable in the look that should show the person again")
        return []
    box = write_box(shown.box, CROP, CROP)
    return [{"frame_id": f"{shown.frame:06d}", "bbox": box}]
