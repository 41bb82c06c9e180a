"""Proofs that the template and the plan of a question require."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Final

from jrdb_avr.engine.generate.perturb import BY_CONSTRUCTION
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.templates import forms_of

ALWAYS: Final = (
    ("anchor", "match"),
    ("evidence", "clear views"),
    ("view.ahead", "180"),
    ("view.single", "any angle"),
    ("rederive", "annotations"),
)
"""Proofs that every question has, as kind and variant."""


def expected(name: str, plan: Plan, rules: Rules) -> set[tuple[str, str]]:
    """Return the kind and the variant of each proof that a question has.

    Args:
        name: Name of the template.
        plan: Plan of the question.
        rules: Thresholds.

    Returns:
        Pairs of kind and variant.

    Raises:
        PlanError: If the template is unknown.
    """
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
    """Return the required proofs that do not hold.

    Args:
        name: Name of the template.
        proofs: Proofs of the question.
        rules: Rule about time shifts.

    Returns:
        The kinds, with the variant if each variant must hold. One of both time shifts is enough. So is one of both
        branches of a fork.
    """
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
