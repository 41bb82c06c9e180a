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
"""Columns of each layer that are read. They have half of the bytes of all columns."""


class _LayerTables(Mapping[str, pa.Table]):
    """Annotation tables of a sequence by layer. Each access reads the table from its file.

    `load` writes a file for every layer, even if the sequence lacks the layer. A missing file is therefore an error of
    the store. If it counted as an empty layer, most questions would fail.
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
    """Annotation tables of one sequence, indexed by frame and by person."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._held: dict[tuple[Condition, int], dict[int, int]] = {}

    @classmethod
    def read(cls, store: Store, sequence: str, rules: Rules) -> Annotations:
        """Read the tables of a sequence.

        Args:
            store: Store with the annotations.
            sequence: Name of the sequence.
            rules: Thresholds.

        Returns:
            The annotations.

        Raises:
            StoreError: If a file is missing or broken.
        """
        return cls(_LayerTables(store, sequence), rules)

    # -- descriptions -------------------------------------------------------------------------------------------

    def holds(self, condition: Condition, track: int, frame: int) -> int:
        """Evaluate a condition of a description.

        Args:
            condition: Condition.
            track: Track of a person with a box at the frame.
            frame: Frame.

        Returns:
            Whether the condition holds: FALSE, TRUE or UNKNOWN.
        """
        if condition.action is not None:
            fact = self.state(track, condition.action, frame)
            return UNKNOWN if fact == FALSE and self._flickers(track, condition.action, frame) else fact
        if condition.interaction is not None:
            return self.interacts(track, condition.interaction, frame)
        if condition.object is not None and condition.verb is not None:
            return self.handles(track, condition.verb, condition.object, frame)
        match condition.attribute, condition.value:
            case ("gender" | "age") as name, str(value):
                return self.attribute(track, name, value)
            case "group_size", int(size):
                sizes = self.group_sizes(track, frame)
                return UNKNOWN if not sizes else among(size, sizes)
            case "sector", str(word):
                return self.in_sector(track, word, frame) if word in AXES else FALSE
            case "distance", str(word):
                return among(word, self.distance_words(track, frame))
        return UNKNOWN

    def _flickers(self, track: int, action: str, frame: int) -> bool:
        """Return whether an action with unsteady labels has a label one second earlier or later."""
        near = (frame - KEYFRAME_STEP, frame + KEYFRAME_STEP)
        return self.judges_views and action in FLICKERING and any(action in self.written(track, at) for at in near)

    def held(self, condition: Condition, frame: int) -> dict[int, int]:
        """Evaluate a condition for all people with a box at the frame who are not covered. Returns facts by track."""
        key = (condition, frame)
        if key not in self._held:
            self._held[key] = {track: self.holds(condition, track, frame) for track in self.uncovered_people(frame)}
        return self._held[key]

    def could_match(self, conditions: Iterable[Condition], frame: int) -> list[int]:
        """Return all people at the frame who could match a description: no condition is false."""
        facts = [self.held(condition, frame) for condition in conditions]
        return [track for track in self.uncovered_people(frame) if all(fact[track] != FALSE for fact in facts)]

    def find(self, conditions: tuple[Condition, ...], frame: int) -> tuple[OutcomeKind, int | None]:
        """Find the only person of a description at a frame.

        Args:
            conditions: Conditions of the description.
            frame: Frame.

        Returns:
            "defined" and the track of the person, or the reason why it is not one person, and None.
        """
        if not self.knows(frame):
            return "unknown", None
        facts = [self.held(condition, frame) for condition in conditions]
        return only({track: conjunction(fact[track] for fact in facts) for track in self.uncovered_people(frame)})

    # -- relations ----------------------------------------------------------------------------------------------

    def related(self, relation: str, track: int, partner: int, frame: int) -> int:
        """Evaluate a relation between two people.

        Args:
            relation: Name of the relation.
            track: Track of the source, with a box at the frame.
            partner: Track of the target, with a box at the frame.
            frame: Frame.

        Returns:
            Whether the relation holds: FALSE, TRUE or UNKNOWN.
        """
        row = RELATIONS.get(relation)
        if row is None:
            return UNKNOWN
        match row.kind:
            case "social":
                return self.together(track, partner, relation, frame)
            case "group":
                return self.same_group(track, partner, frame)
            case "first":
                return self.first_beside(track, partner, frame, row.side == "left")
            case "person":
                return self.seen_from(track, partner, row.sector, row.distance, frame)
            case "window":
                return self.within(track, partner, row.degrees, frame, row.side == "left")

    def step_to(self, relation: str, track: int, frame: int) -> tuple[OutcomeKind, int | None]:
        """Find the only person at the frame who is the target of a relation. `find` describes the results."""
        partners = [partner for partner in self.uncovered_people(frame) if partner != track]
        return only({partner: self.related(relation, track, partner, frame) for partner in partners})


def conjunction(facts: Iterable[int]) -> int:
    """Return whether all facts hold."""
    values = set(facts)
    return FALSE if FALSE in values else UNKNOWN if UNKNOWN in values else TRUE


def only(facts: dict[int, int]) -> tuple[OutcomeKind, int | None]:
    """Find the only person with a true fact.

    Args:
        facts: Facts by track.

    Returns:
        "defined" and the track if the fact is true for one person and false for all others. Else None and the reason:
        "ambiguous" if it is true for several, "empty" if it is false for all, or "unknown".
    """
    could = [track for track, fact in facts.items() if fact != FALSE]
    does = [track for track in could if facts[track] == TRUE]
    if len(does) > 1:
        return "ambiguous", None
    if not could:
        return "empty", None
    return ("defined", does[0]) if could == does else ("unknown", None)
