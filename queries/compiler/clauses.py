"""Clauses: the Cypher of each kind of condition and edge of a plan, as two boolean expressions.

Because facts have three values, each clause has two texts. `sure` is true if the fact is certain, and `could` is true
if the fact is not certainly false. Both are templates over variables that the caller binds. `n` is a person with the
sighting `s`. `m` is the other person of an edge with the sighting `z`. `t` is the frame, and `scope` the sequence. `v`
and `w` are the requested values. Values are variables, so that no text of a plan is part of a statement.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

Variables = dict[str, str]
"""Names of bound variables, by the letters above."""


class Clause(NamedTuple):
    """Cypher of a condition of a person, or of an edge between two people."""

    sure: str
    could: str


def in_rows(
    pattern: str,
    equal: Mapping[str, str] | None = None,
    nullable: Mapping[str, str] | None = None,
    *,
    may: str = "",
    span: str = "r",
    then: Clause | None = None,
) -> Clause:
    """Return the clause of facts that are rows over intervals of frames.

    A row that is not certain makes the fact possible.

    Args:
        pattern: Pattern of a row.
        equal: Columns of the row with the variables that they must equal.
        nullable: The same for columns with a null if any value is possible.
        may: Relationship with further rows that make the fact possible, or "".
        span: Variable of the row, which has the columns `first`, `last` and `certain`.
        then: Clause of a second row that must exist too, or None. It is a separate pattern, because one pattern of both
            rows would be a cycle, and the engine loses rows of cycles.
    """
    same = [f"{column} = {{{variable}}}" for column, variable in (equal or {}).items()]
    optional = (nullable or {}).items()
    # IS NOT NULL is needed, because the engine loses rows of a subquery that compares a column with nulls.
    present = [f"{column} IS NOT NULL AND {column} = {{{variable}}}" for column, variable in optional]
    possible = [f"({column} = {{{variable}}} OR {column} IS NULL)" for column, variable in optional]
    covers = f"{span}.first <= {{t}} AND {span}.last >= {{t}}"
    sure = [*same, *present, f"{span}.certain", covers, *(then[:1] if then else ())]
    could = [*same, *possible, covers, *(then[1:] if then else ())]
    either = pattern.replace("]", f"|{may}]") if may else pattern
    texts = ((pattern, sure), (either, could))
    return Clause(*(f"EXISTS {{{{ MATCH {match} WHERE {' AND '.join(parts)} }}}}" for match, parts in texts))


def in_column(value: str, second_value: str = "", rows: Clause | None = None, near: str = "") -> Clause:
    """Return the clause of a fact that is one value, or null if the value is unknown.

    Args:
        value: Column of the value.
        second_value: Column of a second possible value, or "".
        rows: Clause of facts that make `v` possible beside another value, or None.
        near: Condition that makes `v` possible beside another value, or "".
    """
    alone, second = (f" AND {second_value} IS NULL", f" OR {second_value} = {{v}}") if second_value else ("", "")
    listed = f" OR {rows.could}" if rows else ""
    also = f" OR {near}" if near else ""
    could = f"({value} IS NULL OR {value} = {{v}}{second}{listed}{also})"
    return Clause(f"coalesce({value} = {{v}}{alone}, false)", could)


def in_range(least: str, most: str) -> Clause:
    """Return the clause of a number between two columns, which are null if the number is unknown.

    Args:
        least: Column of the minimum.
        most: Column of the maximum.
    """
    could = f"({least} IS NULL OR ({least} <= {{v}} AND {most} >= {{v}}))"
    return Clause(f"coalesce({least} = {{v}} AND {most} = {{v}}, false)", could)


def unless_listed(rows: Clause, listed: str) -> Clause:
    """Return the clause of a fact that rows state. Without a row it is false if the list is complete, else unknown.

    Args:
        rows: Clause of the rows.
        listed: Condition that the list is complete.
    """
    return Clause(rows.sure, f"({rows.could} OR NOT {listed})")


def unless_labelled_near(fact: Clause, pattern: str) -> Clause:
    """Return the clause of a condition that is unknown, not false, if an unsteady label is near.

    The label `v` is unsteady if it is in the list `$flickering`. It is near if the person has it one keyframe before or
    after.

    Args:
        fact: Clause of the condition.
        pattern: Pattern of a row `r` of the label `x.name`.
    """
    near = " OR ".join(f"(r.first <= {{t}} {step} AND r.last >= {{t}} {step})" for step in ("- 15", "+ 15"))
    rows = f"EXISTS {{{{ MATCH {pattern} WHERE x.name = {{v}} AND ({near}) }}}}"
    return Clause(fact.sure, f"({fact.could} OR (list_contains($flickering, {{v}}) AND {rows}))")


def unless_both_listed(rows: Clause, listed: str) -> Clause:
    """Return the clause of edges that are rows.

    Without a row, the edge is false if the lists of both people are complete.

    Args:
        rows: Clause of the rows.
        listed: Condition that the list of a person is complete.
    """
    return unless_listed(rows, f"({listed} AND {listed.replace('{n}', '{m}').replace('{s}', '{z}')})")


def within(source: str, target: str) -> Clause:
    """Return the clause of an edge by panorama angles: the target is less than `v` degrees to the left of the source.

    The edge is unknown if the target is within a margin of the limit, or within a margin of the source's direction.

    Args:
        source: Angle of the source. For the right side, angle of the target.
        target: Angle of the target. For the right side, angle of the source.
    """
    turn = f"({source} - {target})"
    left = f"({turn} - 360.0 * floor({turn} / 360.0))"
    return Clause(
        f"({left} > $margin AND 360.0 - {left} > $margin AND {left} < {{v}} AND {{v}} - {left} > $margin)",
        f"({left} <= $margin OR 360.0 - {left} <= $margin OR {left} < {{v}} OR {left} - {{v}} <= $margin)",
    )


def seen_with(pattern: str, present: str, edge: Clause) -> Clause:
    """Return the clause of an edge to a thing. The edge needs a sighting of the thing.

    Args:
        pattern: Pattern of a sighting `z` of the thing.
        present: Condition that the sighting is at the time.
        edge: Clause of the edge with the sighting.
    """
    return Clause(*(f"EXISTS {{{{ MATCH {pattern} WHERE {present} AND {text} }}}}" for text in edge))


def towards(angle: str) -> Clause:
    """Return the clause of a condition that a person is in the sector with the axis `v`.

    Args:
        angle: Cypher expression of the person's panorama angle in degrees.
    """
    off = f"({angle} - {{v}} + 180.0)"
    off = f"abs({off} - 360.0 * floor({off} / 360.0) - 180.0)"
    return Clause(f"({off} <= $sector_true)", f"({off} <= $sector_false)")


def to_anybody(edge: Clause, pattern: str) -> Clause:
    """Return the clause of a condition that holds if an edge leads to any other person who matches a pattern.

    The condition is certain only if that person is in clear view, or if the rules do not judge views (`$in_view`).

    Args:
        edge: Clause of the edge.
        pattern: Pattern of a person, a template over `n` and `s`.
    """
    match = pattern.replace("{n}", "other").replace("{s}", "seen")
    texts = (text.replace("{m}", "other").replace("{z}", "seen") for text in edge)
    sure, could = (f"EXISTS {{{{ MATCH {match} AND other.id <> {{n}}.id AND {text}" for text in texts)
    return Clause(f"{sure} AND (seen.clear OR NOT $in_view) }}}}", f"{could} }}}}")
