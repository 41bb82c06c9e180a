"""Searches in time: when an action starts and ends, what comes next, how long somebody is away, who is met.

A moment is searched for as a person would: by stepping until the change has been passed, and then closing in on it.
Thresholds of the question's rules are not used. A search that runs out of looks gives the best it has and notes why.
"""

from __future__ import annotations

from typing import Final

from jrdb_avr.agent.policy.explorer import AROUND, NEARBY, Spent
from jrdb_avr.agent.policy.game import Game
from jrdb_avr.agent.policy.hops import look_round, related
from jrdb_avr.agent.simulated.requests import Sighting
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.rules import frames as frames_in

_STEP: Final = frames_in(2.0)
"""An action asked about lasts two seconds at least, so steps of two seconds meet it."""

_WAIT: Final = frames_in(3.0)
"""What is asked about lies three seconds after the description, or more."""

_LONG: Final = frames_in(10.0)
"""A posture that a question waits the end of lasts ten seconds at least."""

_CLOSE_SPAN_FRAMES: Final = 14
"""Both ends of a stretch count together, and it may last two seconds only."""

_CLOSING_LOOKS: Final = 2

_EARLY: Final = 0.5
"""Steps of a search are this share of even ones: what is asked about comes sooner rather than late."""

_SIDEWAYS: Final = 3
"""Somebody who was not seen is looked for to the sides at the first of so many tries."""


def does(action: str, seen: Sighting) -> bool:
    """Whether somebody was seen with an action, a pose or another."""
    return action == seen.mark.pose if action in POSES else action in seen.mark.actions


def _probe(game: Game, person: Sighting, action: str, frame: float) -> bool | None:
    """Whether the person performs the action at a frame; None where it was not seen near where it was expected."""
    turns = NEARBY if game.misses % _SIDEWAYS == 0 else NEARBY[:1]
    seen = game.eyes.follow(person.mark.identity, frame, turns)
    game.misses = 0 if seen is not None else game.misses + 1
    if seen is None:
        game.note(f"mark unreadable at frame {game.eyes.legal(frame)}")
        return None
    return does(action, seen)


def find_start(
    game: Game, person: Sighting | None, t0: int, event: int = 0, close: int | None = None
) -> tuple[float, int | None]:
    """The moment at which an action starts, and a frame at which it was seen after that (None if it never was).

    `event` counts the starts that the question names; `close` is to how many frames the moment is to be known,
    if not to those of the game.
    """
    last = game.eyes.frames[-1]
    guess = (t0 + _WAIT + last) / 2
    action = [time.action for _, time in sorted(game.plan.times.items()) if time.event == "start"][event]
    if person is None or action is None:
        return guess, None
    before, after = min(t0 + _WAIT, last) - 1, None
    try:
        before, after = _first_seen(game, person, action, before, last)
        if after is None:
            game.note("mark unreadable, or the steps were too wide: the action was never seen")
            return guess, None
        before, after = _close_in(game, person, action, before, after, close or game.close, wanted=True)
    except Spent:
        game.note("budget: the start was not closed in on")
    seen = sorted(_performed(game, person, action, t0 + 1))
    if not seen:
        return guess, None
    unseen = [frame for frame in _performed(game, person, action, t0 + 1, wanted=False) if frame < seen[0]]
    return (max([*unseen, before if before < seen[0] else t0]) + seen[0]) / 2, seen[0]


def _first_seen(game: Game, person: Sighting, action: str, begin: int, last: int) -> tuple[int, int | None]:
    """Steps from `begin` on: (last probed frame without the action, first one with it)."""
    before, frame = begin, begin + 1
    while frame <= last:
        performed, at = _probe(game, person, action, frame), game.eyes.legal(frame)
        # A fixed context may hold no picture between the description and here.
        if performed and at >= begin:
            return before, at
        if performed is False:
            before = max(before, at)
        if frame == last:
            break
        looks = max(game.eyes.spare() - _CLOSING_LOOKS, 1)
        frame = min(frame + max(_STEP, round(_EARLY * (last - frame) / looks)), last)
    return before, None


def _close_in(
    game: Game, person: Sighting, action: str, low: int, high: int, close: int, *, wanted: bool
) -> tuple[int, int]:
    """Halve (low, high] until the change from not `wanted` to `wanted` is known to `close` frames, or not readable."""
    while high - low > close:
        for share in (0.5, 0.35):
            middle = game.eyes.legal(low + share * (high - low))
            if not low < middle < high:
                return low, high
            performed = _probe(game, person, action, middle)
            if performed is not None:
                break
        else:
            return low, high
        if performed is wanted:
            high = middle
        else:
            low = middle
    return low, high


def find_span(game: Game, person: Sighting | None, t0: int) -> tuple[float, float]:
    """The moments at which an action starts and ends."""
    start, inside = find_start(game, person, t0, close=_CLOSE_SPAN_FRAMES)
    last = game.eyes.frames[-1]
    if person is None or inside is None:
        return start, min(start + 2 * _STEP, last)
    action = next(time.action for time in game.plan.times.values() if time.event == "start")
    assert action is not None, "a start names its action"
    during, after = inside, None
    try:
        frame = inside
        while frame < last and after is None:
            frame = min(frame + _STEP, last)
            performed = _probe(game, person, action, frame)
            if performed:
                during = game.eyes.legal(frame)
            elif performed is False:
                after = game.eyes.legal(frame)
        if after is not None:
            during, after = _close_in(game, person, action, during, after, _CLOSE_SPAN_FRAMES, wanted=False)
    except Spent:
        game.note("budget: the end was not closed in on")
    return start, (during + after) / 2 if after is not None else during


def angle_near(game: Game, person: Sighting | None, frame: float) -> float:
    """Where the person was seen nearest to a frame."""
    if person is None:
        return 180.0
    seen = min(game.eyes.sightings(person.mark.identity), key=lambda s: (abs(s.frame - frame), s.frame))
    return round(seen.angle, 1)


def find_next_pose(game: Game, person: Sighting | None, t0: int) -> str | None:
    """The first other pose in which the person is seen after holding that of t0 for a while."""
    if person is None:
        return None
    last, frame = game.eyes.frames[-1], t0 + _LONG
    step = max(_STEP, -(-(last - frame) // max(game.eyes.spare(), 1)))
    try:
        while frame <= last:
            seen = game.eyes.follow(person.mark.identity, frame, NEARBY)
            if seen is not None and seen.mark.pose not in (None, person.mark.pose):
                return seen.mark.pose
            if seen is None:
                game.note(f"mark unreadable at frame {game.eyes.legal(frame)}")
            frame += step
    except Spent:
        game.note("budget: no other posture was seen")
    return None


def find_seconds(game: Game, person: Sighting | None, t0: int) -> float:
    """Seconds between two starts, or from leaving the view to coming back."""
    if any(time.event == "start" for time in game.plan.times.values()):
        first, begun = find_start(game, person, t0)
        second, _ = find_start(game, person, t0 if begun is None else max(begun - _WAIT, t0), event=1)
        return max((second - first) / FPS, 1.0)
    return _absence(game, person, t0)


def _absence(game: Game, person: Sighting | None, t0: int) -> float:
    """Length of the first absence after t0: the person is followed until it is gone, and then until it is back."""
    last = game.eyes.frames[-1]
    guess = 10.0
    if person is None:
        return guess
    there, gone, frame = t0, None, t0 + _WAIT
    try:
        while frame <= last:
            seen = game.eyes.follow(person.mark.identity, frame, NEARBY)
            if seen is None:
                gone = game.eyes.legal(frame) if gone is None else gone
            elif gone is None:
                there = seen.frame
            else:
                return max((seen.frame + game.eyes.legal(frame - _WAIT) - there - gone) / 2 / FPS, 1.0)
            frame += _WAIT
    except Spent:
        game.note("budget: the person was not seen coming back")
    return max((frame - there) / FPS, 1.0) if gone is not None else guess


def count_people(game: Game, person: Sighting | None) -> int:
    """How many different people are seen to have the relation between the two stated times."""
    begin, end = (game.frame_of(name) for name in game.plan.answer.times)
    relation = game.plan.answer.relation
    found: set[int] = set()
    rounds = max(game.eyes.spare() // (len(AROUND) + len(NEARBY)), 2)
    frame = begin
    try:
        while person is not None and relation is not None and frame <= end:
            own = game.eyes.follow(person.mark.identity, frame, NEARBY)
            if own is not None:
                people = look_round(game.eyes, own.frame)
                others = [seen for seen in people if seen.mark.identity != person.mark.identity]
                found |= {seen.mark.identity for seen in others if related(relation, own, seen, people)}
            frame += max(_STEP, (end - begin) // rounds)
    except Spent:
        game.note("budget: not all of the time was looked at")
    return max(len(found), 1)


def _performed(game: Game, person: Sighting, action: str, begin: int, *, wanted: bool = True) -> list[int]:
    """Frames from `begin` on at which the person was seen with (or, not `wanted`, without) the action."""
    seen = game.eyes.sightings(person.mark.identity)
    return [s.frame for s in seen if s.frame >= begin and does(action, s) is wanted]
