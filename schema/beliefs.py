"""Tables of the world namespace: the observations and beliefs of agents, keyed by episode.

An episode is one question of one run. Every belief belongs to an observation of the same episode: a sighting and an
attribute are edges from an entity to the observation; a relation has the observation's key. A belief holds at the
frame of its observation (`first` = `last`); gender and age always hold (0 to `ALWAYS`). A belief that a later write
replaces stays, with `current` false and `until` set to the step of that write. So an edge was believed at step k if
`step <= k AND until > k`. If readings are fused, each reading is an edge, and `current` marks the result. A reading
that the result contradicts was never believed: its `until` equals its `step`.

Keys: `Episode` has `<run>/<question>`, `Observation` `<episode>/o<number>`, `Entity` `<episode>/<name that the agent
gave it>`, `Slot` and `Write` `<episode>/<number>`, `Hypothesis` `<episode>/h<rank>`.

Nodes with edges also have a hash of the episode's key, and edges name their ends. Without them the engine would spend
half of its work on edges and names of other episodes, because agents read and write after almost every observation.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Final, Literal
from uuid import UUID

import msgspec

from jrdb_avr.schema.panorama import Box

ALWAYS: Final = 10_000_000
"""`last` of a belief that holds at every frame, and `until` of a current belief."""

TIMELESS: Final = frozenset({"gender", "age"})
"""Attributes that hold at every frame."""


def free_value(text: str) -> str:
    """Return the value of a free attribute in the form that beliefs and plans compare: lower case, single blanks.

    >>> free_value("Dark  Red")
    'dark red'
    """
    return " ".join(text.lower().split())


Origin = Literal["model", "derived"]
"""Origin of a belief. model: a model that sees a picture. derived: code that uses earlier readings."""

Tool = Literal["begin", "plan", "observe", "get_graph", "add_entity", "add_attribute", "add_relation", "final_answer"]


@dataclass(frozen=True, slots=True)
class Write:
    """One write of an episode, accepted or refused: a row of `world.parquet` and a `Write` node.

    The rows restore the world tables. The first write of an episode is `begin`, which makes the `Episode`.

    number: position in the episode, from 0. step: the model call that made the write. arguments: of the tool, as JSON.
    reason: of a refusal. fact: a `Fact` as JSON with the rows added to the graph, "" if none.
    """

    number: int
    step: int
    tool: Tool
    arguments: str
    accepted: bool
    reason: str
    fact: str


class _Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of a table. Its fields are the columns."""


class EpisodeRow(_Row, frozen=True):
    """A row of `Episode`. plan: "" until a plan is accepted. verdict: "" until the episode has its answer."""

    id: str
    run: str
    question: str
    sequence: str
    plan: str
    verdict: str


class _NodeRow(_Row, frozen=True):
    """A row of a node that belongs to an episode. Its key begins with the key of the episode."""

    id: str
    episode: str


class ObservationRow(_NodeRow, frozen=True):
    """A row of `Observation` without the hash, and of `Made` from its episode.

    A crop covers columns [left, left + width) of the panorama across the seam; a whole panorama covers all 3760.
    """

    number: int
    step: int
    frame: int
    angle: float
    left: int
    width: int


class EntityRow(_NodeRow, frozen=True):
    """A row of `Entity` without the hash, and of `Holds` from its episode. Only `kind` and `node` may change."""

    name: str
    number: int
    kind: str
    node: str
    step: int


class SlotRow(_NodeRow, frozen=True):
    """A row of `Slot`, and of `Asks` from its episode: one part of the plan.

    kind: a node (a person to find), a condition, an edge, or the read. A text column that the kind lacks is "", and
    the frame is -1 if the part has no stated time.
    """

    number: int
    kind: str
    node: str
    other: str
    name: str
    value: str
    frame: int


class HypothesisRow(_NodeRow, frozen=True):
    """A row of `Hypothesis`, and of `Ranks` from its episode: one assignment of entities to the plan's nodes.

    Rank 1 is the likeliest. The rows are written with the answer of the episode, which is the answer of rank 1.

    entity: name of the target. nodes: the assignment as "a=p1, b=p2". answer: answer read from the target at `frame`,
    as stored JSON.
    """

    step: int
    rank: int
    entity: str
    nodes: str
    log_odds: float
    answer: str
    frame: int


class _EdgeRow(_Row, frozen=True):
    """A row of an edge.

    source, target: keys of the nodes. write: number of the write, unique among the edges of an episode. votes,
    against: readings that agreed and disagreed with the edge at that write.
    """

    source: str
    target: str
    episode: str
    write: int
    step: int
    votes: int
    against: int
    origin: str


class SightingRow(_EdgeRow, frozen=True):
    """A row of `Sighted`. box: the box that the agent gave. angle: panorama angle of the box's centre, degrees."""

    frame: int
    box: Box
    angle: float


class AttributeRow(_EdgeRow, frozen=True):
    """A row of `Has`. value: text of the value. number: the value as a number, 0 if it is not a number."""

    name: str
    value: str
    number: float
    first: int
    last: int


class RelationRow(_EdgeRow, frozen=True):
    """A row of `Related`. observation: key of the `Observation` node."""

    name: str
    observation: str
    first: int
    last: int


class Fact(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """Rows that one write adds or changes, by table.

    episode: set on `begin`, with its plan on `plan`, and with its verdict on `final_answer`. entity: a new entity.
    changed: an entity with a new kind or node. freed: keys of entities that lose their node to this entity. replaced:
    writes with an edge that stops being `current` at this step; this write may be one of them. A new edge has
    `current` true and `until` `ALWAYS`.
    """

    episode: EpisodeRow | None = None
    slots: tuple[SlotRow, ...] = ()
    observation: ObservationRow | None = None
    entity: EntityRow | None = None
    changed: EntityRow | None = None
    freed: tuple[str, ...] = ()
    sighted: SightingRow | None = None
    has: AttributeRow | None = None
    related: RelationRow | None = None
    replaced: tuple[int, ...] = ()
    hypotheses: tuple[HypothesisRow, ...] = ()


_TYPES: Final = {str: "STRING", int: "INT64", float: "DOUBLE", Box: "STRUCT(x DOUBLE, y DOUBLE, w DOUBLE, h DOUBLE)"}


def _columns(row: type[_Row], *more: str) -> tuple[str, ...]:
    """Return the fields of a row without the ends of an edge, and more columns, as name and type."""
    fields = [f"{field.name} {_TYPES[field.type]}" for field in msgspec.structs.fields(row)]
    return (*(column for column in fields if column.split()[0] not in ("source", "target")), *more)


_CURRENT: Final = ("current BOOLEAN", "until INT64")

WORLD_NODES: Final[dict[str, str]] = {
    name: ", ".join(columns).replace("id STRING", "id STRING PRIMARY KEY", 1)
    for name, columns in {
        "Episode": _columns(EpisodeRow),
        "Observation": _columns(ObservationRow, "episode_hash UUID"),
        "Entity": _columns(EntityRow, "episode_hash UUID"),
        "Slot": _columns(SlotRow),
        "Hypothesis": _columns(HypothesisRow),
        "Write": (
            *("id STRING", "episode STRING", "number INT64", "step INT64"),
            *("tool STRING", "arguments STRING", "accepted BOOLEAN", "reason STRING"),
        ),
    }.items()
}

WORLD_RELS: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "Made": ("Episode", "Observation", ()),
    "Holds": ("Episode", "Entity", ()),
    "Asks": ("Episode", "Slot", ()),
    "Wrote": ("Episode", "Write", ()),
    "Ranks": ("Episode", "Hypothesis", ()),
    # `who` and `whom` are the names of the entities at both ends.
    "Sighted": ("Entity", "Observation", _columns(SightingRow, *_CURRENT, "who STRING")),
    "Has": ("Entity", "Observation", _columns(AttributeRow, *_CURRENT, "who STRING")),
    "Related": ("Entity", "Entity", _columns(RelationRow, *_CURRENT, "who STRING", "whom STRING")),
}
"""Relationship tables by name: source table, target table, and columns as name and type."""


def episode_key(run_id: str, question_id: str) -> str:
    """Return the key of an `Episode` node."""
    return f"{run_id}/{question_id}"


def episode_hash(episode: str) -> str:
    """Return 128 bits of the SHA-256 of an episode's key, as the text of a UUID."""
    return str(UUID(bytes=sha256(episode.encode()).digest()[:16]))


def name_of(key: str) -> str:
    """Return the name that the agent gave an entity or observation, from its key."""
    return key.rpartition("/")[2]
