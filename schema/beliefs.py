"""The world namespace: what an agent observed and believes, in tables beside the scene's, keyed by episode.

An episode is one question of one run. Every belief belongs to an observation of its own episode: a sighting and an
attribute are edges from an entity to the observation; a relation carries the observation's key. A belief holds at the
frame of its observation (`first` = `last`); gender and age hold always (0 to `ALWAYS`). A belief that a later write
replaces stays, with `current` false and `until` the step of that write: at step k an edge was believed where
`step <= k AND until > k`. Where readings are fused, each is an edge, and `current` is the one that they come to; a
reading that they speak against is never believed (`until` is its `step`). Keys: `Episode` is `<run>/<question>`;
`Observation` `<episode>/o<number>`; `Entity` `<episode>/<the agent's own name for it>`; `Slot` and `Write`
`<episode>/<number>`; `Hypothesis` `<episode>/h<rank>`.

The agent's edges are read and written after almost every observation. From the episode to its nodes and on to their
edges the engine would scan edges and names of other episodes, half of its work. So nodes with edges carry a hash of the
episode's key, found in one pass over a column of numbers, and edges name their ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Final, Literal
from uuid import UUID

import msgspec

from jrdb_avr.schema.panorama import Box

ALWAYS: Final = 10_000_000
"""`last` of a belief that holds at every frame, and `until` of a current one."""

TIMELESS: Final = frozenset({"gender", "age"})
"""Attributes that hold at every frame."""


def free_value(text: str) -> str:
    """The value of an attribute without labels, as beliefs and plans compare it: lower case, single blanks.

    >>> free_value("Dark  Red")
    'dark red'
    """
    return " ".join(text.lower().split())


Origin = Literal["model", "derived"]
"""Who states a belief: a model that looks at a picture, or code that goes by what was read so far."""

Tool = Literal["begin", "plan", "observe", "get_graph", "add_entity", "add_attribute", "add_relation", "final_answer"]


@dataclass(frozen=True, slots=True)
class Write:
    """One line of an episode's record, accepted or refused: a row of `world.parquet`, which restores the world tables.

    number: from 0, in order; step: the model call that made it; arguments: the agent's, as JSON; reason: why it was
    refused; fact: what it added to the graph, a `Fact` as JSON, "" for nothing. The first write of an episode is its
    `begin`, which makes the `Episode`; each write is a `Write` node as well.
    """

    number: int
    step: int
    tool: Tool
    arguments: str
    accepted: bool
    reason: str
    fact: str


class _Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of a table; its fields are the columns."""


class EpisodeRow(_Row, frozen=True):
    """A row of `Episode`; the plan is "" until one is accepted, the verdict until the episode has its answer."""

    id: str
    run: str
    question: str
    sequence: str
    plan: str
    verdict: str


class _NodeRow(_Row, frozen=True):
    """A node of one episode's beliefs; its key begins with the key of the episode."""

    id: str
    episode: str


class ObservationRow(_NodeRow, frozen=True):
    """A row of `Observation` without the hash, and of `Made` from its episode.

    A crop covers columns [left, left + width) of the panorama, over the seam; a whole panorama all 3760.
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
    """A row of `Slot`, and of `Asks` from its episode: a part of the plan.

    kind: a node (a person to be found), a condition, an edge, or the read. What a kind lacks is "", and -1 for the
    frame of a part at no stated time.
    """

    number: int
    kind: str
    node: str
    other: str
    name: str
    value: str
    frame: int


class HypothesisRow(_NodeRow, frozen=True):
    """A row of `Hypothesis`, and of `Ranks` from its episode: who the plan's people may be, the likeliest first.

    entity: the name of the target; nodes: whom each node is, as "a=p1, b=p2"; answer: what is read of the target at
    `frame`, stored JSON. Written with the answer of the episode, which is that of the first.
    """

    step: int
    rank: int
    entity: str
    nodes: str
    log_odds: float
    answer: str
    frame: int


class _EdgeRow(_Row, frozen=True):
    """A row of an edge; source and target are keys of the nodes.

    write: the write that made it; no two edges of an episode have the same. votes, against: how many readings agreed
    with it and how many did not when it was written.
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
    """A row of `Sighted`. box: as the agent saw it; angle: that of the box's centre."""

    frame: int
    box: Box
    angle: float


class AttributeRow(_EdgeRow, frozen=True):
    """A row of `Has`. `value` is a text; `number` its number, 0 where it is none."""

    name: str
    value: str
    number: float
    first: int
    last: int


class RelationRow(_EdgeRow, frozen=True):
    """A row of `Related`; `observation` is the key of its node."""

    name: str
    observation: str
    first: int
    last: int


class Fact(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """The rows that one write adds to the tables or changes, each under the name of its table.

    episode: on `begin`, again with its plan on `plan` and with its verdict on `final_answer`. entity: a new one;
    changed: one with another kind or node. freed: keys of entities whose node becomes "", as this entity takes it.
    Edges begin with `current` true and `until` `ALWAYS`; replaced: writes of this episode, or this one, whose edge is
    not `current` any more and ends with this step.
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
    """Columns of a row's fields, as name and type; the ends of an edge are no columns."""
    fields = [f"{one.name} {_TYPES[one.type]}" for one in msgspec.structs.fields(row)]
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
    # who, whom: the entities at the ends, by name.
    "Sighted": ("Entity", "Observation", _columns(SightingRow, *_CURRENT, "who STRING")),
    "Has": ("Entity", "Observation", _columns(AttributeRow, *_CURRENT, "who STRING")),
    "Related": ("Entity", "Entity", _columns(RelationRow, *_CURRENT, "who STRING", "whom STRING")),
}
"""Per relationship table: from, to, and its columns as name and type."""


def episode_key(run_id: str, question_id: str) -> str:
    """Key of an `Episode` node."""
    return f"{run_id}/{question_id}"


def episode_hash(episode: str) -> str:
    """128 bits of the SHA-256 of an episode's key, as text of the engine's type for such numbers."""
    return str(UUID(bytes=sha256(episode.encode()).digest()[:16]))


def name_of(key: str) -> str:
    """The agent's own name of an entity or observation, from its key."""
    return key.rpartition("/")[2]
