"""Make the proofs of a question, list those that its template and plan require, and check that they hold."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.candidates import OUTCOMES, PROVING, VALUES, Candidates
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.scene import NOBODY
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.questions import NeededBox, Proof
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.templates import forms_of


def stored_proofs(
    context: SearchContext, candidates: Candidates, row: int, own: str, needed: Sequence[NeededBox]
) -> list[Proof]:
    """The proofs of one candidate that all set-wise rules passed; `own` is its answer's text."""
    name = int(candidates.name[row])
    found = [Proof("anchor", "match", True, "same", own)]
    for condition, left in zip(context.descriptions.of(name), context.descriptions.left[name], strict=False):
        found.append(Proof("anchor", f"without {condition.words}", int(left) >= 2, "ambiguous"))
    found.append(Proof("evidence", "clear views", True, "same", own))
    for result in candidates.perturbed:
        outcome, answer = result.outcome.item(row), result.answer.item(row)
        text = VALUES[answer] if answer != NOBODY else None
        found.append(Proof(result.kind, result.variant, bool(outcome in PROVING), OUTCOMES[outcome], text))
    if candidates.template.time_proof == "construction":
        # The answer is the time itself: at another time another answer would be right.
        found += [Proof(kind, BY_CONSTRUCTION, None, "not_run") for kind in ("time.shift", "time.drop")]
    # A method that sees only the forward view, without the decisive boxes, has nothing to answer from.
    found.append(Proof("view.ahead", "180", True, "empty"))
    x, w = np.array([box.x for box in needed]), np.array([box.w for box in needed])
    single = views.single_view(x, w, context.rules.visible_share)
    found.append(Proof("view.single", "any angle", not single, "same" if single else "empty", own if single else None))
    return found


BY_CONSTRUCTION: Final = "by construction"
"""Variant of the proofs about time that are not run."""

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
    proofs = {*ALWAYS, *(("anchor", f"without {condition.words}") for condition in conditions)}
    template = forms_of(name)[0]
    if template.edges:
        proofs |= {("hop.stop", str(place)) for place in range(len(template.people) - 1)}
        # To leave out the last hop of a path is to stop one person early; of a fork each can be left out.
        proofs |= {("hop.skip", str(hop)) for hop in range(1, len(template.edges) + template.joins)}
    if template.time_proof == "construction":
        return proofs | {("time.shift", BY_CONSTRUCTION), ("time.drop", BY_CONSTRUCTION)}
    shifts = {("time.shift", f"{sign * frames(rules.shift_s) / FPS:+g} s") for sign in (-1, 1)}
    return proofs | shifts | {("time.drop", "all keyframes")}


def failing(name: str, proofs: Iterable[Proof], rules: Rules) -> list[str]:
    """Required proofs that do not hold: one of both time shifts is enough, as is one of a fork read at b and at c."""
    template = forms_of(name)[0]
    groups: dict[str, list[bool]] = defaultdict(list)
    for proof in proofs:
        kind, variant = proof.kind, proof.variant
        any_of = kind == "time.shift" or (kind == "hop.stop" and variant != "0" and template.joins)
        optional = kind == "view.single" and template.single_view
        if not optional and variant != BY_CONSTRUCTION:
            groups[kind if any_of else f"{kind} {variant}"].append(bool(proof.holds))
        if kind == "time.shift" and rules.time_shift == "both" and proof.outcome == "same":
            groups[f"{kind} {variant}"].append(False)
    return [group for group, held in groups.items() if not any(held)]
