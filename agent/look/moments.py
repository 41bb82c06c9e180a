"""Moments of events and absences, bounded by what was seen of a person at single frames.

An event lies between two sightings: the last before the change and the first after it. Near each other they decide its
moment for certain; else the middle is the supported one. An absence needs looks that show where the person should be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.association import expected_place
from jrdb_avr.agent.perceive.geometry import around, covered
from jrdb_avr.agent.perceive.votes import UNIT, SlotState, Tracks
from jrdb_avr.queries.compiler.beliefs import RESOLVED_FRAMES
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import KEYFRAME_STEP

CHANGE: Final = 0.75 * UNIT
"""Log-odds against a change between two frames: a reading that two others belie is none, the last one may be."""

ABSENT_REACH: Final = 60.0
"""Degrees to either side of the expected angle that looks must show before somebody counts as absent."""


class Bracket(NamedTuple):
    """A change that lies after frame `low` and by frame `high`; None where it has not been seen yet.

    after: the frame from which on it is looked for.
    """

    low: int
    high: int | None
    after: int = 0

    @property
    def middle(self) -> float | None:
        """The moment taken for the event."""
        return None if self.high is None else (self.low + self.high) / 2

    @property
    def state(self) -> SlotState:
        """Whether the moment is certain, supported or open."""
        if self.high is None:
            return "open"
        return "certain" if self.high - self.low <= RESOLVED_FRAMES else "supported"


def place_seen(tracks: Tracks, who: str, frame: int) -> bool:
    """Whether the looks at a frame show all of the circle in which somebody can be expected."""
    readings = tracks.people.get(who, ())
    if not readings or frame not in tracks.looks:
        return False
    return covered(tracks.looks[frame], around(expected_place(readings, frame).angle, ABSENT_REACH))


def absence(tracks: Tracks, who: str, frame: int) -> SlotState:
    """Whether somebody is known to be away at a frame.

    Certain where looks show that at the frame and at another one within a second, supported where at the frame alone;
    a sighting within a second contradicts it.
    """
    if any(abs(one.frame - frame) <= KEYFRAME_STEP for one in tracks.people.get(who, ())):
        return "contradicted"
    if not place_seen(tracks, who, frame):
        return "open"
    near = [at for at in tracks.looks if 0 < abs(at - frame) <= KEYFRAME_STEP and place_seen(tracks, who, at)]
    return "certain" if near else "supported"


def presence(tracks: Tracks, who: str, frame: int) -> bool | None:
    """Whether somebody was seen at a frame; None where neither they nor all of the place they should be at was."""
    return True if tracks.at(who, frame) else False if place_seen(tracks, who, frame) else None


def in_group(tracks: Tracks, who: str, frame: int) -> bool | None:
    """Return whether the readings of a person at a frame show a group of two or more, or None if they do not decide."""
    alone = tracks.statement(who, "group_size", "1", frame).log_odds if tracks.at(who, frame) else 0.0
    return None if alone == 0 else alone < 0


def group_changes(plan: Plan, tracks: Tracks, people: Mapping[str, str]) -> dict[str, int]:
    """Return the frames at which people were read to have joined or left a group, by the name of the event.

    Args:
        plan: Plan.
        tracks: Readings.
        people: Person of each node, as far as it is known.
    """
    frames = {}
    for name, time in plan.times.items():
        if time.is_group_event and (who := people.get(time.of or "")) is not None:
            after = plan.times[time.after or ""].frame or 0
            states = _states(tracks, lambda frame, who=who: in_group(tracks, who, frame))
            bracket = change(states, after, time.event == "joins_group")
            if bracket.high is not None and states.get(bracket.low, True) is not states[bracket.high]:
                frames[name] = bracket.high
    return frames


def performs_at(tracks: Tracks, who: str, action: str, frame: int) -> bool | None:
    """Whether the readings at exactly this frame say that somebody performs an action; None where they do not tell."""
    odds = _here(tracks, who, frame).statement(who, "action", action, frame).log_odds
    return None if odds == 0 else odds > 0


def _here(tracks: Tracks, who: str, frame: int) -> Tracks:
    """Nothing but the readings of somebody at exactly this frame."""
    return Tracks({who: tuple(tracks.at(who, frame))}, {})


def _frames(tracks: Tracks, who: str, after: int) -> list[int]:
    return sorted({one.frame for one in tracks.people.get(who, ()) if one.frame >= after})


def postures(tracks: Tracks, who: str, after: int) -> dict[int, str]:
    """The posture of somebody at each frame read from one on, ascending: a single reading amid others is no change."""
    read = {at: tracks.values(who, "pose", at) for at in _frames(tracks, who, after)}
    return likeliest_course({at: {one.value: one.weight for one in tallies} for at, tallies in read.items() if tallies})


def likeliest_course(votes: Mapping[int, Mapping[str, float]]) -> dict[int, str]:
    """The value at each frame (ascending) that votes bear out best, each change costing `CHANGE`; empty without any."""
    values = dict.fromkeys(value for told in votes.values() for value in told)
    if not values:
        return {}
    best: dict[str, tuple[float, tuple[str, ...]]] = dict.fromkeys(values, (0.0, ()))
    for told in votes.values():
        change = max(best.values(), key=lambda one: one[0])
        grown = {}
        for value, own in best.items():
            odds, course = own if own[0] >= change[0] - CHANGE else (change[0] - CHANGE, change[1])
            grown[value] = odds + told.get(value, 0.0), (*course, value)
        best = grown
    course = max(best.values(), key=lambda one: one[0])[1]
    return dict(zip(votes, course, strict=True))


def change(states: Mapping[int, bool], after: int, wanted: bool) -> Bracket:
    """The first change to `wanted` after a frame, by the states at the frames where they are known."""
    low = after
    for frame in sorted(frame for frame in states if frame > after):
        if states[frame] is wanted:
            return Bracket(low, frame, after)
        low = frame
    return Bracket(low, None, after)


def brackets(plan: Plan, tracks: Tracks, who: str) -> dict[str, Bracket]:
    """The bracket of each event of a plan, by its time's name, except events that wait for one that was not seen."""
    found: dict[str, Bracket] = {}
    for name in (*plan.times, *plan.times):
        # Twice, as an event may be written before the one that it waits for.
        time = plan.times[name]
        if time.event is None or time.after is None or name not in plan.answer.times:
            continue
        before = found[time.after].high if time.after in found else plan.times[time.after].frame
        if before is not None:
            found[name] = change(_states(tracks, _state_of(plan, tracks, who, name, before)), before,
                                 time.event in ("start", "returns", "joins_group"))  # fmt: skip
    return found


def _states(tracks: Tracks, state: Callable[[int], bool | None]) -> dict[int, bool]:
    known = {frame: state(frame) for frame in tracks.looks}
    return {frame: value for frame, value in known.items() if value is not None}


def _state_of(plan: Plan, tracks: Tracks, who: str, name: str, before: int) -> Callable[[int], bool | None]:
    """Whether what an event starts or ends goes on at a frame."""
    time = plan.times[name]
    if time.event in ("leaves", "returns"):
        return lambda frame: presence(tracks, who, frame)
    if time.is_group_event:
        return lambda frame: in_group(tracks, who, frame)
    if time.event == "start":
        return lambda frame: performs_at(tracks, who, time.action or "", frame)
    # Somebody is seldom taken to do what they do not, and often not to do what they do: one such reading ends nothing.
    # The end without an action is that of the posture held before.
    held = _spells(tracks, who, before, time.action)
    return lambda frame: held[frame] == held[min(held)] if frame in held else None


def _spells(tracks: Tracks, who: str, after: int, action: str | None) -> dict[int, str]:
    """What somebody does at each frame read from one on: the action, as yes or no, or the posture where it is None."""
    if action is None:
        return postures(tracks, who, after)
    odds = {
        at: _here(tracks, who, at).statement(who, "action", action, at).log_odds for at in _frames(tracks, who, after)
    }
    return likeliest_course({at: {"yes": max(told, 0.0), "no": max(-told, 0.0)} for at, told in odds.items()})
