"""Which proofs a question has, by its template and plan, and which of them must hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import Rules

from .proofs import condition_text
from .templates import TEMPLATES

ALWAYS: Final = (
    ("anchor", "match"),
    ("evidence", "clear views"),
    ("view.ahead", "180"),
    ("view.single", "any angle"),
    ("rederive", "annotations"),
)
"""Proofs that every question has, as kind and variant."""


def expected_proofs(name: str, plan: Plan, rules: Rules) -> set[tuple[str, str]]:
    """Kind and variant of every proof that a question has."""
    expected = set(ALWAYS)
    for node in plan.nodes:
        expected |= {("anchor", f"without {condition_text(condition)}") for condition in node.conditions}
    template = next((template for template in TEMPLATES if template.name == name), None)
    if template is None:
        return expected
    if template.edges:
        expected |= {("hop.stop", str(place)) for place in range(len(template.people) - 1)}
        # To leave out the last hop of a path is to stop one person early; of a fork each can be left out.
        expected |= {("hop.skip", str(hop)) for hop in range(1, len(template.edges) + template.joins)}
    if template.time_proof == "construction":
        return expected | {("time.drop", "by construction")}
    shifts = {("time.shift", f"{sign * rules.shift_s:+g} s") for sign in (-1, 1)}
    return expected | shifts | {("time.drop", "all keyframes")}


def failing_proofs(name: str, holds: Mapping[tuple[str, str], bool]) -> list[str]:
    """What does not hold though it must: of both shifts one is enough, and of a fork read at b and at c."""
    template = next((template for template in TEMPLATES if template.name == name), None)
    joins, single = template is not None and template.joins, template is None or template.single_view
    either: dict[str, bool] = {}
    failing = []
    for (kind, variant), held in holds.items():
        if kind == "time.shift" or (joins and kind == "hop.stop" and variant != "0"):
            either[kind] = either.get(kind, False) or held
        elif not held and not (kind == "view.single" and single):
            failing.append(f"{kind} {variant}")
    return failing + [kind for kind, held in either.items() if not held]
