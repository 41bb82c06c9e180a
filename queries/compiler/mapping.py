"""Mapping from plans to the scene in a graph: patterns, clauses of conditions and edges, and their values.

Facts of a scene are true, false or unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from jrdb_avr.queries.compiler.clauses import (
    Clause,
    in_column,
    in_range,
    in_rows,
    seen_with,
    to_anybody,
    towards,
    unless_both_listed,
    unless_labelled_near,
    unless_listed,
    within,
)
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import ROBOT_SECTORS, may_be_called
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import RELATIONS, SAME_GROUP
from jrdb_avr.schema.things import VERBS

PersonId = int
"""Person in a sequence: the number of a track."""


@dataclass(frozen=True)
class NodeMapping:
    """Cypher that finds people, or things, in the scene of a graph.

    Attributes:
        pattern: Pattern of a node `n`. A person has the sighting `s`.
        present: Condition that the sighting is at frame `t` of `scope` and that the person is not covered. A covered
            person does not count. For things, the condition that the thing is in `scope`.
        key: Track of the person, or key of the thing.
        conditions: Clauses of conditions by kind, as in `Condition.kind`. A thing has only the condition "kind".
        edges: Clauses of edges from a person to the node by kind, as in `edge_kind` and `thing_edge_kind`.
    """

    pattern: str
    present: str
    key: str
    conditions: Mapping[str, Clause]
    edges: Mapping[str, Clause]


def condition_values(condition: Condition) -> dict[str, str | float | list[str]]:
    """Return the values that the clause of a condition compares with, by variable.

    Args:
        condition: Condition of a plan.

    Raises:
        PlanError: If the sector is unknown.
    """
    if condition.attribute == "sector":
        if condition.value not in ROBOT_SECTORS:
            raise PlanError("conditions", f"{condition.value!r} is no sector")
        return {"v": ROBOT_SECTORS[str(condition.value)]}
    given = (condition.value, condition.action, condition.object, condition.interaction)
    values: dict[str, str | float | list[str]] = {"v": next(value for value in given if value is not None)}
    if condition.attribute == "age":
        values["w"] = sorted(may_be_called(str(condition.value)))
    return values if condition.verb is None else values | {"w": condition.verb}


def edge_kind(relation: str) -> str:
    """Return the kind of an edge between two people: the kind of its relation, or the side of a window.

    An unknown relation has the kind "person". There are no rows with its label, so the edge is never true.

    Args:
        relation: Relation of the edge.
    """
    row = RELATIONS.get(relation)
    if row is None:
        return "person"
    return row.side if row.kind == "window" else row.kind


def thing_edge_kind(field: str, relation: str) -> str:
    """Return the kind of an edge to a thing.

    Args:
        field: Name of the field, for the error message.
        relation: Relation of the edge.

    Raises:
        PlanError: If no label has the relation to a thing.
    """
    if relation in VERBS:
        return "handles"
    row = RELATIONS.get(relation)
    if row is None or row.kind != "window":
        use = "use a verb, as 'holding', or 'within 30 degrees to the left of (robot view)'"
        raise PlanError(field, f"{relation!r} to a thing is not labelled; {use}")
    return row.side


def edge_values(relation: str) -> dict[str, str | float]:
    """Return the values that fill the variables of the clause of an edge, by the letter of the variable.

    The relation "in the same group as" has no value. "Within N degrees" has N. All others have their label.

    Args:
        relation: Relation of the edge.
    """
    if relation == SAME_GROUP:
        return {}
    row = RELATIONS.get(relation)
    return {"v": float(row.degrees) if row and row.kind == "window" else relation}


_PATTERN: Final = "({n}:Person)-[{s}:SeenIn]->(:Frame)"
BOXED: Final = "{s}.sequence = {scope} AND {s}.frame = {t}"
"""Condition that a sighting is at frame `t` of `scope`."""

_LABELLED: Final = "({n})-[r:Performs]->(x:Action)"
_PERFORMS: Final = in_rows(_LABELLED, {"x.name": "v"}, may="MayPerform")
_HANDLES: Final = in_rows("({n})-[r:Handles]->(x:Object)", {"r.verb": "w"}, {"x.category": "v"}, may="MayHandle")
_BESIDE: Final = in_rows("({n})-[r:Beside]->({m})", {"r.label": "v"})
_GROUPED: Final = in_rows(
    "({n})-[r:MemberOf]->(g:SocialGroup)",
    may="MayBelong",
    then=in_rows("(g)<-[o:MemberOf]-({m})", may="MayBelong", span="o"),
)
_MEMBER: Final = (
    "EXISTS {{ MATCH ({n})-[r:MemberOf]->(:SocialGroup) WHERE r.first <= {t} AND r.last >= {t} AND r.certain }}"
)
_THING_SEEN: Final = ("({m})-[{z}:SeenIn]->(:Frame)", BOXED.replace("{s}", "{z}"))
_SOCIAL: Final = unless_both_listed(
    in_rows("({n})-[r:Interacts]->({m})", {"r.label": "v"}, may="MayInteract"), "{s}.interactions_listed"
)

PEOPLE: Final = NodeMapping(
    pattern=_PATTERN,
    present=f"{BOXED} AND NOT {{s}}.covered",
    key="{n}.track",
    conditions={
        "gender": in_column("{n}.gender"),
        "age": in_column("{n}.age", near="list_contains({w}, {n}.age)"),
        # A closed gap of a pose leaves it possible beside the pose that is listed.
        "pose": in_column("{s}.pose", rows=_PERFORMS),
        "action": unless_labelled_near(unless_listed(_PERFORMS, "{s}.listed"), _LABELLED),
        "object": unless_listed(_HANDLES, "{s}.handles_listed"),
        "interaction": to_anybody(_SOCIAL, f"{_PATTERN} WHERE {BOXED}"),
        "group_size": in_range("{s}.group_size_min", "{s}.group_size_max"),
        "sector": towards("{s}.angle"),
        "distance": in_column("{s}.distance_word", "{s}.distance_word_other"),
    },
    edges={
        "social": _SOCIAL,
        "group": unless_both_listed(_GROUPED, _MEMBER),
        "first": unless_both_listed(_BESIDE, "{s}.robot_view_listed"),
        "person": unless_both_listed(_BESIDE, "{s}.person_view_listed"),
        "left": within("{s}.angle", "{z}.angle"),
        "right": within("{z}.angle", "{s}.angle"),
    },
)
"""People of a sequence. `scope` is the name of the sequence."""

THINGS: Final = NodeMapping(
    pattern="({n}:Object)",
    present="{n}.sequence = {scope}",
    key="{n}.id",
    conditions={"kind": in_column("{n}.category")},
    edges={
        "handles": unless_listed(
            in_rows("({n})-[r:Handles]->({m})", {"r.verb": "v"}, may="MayHandle"), "{s}.handles_listed"
        ),
        "left": seen_with(*_THING_SEEN, within("{s}.angle", "{z}.angle")),
        "right": seen_with(*_THING_SEEN, within("{z}.angle", "{s}.angle")),
    },
)
"""Things of a sequence. `scope` is the name of the sequence."""
