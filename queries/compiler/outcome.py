"""What the rows of a plan's statement come to: nobody, somebody, or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from jrdb_avr.queries.compiler.find import Find
from jrdb_avr.schema.plan import Plan

Outcome = Literal["defined", "ambiguous", "empty", "unknown"]

Who = int | str
"""Who somebody is in a scope: the number of a track, or the name of an entity."""

Agreed = tuple[Outcome, Mapping[str, Who]]
"""An outcome, and who the plan's nodes are where it is defined."""


def people_of(find: Find, row: Mapping[str, Any]) -> dict[str, Who]:
    """The binding that a row of a plan's statement is."""
    return {node: row[f"who{place}"] for place, node in enumerate(find.nodes)}


def outcome_of_people(find: Find, rows: Sequence[Mapping[str, Any]]) -> Agreed:
    """Where one binding is to be certain, and no other one possible."""
    certain = sum(all(row[name] for name in row if name.startswith("sure")) for row in rows)
    if certain > 1:
        return "ambiguous", {}
    if not rows:
        return "empty", {}
    return ("defined", people_of(find, rows[0])) if len(rows) == certain else ("unknown", {})


def outcome_of_target(plan: Plan, people: Sequence[Mapping[str, Who]]) -> Agreed:
    """Where bindings are certain, and are to have one target: with the nodes who they are the same in all of them."""
    if len({one[plan.target] for one in people}) != 1:
        return "ambiguous" if people else "empty", {}
    return "defined", {node: who for node, who in people[0].items() if all(one[node] == who for one in people)}
