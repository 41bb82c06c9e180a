"""The second path: what a stored plan answers, read from the per-frame annotation tables alone.

Nothing here is shared with the intervals of the loaders or the queries of generation: facts, closed gaps, clear views,
stable segments, relations and uniqueness are worked out once more, person by person and frame by frame, from
`annotations/`. A question stands only if both paths find the same answer.

Modules, each adding to one sequence's `Annotations` what it reads: `people` boxes, `actions` what they do, `ties` whom
and what they are with, `places` where they are, `annotations` descriptions and relations; then `asked` finds the people
of a plan, and `reads` and `events` what is read of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from jrdb_avr.engine.rederive.events import (
    read_next_action,
    read_seconds_between,
    read_span,
    read_start,
    read_start_view,
)
from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.plan import Asked, find_people
from jrdb_avr.engine.rederive.reads import Reading, read_action, read_count, read_distance, read_presence
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, NeededBox, Outcome, Undefined
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import Rules

__all__ = ["FALSE", "TRUE", "UNKNOWN", "Annotations", "NeededBox", "Outcome", "rederive"]

_READERS: Final[dict[str, Callable[[Asked], Reading]]] = {
    "action": read_action,
    "presence": read_presence,
    "distance_change": read_distance,
    "count": read_count,
    "start": read_start,
    "span": read_span,
    "start_view": read_start_view,
    "next_action": read_next_action,
    "seconds_between": read_seconds_between,
}


def rederive(annotations: Annotations, plan: Plan, template: str, rules: Rules) -> Outcome:
    """What the plan answers, and which rules of its template do not hold."""
    try:
        asked = find_people(annotations, plan, template, rules)
        reading = _READERS[plan.answer.read](asked)
    except Undefined as reason:
        return Outcome(reason.outcome, faults=(str(reason),))
    needed = _needed(asked, reading)
    people, times = sorted(asked.people.items()), sorted((asked.stated | reading.events).items())
    return Outcome("defined", reading.answer, asked.target, tuple(people), tuple(times), needed, tuple(asked.faults))


def _needed(asked: Asked, reading: Reading) -> tuple[NeededBox, ...]:
    """Everybody's box at t0, and the target's where it is read: those decide or, where there are none, that at t0."""
    annotations, shown = asked.annotations, set(reading.shown)
    needed = []
    for node, track in asked.people.items():
        decisive = (shown or {asked.t0}) if node == asked.plan.target else set()
        for frame in sorted(decisive | {asked.t0}):
            box = annotations.box(track, frame)
            who = "the person" if len(asked.people) == 1 else node
            clear = box is not None and annotations.clear(track, frame)
            asked.check(clear, f"{who} is not in clear view at frame {frame}")
            if box is not None:
                needed.append(NeededBox(node, track, frame, box, frame in decisive))
    needed += reading.more
    for frame in sorted({box.frame for box in needed}):
        asked.check(annotations.has_image(frame), f"frame {frame} has no image")
    return tuple(needed)
