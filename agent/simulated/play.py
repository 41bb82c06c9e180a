"""The stages that the marker plays, by the last line of a request.

The marker's ReAct turns: the next look, or the answer with the person's box in the newest picture.

The marker's plans: what the question's words say, as the one template table reads them.

The marker plays the methods with a fixed context: it answers from the pictures that it was given.

Few of the panoramas show a moment that the question names. Somebody is sought in the one nearest to the description,
events lie between two panoramas, and where nothing tells the marker guesses, as the contract demands an answer. A box
is always that of somebody who was read.

The marker's turns as the reference agent: which of the variants a request belongs to.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.policy.explorer import Eyes, Spent, Want
from jrdb_avr.agent.policy.finding import likely
from jrdb_avr.agent.policy.game import Game
from jrdb_avr.agent.policy.policy import find_target, read_answer
from jrdb_avr.agent.simulated.play_agent import chat, remember, remember_shown
from jrdb_avr.agent.simulated.requests import Look, Play, Request, Sighting, Turn
from jrdb_avr.agent.simulated.shown import Shown
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import CROP, Box, from_crop, iou

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


PLAN: Final = "Your plan, as one JSON object:"


def plan(request: Request) -> Turn:
    """The question's plan; a plan that was refused is said again, as there is no other reading of the words."""
    return Turn(msgspec.to_builtins(request.plan))


ANSWER: Final = "Your answer, as one JSON object:"
FACTS: Final = "Your facts, as one JSON object:"
PLACE: Final = "Where the person is, as one JSON object:"
BOX: Final = "The person's box in the crop, as one JSON object:"
CHOICE: Final = "Your choice of answer, as one JSON object:"

_MOST_FACTS: Final = 12


def answer_at_once(request: Request) -> Turn:
    """Answer and box from the panoramas; facts that were written down before say no more than these."""
    game, person = _found(request)
    answer = read_answer(game, person)
    return Turn({"answer": answer, "evidence_bboxes": _evidence_baselines(game.eyes.looks, person)}, game.missing)


def write_facts(request: Request) -> Turn:
    """What the panoramas show of the person whom the question asks about."""
    game, person = _found(request)
    facts = [_seen(seen) for seen in sorted(_everywhere(game.eyes.looks, person), key=lambda seen: seen.frame)]
    facts += [f"What could not be made out: {reason}." for reason in game.missing]
    return Turn({"reasoning": facts[:_MOST_FACTS] or ["Nobody in the pictures fits the description."]})


def propose(request: Request) -> Turn:
    """The person's box in one of the panoramas."""
    game, person = _found(request)
    evidence = _evidence_baselines(game.eyes.looks, person)
    return Turn({"evidence_bboxes": evidence}, None if evidence else game.missing)


def refine(request: Request) -> Turn:
    """The person's box in the crop, which was centred on the box proposed before.

    That is whoever fits best there or, where the description tells no more, who stands nearest to the middle.
    """
    crop = next((look for look in request.looks if not look.panorama), None)
    if crop is None:
        raise DecodeError("the prompt shows no crop")
    game = Game(request.plan, request.choices, Shown((crop,)))
    people = sorted(crop.sightings, key=lambda seen: abs(seen.box.x + seen.box.w / 2 - crop.width / 2))
    person = people[0] if people else None
    if people and not request.plan.edges:
        root = request.plan.nodes[0]
        person = likely(root.conditions, people, exact=crop.frame == game.t0) or person
    if person is None:
        game.note("mark unreadable: nobody in the crop")
    evidence = _evidence_baselines((crop,), person)
    return Turn({"evidence_bboxes": evidence}, None if evidence else game.missing)


def choose(request: Request) -> Turn:
    """The answer, read of the person in the refined box."""
    game = Game(request.plan, request.choices, Shown(request.looks))
    box = _refined(request)
    seen = [
        (iou(box, _stitched(look, seen.box)), look.panorama, seen) for look in request.looks for seen in look.sightings
    ]
    overlap, _, person = max(seen, key=lambda found: found[:2], default=(0.0, False, None))
    if overlap <= 0:
        person = None
        game.note("mark unreadable: nobody in the refined box")
    game.note_unseen()
    return Turn({"answer": read_answer(game, person)}, game.missing)


# -- parts ------------------------------------------------------------------------------------------------------------


def _found(request: Request) -> tuple[Game, Sighting | None]:
    game = Game(request.plan, request.choices, Shown(request.looks))
    person = find_target(game)
    game.note_unseen()
    return game, person


def _everywhere(looks: Sequence[Look], person: Sighting | None) -> list[Sighting]:
    """The person in every picture that shows it."""
    found = () if person is None else (look.of(person.mark.identity) for look in looks)
    return [seen for seen in found if seen is not None]


def _evidence_baselines(looks: Sequence[Look], person: Sighting | None) -> list[dict[str, Any]]:
    """The person's box where it was recognized or, where a picture's edge cuts it there, in a picture nearby.

    Of a person over the seam of a panorama the larger part.
    """
    seen = [
        (not seen.whole, abs(seen.frame - person.frame), look, seen)
        for look in looks
        if person is not None and (seen := look.of(person.mark.identity)) is not None
    ]
    if not seen:
        return []
    _, _, look, best = min(seen, key=lambda found: found[:2])
    x = best.box.x
    if look.panorama:
        x -= look.width * ((x + best.box.w / 2) // look.width)
    box = write_box(best.box._replace(x=x), look.width, look.height)
    return [{"frame_id": f"{best.frame:06d}", "bbox": box}]


def _refined(request: Request) -> Box:
    """The box of the line `Refined box, ...`, in stitched pixels. Raises DecodeError where it is not there."""
    text = request.line("Refined box, stitched pixels: ") or ""
    try:
        return Box(*msgspec.json.decode(text, type=tuple[float, float, float, float]))
    except msgspec.DecodeError:
        raise DecodeError("the prompt has no refined box of four numbers") from None


def _stitched(look: Look, box: Box) -> Box:
    return box if look.panorama else from_crop(box, look.left)


def _seen(seen: Sighting) -> str:
    """One sighting in a sentence."""
    mark = seen.mark
    told = [
        mark.gender,
        mark.age,
        mark.pose,
        *mark.actions,
        None if mark.interaction is None else f"{mark.interaction} with somebody",
        None if mark.object is None or mark.verb is None else f"{mark.verb} {mark.object}",
        None if mark.distance_dm is None else f"{mark.distance_dm / 10:g} m away",
    ]
    what = ", ".join(text for text in told if text) or "no more can be told"
    return f"Frame {seen.frame:06d}: the person stands at panorama angle {seen.angle:.0f}: {what}."


CALLS: Final = "Your next calls, as one JSON object:"


def agency(request: Request) -> Turn:
    """A turn with the graph, or with the chat in its place; with looks, or with panoramas in theirs."""
    if request.line("Plan: ") is None:
        return chat(request)
    return remember_shown(request) if any(look.panorama for look in request.looks) else remember(request)


STAGES: Final[dict[str, Play]] = {
    ANSWER: answer_at_once,
    FACTS: write_facts,
    PLACE: propose,
    BOX: refine,
    CHOICE: choose,
    REACT: react,
    PLAN: plan,
    CALLS: agency,
}
