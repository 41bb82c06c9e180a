"""Choices of questions about actions: the rules for the true one and for the false ones."""

from __future__ import annotations

from itertools import combinations
from typing import Final

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.plan import ResolvedPlan
from jrdb_avr.engine.rederive.truth import FALSE
from jrdb_avr.schema.choice_labels import CALLED, CHOICE_LABELS, implied_actions
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import KEYFRAME_STEP

_COUNT: Final = 4
"""Number of choices."""

_WINDOW: Final = 3
"""Number of keyframes before and after the asked time without a label of a wrong choice. For a pose, it is 1."""


def check_choices(resolved: ResolvedPlan, answer: str, frame: int) -> None:
    """Note the rules that the choices of a question break.

    Args:
        resolved: The question's plan with its people and choices.
        answer: The true choice.
        frame: Keyframe that the question asks about.
    """
    annotations, choices = resolved.annotations, resolved.choices
    allowed = POSES if resolved.plan.answer.read == "next_action" else CHOICE_LABELS
    implied = _implied_actions(resolved.plan)
    resolved.check(len(choices) == len(set(choices)) == _COUNT, f"there are not {_COUNT} different choices")
    resolved.check(answer in choices, f"{answer!r} is true and not among the choices")
    for choice in choices:
        resolved.check(choice in allowed, f"{choice!r} may not be a choice")
        resolved.check(choice not in implied, f"the question's words state or imply the choice {choice!r}")
        shown = choice in annotations.shown_actions
        resolved.check(shown, f"no person in clear view is certainly {choice!r} at any keyframe")
        false = choice == answer or is_false_around(annotations, resolved.target, choice, frame)
        resolved.check(false, f"the choice {choice!r} is not certainly false around frame {frame}")
    for choice, rival in combinations(choices, 2):
        same = rival in CALLED.get(choice, ()) or choice in CALLED.get(rival, ())
        resolved.check(not same, f"the choices {choice!r} and {rival!r} may be called the same")


def is_supported(annotations: Annotations, track: int, action: str, frame: int) -> bool:
    """Return whether an action is certain by the labels one keyframe before or after a frame."""
    near = annotations.keyframes & {frame - KEYFRAME_STEP, frame + KEYFRAME_STEP}
    return any(action in annotations.certain(track, keyframe) for keyframe in near)


def is_false_around(annotations: Annotations, track: int, action: str, frame: int) -> bool:
    """Return whether an action is certainly false at a frame and without a label at the keyframes around it."""
    reach = KEYFRAME_STEP * (1 if action in POSES else _WINDOW)
    around = annotations.keyframes.intersection(range(frame - reach, frame + reach + 1, KEYFRAME_STEP))
    labelled = any(action in annotations.written(track, keyframe) for keyframe in around)
    return not labelled and annotations.performs(track, action, frame) == FALSE


def _implied_actions(plan: Plan) -> frozenset[str]:
    """Return the actions that the words of a question state or imply."""
    conditions = [condition for node in plan.nodes for condition in node.conditions]
    labels = {word for stated in conditions for word in (stated.action, stated.interaction, stated.verb)}
    labels |= {edge.relation for edge in plan.edges} | {time.action for time in plan.times.values()}
    return frozenset().union(*(implied_actions(word) for word in labels if word is not None))
