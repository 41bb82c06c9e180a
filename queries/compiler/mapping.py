"""The mapping from plans to the graph's schema: patterns, clauses of conditions and edges, and their values.

Another namespace of facts with three values is another `SchemaMapping`; the compiler stays as it is. (Beliefs of an
agent are never false, so `beliefs` compiles them in its own way.)
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
    unless_flickering,
    unless_listed,
    within,
)
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import FLICKERING, ROBOT_SECTORS, may_be_called
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import RELATIONS, SAME_GROUP
from jrdb_avr.schema.rules import KEYFRAME_STEP
from jrdb_avr.schema.things import VERBS

PersonId = int | str
"""A person in a scope: the number of a track, or the name of an entity."""


@dataclass(frozen=True)
class SchemaMapping:
    """A namespace of the graph. The property `id` identifies its people.

    pattern, boxed, there: a person `n` with a sighting `s`, the condition for one at frame `t` of `scope`, and for one
    of a person who counts then; who: the person's number or name in its scope; conditions, edges: clauses by kind, see
    `Condition.kind` and `edge_kind`; things: the things `n` of `scope`.
    """

    pattern: str
    boxed: str
    there: str
    who: str
    conditions: Mapping[str, Clause]
    edges: Mapping[str, Clause]
    things: ThingMapping


@dataclass(frozen=True)
class ThingMapping:
    """The things of a namespace: pattern, condition and name as those of people, but without a sighting.

    kind: the clause of a thing's kind `v`; edges: clauses of edges from a person to a thing, by kind.
    """

    pattern: str
    there: str
    who: str
    kind: Clause
    edges: Mapping[str, Clause]


def condition_values(condition: Condition) -> dict[str, str | float | list[str]]:
    """The values a condition's clause compares with, by variable. Raises PlanError for an unknown sector."""
    if condition.attribute == "sector":
        if condition.value not in ROBOT_SECTORS:
            raise PlanError("conditions", f"{condition.value!r} is no sector")
        return {"v": ROBOT_SECTORS[str(condition.value)]}
    wanted = (condition.value, condition.action, condition.object, condition.interaction)
    values: dict[str, str | float | list[str]] = {"v": next(value for value in wanted if value is not None)}
    if condition.attribute == "age":
        values["w"] = sorted(may_be_called(str(condition.value)))
    if condition.kind == "action":
        values["w"] = KEYFRAME_STEP if condition.action in FLICKERING else 0
    return values if condition.verb is None else values | {"w": condition.verb}


def edge_kind(relation: str) -> str:
    """Kind of an edge: that of its relation, or the side of a window. A label that names no relation counts as a
    person's place, of which there is no row.
    """
    row = RELATIONS.get(relation)
    if row is None:
        return "person"
    return row.side if row.kind == "window" else row.kind


def thing_edge_kind(field: str, relation: str) -> str:
    """Kind of an edge to a thing. Raises PlanError for a relation that nothing is labelled with."""
    if relation in VERBS:
        return "handles"
    row = RELATIONS.get(relation)
    if row is None or row.kind != "window":
        use = "use a verb, as 'holding', or 'within 30 degrees to the left of (robot view)'"
        raise PlanError(field, f"{relation!r} to a thing is not labelled; {use}")
    return row.side


def edge_values(relation: str) -> dict[str, str | float]:
    """The values that an edge's clause compares with, by variable: none for the same group, a window's degrees, and
    otherwise the label.
    """
    if relation == SAME_GROUP:
        return {}
    row = RELATIONS.get(relation)
    return {"v": float(row.degrees) if row and row.kind == "window" else relation}


_PATTERN: Final = "({n}:Person)-[{s}:SeenIn]->(:Frame)"
_THERE: Final = "{s}.sequence = {scope} AND {s}.frame = {t}"
_CLEAR: Final = "({z}.clear OR $in_view = false)"

_PERFORMS: Final = in_rows("({n})-[r:Performs]->(x:Action)", {"x.name": "v"}, may="MayPerform")
_HANDLES: Final = in_rows("({n})-[r:Handles]->(x:Object)", {"r.verb": "w"}, {"x.category": "v"}, may="MayHandle")
_BESIDE: Final = in_rows("({n})-[r:Beside]->({m})", {"r.label": "v"})
_GROUPED: Final = in_rows(
    "({n})-[r:MemberOf]->(g:SocialGroup)",
    may="MayBelong",
    then=in_rows("(g)<-[o:MemberOf]-({m})", may="MayBelong", span="o"),
)
_MEMBER: Final = (
    "EXISTS {{ MATCH ({n})-[r:MemberOf|MayBelong]->(:SocialGroup) WHERE r.first <= {t} AND r.last >= {t} }}"
)
_THING_SEEN: Final = ("({m})-[{z}:SeenIn]->(:Frame)", _THERE.replace("{s}", "{z}"))
_SOCIAL: Final = unless_both_listed(
    in_rows("({n})-[r:Interacts]->({m})", {"r.label": "v"}, may="MayInteract"), "{s}.interactions_listed"
)

SCENE: Final = SchemaMapping(
    pattern=_PATTERN,
    boxed=_THERE,
    there=f"{_THERE} AND NOT {{s}}.covered",
    who="{n}.track",
    conditions={
        "gender": in_column("{n}.gender"),
        "age": in_column("{n}.age", near="list_contains({w}, {n}.age)"),
        # A closed gap of a pose leaves it possible beside the pose that is listed.
        "pose": in_column("{s}.pose", rows=_PERFORMS),
        "action": unless_listed(unless_flickering(_PERFORMS), "{s}.listed"),
        "object": unless_listed(_HANDLES, "{s}.handles_listed"),
        "interaction": to_anybody(Clause(f"{_CLEAR} AND {_SOCIAL.sure}", _SOCIAL.could), f"{_PATTERN} WHERE {_THERE}"),
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
    things=ThingMapping(
        pattern="({n}:Object)",
        there="{n}.sequence = {scope}",
        who="{n}.id",
        kind=in_column("{n}.category"),
        edges={
            "handles": unless_listed(
                in_rows("({n})-[r:Handles]->({m})", {"r.verb": "v"}, may="MayHandle"), "{s}.handles_listed"
            ),
            "left": seen_with(*_THING_SEEN, within("{s}.angle", "{z}.angle")),
            "right": seen_with(*_THING_SEEN, within("{z}.angle", "{s}.angle")),
        },
    ),
)
"""The scene namespace: the annotations. `scope` is the sequence, `who` the track, or the key of a thing."""
