"""A table of names: how the scene namespace writes down who is there, and each kind of condition and edge.

Another namespace of facts with three values is another `Names`; what is compiled stays. (What an agent believes in an
episode has none that tells that something is false: `believed_find`.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Final

from jrdb_avr.queries.compiler.clauses import Clause, Known, Listed, Rows, Somebody, Tie, Within
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import RELATIONS, SAME_GROUP


@dataclass(frozen=True)
class Names:
    """A namespace's names. People are told apart by their property `id`.

    pattern, there: a person `n` with a sighting `s`, and what makes it one at frame `t` of `scope`; who: the person's
    number or name in its scope; conditions, edges: clauses by kind, see `Condition.kind` and `edge_kind`; reads: folder
    of the statements that read answers.
    """

    pattern: str
    there: str
    who: str
    conditions: Mapping[str, Clause]
    edges: Mapping[str, Clause]
    reads: str


def read_text(folder: str, name: str) -> str:
    """The text of the packaged statement `queries/reads/<folder>/<name>.cypher`."""
    return resources.files("jrdb_avr.queries").joinpath("reads", folder, f"{name}.cypher").read_text("utf-8")


def condition_values(condition: Condition) -> dict[str, str | int]:
    """The values a condition's clause compares with, by variable."""
    wanted = (condition.value, condition.action, condition.object, condition.interaction)
    values: dict[str, str | int] = {"v": next(value for value in wanted if value is not None)}
    return values if condition.verb is None else values | {"w": condition.verb}


def edge_kind(relation: str) -> str:
    """Kind of an edge: that of its relation, or the side of a window. A label that names no relation counts as a
    person's place, of which there is no row.
    """
    row = RELATIONS.get(relation)
    if row is None:
        return "person"
    return row.side if row.kind == "window" else row.kind


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

_PERFORMS: Final = Rows("({n})-[r:Performs]->(x:Action)", (("x.name", "v"),))
_HANDLES: Final = Rows("({n})-[r:Handles]->(x:Object)", (("r.verb", "w"),), (("x.category", "v"),))
_INTERACTS: Final = Rows("({n})-[r:Interacts]->({m})", (("r.label", "v"),))
_BESIDE: Final = Rows("({n})-[r:Beside]->({m})", (("r.label", "v"),))
_GROUPED: Final = Rows("({n})-[r:MemberOf]->(g:SocialGroup)", then=Rows("(g)<-[o:MemberOf]-({m})", span="o"))
_MEMBER: Final = "EXISTS {{ MATCH ({n})-[r:MemberOf]->(:SocialGroup) WHERE r.first <= {t} AND r.last >= {t} }}"
_SOCIAL: Final = Tie(_INTERACTS, "{s}.interactions_listed")

SCENE: Final = Names(
    pattern=_PATTERN,
    there=_THERE,
    who="{n}.track",
    conditions={
        "gender": Known("{n}.gender"),
        "age": Known("{n}.age"),
        # A closed gap of a pose leaves it possible beside the pose that is listed.
        "pose": Known("{s}.pose", rows=_PERFORMS),
        "action": Listed(_PERFORMS, "{s}.listed"),
        "object": Listed(_HANDLES, "{s}.handles_listed"),
        "interaction": Somebody(_SOCIAL, f"{_PATTERN} WHERE {_THERE}"),
        "group_size": Known("{s}.group_size"),
        "sector": Known("{s}.sector", "{s}.sector_other"),
        "distance": Known("{s}.distance_word", "{s}.distance_word_other"),
    },
    edges={
        "social": _SOCIAL,
        "group": Tie(_GROUPED, _MEMBER),
        "first": Tie(_BESIDE),
        "person": Tie(_BESIDE, "{s}.located"),
        "left": Within("{s}.angle", "{z}.angle"),
        "right": Within("{z}.angle", "{s}.angle"),
    },
    reads="scene",
)
"""The scene namespace: what was annotated. `scope` is the sequence, `who` the track."""
