"""How the marker model takes a question: find the person, then read what is asked.

A read that meets something unreadable, or runs out of looks, gives the best it has and notes why. Thresholds of the
question's rules are not used here: a start is searched for as a person would, by stepping and closing in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from jrdb_avr.schema.plan import Condition, Plan
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP
from jrdb_avr.schema.rules import frames as frames_in
from jrdb_avr.schema.vocabulary import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS

from .eyes import AROUND, NEARBY, Eyes, Spent
from .finding import Found, find, likely
from .hops import look_round, related, walk
from .reading import Sighting

_STEP: Final = frames_in(2.0)
"""An action asked about lasts two seconds at least, so steps of two seconds meet it."""

_WAIT: Final = frames_in(3.0)
"""What is asked about lies three seconds after the description, or more."""

_LONG: Final = frames_in(10.0)
"""A posture that a question waits the end of lasts ten seconds at least."""

_CLOSE_FRAMES: Final = 28
"""Closing in ends when the moment is known to this many frames: half of them is within a second."""

_CLOSE_SPAN_FRAMES: Final = 14
"""Both ends of a stretch count together, and it may last two seconds only."""

_CLOSING_LOOKS: Final = 2

_EARLY: Final = 0.5
"""Steps of a search are this share of even ones: what is asked about comes sooner rather than late."""

_SIDEWAYS: Final = 3
"""Somebody who was not seen is looked for to the sides at the first of so many tries."""

_BESIDE: Final = (KEYFRAME_STEP, -KEYFRAME_STEP)
_CHANGED_M: Final = 1.0


@dataclass
class Game:
    """One question: what is asked, what has been seen, and notes of what could not be read.

    `beside`: whether a look a second away may stand for one in which somebody is hidden. `misses` counts the tries at
    which the person searched for in time was not seen, since it last was. `close` is to how many frames a moment is to
    be known.
    """

    plan: Plan
    choices: Sequence[str]
    eyes: Eyes
    missing: list[str] = field(default_factory=list)
    beside: bool = False
    misses: int = 0
    close: int = _CLOSE_FRAMES

    def frame_of(self, name: str) -> int:
        """A stated time's frame."""
        frame = self.plan.times[name].frame
        assert frame is not None, "reads ask for stated times only"
        return frame

    @property
    def t0(self) -> int:
        """The frame of the description: the first that is stated."""
        return min(time.frame for time in self.plan.times.values() if time.frame is not None)

    def note_unseen(self) -> None:
        """Note which stated times no picture shows, where pictures cannot be chosen."""
        for name, time in sorted(self.plan.times.items()):
            if time.frame is not None and self.eyes.legal(time.frame) != time.frame:
                self.note(f"not shown: {name}")

    def note(self, reason: str) -> None:
        if reason not in self.missing:
            self.missing.append(reason)

    def choose(self, text: str | None, not_this: str | None = None) -> int:
        """The number of the choice with this text, else of the first that does not say what is known to be wrong."""
        if text in self.choices:
            return self.choices.index(text) + 1
        others = [n for n, choice in enumerate(self.choices, 1) if choice != not_this]
        return others[0] if others else 1


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
            start, _ = _start(game, person, t0)
            return {"frame_id": _id(game, start)}
        case "span":
            start, end = _span(game, person, t0)
            return {"start_frame": _id(game, start), "end_frame": _id(game, end)}
        case "start_view":
            start, _ = _start(game, person, t0)
            return {"frame_id": _id(game, start), "angle_deg": _angle(game, person, start)}
        case "next_action":
            return game.choose(_next_pose(game, person, t0), person.mark.pose if person else None)
        case "seconds_between":
            return {"value": f"{_seconds_between(game, person, t0):.1f}"}
        case "count":
            return {"value": str(_count(game, person))}


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
    seen = _seen_at(game, person, game.plan.asked()[0])
    return None if seen is None else seen.mark.pose


def _presence(game: Game, person: Sighting | None) -> str | None:
    if person is None:
        return None
    names = game.plan.asked()
    first = _seen_at(game, person, names[0], len(AROUND)) is not None
    second = _seen_at(game, person, names[1]) is not None
    both, only_first, only_second, neither = PRESENCE_ANSWERS
    return (both if second else only_first) if first else (only_second if second else neither)


def _distance(game: Game, person: Sighting | None) -> str | None:
    if person is None or person.mark.distance_dm is None:
        return None
    closer, farther, same, unseen = DISTANCE_ANSWERS
    later = _seen_at(game, person, game.plan.asked()[1])
    if later is None:
        return unseen
    if later.mark.distance_dm is None:
        return None
    change = (later.mark.distance_dm - person.mark.distance_dm) / 10
    return same if abs(change) < _CHANGED_M else (farther if change > 0 else closer)


# -- searches in time -------------------------------------------------------------------------------------------------


def does(action: str, seen: Sighting) -> bool:
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


def _start(
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


def _span(game: Game, person: Sighting | None, t0: int) -> tuple[float, float]:
    start, inside = _start(game, person, t0, close=_CLOSE_SPAN_FRAMES)
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
            does = _probe(game, person, action, frame)
            if does:
                during = game.eyes.legal(frame)
            elif does is False:
                after = game.eyes.legal(frame)
        if after is not None:
            during, after = _close_in(game, person, action, during, after, _CLOSE_SPAN_FRAMES, wanted=False)
    except Spent:
        game.note("budget: the end was not closed in on")
    return start, (during + after) / 2 if after is not None else during


def _angle(game: Game, person: Sighting | None, frame: float) -> float:
    """Where the person was seen nearest to a frame."""
    if person is None:
        return 180.0
    seen = min(game.eyes.sightings(person.mark.identity), key=lambda s: (abs(s.frame - frame), s.frame))
    return round(seen.angle, 1)


def _next_pose(game: Game, person: Sighting | None, t0: int) -> str | None:
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


def _seconds_between(game: Game, person: Sighting | None, t0: int) -> float:
    """Seconds between two starts, or from leaving the view to coming back."""
    if any(time.event == "start" for time in game.plan.times.values()):
        first, begun = _start(game, person, t0)
        second, _ = _start(game, person, t0 if begun is None else max(begun - _WAIT, t0), event=1)
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


def _count(game: Game, person: Sighting | None) -> int:
    """How many different people are seen to have the relation between the two stated times."""
    begin, end = (game.frame_of(name) for name in game.plan.asked())
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
