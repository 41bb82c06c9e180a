"""Make the proofs of a question, list those that its template and plan require, and check that they hold."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.candidates import OUTCOMES, PROVING, VALUES, Candidates
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.scene import NOBODY
from jrdb_avr.schema.plan import Condition, Plan
from jrdb_avr.schema.questions import NeededBox, Proof
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import forms_of


def stored_proofs(
    context: SearchContext, candidates: Candidates, row: int, own: str, needed: Sequence[NeededBox]
) -> list[Proof]:
    """The proofs of one candidate that all set-wise rules passed; `own` is its answer's text."""
    name = int(candidates.name[row])
    found = [Proof("anchor", "match", True, "same", own)]
    for condition, left in zip(context.descriptions.of(name), context.descriptions.left[name], strict=False):
        found.append(Proof("anchor", f"without {condition_text(condition)}", int(left) >= 2, "ambiguous"))
    found.append(Proof("evidence", "clear views", True, "same", own))
    for result in candidates.perturbed:
        outcome, answer = result.outcome[row], result.answer[row]
        text = VALUES[answer] if answer != NOBODY else None
        found.append(Proof(result.kind, result.variant, bool(outcome in PROVING), OUTCOMES[outcome], text))
    if candidates.template.time_proof == "construction":
        # The answer is the time itself: at another time another answer would be right.
        found.append(Proof("time.drop", "by construction", True, "different"))
    # A method that sees only the forward view, without the decisive boxes, has nothing to answer from.
    found.append(Proof("view.ahead", "180", True, "empty"))
    x, w = np.array([box.x for box in needed]), np.array([box.w for box in needed])
    single = views.single_view(x, w, context.rules.visible_share)
    found.append(Proof("view.single", "any angle", not single, "same" if single else "empty", own if single else None))
    return found


def condition_text(condition: Condition) -> str:
    """A condition in a few words, as in "action sitting", "sector left" or "object bag (carrying)"."""
    if condition.attribute is not None:
        return f"{condition.attribute} {condition.value}"
    if condition.object is not None:
        return f"object {condition.object} ({condition.verb})"
    return f"interaction {condition.interaction}" if condition.action is None else f"action {condition.action}"


ALWAYS: Final = (
    ("anchor", "match"),
    ("evidence", "clear views"),
    ("view.ahead", "180"),
    ("view.single", "any angle"),
    ("rederive", "annotations"),
)
"""Proofs that every question has, as kind and variant."""


def expected(name: str, plan: Plan, rules: Rules) -> set[tuple[str, str]]:
    """Kind and variant of every proof that a question has. Raises PlanError for an unknown template."""
    conditions = [condition for node in plan.nodes for condition in node.conditions]
    proofs = {*ALWAYS, *(("anchor", f"without {condition_text(condition)}") for condition in conditions)}
    template = forms_of(name)[0]
    if template.edges:
        proofs |= {("hop.stop", str(place)) for place in range(len(template.people) - 1)}
        # To leave out the last hop of a path is to stop one person early; of a fork each can be left out.
        proofs |= {("hop.skip", str(hop)) for hop in range(1, len(template.edges) + template.joins)}
    if template.time_proof == "construction":
        return proofs | {("time.drop", "by construction")}
    shifts = {("time.shift", f"{sign * rules.shift_s:+g} s") for sign in (-1, 1)}
    return proofs | shifts | {("time.drop", "all keyframes")}


def failing(name: str, holds: Mapping[tuple[str, str], bool]) -> list[str]:
    """Required proofs that do not hold: one of both time shifts is enough, as is one of a fork read at b and at c."""
    template = forms_of(name)[0]
    groups: dict[str, list[bool]] = defaultdict(list)
    for (kind, variant), held in holds.items():
        any_of = kind == "time.shift" or (kind == "hop.stop" and variant != "0" and template.joins)
        if kind != "view.single" or not template.single_view:
            groups[kind if any_of else f"{kind} {variant}"].append(held)
    return [group for group, held in groups.items() if not any(held)]
