"""Moments of events and absences, bounded by the frames at which a person was read.

An event is between two sightings: the last before the change and the first after it. If they are near each other, the
moment is certain; otherwise the middle is supported. An absence needs looks that show where the person should be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.expectation import expected_place
from jrdb_avr.agent.perceive.geometry import around, covered
from jrdb_avr.agent.perceive.votes import UNIT, SlotState, Tracks
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP

RESOLVED_FRAMES: Final = round(2 * FPS)
"""Maximum length in frames of the bracket of a certain moment: its middle is within a second of the event."""

CHANGE: Final = 0.75 * UNIT
"""Log-odds penalty for a change of state between adjacent frames.

A reading that both neighbors contradict is an error. A deviating last reading may be a real change.
"""

ABSENT_REACH: Final = 60.0
"""Degrees to either side of the expected angle that looks must show for a person to be absent."""


class Bracket(NamedTuple):
    """A change after frame `low` and not later than frame `high`.

    high: None if the change has not been seen. after: first frame at which the change may lie.
    """

    low: int
    high: int | None
    after: int = 0

    @property
    def middle(self) -> float | None:
        """The moment of the event, None if the change has not been seen."""
        return None if self.high is None else (self.low + self.high) / 2

    @property
    def state(self) -> SlotState:
        """Whether the moment is certain, supported or open."""
        if self.high is None:
            return "open"
        return "certain" if self.high - self.low <= RESOLVED_FRAMES else "supported"


def shows_place(tracks: Tracks, entity: str, frame: int) -> bool:
    """Return whether the looks at a frame show all of the arc in which a person can be expected."""
    readings = tracks.people.get(entity, ())
    if not readings or frame not in tracks.looks:
        return False
    return covered(tracks.looks[frame], around(expected_place(readings, frame).angle, ABSENT_REACH))


def absence(tracks: Tracks, entity: str, frame: int) -> SlotState:
    """Return how well readings support the absence of a person at a frame.

    Args:
        tracks: All readings and looks.
        entity: The person.
        frame: The frame.

    Returns:
        "certain" if looks show the absence at the frame and at another frame within a second, "supported" if they show
        it at the frame only, "contradicted" after a sighting within a second, else "open".
    """
    if any(abs(reading.frame - frame) <= KEYFRAME_STEP for reading in tracks.people.get(entity, ())):
        return "contradicted"
    if not shows_place(tracks, entity, frame):
        return "open"
    near = [at for at in tracks.looks if 0 < abs(at - frame) <= KEYFRAME_STEP and shows_place(tracks, entity, at)]
    return "certain" if near else "supported"


def presence(tracks: Tracks, entity: str, frame: int) -> bool | None:
    """Return whether a person was seen at a frame, or None if no look decides it."""
    return True if tracks.readings_at(entity, frame) else False if shows_place(tracks, entity, frame) else None


def is_in_group(tracks: Tracks, entity: str, frame: int) -> bool | None:
    """Return whether the readings of a person at a frame show a group of two or more, or None if they do not decide."""
    present = tracks.readings_at(entity, frame)
    alone = tracks.statement(entity, "group_size", "1", frame).log_odds if present else 0.0
    return None if alone == 0 else alone < 0


def group_changes(plan: Plan, tracks: Tracks, people: Mapping[str, str]) -> dict[str, int]:
    """Return the frames at which people were read to have joined or left a group, by the name of the event.

    Args:
        plan: The plan.
        tracks: All readings and looks.
        people: Entity of each node, as far as it is known.

    Returns:
        The frames of the events that were seen.
    """
    frames = {}
    for name, time in plan.times.items():
        if time.is_group_event and (entity := people.get(time.of or "")) is not None:
            after = plan.times[time.after or ""].frame or 0
            states = _known_states(tracks, partial(is_in_group, tracks, entity))
            bracket = group_change(states, after, time.event == "joins_group")
            if bracket.high is not None:
                frames[name] = bracket.high
    return frames


def group_change(states: Mapping[int, bool], after: int, expected: bool) -> Bracket:
    """Return the bracket of the first change to `expected`, as `change`, but only after the opposite state is known."""
    opposite = min((frame for frame, state in states.items() if frame >= after and state is not expected), default=None)
    return Bracket(after, None, after) if opposite is None else change(states, opposite, expected)._replace(after=after)


def performs_at(tracks: Tracks, entity: str, action: str, frame: int) -> bool | None:
    """Return whether readings at exactly this frame show an action of a person, or None if they do not decide."""
    odds = _action_odds(tracks, entity, action, frame)
    return None if odds == 0 else odds > 0


def _action_odds(tracks: Tracks, entity: str, action: str, frame: int) -> float:
    """Return the log-odds of an action by only the readings of a person at exactly this frame."""
    alone = Tracks({entity: tuple(tracks.readings_at(entity, frame))}, {}, tracks.repeats)
    return alone.statement(entity, "action", action, frame).log_odds


def _frames(tracks: Tracks, entity: str, after: int) -> list[int]:
    return sorted({reading.frame for reading in tracks.people.get(entity, ()) if reading.frame >= after})


def postures(tracks: Tracks, entity: str, after: int) -> dict[int, str]:
    """Return the likeliest posture of a person at each frame with a reading, from frame `after`, ascending."""
    votes = {frame: tracks.values(entity, "pose", frame) for frame in _frames(tracks, entity, after)}
    return likeliest_course({frame: odds for frame, odds in votes.items() if odds})


def likeliest_course(votes: Mapping[int, Mapping[str, float]]) -> dict[int, str]:
    """Return the sequence of values with the highest sum of votes, where each change costs `CHANGE`.

    Args:
        votes: Log-odds of each value, by frame, ascending.

    Returns:
        The value at each frame. Empty without votes.
    """
    values = dict.fromkeys(value for odds in votes.values() for value in odds)
    if not values:
        return {}
    best: dict[str, tuple[float, tuple[str, ...]]] = dict.fromkeys(values, (0.0, ()))
    for odds in votes.values():
        highest = max(best.values(), key=lambda course: course[0])
        grown = {}
        for value, same in best.items():
            total, course = same if same[0] >= highest[0] - CHANGE else (highest[0] - CHANGE, highest[1])
            grown[value] = total + odds.get(value, 0.0), (*course, value)
        best = grown
    course = max(best.values(), key=lambda course: course[0])[1]
    return dict(zip(votes, course, strict=True))


def change(states: Mapping[int, bool], after: int, expected: bool) -> Bracket:
    """Return the bracket of the first change to `expected` after a frame.

    Args:
        states: The states at the frames at which they are known.
        after: The frame.
        expected: State after the change.

    Returns:
        The bracket.
    """
    low = after
    for frame in sorted(frame for frame in states if frame > after):
        if states[frame] is expected:
            return Bracket(low, frame, after)
        low = frame
    return Bracket(low, None, after)


def brackets(plan: Plan, tracks: Tracks, entity: str) -> dict[str, Bracket]:
    """Return the brackets of the events of a plan's answer.

    Args:
        plan: The plan.
        tracks: All readings and looks.
        entity: The target.

    Returns:
        The brackets by the names of the times, without events that wait for an event that was not seen.
    """
    ends: dict[str, Bracket] = {}
    # Twice, because an event may be written before the event that it waits for.
    for name in (*plan.times, *plan.times):
        time = plan.times[name]
        if time.event is None or time.after is None or name not in plan.answer.times:
            continue
        before = ends[time.after].high if time.after in ends else plan.times[time.after].frame
        if before is not None:
            states = _known_states(tracks, _state_of(plan, tracks, entity, name, before))
            find = group_change if time.is_group_event else change
            ends[name] = find(states, before, time.event in ("start", "returns", "joins_group"))
    return ends


def _known_states(tracks: Tracks, state: Callable[[int], bool | None]) -> dict[int, bool]:
    states = {frame: state(frame) for frame in tracks.looks}
    return {frame: value for frame, value in states.items() if value is not None}


def _state_of(plan: Plan, tracks: Tracks, entity: str, name: str, before: int) -> Callable[[int], bool | None]:
    """Return the function from a frame to the state that an event changes: True, False or None (unknown)."""
    time = plan.times[name]
    if time.event in ("leaves", "returns"):
        return lambda frame: presence(tracks, entity, frame)
    if time.is_group_event:
        return lambda frame: is_in_group(tracks, entity, frame)
    if time.event == "start":
        return lambda frame: performs_at(tracks, entity, time.action or "", frame)
    # Models miss an action more often than they invent one, so one negative reading ends nothing. If the event names no
    # action, the posture before the event ends.
    spells = _spells(tracks, entity, before, time.action)
    return lambda frame: spells[frame] == spells[min(spells)] if frame in spells else None


def _spells(tracks: Tracks, entity: str, after: int, action: str | None) -> dict[int, str]:
    """Return at each frame whether the person performs the action ("yes" or "no"); without an action, the posture."""
    if action is None:
        return postures(tracks, entity, after)
    odds = {frame: _action_odds(tracks, entity, action, frame) for frame in _frames(tracks, entity, after)}
    return likeliest_course({at: {"yes": max(value, 0.0), "no": max(-value, 0.0)} for at, value in odds.items()})
