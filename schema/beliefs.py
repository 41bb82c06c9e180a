"""Tables of an agent's world model in the graph: the agent's observations, and its beliefs about what it saw.

Every row belongs to one episode, which is one question of one run. An *entity* is a person or thing that the agent
named. A *belief* is an edge that begins at an entity and refers to one observation of the same episode. There are three
kinds of beliefs. A sighting (`Sighted`) or an attribute (`Has`) ends at the observation. A relation (`Related`) ends at
another entity, and its column `observation` has the key of the observation.

A belief holds at the frame of its observation (`first` = `last`). Gender and age hold at every frame (0 to `ALWAYS`). A
belief stays in the graph if a later write replaces it: `current` becomes false, and `until` becomes the step of that
write. So an edge was believed at step k if `step <= k AND until > k`. If several readings of one attribute are
combined, each reading is an edge, and `current` marks the edge with the result. A reading that the result contradicts
was never believed, so its `until` equals its `step`.

The nodes have these keys: an `Episode` has `<run>/<question>`. An `Observation` has `<episode>/o<number>`. An `Entity`
has `<episode>/<name>`, with a name that the agent chose. A `Slot` or a `Write` has `<episode>/<number>`. A `Hypothesis`
has `<episode>/h<rank>`.

`Observation` and `Entity` also have a hash of the episode's key, and edges of beliefs have the names of the entities at
both ends. The reads and writes of an agent use this hash and these names to find the edges of the agent's episode.
Otherwise, the engine would spend half of its work on edges of other episodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Final, Literal
from uuid import UUID

import msgspec

from jrdb_avr.schema.panorama import Box

ALWAYS: Final = 10_000_000
"""Value of the column `last` if a belief holds at every frame, and of the column `until` if a belief is current."""

TIMELESS: Final = frozenset({"gender", "age"})
"""Attributes that hold at every frame."""


def free_value(text: str) -> str:
    """Return the value of a free attribute in the form that beliefs and plans compare: lower case, with single blanks.

    >>> free_value("Dark  Red")
    'dark red'
    """
    return " ".join(text.lower().split())


Origin = Literal["model", "derived"]
"""Origin of a belief. model: a model read it from a picture. derived: code computed it from earlier readings."""

Tool = Literal["begin", "plan", "observe", "get_graph", "add_entity", "add_attribute", "add_relation", "final_answer"]


@dataclass(frozen=True, slots=True)
class Write:
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
        fact: JSON of a `Fact`, which contains the rows that the write added or changed. "" if there are no such rows.
    """

    number: int
    step: int
    tool: Tool
    arguments: str
    accepted: bool
    reason: str
    fact: str


class _Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Row of a world table. The fields are the columns."""


class EpisodeRow(_Row, frozen=True):
    """Row of `Episode`.

    Attributes:
        id: Key of the episode.
        run: Id of the run.
        question: Id of the question.
        sequence: Name of the sequence.
        plan: Plan as JSON, "" until a plan is accepted.
        verdict: How well the world model supports the answer, "" until the episode has an answer.
    """

    id: str
    run: str
    question: str
    sequence: str
    plan: str
    verdict: str


class _NodeRow(_Row, frozen=True):
    """Row of a node that belongs to an episode. The key `id` of the node begins with the key of the episode."""

    id: str
    episode: str


class ObservationRow(_NodeRow, frozen=True):
    """Row of `Observation`, without the column `episode_hash`.

    The edge `Made` from the episode to the observation is written together with the row. A crop covers the columns
    [left, left + width) of the panorama, which continue at column 0 after column 3759. A whole panorama covers all 3760
    columns.
    """

    number: int
    step: int
    frame: int
    angle: float
    left: int
    width: int


class EntityRow(_NodeRow, frozen=True):
    """Row of `Entity`, without the column `episode_hash`.

    The edge `Holds` from the episode to the entity is written together with the row. A later write may change the
    columns `kind` and `node`, but no other column.
    """

    name: str
    number: int
    kind: str
    node: str
    step: int


class SlotRow(_NodeRow, frozen=True):
    """Row of `Slot`, which is one part of the agent's plan.

    The edge `Asks` from the episode to the slot is written together with the row. A part is a node (a person to find),
    a condition on a node, an edge between two nodes, or the read (the value that answers the question). The column
    `kind` says which of these four the part is. A text column that does not apply to the kind is "". The column `frame`
    is -1 if the part has no stated time.
    """

    number: int
    kind: str
    node: str
    other: str
    name: str
    value: str
    frame: int


class HypothesisRow(_NodeRow, frozen=True):
    """Row of `Hypothesis`, which is one assignment of entities to the nodes of the plan.

    The edge `Ranks` from the episode to the hypothesis is written together with the row. The hypotheses are written
    when the episode gets its answer.

    Attributes:
        step: Index of the model call after which the hypothesis was written.
        rank: Rank by likelihood. The episode's answer is the answer of rank 1, the likeliest hypothesis.
        entity: Name of the entity that is assigned to the target of the question.
        nodes: Assignment as text, such as "a=p1, b=p2".
        log_odds: Log-odds of the hypothesis.
        answer: Answer that was read from the target at `frame`, as stored JSON.
        frame: Frame of the reading that gave the answer.
    """

    step: int
    rank: int
    entity: str
    nodes: str
    log_odds: float
    answer: str
    frame: int


class _EdgeRow(_Row, frozen=True):
    """Row of an edge that states a belief.

    Attributes:
        source: Key of the node at the start of the edge.
        target: Key of the node at the end of the edge.
        episode: Key of the episode.
        write: Index, in the episode, of the write that added the edge. Each write adds at most one edge.
        step: Index of the model call that made the write.
        votes: Number of readings that agreed with the edge when the write was made.
        against: Number of readings that disagreed with the edge when the write was made.
        origin: Origin of the belief.
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
    """Row of `Sighted`.

    `box` is the box that the agent gave. `angle` is the panorama angle of the centre of `box`, in degrees.
    """

    frame: int
    box: Box
    angle: float


class AttributeRow(_EdgeRow, frozen=True):
    """Row of `Has`. `value` is the attribute's value as text. `number` is the value if it is a number, otherwise 0."""

    name: str
    value: str
    number: float
    first: int
    last: int


class RelationRow(_EdgeRow, frozen=True):
    """Row of `Related`. `observation` is the key of the observation that showed the relation."""

    name: str
    observation: str
    first: int
    last: int


class Fact(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """Rows that one write adds to the world tables or changes there.

    In a new edge, the column `current` is true, and the column `until` is `ALWAYS`.

    Attributes:
        episode: New or changed episode. The tool `begin` creates the episode, `plan` adds the plan, and `final_answer`
            adds the verdict.
        slots: Parts of an accepted plan.
        observation: New observation.
        entity: New entity.
        changed: Existing entity with a new kind or a new plan node.
        freed: Keys of the entities that lose their plan node because another entity takes the node.
        sighted: New sighting.
        has: New attribute.
        related: New relation.
        replaced: Indexes of writes. The edges that these writes added stop being `current` at the step of this
            fact's write. The index of this fact's own write may be in the tuple too.
        hypotheses: Hypotheses at the end of the episode.
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
    """Return the columns of the table for a row class, each as a text such as "step INT64".

    The fields of the class come first, without the fields `source` and `target` of edges. The columns `more` follow.
    """
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
    # `who` is the name of the entity at the start of the edge, and `whom` is the name of the entity at the end.
    "Sighted": ("Entity", "Observation", _columns(SightingRow, *_CURRENT, "who STRING")),
    "Has": ("Entity", "Observation", _columns(AttributeRow, *_CURRENT, "who STRING")),
    "Related": ("Entity", "Entity", _columns(RelationRow, *_CURRENT, "who STRING", "whom STRING")),
}
"""Relationship tables by name: the table at the start, the table at the end, and columns as texts of name and type."""


def episode_key(run_id: str, question_id: str) -> str:
    """Return the key of an `Episode` node."""
    return f"{run_id}/{question_id}"


def episode_hash(episode: str) -> str:
    """Return the first 128 bits of the SHA-256 of an episode's key, as the text of a UUID."""
    return str(UUID(bytes=sha256(episode.encode()).digest()[:16]))


def name_of(key: str) -> str:
    """Return the name of an entity or an observation. The name is the last part of the node's key."""
    return key.rpartition("/")[2]
