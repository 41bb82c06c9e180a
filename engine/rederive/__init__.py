"""The second program: derive the answer of a stored plan from the per-frame annotation tables alone.

It shares nothing with the intervals of the loaders or with the queries of generation. From `annotations/` it computes
facts, closed gaps, clear views, stable segments, relations and uniqueness again, person by person and frame by frame. A
question is published only if both programs agree.

Each module adds facts to the module before it: `people` (boxes), `actions` (actions of a person), `relations`
(relations to people and things, and positions), `labels` (conditions and relations as three-valued facts). Then `plan`
finds the people of a plan, and `reads` reads the answer: `read_<read>` for each read of `schema.plan`. `choices` judges
the choices of questions about actions, and `twins` pairs of questions. `perturbations` evaluates every proof of the
plan in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.perturbations import prove_again
from jrdb_avr.engine.rederive.plan import ResolvedPlan, find_people
from jrdb_avr.engine.rederive.reads import Reading, reading_of
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, Outcome, Undefined
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.questions import NeededBox
from jrdb_avr.schema.rules import Rules

__all__ = ["FALSE", "TRUE", "UNKNOWN", "Annotations", "Outcome", "prove_again", "rederive"]


def rederive(annotations: Annotations, plan: Plan, template: str, rules: Rules, choices: Sequence[str] = ()) -> Outcome:
    """Derive the answer of a plan.

    Args:
        annotations: Annotations of the sequence.
        plan: Plan of a question.
        template: Name of the question's template.
        rules: Thresholds.
        choices: Texts of the question's choices. Questions about actions have no answer without them.

    Returns:
        The answer, and the rules that the question breaks.
    """
    try:
        resolved = find_people(annotations, plan, template, rules)
        reading = reading_of(resolved, choices)
    except Undefined as reason:
        return Outcome(reason.outcome, faults=(str(reason),))
    needed = _needed_boxes(resolved, reading)
    people, times = sorted(resolved.people.items()), sorted((resolved.stated | reading.events).items())
    faults = tuple(resolved.faults)
    return Outcome("defined", reading.answer, resolved.target, tuple(people), tuple(times), needed, faults)


def _needed_boxes(resolved: ResolvedPlan, reading: Reading) -> tuple[NeededBox, ...]:
    """Return the boxes that must be seen: of all people at t0, and of the target in the frames of the answer.

    The target's boxes in the frames of the answer are decisive. If there are none, its box at t0 is decisive.
    """
    annotations, decisive_frames = resolved.annotations, set(reading.decisive)
    needed = []
    for node, track in resolved.people.items():
        decisive = (decisive_frames or {resolved.t0}) if node == resolved.plan.target else set()
        for frame in sorted(decisive | {resolved.t0}):
            box = annotations.box(track, frame)
            name = "the person" if len(resolved.people) == 1 else node
            clear = box is not None and annotations.clear(track, frame)
            resolved.check(clear, f"{name} is not in clear view at frame {frame}")
            if box is not None:
                needed.append(NeededBox(node, track, frame, *box, frame in decisive))
    needed += reading.more
    for frame in sorted({box.frame for box in needed}):
        resolved.check(annotations.has_image(frame), f"frame {frame} has no image")
    return tuple(needed)
