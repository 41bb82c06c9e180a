"""The second program: derive the answer of a stored plan from the per-frame annotation tables alone.

It shares nothing with the intervals of the loaders or the queries of generation: it computes facts, closed gaps, clear
views, stable segments, relations and uniqueness again, person by person and frame by frame, from `annotations/`. A
question is published only if both programs find the same answer.

Each module adds facts to those of the one before: `people` (boxes), `actions` (what people do), `relations` (whom and
what they are with, and where), `labels` (conditions and relations as three-valued facts). `plan` then finds the people
of a plan, and `reads` reads the answer: `read_<read>` of each read of `schema.plan`. `perturbations` evaluates every
proof of the plan in the same way.
"""

from __future__ import annotations

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.perturbations import prove_again
from jrdb_avr.engine.rederive.plan import ResolvedPlan, find_people
from jrdb_avr.engine.rederive.reads import Reading, reading_of
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, Outcome, Undefined
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.questions import NeededBox
from jrdb_avr.schema.rules import Rules

__all__ = ["FALSE", "TRUE", "UNKNOWN", "Annotations", "Outcome", "prove_again", "rederive"]


def rederive(annotations: Annotations, plan: Plan, template: str, rules: Rules) -> Outcome:
    """Return the plan's answer and the rules of its template that do not hold."""
    try:
        found = find_people(annotations, plan, template, rules)
        reading = reading_of(found)
    except Undefined as reason:
        return Outcome(reason.outcome, faults=(str(reason),))
    needed = _needed(found, reading)
    people, times = sorted(found.people.items()), sorted((found.stated | reading.events).items())
    return Outcome("defined", reading.answer, found.target, tuple(people), tuple(times), needed, tuple(found.faults))


def _needed(found: ResolvedPlan, reading: Reading) -> tuple[NeededBox, ...]:
    """Return the boxes that must be seen: everybody's at t0, and the target's where it is read.

    The target's boxes where it is read are decisive; without any, its box at t0 is.
    """
    annotations, decided = found.annotations, set(reading.decisive)
    needed = []
    for node, track in found.people.items():
        decisive = (decided or {found.t0}) if node == found.plan.target else set()
        for frame in sorted(decisive | {found.t0}):
            box = annotations.box(track, frame)
            who = "the person" if len(found.people) == 1 else node
            clear = box is not None and annotations.clear(track, frame)
            found.check(clear, f"{who} is not in clear view at frame {frame}")
            if box is not None:
                needed.append(NeededBox(node, track, frame, *box, frame in decisive))
    needed += reading.more
    for frame in sorted({box.frame for box in needed}):
        found.check(annotations.has_image(frame), f"frame {frame} has no image")
    return tuple(needed)
