"""Rows that an agent's writes add to its world model: slots of a plan, readings, and what follows from readings."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from jrdb_avr.agent.look.ranking import PlanPart, absence_evidence, frames_of, parts_of
from jrdb_avr.agent.perceive.geometry import DERIVED
from jrdb_avr.agent.perceive.readings import PersonReading, has_one_value, topic_of
from jrdb_avr.agent.perceive.votes import TieKey, Tracks, signed, tie_key
from jrdb_avr.schema.beliefs import TIMELESS, Origin, SlotKind, SlotRow
from jrdb_avr.schema.labels import INTERACTIONS, may_be_called
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import SAME_GROUP

ENTITY_TOPIC: Final = "entity"
"""Topic of the edge that each entity has."""

_ANY_FRAME: Final = -1
_FROM_BOXES: Final = DERIVED | {"sector", "distance", "group_size", SAME_GROUP}
"""Attributes and relations that are derived from boxes, distances and relations."""


class Slot(NamedTuple):
    """A slot with its part of the plan. part: None for the kinds "entity" and "presence"."""

    row: SlotRow
    part: PlanPart | None

    @property
    def frame(self) -> int | None:
        """The frame at which the slot holds, None for any frame."""
        return None if self.row.frame == _ANY_FRAME else self.row.frame


def slots_of(plan: Plan, episode: str, step: int = 0, first: int = 0) -> tuple[Slot, ...]:
    """Return the slots of a plan.

    Args:
        plan: The plan, as `perceivable` returns it.
        episode: Key of the episode.
        step: Index of the model call that set the plan.
        first: Number of the first slot.

    Returns:
        The slot that all entities fill, then the parts of the plan, then the presences.
    """
    slots: list[Slot] = []

    def add(kind: SlotKind, part: PlanPart | None, topic: str, origin: Origin, frame: int, node: str = "") -> None:
        source, target = (node, "") if part is None else (*part.nodes, "")[:2]
        name, value, often = (kind, "", 1.0) if part is None else (part.name, part.value, part.often)
        also = "|".join(sorted(may_be_called(value))) if origin == "model" and kind == "condition" else ""
        number = first + len(slots)
        key = f"{episode}/slots/{number}"
        row = SlotRow(key, episode, number, step, kind, source, target, name, value, topic, origin, also, frame, often)
        slots.append(Slot(row, part))

    add("entity", None, ENTITY_TOPIC, "derived", _ANY_FRAME)
    for part in parts_of(plan):
        kind: SlotKind = "condition" if len(part.nodes) == 1 else "edge"
        frame = _ANY_FRAME if part.frame is None or part.name in TIMELESS else part.frame
        if part.name in _FROM_BOXES:
            topic = " ".join(filter(None, (part.name, part.value, str(frame))))
            add(kind, part, topic, "derived", frame)
        else:
            add(kind, part, topic_of(part.name, part.value), "model", frame)
    for node in plan.nodes:
        for frame in frames_of(plan, node.id):
            add("presence", None, f"seen {frame}", "derived", frame, node.id)
    return tuple(slots)


Value = tuple[str, int, str, str, str, float, float, bool, Origin]
"""An attribute to write: the entity, and the columns of `AttributeRow` from `frame` on."""

Relation = tuple[str, str, int, str, float, float, Origin]
"""A relation to write: both entities, and the columns of `RelationRow` from `frame` on, without `look`."""


def read_values(before: Tracks, people: Sequence[tuple[str, PersonReading]]) -> Iterator[Value]:
    """Yield the attributes of new readings.

    Args:
        before: Tracks before the readings, which say what a reading repeats.
        people: Entity and reading of each person of a picture.

    Yields:
        The attributes, with weights.
    """
    for entity, reading in people:
        others = [item for item in before.readings_at(entity, reading.frame) if item.observation != reading.observation]
        topics = {label.topic for item in others for label in item.labels}
        for label in reading.labels:
            log_odds = signed(label.holds)
            weight = log_odds * (before.repeats.frame if label.topic in topics else 1.0)
            columns = label.topic, label.name, label.value, log_odds, weight, has_one_value(label.topic)
            yield entity, reading.frame, *columns, "model"


def read_relations(
    before: Tracks, after: Tracks, people: Sequence[tuple[str, PersonReading]]
) -> tuple[list[Relation], list[Value]]:
    """Return the relations of new readings, and the interactions that affirmed relations imply for both.

    Args:
        before: Tracks before the readings.
        after: Tracks with the readings.
        people: Entity and reading of each person of a picture.

    Returns:
        The relations, and the changes of the interactions' sums. The weights of a pair sum to the change of the sum of
        the pair's votes at the frame.
    """
    names = {reading.number: entity for entity, reading in people}
    groups: dict[tuple[TieKey, int], list[tuple[str, str, float]]] = defaultdict(list)
    for entity, reading in people:
        for tie in reading.ties:
            if (target := names.get(tie.other)) is not None:
                key = tie_key(entity, tie.relation, target), reading.frame
                groups[key].append((entity, target, signed(tie.holds)))
    relations: list[Relation] = []
    values: list[Value] = []
    for ((first, name, last), frame), ties in groups.items():
        later, earlier = (tracks.tie_votes((first, name, last), frame) for tracks in (after, before))
        weights = [log_odds * before.repeats.frame for _, _, log_odds in ties[1:]]
        weights.insert(0, sum(later) - sum(earlier) - sum(weights))
        for (source, target, log_odds), weight in zip(ties, weights, strict=True):
            relations.append((source, target, frame, name, log_odds, weight, "model"))
        change = sum(vote for vote in later if vote > 0) - sum(vote for vote in earlier if vote > 0)
        if name in INTERACTIONS and change:
            columns = topic_of("interaction", name), "interaction", name, change, change
            values += [(entity, frame, *columns, False, "relation") for entity in (first, last)]
    return relations, values


Key = tuple[str, str, str]
"""Topic of a derived slot, entity, and the other entity of a pair or ""."""


def increments(slots: Sequence[Slot], tracks: Tracks, written: Mapping[Key, float]) -> dict[Key, float]:
    """Return the changes of the evidence of slots with the origin "derived" against the sums that are written.

    Args:
        slots: Slots of the plan.
        tracks: All readings so far.
        written: Sums of the increments so far.

    Returns:
        The changes of the log-odds by topic and entities. A new entity has a change of 0 for the slot that all entities
        fill.
    """
    sums: dict[Key, float] = {}
    # Slots of one topic ask for the same evidence.
    for row, part in {slot.row.topic: slot for slot in slots if slot.row.origin == "derived"}.values():
        for entity in tracks.people:
            if part is None:
                absent = row.kind == "presence"
                sums[row.topic, entity, ""] = absence_evidence(tracks, entity, row.frame) if absent else 0.0
            else:
                for other in tracks.people if row.kind == "edge" else ("",):
                    if other != entity:
                        people = (entity, other)[: len(part.nodes)]
                        sums[row.topic, entity, other] = part.support(tracks, people).log_odds
    changed = {key: sums[key] for key in sums if sums[key] != written.get(key, None if key[0] == ENTITY_TOPIC else 0.0)}
    return {key: total - written.get(key, 0.0) for key, total in changed.items()}
