"""The annotation tables of one sequence as three-valued facts: descriptions and relations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import pyarrow as pa

from jrdb_avr.engine.rederive.relations import AXES, RelationFacts
from jrdb_avr.engine.rederive.truth import FALSE, TRUE, UNKNOWN, OutcomeKind, among
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.labels import FLICKERING
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules

_COLUMNS: Final = {
    "frames": ("layer", "frame"),
    "boxes_2d": ("frame", "track", *"xywh", "has_attributes", "occlusion", "no_eval", "has_actions"),
    "boxes_3d": ("frame", "track", "cx", "cy", "cz", "rot_z", "distance", "num_points"),
    "actions": ("frame", "track", "action", "difficulty"),
    "demographics": ("track", "attribute", "value", "difficulty"),
    "poses": ("frame", "track", "keypoints"),
    "listed": ("layer", "frame", "track"),
    "groups": ("frame", "track", "cluster", "difficulty"),
    "interactions": ("frame", "track", "partner", "label", "difficulty"),
    "handles": ("frame", "track", "object", "category_id", "verb", "difficulty"),
    "categories": ("category_id", "category"),
}
"""The columns that are read of each layer: half of their bytes."""


class _LayerTables(Mapping[str, pa.Table]):
    """A sequence's annotation tables by layer, each read when it is used and not held.

    A load writes a table of each layer, empty where the sequence lacks it: a missing file is a damaged store. Taken for
    an empty layer it would refute most questions.
    """

    def __init__(self, store: Store, sequence: str) -> None:
        self._store, self._sequence = store, sequence

    def __getitem__(self, layer: str) -> pa.Table:
        return self._store.annotation(layer, self._sequence, _COLUMNS[layer])

    def __iter__(self) -> Iterator[str]:
        return iter(_COLUMNS)

    def __len__(self) -> int:
        return len(_COLUMNS)


class Annotations(RelationFacts):
    """One sequence's annotation tables, indexed by frame and by person."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._held: dict[tuple[Condition, int], dict[int, int]] = {}

    @classmethod
    def read(cls, store: Store, sequence: str, rules: Rules) -> Annotations:
        """Read a sequence's tables. Raises StoreError for a missing or broken file."""
        return cls(_LayerTables(store, sequence), rules)

    # -- descriptions -------------------------------------------------------------------------------------------

    def holds(self, condition: Condition, track: int, frame: int) -> int:
        """A condition of a description, of a person with a box at the frame."""
        if condition.action is not None:
            fact = self.state(track, condition.action, frame)
            return UNKNOWN if fact == FALSE and self._flickers(track, condition.action, frame) else fact
        if condition.interaction is not None:
            return self.interacts(track, condition.interaction, frame)
        if condition.object is not None and condition.verb is not None:
            return self.handles(track, condition.verb, condition.object, frame)
        match condition.attribute, condition.value:
            case ("gender" | "age") as name, str(wanted):
                return self.attribute(track, name, wanted)
            case "group_size", int(wanted):
                sizes = self.group_sizes(track, frame)
                return UNKNOWN if not sizes else among(wanted, sizes)
            case "sector", str(wanted):
                return self.in_sector(track, wanted, frame) if wanted in AXES else FALSE
            case "distance", str(wanted):
                return among(wanted, self.distance_words(track, frame))
        return UNKNOWN

    def _flickers(self, track: int, action: str, frame: int) -> bool:
        """Return whether an action whose labels come and go is labelled one keyframe earlier or later."""
        near = (frame - KEYFRAME_STEP, frame + KEYFRAME_STEP)
        return self.judges_views and action in FLICKERING and any(self.writes(track, action, one) for one in near)

    def held(self, condition: Condition, frame: int) -> dict[int, int]:
        """A condition of everybody with a box at the frame who is not covered."""
        key = (condition, frame)
        if key not in self._held:
            self._held[key] = {track: self.holds(condition, track, frame) for track in self.uncovered_people(frame)}
        return self._held[key]

    def could_match(self, conditions: Iterable[Condition], frame: int) -> list[int]:
        """Everybody at the frame whom none of the conditions excludes."""
        facts = [self.held(condition, frame) for condition in conditions]
        return [track for track in self.uncovered_people(frame) if all(fact[track] != FALSE for fact in facts)]

    def find(self, conditions: tuple[Condition, ...], frame: int) -> tuple[OutcomeKind, int | None]:
        """The one person of a description at a frame; `ambiguous`, `empty` or `unknown` where it is not one."""
        if not self.knows(frame):
            return "unknown", None
        facts = [self.held(condition, frame) for condition in conditions]
        return only({track: conjunction(fact[track] for fact in facts) for track in self.uncovered_people(frame)})

    # -- relations ----------------------------------------------------------------------------------------------

    def related(self, relation: str, track: int, other: int, frame: int) -> int:
        """Whether another person has the relation to a person; both have a box at the frame."""
        row = RELATIONS.get(relation)
        if row is None:
            return UNKNOWN
        match row.kind:
            case "social":
                return self.together(track, other, relation, frame)
            case "group":
                return self.same_group(track, other, frame)
            case "first":
                return self.first_beside(track, other, frame, row.side == "left")
            case "person":
                return self.seen_from(track, other, row.sector, row.distance, frame)
            case "window":
                return self.within(track, other, row.degrees, frame, row.side == "left")

    def step_to(self, relation: str, track: int, frame: int) -> tuple[OutcomeKind, int | None]:
        """The one other person at the frame to whom a relation leads from a person, or why there is none."""
        others = [other for other in self.uncovered_people(frame) if other != track]
        return only({other: self.related(relation, track, other, frame) for other in others})


def conjunction(facts: Iterable[int]) -> int:
    """Whether all of the facts hold."""
    found = set(facts)
    return FALSE if FALSE in found else UNKNOWN if UNKNOWN in found else TRUE


def only(facts: dict[int, int]) -> tuple[OutcomeKind, int | None]:
    """The one person of whom a fact is certain while it is false of everybody else; else what there is instead."""
    could = [track for track, fact in facts.items() if fact != FALSE]
    does = [track for track in could if facts[track] == TRUE]
    if len(does) > 1:
        return "ambiguous", None
    if not could:
        return "empty", None
    return ("defined", does[0]) if could == does else ("unknown", None)
