"""Events as the solver of the reference agent knows them: enclosed by two sightings of the person.

What it takes for known is that the last sighting without the action and the first with it are near each other; the
moment is then taken to lie in the middle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from jrdb_avr.agent.policy.searches import does
from jrdb_avr.agent.simulated.requests import Sighting
from jrdb_avr.schema.plan import Plan

NEAR: Final = 30
"""Frames between the two sightings, at most."""


@dataclass(frozen=True)
class Event:
    """A change between two sightings of a person: after frame `low`, and by frame `high`."""

    low: int
    high: int

    @property
    def known(self) -> bool:
        return self.high - self.low <= NEAR

    @property
    def middle(self) -> float:
        return (self.low + self.high) / 2


def events(plan: Plan, t0: int, seen: Mapping[int, Sighting]) -> dict[str, Event]:
    """The starts and ends that the answer is read at, by their time's name, as far as they have been seen.

    `seen` holds the person's sightings by frame. An end belongs to the start that it waits for.
    """
    found: dict[str, Event] = {}
    for name in plan.answer.times:
        time = plan.times[name]
        if time.action is None or time.event not in ("start", "end"):
            continue
        begun = found.get(time.after or "")
        event = (
            _change(seen, time.action, t0, wanted=True)
            if time.event == "start"
            else None
            if begun is None
            else _change(seen, time.action, begun.high, wanted=False)
        )
        if event is not None:
            found[name] = event
    return found


def _change(seen: Mapping[int, Sighting], action: str, begin: int, *, wanted: bool) -> Event | None:
    """From the last frame after `begin` that is not as wanted to the first that is; from `begin` if there is none."""
    low = begin
    for frame in sorted(frame for frame in seen if frame > begin):
        if does(action, seen[frame]) is wanted:
            return Event(low, frame)
        low = frame
    return None


def between(event: Event, legal: Sequence[int], tried: Sequence[int]) -> int | None:
    """The frame nearest to the event's middle that has not been tried; None where there is none inside."""
    inside = [frame for frame in legal if event.low < frame < event.high and frame not in tried]
    return min(inside, key=lambda frame: (abs(frame - event.middle), frame), default=None)
