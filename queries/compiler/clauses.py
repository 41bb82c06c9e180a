"""Clauses: each kind of condition and edge of a plan as two boolean expressions of Cypher.

Facts have three values, so each clause comes twice: `sure` is true where the fact certainly holds, `could` where it is
not certainly false. Both are templates over variables that the caller binds: `n` a person and `s` the person's sighting
at the time (`m` and `z` those of the other person of an edge), `t` the frame, `scope` the sequence or episode, and `v`,
`w` the wanted values. Values are variables, never text: nothing of a plan enters a statement.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

Variables = dict[str, str]
"""Names of bound variables by the letters above."""


class Clause(NamedTuple):
    """A condition of a person, or an edge between two: when it certainly holds, and when it is possible."""

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
    """Facts stored as rows over intervals of frames, inclusive; a row that is not certain makes the fact possible.

    pattern: what to match; may: a relationship whose rows make the fact possible too; equal: columns of it with the
    variables they must equal; nullable: the same of columns whose null may stand for any value; span: the row's
    variable, with columns `first`, `last` and `certain`; then: the clause of a row that must lead on from this one. (As
    one pattern the two would close a circle, on which the engine loses rows.)
    """
    same = [f"{column} = {{{variable}}}" for column, variable in (equal or {}).items()]
    wanted = (nullable or {}).items()
    # The engine loses rows of a subquery where a column that is compared with a variable holds nulls.
    known = [f"{column} IS NOT NULL AND {column} = {{{variable}}}" for column, variable in wanted]
    possible = [f"({column} = {{{variable}}} OR {column} IS NULL)" for column, variable in wanted]
    covers = f"{span}.first <= {{t}} AND {span}.last >= {{t}}"
    sure = [*same, *known, f"{span}.certain", covers, *(then[:1] if then else ())]
    could = [*same, *possible, covers, *(then[1:] if then else ())]
    either = pattern.replace("]", f"|{may}]") if may else pattern
    texts = ((pattern, sure), (either, could))
    return Clause(*(f"EXISTS {{{{ MATCH {match} WHERE {' AND '.join(parts)} }}}}" for match, parts in texts))


def in_column(value: str, other: str = "", rows: Clause | None = None, near: str = "") -> Clause:
    """A fact stored as one value, null where it is unknown.

    value: the column; other: one with a second possible value, or ""; rows: a clause that makes another value possible;
    near: a test that does so, or "".
    """
    alone, second = (f" AND {other} IS NULL", f" OR {other} = {{v}}") if other else ("", "")
    listed = f" OR {rows.could}" if rows else ""
    also = f" OR {near}" if near else ""
    could = f"({value} IS NULL OR {value} = {{v}}{second}{listed}{also})"
    return Clause(f"coalesce({value} = {{v}}{alone}, false)", could)


def in_range(low: str, high: str) -> Clause:
    """A fact stored as the least and the greatest possible value, null where nothing is known."""
    sure = f"coalesce({low} = {{v}} AND {high} = {{v}}, false)"
    return Clause(sure, f"({low} IS NULL OR {low} <= {{v}} AND {high} >= {{v}})")


def unless_flickering(rows: Clause) -> Clause:
    """An action stored as rows: a label `w` frames earlier or later makes it possible, if only clear views count."""
    by = "CASE WHEN $in_view = true THEN {w} ELSE 0 END"
    times = (f"r.first <= {{t}} {sign} {by} AND r.last >= {{t}} {sign} {by}" for sign in "-+")
    near = f"EXISTS {{{{ MATCH ({{n}})-[r:Performs]->(x:Action) WHERE x.name = {{v}} AND ({' OR '.join(times)}) }}}}"
    return Clause(rows.sure, f"{rows.could} OR {near}")


def unless_listed(rows: Clause, listed: str) -> Clause:
    """A fact stored as rows: without a row it is false where `listed` holds, else unknown."""
    return Clause(rows.sure, f"({rows.could} OR NOT {listed})")


def unless_both_listed(rows: Clause, listed: str) -> Clause:
    """An edge stored as rows between two people: without a row it is false where `listed` holds of both."""
    return unless_listed(rows, f"({listed} AND {listed.replace('{n}', '{m}').replace('{s}', '{z}')})")


def within(here: str, there: str) -> Clause:
    """An edge by the panorama angles of two people: the other one is less than `v` degrees to the left.

    One turns left from `there` to `here`. Whoever is within the margin of the edge, or of the person's own direction,
    could be inside.
    """
    turn = f"({here} - {there})"
    left = f"({turn} - 360.0 * floor({turn} / 360.0))"
    return Clause(
        f"({left} > $margin AND 360.0 - {left} > $margin AND {left} < {{v}} AND {{v}} - {left} > $margin)",
        f"({left} <= $margin OR 360.0 - {left} <= $margin OR {left} < {{v}} OR {left} - {{v}} <= $margin)",
    )


def seen_with(pattern: str, there: str, edge: Clause) -> Clause:
    """An edge to a thing: it holds with a sighting `z` of the thing by `pattern` that is `there`."""
    return Clause(*(f"EXISTS {{{{ MATCH {pattern} WHERE {there} AND {text} }}}}" for text in edge))


def towards(angle: str) -> Clause:
    """A condition by the panorama angle of a person: it lies near the axis `v` of a sector."""
    off = f"({angle} - {{v}} + 180.0)"
    off = f"abs({off} - 360.0 * floor({off} / 360.0) - 180.0)"
    return Clause(f"({off} <= $sector_true)", f"({off} <= $sector_false)")


def to_anybody(edge: Clause, pattern: str) -> Clause:
    """A condition: an edge of this kind leads to anybody who matches `pattern`, a template over `n` and `s`."""
    match = pattern.replace("{n}", "other").replace("{s}", "seen")
    holds = (text.replace("{m}", "other").replace("{z}", "seen") for text in edge)
    return Clause(*(f"EXISTS {{{{ MATCH {match} AND other.id <> {{n}}.id AND {text} }}}}" for text in holds))
