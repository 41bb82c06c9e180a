"""Proofs that the template and the plan of a question require."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from jrdb_avr.engine.generate.perturb import BY_CONSTRUCTION
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import forms_of


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
