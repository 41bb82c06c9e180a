"""Tables of names: how each namespace writes down who is there, and each kind of condition and edge.

Another namespace is another `Names`; what is compiled stays. `SCENE` is what was annotated, `WORLD` what an agent
believes in an episode: rows that hold for one frame, most of them, and none that tells that something is false.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final, Generic, Literal, TypeVar

from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.vocabulary import (
    FIRST_LEFT,
    FIRST_RIGHT,
    INTERACTIONS,
    POSES,
    SAME_GROUP,
    WINDOW_DEGREES,
    WINDOWS_LEFT,
    WINDOWS_RIGHT,
)

from .clauses import Clause, Known, Listed, Rows, Somebody, Tie, Told, Within

_DEGREES: Final = dict(zip((*WINDOWS_LEFT, *WINDOWS_RIGHT), WINDOW_DEGREES * 2, strict=True))


C = TypeVar("C")
"""How a namespace's clauses tell: by patterns (`Clause`), or by rows (`Told`)."""


@dataclass(frozen=True)
class Names(Generic[C]):
    """A namespace's names. People are told apart by their property `id`.

    pattern, there: a person `n` with a sighting `s`, and what makes it one at frame `t` of `scope`; who: the person's
    number or name in its scope; conditions, edges: clauses by kind, see `condition_kind` and `edge_kind`; reads: folder
    of the statements that read answers.

    opening: lines that give the facts of one scope as rows; what they are given is bound by the namespace's reader.
    Clauses are then `Told` by these, `there` says what makes one a sighting; a person is a name, and no sightings are
    bound.
    single: what there must be exactly one of: of all people of a plan together, or of its target alone. turned: whether
    windows are told by the angles of two people, so that an edge's value is how many degrees; else it is the window's
    label.
    """

    pattern: str
    there: str
    who: str
    conditions: Mapping[str, C]
    edges: Mapping[str, C]
    reads: str
    opening: str = ""
    single: Literal["people", "target"] = "people"
    turned: bool = True


def read_text(names: Names[Any], name: str) -> str:
    """The text of a packaged statement of a namespace."""
    return _packaged(names.reads, name)


def _packaged(folder: str, name: str) -> str:
    return resources.files("jrdb_avr.queries").joinpath("reads", folder, f"{name}.cypher").read_text("utf-8")


def condition_kind(condition: Condition) -> str:
    """Kind of a condition: its attribute, or pose, action, object or interaction."""
    if condition.attribute is not None:
        return condition.attribute
    if condition.action is not None:
        return "pose" if condition.action in POSES else "action"
    return "object" if condition.object is not None else "interaction"


def condition_values(condition: Condition) -> dict[str, str | int]:
    """The values a condition's clause compares with, by variable."""
    wanted = (condition.value, condition.action, condition.object, condition.interaction)
    values: dict[str, str | int] = {"v": next(value for value in wanted if value is not None)}
    return values if condition.verb is None else values | {"w": condition.verb}


def edge_kind(relation: str) -> str:
    """Kind of an edge: social, group, first, left or right (windows), or person (in a person's own frame)."""
    if relation in INTERACTIONS:
        return "social"
    if relation == SAME_GROUP:
        return "group"
    if relation in (FIRST_LEFT, FIRST_RIGHT):
        return "first"
    if relation in _DEGREES:
        return "left" if relation in WINDOWS_LEFT else "right"
    return "person"


def edge_values(relation: str, names: Names[Any]) -> dict[str, str | float]:
    """The values an edge's clause compares with, by variable; "in the same group as" has none."""
    if relation == SAME_GROUP:
        return {}
    return {"v": float(_DEGREES[relation]) if names.turned and relation in _DEGREES else relation}


_PATTERN: Final = "({n}:Person)-[{s}:SeenIn]->(:Frame)"
_THERE: Final = "{s}.sequence = {scope} AND {s}.frame = {t}"

_PERFORMS: Final = Rows("({n})-[r:Performs]->(x:Action)", (("x.name", "v"),))
_HANDLES: Final = Rows("({n})-[r:Handles]->(x:Object)", (("r.verb", "w"),), (("x.category", "v"),))
_INTERACTS: Final = Rows("({n})-[r:Interacts]->({m})", (("r.label", "v"),))
_BESIDE: Final = Rows("({n})-[r:Beside]->({m})", (("r.label", "v"),))
_GROUPED: Final = Rows("({n})-[r:MemberOf]->(g:SocialGroup)", then=Rows("(g)<-[o:MemberOf]-({m})", span="o"))
_MEMBER: Final = "EXISTS {{ MATCH ({n})-[r:MemberOf]->(:SocialGroup) WHERE r.first <= {t} AND r.last >= {t} }}"
_SOCIAL: Final = Tie(_INTERACTS, "{s}.interactions_listed")

SCENE: Final[Names[Clause]] = Names(
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


SYMMETRIC: Final = frozenset((*INTERACTIONS, SAME_GROUP))
"""Relations that hold both ways; an agent writes them once."""


_DURING: Final = "r.first <= {t} AND r.last >= {t}"


def _attribute(name: str, value: str = "r.value = {v}") -> Told:
    return Told((("id", "", f"r.name = '{name}' AND {value} AND {_DURING}"),))


def _relation(name: str, *, both: bool = False) -> Told:
    where = f"other IS NOT NULL AND r.name = {name} AND {_DURING}"
    return Told((("id", "other", where), ("other", "id", where)) if both else (("id", "other", where),))


_BELIEVED: Final = _relation("{v}")
_WITH_ANYBODY: Final = tuple((n, "", where) for n, _, where in _relation("{v}", both=True).ways)

WORLD: Final[Names[Told]] = Names(
    pattern="",
    there="r.frame = {t}",
    who="{n}",
    conditions={
        "gender": _attribute("gender"),
        "age": _attribute("age"),
        "pose": _attribute("action"),
        "action": _attribute("action"),
        "object": _attribute("object", "r.value = concat({w}, ': ', {v})"),
        "interaction": Told((*_attribute("interaction").ways, *_WITH_ANYBODY)),
        "group_size": _attribute("group_size", "r.number = {v}"),
        "sector": _attribute("sector"),
        "distance": _attribute("distance"),
    },
    edges={
        "social": _relation("{v}", both=True),
        "group": _relation(f"'{SAME_GROUP}'", both=True),
        "first": _BELIEVED,
        "person": _BELIEVED,
        "left": _BELIEVED,
        "right": _BELIEVED,
    },
    reads="world",
    opening=_packaged("world", "beliefs"),
    single="target",
    turned=False,
)
"""The world namespace: what is believed in one episode. `who` is the agent's own name for an entity."""
