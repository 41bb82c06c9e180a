"""Tables of an agent's world model in the graph: the agent's looks, and what it read in them.

Every row belongs to one episode, which is one question of one run. An *entity* is a person that the agent named. The
tables are append-only: a write adds rows and changes none. So what was known after step k are the rows with
`step <= k`.

A *reading* is an edge that begins at an entity. `Sighted` (a box) and `Has` (an attribute) end at the look that shows
it. `Related` (a relation) ends at another entity, and its column `look` has the key of the look. `log_odds` is what the
reading says: positive if the value was affirmed, negative if it was denied. `weight` is what the reading adds to the
sum of its frame. A further reading of a topic in the same frame adds less (`schema.repeats`).

An edge with `origin` "derived" holds what follows from boxes and from several readings, such as the sector of a person.
Its weight is the change against the sum of the edges before it. So a sum of weights is what is known at a step.

The nodes have these keys: an `Episode` has `<run>/<question>`. A `Look` has `<episode>/o<number>`. An `Entity` has
`<episode>/<name>`, with a name that the agent chose. A `Slot` or a `Write` has `<episode>/<number>`. A `Hypothesis` has
`<episode>/h<number>.<rank>`.

`Look`, `Entity` and `Slot` also have a hash of the episode's key. Reads and writes of an agent find the rows of the
agent's episode by this hash, because the engine compares it faster than the key.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any, Final, Literal
from uuid import UUID

import msgspec

from jrdb_avr.schema.panorama import Box

ALWAYS: Final = 10_000_000
"""Frame that means the end of time."""

TIMELESS: Final = frozenset({"gender", "age"})
"""Attributes that hold at every frame."""


def free_value(text: str) -> str:
    """Return the value of a free attribute in the form that readings and plans compare: lower case, single blanks.

    >>> free_value("Dark  Red")
    'dark red'
    """
    return " ".join(text.lower().split())


Origin = Literal["model", "relation", "derived"]
"""Origin of an edge.

model: a model read it from a picture. relation: affirmed relations imply it for both. derived: code computed it
from readings.
"""

Tool = Literal[
    "begin",
    "plan",
    "rank",
    "observe",
    "get_graph",
    "add_people",
    "add_entity",
    "add_attribute",
    "add_relation",
    "final_answer",
]


class _Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Row of a world table. The fields are the columns."""


class Write(_Row, frozen=True):
    """One write of an agent into its world model, accepted or refused.

    A write is stored as a row of `world.parquet` and as a `Write` node of the graph. The rows of `world.parquet` are
    enough to build the world tables of the graph again. The first write of an episode is `begin`, which creates the
    `Episode` node.

    Attributes:
        number: Index of the write in its episode, from 0.
        step: Index of the model call that made the write.
        tool: Tool that the agent called.
        arguments: Arguments of the tool, as JSON.
        accepted: Whether the world model accepted the write.
        reason: Reason of the refusal, "" if the write was accepted.
        fact: JSON of a `Fact`, which contains the rows that the write added. "" if there are no such rows.
    """

    number: int
    step: int
    tool: Tool
    arguments: str
    accepted: bool
    reason: str
    fact: str


class EpisodeRow(_Row, frozen=True):
    """Row of `Episode`.

    Attributes:
        id: Key of the episode.
        run: Id of the run.
        question: Id of the question.
        sequence: Name of the sequence.
    """

    id: str
    run: str
    question: str
    sequence: str


class _NodeRow(_Row, frozen=True):
    """Row of a node that belongs to an episode. The key `id` of the node begins with the key of the episode."""

    id: str
    episode: str
    number: int


class LookRow(_NodeRow, frozen=True):
    """Row of `Look`, without the column `episode_hash`.

    The edge `Made` from the episode to the look is written together with the row. A crop covers the columns [left, left
    + width) of the panorama, which continue at column 0 after column 3759. A panorama covers all 3760 columns.
    """

    step: int
    frame: int
    angle: float
    left: int
    width: int


class EntityRow(_NodeRow, frozen=True):
    """Row of `Entity`, without the column `episode_hash`.

    The edge `Holds` from the episode to the entity is written together with the row.
    """

    name: str
    step: int


SlotKind = Literal["entity", "condition", "edge", "presence"]
"""Kind of a slot.

entity: all entities fill it. presence: the person of a node is visible at a frame that the plan states.
"""


class SlotRow(_NodeRow, frozen=True):
    """Row of `Slot`, which is one part of the agent's plan, without the column `episode_hash`.

    The edge `Asks` from the episode to the slot is written together with the row. A text column that does not apply to
    the kind is "". The column `frame` is -1 if the part holds at any frame.

    Attributes:
        number: Index of the slot in its episode.
        step: Index of the model call that set the plan. The slots of a later plan replace all earlier slots.
        kind: Kind of the slot.
        node: Node of the plan. The source of an edge.
        other: Target of an edge.
        name: Attribute or relation.
        value: Value of the attribute.
        topic: Topic of the `Has` edges that are evidence.
        origin: Origin of the edges that are evidence.
        also: Other values that the value may be called, joined by "|". Readings of them are no evidence against.
        frame: Stated frame.
        often: Prior probability that the part holds for a person or a pair.
    """

    step: int
    kind: SlotKind
    node: str
    other: str
    name: str
    value: str
    topic: str
    origin: Origin
    also: str
    frame: int
    often: float


class HypothesisRow(_NodeRow, frozen=True):
    """Row of `Hypothesis`, which is one binding of the plan's nodes.

    The edge `Ranks` from the episode to the hypothesis is written together with the row. Hypotheses are written each
    time the statements give other ones, and at the end of the episode.

    Attributes:
        number: Index of the write that added the hypothesis.
        step: Index of the model call after which the binding was written.
        rank: Rank by log-odds, from 1. The answer is about the target of rank 1 or of one nearly as likely.
        entity: Entity of the plan's target.
        nodes: Binding as text, such as "a=p1, b=p2".
        log_odds: Summed log-odds.
        margin: Log-odds over the best binding with another target.
        answer: Stored JSON of the answer, "" if the answer is about another entity.
        verdict: Verdict of the answer, "" if the answer is about another entity.
        frame: Frame of the evidence, -1 if the answer is about another entity.
    """

    step: int
    rank: int
    entity: str
    nodes: str
    log_odds: float
    margin: float
    answer: str
    verdict: str
    frame: int


class _EdgeRow(_Row, frozen=True):
    """Row of an edge.

    Attributes:
        source: Key of the node at the start of the edge.
        target: Key of the node at the end of the edge.
        episode: Key of the episode.
        write: Index, in the episode, of the write that added the edge.
        step: Index of the model call that made the write.
        frame: Frame of the look. The frame of the slot if the edge is derived.
    """

    source: str
    target: str
    episode: str
    write: int
    step: int
    frame: int


class ListedRow(_EdgeRow, frozen=True):
    """Row of `Listed`: the agent has listed the people of a look. The edge leads from the episode to the look."""


class SightingRow(_EdgeRow, frozen=True):
    """Row of `Sighted`.

    Attributes:
        box: Box in stitched pixels.
        angle: Panorama angle of the centre of the box, in degrees.
        whole: Whether no edge of the look cuts the box.
        number: Number of the person among the people of the look.
        metres: Distance in metres as the model read it, -1 without a reading.
    """

    box: Box
    angle: float
    whole: bool
    number: int
    metres: float


class AttributeRow(_EdgeRow, frozen=True):
    """Row of `Has`.

    Attributes:
        topic: Question that the value answers, such as "pose" or "action reading".
        name: Attribute.
        value: Value.
        log_odds: Log-odds of the reading for the value.
        weight: Log-odds that the edge adds for the value.
        exclusive: Whether an affirmed value excludes the other values of its topic.
        origin: Origin of the edge.
    """

    topic: str
    name: str
    value: str
    log_odds: float
    weight: float
    exclusive: bool
    origin: Origin


class RelationRow(_EdgeRow, frozen=True):
    """Row of `Related`.

    Attributes:
        name: Relation.
        log_odds: Log-odds of the reading for the relation.
        weight: Log-odds that the edge adds for the relation.
        look: Key of the look that shows the relation.
        origin: Origin of the edge.
    """

    name: str
    log_odds: float
    weight: float
    look: str
    origin: Origin


class Fact(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """Rows that one write adds to the world tables.

    Attributes:
        episode: New episode, which the tool `begin` creates.
        slots: Parts of an accepted plan.
        looks: New looks.
        entities: New entities.
        listed: Looks with people that the write lists.
        sighted: New sightings.
        has: New attributes.
        related: New relations.
        hypotheses: Likeliest bindings.
    """

    episode: EpisodeRow | None = None
    slots: tuple[SlotRow, ...] = ()
    looks: tuple[LookRow, ...] = ()
    entities: tuple[EntityRow, ...] = ()
    listed: tuple[ListedRow, ...] = ()
    sighted: tuple[SightingRow, ...] = ()
    has: tuple[AttributeRow, ...] = ()
    related: tuple[RelationRow, ...] = ()
    hypotheses: tuple[HypothesisRow, ...] = ()


_TYPES: Final[dict[Any, str]] = {
    str: "STRING",
    int: "INT64",
    float: "DOUBLE",
    bool: "BOOLEAN",
    **dict.fromkeys((Origin, SlotKind, Tool), "STRING"),
    Box: "STRUCT(x DOUBLE, y DOUBLE, w DOUBLE, h DOUBLE)",
}


def _columns(row: type[_Row], *more: str) -> tuple[str, ...]:
    """Return the columns of the table for a row class, each as a text such as "step INT64".

    The fields of the class come first, without the fields `source` and `target` of edges. The columns `more` follow.
    """
    fields = [f"{field.name} {_TYPES[field.type]}" for field in msgspec.structs.fields(row)]
    return (*(column for column in fields if column.split()[0] not in ("source", "target")), *more)


WORLD_NODES: Final[dict[str, str]] = {
    name: ", ".join(columns).replace("id STRING", "id STRING PRIMARY KEY", 1)
    for name, columns in {
        "Episode": _columns(EpisodeRow),
        "Look": _columns(LookRow, "episode_hash UUID"),
        "Entity": _columns(EntityRow, "episode_hash UUID"),
        "Slot": _columns(SlotRow, "episode_hash UUID"),
        "Hypothesis": _columns(HypothesisRow),
        "Write": ("id STRING", "episode STRING", *_columns(Write)[:-1]),
    }.items()
}

WORLD_RELS: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "Made": ("Episode", "Look", ()),
    "Holds": ("Episode", "Entity", ()),
    "Asks": ("Episode", "Slot", ()),
    "Wrote": ("Episode", "Write", ()),
    "Ranks": ("Episode", "Hypothesis", ()),
    "Listed": ("Episode", "Look", _columns(ListedRow)),
    "Sighted": ("Entity", "Look", _columns(SightingRow)),
    "Has": ("Entity", "Look", _columns(AttributeRow)),
    "Related": ("Entity", "Entity", _columns(RelationRow)),
}
"""Relationship tables by name: the table at the start, the table at the end, and columns as texts of name and type."""


def episode_key(run_id: str, question_id: str) -> str:
    """Return the key of an `Episode` node."""
    return f"{run_id}/{question_id}"


def episode_hash(episode: str) -> str:
    """Return the first 128 bits of the SHA-256 of an episode's key, as the text of a UUID."""
    return str(UUID(bytes=sha256(episode.encode()).digest()[:16]))


def name_of(key: str) -> str:
    """Return the name of an entity or a look. The name is the last part of the node's key."""
    return key.rpartition("/")[2]
