"""How the marker model takes a question: find the person, then read what is asked.

A read that meets something unreadable, or runs out of looks, gives the best it has and notes why.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from jrdb_avr.agent.policy.explorer import AROUND, NEARBY, Spent
from jrdb_avr.agent.policy.finding import Found, find, likely
from jrdb_avr.agent.policy.game import Game
from jrdb_avr.agent.policy.hops import look_round, walk
from jrdb_avr.agent.policy.searches import angle_near, count_people, find_next_pose, find_seconds, find_span, find_start
from jrdb_avr.agent.simulated.requests import Sighting
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import KEYFRAME_STEP

_BESIDE: Final = (KEYFRAME_STEP, -KEYFRAME_STEP)
"""Frames away at which somebody who is hidden is looked for."""

_CHANGED_M: Final = 1.0
"""A change of distance from which on somebody is closer or farther, metres."""


def find_target(game: Game) -> Sighting | None:
    """The person whom the question asks about, as seen at the time of the description; None where not found."""
    root = next(node for node in game.plan.nodes if node.id == game.plan.root)
    try:
        described = _described(game, root.conditions)
        if described is None or not game.plan.edges:
            return described
        people = look_round(game.eyes, described.frame)
        if game.plan.answer.read == "action":
            people = [*people, *_hidden(game, described.frame)]
        person = walk(game.plan, described, people)
    except Spent:
        game.note("budget: not everybody near the person was seen")
        return None
    if person is None:
        game.note("mark unreadable: a hop leads to nobody, or to several")
    return person


def _described(game: Game, conditions: Sequence[Condition]) -> Sighting | None:
    """The person of the description, or the best guess among those who were seen."""
    frame = game.eyes.legal(game.t0)
    try:
        found = find(conditions, frame, game.eyes)
    except Spent:
        found = Found(None, "budget: the person was not found")
    if found.missing:
        game.note(found.missing)
    if found.sighting is not None:
        return found.sighting
    exact = frame == game.t0
    people = game.eyes.at(frame)
    guess = likely(conditions, people, exact=exact)
    if guess is None and exact:
        guess = likely(conditions, _hidden(game, frame), exact=True)
    if guess is not None:
        return guess
    # Somebody hidden then may be seen at another time. Who was seen then is known not to fit.
    known = {seen.mark.identity for seen in people} if exact else set()
    for other in sorted({look.frame for look in game.eyes.looks}, key=lambda other: (abs(other - frame), other)):
        hidden = [seen for seen in game.eyes.at(other) if seen.mark.identity not in known]
        if (guess := likely(conditions, hidden, exact=False)) is not None:
            return guess
    return None


def _hidden(game: Game, frame: int) -> list[Sighting]:
    """Who is seen a second after a frame and was not seen at it; nobody where looks are short."""
    if not game.beside or game.eyes.spare() < len(AROUND) + len(NEARBY):
        return []
    seen = {person.mark.identity for person in game.eyes.at(frame)}
    then = game.eyes.legal(frame + KEYFRAME_STEP)
    return [person for person in look_round(game.eyes, then) if person.mark.identity not in seen]


def read_answer(game: Game, person: Sighting | None) -> Any:
    """The contract's `answer` for the person that was found; a guess where there is none."""
    t0 = game.t0
    match game.plan.answer.read:
        case "action":
            return game.choose(_pose(game, person), person.mark.pose if person else None)
        case "presence":
            return game.choose(_presence(game, person))
        case "distance_change":
            return game.choose(_distance(game, person))
        case "start":
            start, _ = find_start(game, person, t0)
            return {"frame_id": _id(game, start)}
        case "span":
            start, end = find_span(game, person, t0)
            return {"start_frame": _id(game, start), "end_frame": _id(game, end)}
        case "start_view":
            start, _ = find_start(game, person, t0)
            return {"frame_id": _id(game, start), "angle_deg": angle_near(game, person, start)}
        case "next_action":
            return game.choose(find_next_pose(game, person, t0), person.mark.pose if person else None)
        case "seconds_between":
            return {"value": f"{find_seconds(game, person, t0):.1f}"}
        case "count":
            return {"value": str(count_people(game, person))}


def _id(game: Game, frame: float) -> str:
    return f"{min(max(round(frame), 0), game.eyes.frames[-1]):06d}"


# -- reads of one moment ----------------------------------------------------------------------------------------------


def _seen_at(game: Game, person: Sighting, name: str, keep: int = 0) -> Sighting | None:
    """The person at a stated time, all round if need be; notes why where it was not seen.

    Somebody who is hidden then is looked for a second away, as long as more than `keep` looks are left.
    """
    identity, frame = person.mark.identity, game.frame_of(name)
    if frame == game.t0 and person.frame != frame:
        # Everybody was looked for then, and this one was hidden.
        return person
    try:
        seen = game.eyes.follow(identity, frame, AROUND)
        for offset in _BESIDE if game.beside else ():
            if seen is None and game.eyes.spare() >= keep + len(NEARBY):
                seen = game.eyes.follow(identity, frame + offset, NEARBY)
    except Spent:
        game.note(f"budget: {name} was not looked at all round")
        return None
    if seen is None:
        game.note(f"mark unreadable, or absent, at {name}")
    return seen


def _pose(game: Game, person: Sighting | None) -> str | None:
    if person is None:
        return None
    seen = _seen_at(game, person, game.plan.answer.times[0])
    return None if seen is None else seen.mark.pose


def _presence(game: Game, person: Sighting | None) -> str | None:
    if person is None:
        return None
    names = game.plan.answer.times
    first = _seen_at(game, person, names[0], len(AROUND)) is not None
    second = _seen_at(game, person, names[1]) is not None
    both, only_first, only_second, neither = PRESENCE_ANSWERS
    return (both if second else only_first) if first else (only_second if second else neither)


def _distance(game: Game, person: Sighting | None) -> str | None:
    if person is None or person.mark.distance_dm is None:
        return None
    closer, farther, same, unseen = DISTANCE_ANSWERS
    later = _seen_at(game, person, game.plan.answer.times[1])
    if later is None:
        return unseen
    if later.mark.distance_dm is None:
        return None
    change = (later.mark.distance_dm - person.mark.distance_dm) / 10
    return same if abs(change) < _CHANGED_M else (farther if change > 0 else closer)
