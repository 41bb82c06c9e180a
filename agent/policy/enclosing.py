"""Bound events by sightings, as the reference agent's solver does: an event lies between two sightings of the person.

An event counts as known when the last sighting without the action and the first with it are near each other; its
moment is then the middle between them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from jrdb_avr.agent.policy.explorer import Sighting
from jrdb_avr.agent.policy.searches import performs
from jrdb_avr.schema.plan import Plan

NEAR: Final = 30
"""Most frames between the two sightings of a known event."""


class BoundedEvent(NamedTuple):
    """A change between two sightings of a person: after frame `low`, and by frame `high`."""

    low: int
    high: int

    @property
    def known(self) -> bool:
        """Whether the two sightings are near enough."""
        return self.high - self.low <= NEAR

    @property
    def middle(self) -> float:
        """The moment taken for the event."""
        return (self.low + self.high) / 2


def bounded_events(plan: Plan, t0: int, seen: Mapping[int, Sighting]) -> dict[str, BoundedEvent]:
    """The starts and ends that the answer is read at, by their time's name, as far as they have been seen.

    `seen` holds the person's sightings by frame. An end belongs to the start that it waits for.
    """
    found: dict[str, BoundedEvent] = {}
    for name in plan.answer.times:
        time = plan.times[name]
        start = found.get(time.after or "")
        if time.action is None or time.event not in ("start", "end") or (time.event == "end" and start is None):
            continue
        low = t0 if time.event == "start" or start is None else start.high
        # From the last frame without the change to the first with it.
        for frame in sorted(frame for frame in seen if frame > low):
            if performs(time.action, seen[frame]) is (time.event == "start"):
                found[name] = BoundedEvent(low, frame)
                break
            low = frame
    return found


def between(event: BoundedEvent, legal: Sequence[int], tried: Sequence[int]) -> int | None:
    """The untried frame nearest to the event's middle; None where there is none inside."""
    inside = [frame for frame in legal if event.low < frame < event.high and frame not in tried]
    return min(inside, key=lambda frame: (abs(frame - event.middle), frame), default=None)
