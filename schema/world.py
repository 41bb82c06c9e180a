"""The world namespace: what an agent saw and believes, in tables beside the scene's, keyed by episode.

An episode is one question of one run. Everything believed is tied to an observation of its own episode: a sighting and
an attribute are edges from an entity to the observation, a relation names it. A belief holds for the frame of its
observation (`first` = `last`), but for gender and age, which hold always (0 to `ALWAYS`). What a later write replaces
stays, with `current` false. Keys: `Episode` is `<run>/<question>`; `Observation` `<episode>/o<number>`; `Entity`
`<episode>/<the agent's own name for it>`; `Slot` and `Write` `<episode>/<number>`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

ALWAYS: Final = 10_000_000
"""`last` of what holds at every frame."""

TIMELESS: Final = frozenset({"gender", "age"})
"""Attributes that hold at every frame."""

WORLD_NODES: Final[dict[str, str]] = {
    "Episode": "id STRING PRIMARY KEY, run STRING, question STRING, sequence STRING, plan STRING",
    # A crop covers columns [left, left + width) of the panorama, over the seam; a whole panorama all 3760.
    "Observation": "id STRING PRIMARY KEY, episode STRING, number INT64, step INT64, frame INT64, angle DOUBLE, "
    "left INT64, width INT64",
    "Entity": "id STRING PRIMARY KEY, episode STRING, name STRING, number INT64, kind STRING, node STRING, step INT64",
    # What the plan asks for: a node (somebody is to be found), a condition, an edge, or the read.
    "Slot": "id STRING PRIMARY KEY, episode STRING, number INT64, kind STRING, node STRING, other STRING, "
    "name STRING, value STRING, frame INT64",
    "Write": "id STRING PRIMARY KEY, episode STRING, number INT64, step INT64, tool STRING, arguments STRING, "
    "accepted BOOLEAN, reason STRING",
}

WORLD_RELS: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "Made": ("Episode", "Observation", ()),
    "Holds": ("Episode", "Entity", ()),
    "Asks": ("Episode", "Slot", ()),
    "Wrote": ("Episode", "Write", ()),
    "Sighted": (
        "Entity",
        "Observation",
        (
            "episode STRING",
            "step INT64",
            "frame INT64",
            # Stitched pixels, as the agent saw it; the angle is that of the box's centre.
            "box STRUCT(x DOUBLE, y DOUBLE, w DOUBLE, h DOUBLE)",
            "angle DOUBLE",
            "current BOOLEAN",
        ),
    ),
    "Has": (
        "Entity",
        "Observation",
        (
            "episode STRING",
            "step INT64",
            "name STRING",
            "value STRING",
            "number DOUBLE",
            "first INT64",
            "last INT64",
            "current BOOLEAN",
        ),
    ),
    "Related": (
        "Entity",
        "Entity",
        (
            "episode STRING",
            "step INT64",
            "name STRING",
            "observation STRING",
            "first INT64",
            "last INT64",
            "current BOOLEAN",
        ),
    ),
}
"""Per relationship table: from, to, and its columns as name and type."""

Tool = Literal["plan", "observe", "get_graph", "add_entity", "add_attribute", "add_relation", "final_answer"]


@dataclass(frozen=True, slots=True)
class Write:
    """One line of an episode's record, accepted or refused: a row of `world.parquet`, from which the tables above can
    be made again.

    number: from 0, in order; step: the model call it came with; arguments: as the agent gave them, JSON; reason: why
    it was refused; fact: what an accepted one put into the graph, JSON in the words of the tables above, "" otherwise.
    """

    number: int
    step: int
    tool: Tool
    arguments: str
    accepted: bool
    reason: str
    fact: str


def world_ddl() -> list[str]:
    """CREATE statements of the world namespace, nodes first."""
    statements = [f"CREATE NODE TABLE {name}({columns})" for name, columns in WORLD_NODES.items()]
    for name, (source, target, columns) in WORLD_RELS.items():
        statements.append(f"CREATE REL TABLE {name}({', '.join([f'FROM {source} TO {target}', *columns])})")
    return statements


def episode_key(run_id: str, question_id: str) -> str:
    """Key of an `Episode` node."""
    return f"{run_id}/{question_id}"
