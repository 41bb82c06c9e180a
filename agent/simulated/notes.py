"""The reference agent's graph as the simulated model's memory: reads looks and sightings back, and drafts new writes.

The graph is all that a turn knows of the turns before it. An entity is named after the identity of the mark, so a
person who is read again is the same entity, and a mark is rebuilt from the attributes written at a frame. A draft
leaves out every fact that the graph already holds, so a turn may name all that it needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.policy.explorer import Look, Sighting
from jrdb_avr.agent.policy.searches import performs
from jrdb_avr.agent.simulated.requests import AHEAD, FrameId, Request
from jrdb_avr.agent.simulated.same_person import told_apart
from jrdb_avr.schema.beliefs import TIMELESS
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, crop_left, to_crop
from jrdb_avr.schema.plan import Condition, Plan

_PREFIX: Final = "p"
_UNKNOWN_ACTIONS: Final = ("", "")
"""Stands for actions that were not written down: any other may be true as well."""
_SIGHTING: Final = "sighting"

Fact = tuple[str, str, str | float, int | None]
"""Entity, name, value and frame (None: always) of an attribute or a relation; a sighting's value is its observation."""


class _Observation(msgspec.Struct):
    observation: str
    frame_id: FrameId
    angle_deg: float | None = None


class _Seen(msgspec.Struct):
    observation: str
    frame_id: FrameId
    box: tuple[float, float, float, float]


class _Attribute(msgspec.Struct):
    name: str
    value: str | float
    frame_id: FrameId | None = None


class _Entity(msgspec.Struct):
    id: str
    node: str | None = None
    sightings: list[_Seen] = []
    attributes: list[_Attribute] = []

    @property
    def identity(self) -> int | None:
        """The identity of the mark that the entity is named after."""
        number = self.id.removeprefix(_PREFIX)
        return int(number) if self.id.startswith(_PREFIX) and number.isascii() and number.isdigit() else None


class _Relation(msgspec.Struct):
    source: str
    name: str
    target: str
    frame_id: FrameId


class _Graph(msgspec.Struct):
    observations: list[_Observation] = []
    entities: list[_Entity] = []
    relations: list[_Relation] = []


# Made at import: threads that meet a type first at the same time crash the decoder.
_GRAPH: Final = msgspec.json.Decoder(_Graph)


@dataclass(frozen=True)
class Notes:
    """What a turn knows: `looks` in the order in which they were made, `newest` of them with their pictures.

    A look without its picture shows only people who were written down. `holders` maps each node of the plan to the
    identity of its entity.
    """

    looks: tuple[Look, ...]
    newest: tuple[Look, ...]
    holders: Mapping[str, int]
    facts: frozenset[Fact]

    def of(self, identity: int, frame: int) -> Sighting | None:
        """A person at a frame, if seen there; of several sightings one that shows the box whole."""
        found = [seen for look in self.looks if look.frame == frame and (seen := look.of(identity)) is not None]
        return max(found, key=lambda seen: seen.quality, default=None)

    def look_of(self, seen: Sighting) -> Look:
        """The look that a sighting comes from."""
        return next(look for look in self.looks if any(other is seen for other in look.sightings))

    @property
    def people(self) -> set[str]:
        """The entities that the graph holds with a sighting."""
        return {entity for entity, name, *_ in self.facts if name == _SIGHTING}


def entity_name(identity: int) -> str:
    """The graph's name of the person with this mark."""
    return f"{_PREFIX}{identity}"


def read_notes(request: Request) -> Notes:
    """The notes of a turn of the reference agent. Raises DecodeError for a graph that cannot be read."""
    try:
        graph = _GRAPH.decode(request.line("Graph: ") or "{}")
    except msgspec.DecodeError as error:
        raise DecodeError(f"the prompt's graph cannot be read: {error}") from None
    pictures = {look.name: look for look in request.looks}
    people = [(identity, entity) for entity in graph.entities if (identity := entity.identity) is not None]
    looks = tuple(pictures.get(made.observation) or _restored(made, people) for made in graph.observations)
    if not request.ids:
        looks = told_apart(looks, {look.name: _written(look, look.name in pictures, people) for look in looks})
    facts: set[Fact] = {(tie.source, tie.name, tie.target, int(tie.frame_id)) for tie in graph.relations}
    for _, entity in people:
        facts |= {(entity.id, _SIGHTING, seen.observation, None) for seen in entity.sightings}
        facts |= {(entity.id, a.name, a.value, int(a.frame_id) if a.frame_id else None) for a in entity.attributes}
    holders = {entity.node: identity for identity, entity in people if entity.node is not None}
    return Notes(looks, tuple(look for look in looks if look.name in pictures), holders, frozenset(facts))


def _written(look: Look, shown: bool, people: Sequence[tuple[int, _Entity]]) -> dict[int, Box]:
    """The people who were written down in a look, with their boxes in its picture."""
    if not shown:
        return {seen.identity: look.box_inside(seen) for seen in look.sightings}
    return {
        identity: Box(*seen.box) if look.panorama else to_crop(Box(*seen.box), look.left)
        for identity, entity in people
        for seen in entity.sightings
        if seen.observation == look.name
    }


def _order(observation: str) -> int:
    """Observations are numbered as they are made."""
    return int("".join(filter(str.isdigit, observation)) or 0)


def _restored(made: _Observation, people: Sequence[tuple[int, _Entity]]) -> Look:
    """A look whose picture is gone, with the people who were written down in it."""
    frame, panorama = int(made.frame_id), made.angle_deg is None
    angle = AHEAD if made.angle_deg is None else made.angle_deg
    left, size = (0, (WIDTH, HEIGHT)) if panorama else (int(crop_left(angle)), (CROP, CROP))
    sightings = []
    for identity, entity in people:
        for seen in entity.sightings:
            box = Box(*seen.box)
            place = box if panorama else to_crop(box, left)
            # A person who was looked at again, to be seen whole, was seen here as well.
            again = _order(seen.observation) > _order(made.observation) and 0 <= place.x + place.w / 2 < size[0]
            if int(seen.frame_id) == frame and (again or seen.observation == made.observation):
                inside = place if panorama else _cut_off(place)
                mark = _mark(identity, entity, frame)
                sightings.append(Sighting(frame, mark, inside, False, center_angle(box.x, box.w), size[0]))
    return Look(frame, angle, tuple(sightings), panorama, made.observation, left, size)


def _cut_off(box: Box) -> Box:
    """A crop's box that ends at its edge was cut off there, as boxes are written inside their picture."""
    right = box.x + box.w
    left = -1.0 if box.x < 1 else box.x
    return box._replace(x=left, w=(CROP + 1.0 if right > CROP - 1 else right) - left)


def _mark(identity: int, entity: _Entity, frame: int) -> Mark:
    """The mark of a person at a frame, rebuilt from what was written; only another pose is known to be false of it."""
    written: dict[str, list[str | float]] = {}
    for attribute in entity.attributes:
        if attribute.frame_id is None or int(attribute.frame_id) == frame:
            written.setdefault(attribute.name, []).append(attribute.value)
    actions = [str(value) for value in written.get("action", [])]
    newest = {name: str(values[-1]) for name, values in written.items()}
    metres = next((value for value in written.get("distance_m", []) if isinstance(value, float)), None)
    verb, _, thing = newest.get("object", "").partition(": ")
    return Mark(
        identity,
        gender=newest.get("gender"),
        age=newest.get("age"),
        pose=next((action for action in actions if action in POSES), None),
        actions=(*(action for action in actions if action not in POSES), *_UNKNOWN_ACTIONS),
        distance_dm=None if metres is None else round(metres * 10),
        interaction=newest.get("interaction"),
        object=thing or None,
        verb=verb or None,
    )


class Draft:
    """The calls of a turn that write, in order."""

    def __init__(self, notes: Notes) -> None:
        self.calls: list[dict[str, Any]] = []
        self._notes = notes
        self._facts = set(notes.facts)
        self._holders = dict(notes.holders)

    def _write(self, fact: Fact, tool: str, **call: Any) -> None:
        if fact not in self._facts:
            self._facts.add(fact)
            self.calls.append({"tool": tool, **call})

    def person(self, seen: Sighting, node: str | None = None) -> None:
        """Write a person where seen, and which node of the plan it is."""
        look, entity = self._notes.look_of(seen), entity_name(seen.identity)
        fact = (entity, _SIGHTING, look.name, None)
        if node is not None and self._holders.get(node) != seen.identity:
            self._holders[node] = seen.identity
            self._facts.discard(fact)
        claim = {} if node is None else {"node": node}
        self._write(fact, "add_entity", id=entity, kind="person", **placed(look, seen), **claim)

    def attribute(self, seen: Sighting, name: str, value: str | float | None) -> None:
        """Write an attribute read of a person in a look; None is not written."""
        if value is not None:
            entity, observation = entity_name(seen.identity), self._notes.look_of(seen).name
            fact = (entity, name, value, None if name in TIMELESS else seen.frame)
            self._write(fact, "add_attribute", entity=entity, name=name, value=value, observation=observation)

    def relation(self, source: Sighting, name: str, target: Sighting) -> None:
        """Write a relation of two people who were written down in one frame."""
        first, second = entity_name(source.identity), entity_name(target.identity)
        observation = self._notes.look_of(target).name
        fact = (first, name, second, source.frame)
        self._write(fact, "add_relation", source=first, name=name, target=second, observation=observation)

    def people(self, plan: Plan, nodes: Mapping[str, Sighting]) -> None:
        """Write the person of each node of the plan, and the plan's edges between them."""
        for node, seen in nodes.items():
            self.person(seen, node)
        for edge in plan.edges:
            if edge.source in nodes and edge.target in nodes:
                self.relation(nodes[edge.source], edge.relation, nodes[edge.target])

    def member(self, source: Sighting, name: str, target: Sighting) -> None:
        """Write a person who counts, where first seen in the relation."""
        if entity_name(target.identity) not in self.partners(source, name):
            self.person(target)
            self.relation(source, name, target)

    def partners(self, source: Sighting, name: str) -> set[str | float]:
        """The entities that the graph, with this draft, holds in a relation with a person."""
        return {fact[2] for fact in self._facts if fact[:2] == (entity_name(source.identity), name)}

    def conditions(self, seen: Sighting, conditions: Sequence[Condition]) -> None:
        """Write the conditions of a description that are held to be true of a person."""
        for condition in conditions:
            self.attribute(seen, *attribute_of(condition))

    def read(self, plan: Plan, seen: Sighting, offered: Sequence[str]) -> None:
        """Write a sighting of the question's person, with what the plan reads of it."""
        self.person(seen)
        times = [plan.times[name] for name in plan.answer.times]
        stated = any(time.frame == seen.frame for time in times)
        mark = seen.mark
        match plan.answer.read:
            case "next_action":
                self.attribute(seen, "action", mark.pose)
            case "action" if stated:
                for action in offered:
                    self.attribute(seen, "action", action if performs(action, seen) else None)
            case "distance_change" if stated and mark.distance_dm is not None:
                self.attribute(seen, "distance_m", mark.distance_dm / 10)
            case "start" | "span" | "start_view" | "seconds_between":
                # Of postures the one that is seen, of other actions that it is seen.
                for action in (time.action for time in times if time.action is not None):
                    if action in POSES or action in mark.actions:
                        self.attribute(seen, "action", mark.pose if action in POSES else action)


def placed(look: Look, seen: Sighting) -> dict[str, Any]:
    """The keys of a call that place a person in an observation."""
    return {"observation": look.name, "box": write_box(look.box_inside(seen), look.size)}


def attribute_of(condition: Condition) -> tuple[str, str | float]:
    """Name and value of the attribute that states a condition."""
    name, text = condition.wanted
    return name, float(condition.value) if isinstance(condition.value, int) else text
