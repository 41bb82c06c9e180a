"""Answer a question by looking: find the person, then read the answer.

A read that meets something unreadable, or runs out of looks, returns the best it has and notes why.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from jrdb_avr.agent.policy.explorer import AROUND, NEARBY, BudgetExhausted, Sighting
from jrdb_avr.agent.policy.finding import find, likely
from jrdb_avr.agent.policy.hops import look_round, path
from jrdb_avr.agent.policy.searches import count_people, find_next_pose, find_seconds, find_span, find_start, performs
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP

_BESIDE: Final = (KEYFRAME_STEP, -KEYFRAME_STEP)
"""Frames away at which somebody who is hidden is looked for."""

_CHANGED_M: Final = 1.0
"""Least change of distance, in metres, that counts as closer or farther."""


def find_target(state: EpisodeState) -> Sighting | None:
    """The person of the question at the time of the description; None where not found."""
    try:
        described = _described(state, state.description)
        if described is None or not state.plan.edges:
            return described
        people = look_round(state.explorer, described.frame)
        if state.plan.answer.read == "action":
            people = [*people, *_hidden(state, described.frame)]
    except BudgetExhausted:
        state.note("budget: not everybody near the person was seen")
        return None
    person = path(state.plan, described, people).get(state.plan.target)
    if person is None:
        state.note("mark unreadable: a hop leads to nobody, or to several")
    return person


def _described(state: EpisodeState, conditions: Sequence[Condition]) -> Sighting | None:
    """The person of the description, or the best guess among the people seen."""
    explorer, frame = state.explorer, state.explorer.legal(state.t0)
    found = find(conditions, frame, explorer)
    state.note(found.missing)
    if found.sighting is not None:
        return found.sighting
    exact = frame == state.t0
    people = explorer.at(frame)
    guess = likely(conditions, people, exact=exact)
    if guess is None and exact:
        guess = likely(conditions, _hidden(state, frame), exact=True)
    if guess is not None:
        return guess
    # Somebody hidden then may be seen at another time. The people seen then are known not to fit.
    known = {seen.identity for seen in people} if exact else set()
    for other in sorted({look.frame for look in explorer.looks}, key=lambda other: (abs(other - frame), other)):
        hidden = [seen for seen in explorer.at(other) if seen.identity not in known]
        if (guess := likely(conditions, hidden, exact=False)) is not None:
            return guess
    return None


def _hidden(state: EpisodeState, frame: int) -> list[Sighting]:
    """The people seen a second after a frame and not at it; nobody where looks are short."""
    explorer = state.explorer
    if not state.beside or explorer.spare() < len(AROUND) + len(NEARBY):
        return []
    seen = {person.identity for person in explorer.at(frame)}
    return [p for p in look_round(explorer, explorer.legal(frame + KEYFRAME_STEP)) if p.identity not in seen]


def find_answer(state: EpisodeState, person: Sighting | None) -> Any:
    """The contract's `answer` for the person found; a guess where there is none."""
    match state.plan.answer.read:
        case "action":
            return state.choose(_action(state, person), _offered_actions(state, person))
        case "presence":
            return state.choose(_presence(state, person))
        case "distance_change":
            return state.choose(_distance(state, person))
        case "next_action":
            return state.choose(find_next_pose(state, person), (person.mark.pose,) if person else ())
        case "start":
            return answer_of_moments(state, find_start(state, person)[0])
        case "span":
            return answer_of_moments(state, *find_span(state, person))
        case "start_view":
            start, _ = find_start(state, person)
            angle = 180.0 if person is None else state.explorer.nearest(person.identity, start).angle
            return {**answer_of_moments(state, start), "angle_deg": round(angle, 1)}
        case "seconds_between":
            return {"value": f"{find_seconds(state, person):.1f}"}
        case "count":
            return {"value": str(count_people(state, person))}


def answer_of_moments(state: EpisodeState, *moments: float) -> dict[str, str]:
    """The contract's `answer` for events at these frames, but for an angle."""
    ids = [f"{min(max(round(moment), 0), state.explorer.frames[-1]):06d}" for moment in moments]
    match state.plan.answer.read:
        case "span":
            return {"start_frame": ids[0], "end_frame": ids[1]}
        case "seconds_between":
            return {"value": f"{max((moments[1] - moments[0]) / FPS, 1.0):.1f}"}
    return {"frame_id": ids[0]}


# -- reads of one moment ----------------------------------------------------------------------------------------------


def _seen_at(state: EpisodeState, person: Sighting, name: str, reserve: int = 0) -> Sighting | None:
    """The person at a stated time, all round if need be; notes why where not seen.

    Somebody hidden then is looked for a second away, as long as more than `reserve` looks are left.
    """
    explorer, frame = state.explorer, state.frame_of(name)
    if frame == state.t0 and person.frame != frame:
        # The policy looked for everybody then, and this person was hidden.
        return person
    try:
        seen = explorer.follow(person.identity, frame, AROUND)
        for offset in _BESIDE if state.beside else ():
            if seen is None and explorer.spare() >= reserve + len(NEARBY):
                seen = explorer.follow(person.identity, frame + offset, NEARBY)
    except BudgetExhausted:
        state.note(f"budget: {name} was not looked at all round")
        return None
    if seen is None:
        state.note(f"mark unreadable, or absent, at {name}")
    return seen


def _action(state: EpisodeState, person: Sighting | None) -> str | None:
    seen = person and _seen_at(state, person, state.plan.answer.times[0])
    return next(iter(_offered_actions(state, seen)), None)


def _offered_actions(state: EpisodeState, seen: Sighting | None) -> list[str]:
    """The offered actions that a sighting shows."""
    return [action for action in state.offered if seen is not None and performs(action, seen)]


def _presence(state: EpisodeState, person: Sighting | None) -> str | None:
    if person is None:
        return None
    first, second = state.plan.answer.times
    at_first = _seen_at(state, person, first, len(AROUND)) is not None
    at_second = _seen_at(state, person, second) is not None
    both, only_first, only_second, neither = PRESENCE_ANSWERS
    return (both if at_second else only_first) if at_first else (only_second if at_second else neither)


def _distance(state: EpisodeState, person: Sighting | None) -> str | None:
    if person is None or person.mark.distance_dm is None:
        return None
    closer, farther, same, unseen = DISTANCE_ANSWERS
    later = _seen_at(state, person, state.plan.answer.times[1])
    if later is None:
        return unseen
    if later.mark.distance_dm is None:
        return None
    change = (later.mark.distance_dm - person.mark.distance_dm) / 10
    return same if abs(change) < _CHANGED_M else (farther if change > 0 else closer)
