"""Search in time: when an action starts and ends, what comes next, how long somebody is away, who is met.

A search proceeds as a person would: it steps until the change has been passed, and then closes in on it. It does not
use the thresholds of the question's rules. A search that runs out of looks returns the best it has and notes why.
"""

from __future__ import annotations

from typing import Final

from jrdb_avr.agent.policy.explorer import AROUND, NEARBY, Sighting
from jrdb_avr.agent.policy.hops import look_round, related
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.rules import frames as frames_in

_STEP: Final = frames_in(2.0)
"""The action of a question lasts two seconds at least, so steps of two seconds meet it."""

_WAIT: Final = frames_in(3.0)
"""The moment of a question lies three seconds after the description, or more."""

_LONG: Final = frames_in(10.0)
"""A posture whose end a question waits for lasts ten seconds at least."""

_CLOSE_SPAN_FRAMES: Final = 14
"""Both ends of a span count together, and it may last two seconds only."""

_CLOSING_LOOKS: Final = 2

_EARLY: Final = 0.5
"""Steps of a search are this share of even ones: the moment comes sooner rather than late."""

_SIDEWAYS: Final = 3
"""Of so many tries without success, the first also looks to the sides."""

_ABSENCE_S: Final = 10.0
"""The guess for an absence that was not seen."""


def performs(action: str, seen: Sighting) -> bool:
    """Whether a sighting shows an action or a pose."""
    return action == seen.mark.pose if action in POSES else action in seen.mark.actions


def _probe(state: EpisodeState, person: Sighting, action: str, frame: float) -> bool | None:
    """Whether the person performs the action at a frame; None where not seen near the expected place."""
    turns = NEARBY if state.misses % _SIDEWAYS == 0 else NEARBY[:1]
    seen = state.explorer.follow(person.identity, frame, turns)
    state.misses = 0 if seen is not None else state.misses + 1
    if seen is None:
        state.note(f"mark unreadable at frame {state.explorer.legal(frame)}")
        return None
    return performs(action, seen)


def find_start(
    state: EpisodeState, person: Sighting | None, t0: int | None = None, event: int = 0, close: int | None = None
) -> tuple[float, int | None]:
    """The moment at which an action starts, and a frame at which it was seen after that (None if it never was).

    `t0` is the frame to search from, by default that of the description. `event` counts the starts that the question
    names; `close` replaces the state's number of frames to which the moment is to be known.
    """
    t0 = state.t0 if t0 is None else t0
    last = state.explorer.frames[-1]
    guess = (t0 + _WAIT + last) / 2
    action = [time.action for _, time in sorted(state.plan.times.items()) if time.event == "start"][event]
    if person is None or action is None:
        return guess, None
    before, after = min(t0 + _WAIT, last) - 1, None
    with state.budget("the start was not closed in on"):
        before, after = _first_seen(state, person, action, before, last)
        if after is None:
            state.note("mark unreadable, or the steps were too wide: the action was never seen")
            return guess, None
        before, after = _close_in(state, person, action, before, after, close or state.close, wanted=True)
    sightings = [seen for seen in state.explorer.sightings(person.identity) if seen.frame > t0]
    first = min((seen.frame for seen in sightings if performs(action, seen)), default=None)
    if first is None:
        return guess, None
    unseen = [seen.frame for seen in sightings if seen.frame < first]
    return (max([*unseen, before if before < first else t0]) + first) / 2, first


def _first_seen(state: EpisodeState, person: Sighting, action: str, begin: int, last: int) -> tuple[int, int | None]:
    """Step from `begin` on: (last probed frame without the action, first one with it)."""
    before, frame = begin, begin + 1
    while frame <= last:
        performed, at = _probe(state, person, action, frame), state.explorer.legal(frame)
        # A fixed context may hold no picture between the description and here.
        if performed and at >= begin:
            return before, at
        if performed is False:
            before = max(before, at)
        if frame == last:
            break
        looks = max(state.explorer.spare() - _CLOSING_LOOKS, 1)
        frame = min(frame + max(_STEP, round(_EARLY * (last - frame) / looks)), last)
    return before, None


def _close_in(
    state: EpisodeState, person: Sighting, action: str, low: int, high: int, close: int, *, wanted: bool
) -> tuple[int, int]:
    """Halve (low, high] until the change from not `wanted` to `wanted` is known to `close` frames, or not readable."""
    while high - low > close:
        for share in (0.5, 0.35):
            middle = state.explorer.legal(low + share * (high - low))
            if not low < middle < high:
                return low, high
            performed = _probe(state, person, action, middle)
            if performed is not None:
                break
        else:
            return low, high
        low, high = (low, middle) if performed is wanted else (middle, high)
    return low, high


def find_span(state: EpisodeState, person: Sighting | None) -> tuple[float, float]:
    """The moments at which an action starts and ends."""
    start, inside = find_start(state, person, close=_CLOSE_SPAN_FRAMES)
    last = state.explorer.frames[-1]
    if person is None or inside is None:
        return start, min(start + 2 * _STEP, last)
    action = next(time.action for time in state.plan.times.values() if time.event == "start")
    assert action is not None, "a start names its action"
    frame, during, after = inside, inside, None
    with state.budget("the end was not closed in on"):
        while frame < last and after is None:
            frame = min(frame + _STEP, last)
            performed = _probe(state, person, action, frame)
            if performed:
                during = state.explorer.legal(frame)
            elif performed is False:
                after = state.explorer.legal(frame)
        if after is not None:
            during, after = _close_in(state, person, action, during, after, _CLOSE_SPAN_FRAMES, wanted=False)
    return start, (during + after) / 2 if after is not None else during


def find_next_pose(state: EpisodeState, person: Sighting | None) -> str | None:
    """The first other pose in which the person is seen after holding that of t0 for a while."""
    if person is None:
        return None
    explorer, last, frame = state.explorer, state.explorer.frames[-1], state.t0 + _LONG
    step = max(_STEP, -(-(last - frame) // max(explorer.spare(), 1)))
    with state.budget("no other posture was seen"):
        for at in range(frame, last + 1, step):
            seen = explorer.follow(person.identity, at, NEARBY)
            if seen is None:
                state.note(f"mark unreadable at frame {explorer.legal(at)}")
            elif seen.mark.pose not in (None, person.mark.pose):
                return seen.mark.pose
    return None


def find_seconds(state: EpisodeState, person: Sighting | None) -> float:
    """Seconds between two starts, or from leaving the view to coming back."""
    if any(time.event == "start" for time in state.plan.times.values()):
        first, begun = find_start(state, person)
        second, _ = find_start(state, person, None if begun is None else max(begun - _WAIT, state.t0), event=1)
        return max((second - first) / FPS, 1.0)
    return _ABSENCE_S if person is None else _absence(state, person)


def _absence(state: EpisodeState, person: Sighting) -> float:
    """Length of the first absence after t0: follow the person until absent, and then until back."""
    explorer, last = state.explorer, state.explorer.frames[-1]
    there, gone, frame = state.t0, None, state.t0 + _WAIT
    with state.budget("the person was not seen coming back"):
        while frame <= last:
            seen = explorer.follow(person.identity, frame, NEARBY)
            if seen is None:
                gone = explorer.legal(frame) if gone is None else gone
            elif gone is None:
                there = seen.frame
            else:
                return max((seen.frame + explorer.legal(frame - _WAIT) - there - gone) / 2 / FPS, 1.0)
            frame += _WAIT
    return max((frame - there) / FPS, 1.0) if gone is not None else _ABSENCE_S


def count_people(state: EpisodeState, person: Sighting | None) -> int:
    """How many different people are seen to have the relation between the two stated times."""
    begin, end = (state.frame_of(name) for name in state.plan.answer.times)
    relation = state.plan.answer.relation
    found: set[int] = set()
    rounds = max(state.explorer.spare() // (len(AROUND) + len(NEARBY)), 2)
    if person is None or relation is None:
        return 1
    with state.budget("not all of the time was looked at"):
        for frame in range(begin, end + 1, max(_STEP, (end - begin) // rounds)):
            own = state.explorer.follow(person.identity, frame, NEARBY)
            people = [] if own is None else look_round(state.explorer, own.frame)
            others = [seen for seen in people if seen.identity != person.identity]
            found |= {seen.identity for seen in others if own and related(relation, own, seen, people)}
    return max(len(found), 1)
