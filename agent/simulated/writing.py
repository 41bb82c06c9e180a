"""What the marker writes into the reference agent's graph: people, what is read of them, and what joins them.

Nothing is written twice: a fact that the graph holds already is left out, so a turn may name all that it needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.simulated.notes import Notes, entity_name
from jrdb_avr.agent.simulated.requests import Look, Sighting
from jrdb_avr.schema.beliefs import TIMELESS
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Condition, Plan


class Draft:
    """The calls of a turn that write, in order."""

    def __init__(self, notes: Notes) -> None:
        self.calls: list[dict[str, Any]] = []
        self._notes = notes
        self._sighted = set(notes.sighted)
        self._told = set(notes.told)
        self._ties = set(notes.ties)
        self._holders = dict(notes.holders)

    def person(self, seen: Sighting, node: str | None = None) -> None:
        """Somebody, where seen, and who of the plan it is."""
        look, name = self._notes.look_of(seen), entity_name(seen.mark.identity)
        claimed = node is None or self._holders.get(node) == seen.mark.identity
        if claimed and (name, look.name) in self._sighted:
            return
        call = {"tool": "add_entity", "id": name, "kind": "person", **placed(look, seen)}
        if node is not None:
            call["node"] = node
            self._holders[node] = seen.mark.identity
        self._sighted.add((name, look.name))
        self.calls.append(call)

    def attribute(self, seen: Sighting, name: str, value: str | float | None) -> None:
        """What is read of somebody in a look; None is not written."""
        entity = entity_name(seen.mark.identity)
        fact = (entity, name, value, None if name in TIMELESS else seen.frame)
        if value is None or fact in self._told:
            return
        self._told.add((entity, name, value, fact[3]))
        observation = self._notes.look_of(seen).name
        self.calls.append(
            {"tool": "add_attribute", "entity": entity, "name": name, "value": value, "observation": observation}
        )

    def relation(self, source: Sighting, name: str, target: Sighting) -> None:
        """What joins two people who were written down in one frame."""
        first, second = entity_name(source.mark.identity), entity_name(target.mark.identity)
        if (first, name, second, source.frame) in self._ties:
            return
        self._ties.add((first, name, second, source.frame))
        observation = self._notes.look_of(target).name
        self.calls.append(
            {"tool": "add_relation", "source": first, "name": name, "target": second, "observation": observation}
        )

    def people(self, plan: Plan, nodes: Mapping[str, Sighting]) -> None:
        """Who each node of the plan is, and the plan's edges between them."""
        for node, seen in nodes.items():
            self.person(seen, node)
        for edge in plan.edges:
            if edge.source in nodes and edge.target in nodes:
                self.relation(nodes[edge.source], edge.relation, nodes[edge.target])

    def member(self, source: Sighting, name: str, target: Sighting) -> None:
        """Somebody who counts: written down where first seen in the relation."""
        if entity_name(target.mark.identity) not in self.partners(entity_name(source.mark.identity), name):
            self.person(target)
            self.relation(source, name, target)

    def partners(self, entity: str, name: str) -> set[str]:
        """Whom the graph, with this draft, says to be in a relation with an entity."""
        return {tie[2] for tie in self._ties if tie[:2] == (entity, name)}

    def conditions(self, seen: Sighting, conditions: Sequence[Condition]) -> None:
        """What a description says, of somebody of whom it is held to be true."""
        for condition in conditions:
            self.attribute(seen, *attribute_of(condition))

    def read(self, plan: Plan, seen: Sighting) -> None:
        """A sighting of the person whom the question asks about, with what the plan reads of it."""
        self.person(seen)
        asked = [plan.times[name] for name in plan.answer.times]
        match plan.answer.read:
            case "action":
                if any(time.frame == seen.frame for time in asked):
                    self.attribute(seen, "action", seen.mark.pose)
            case "next_action":
                self.attribute(seen, "action", seen.mark.pose)
            case "distance_change":
                if seen.mark.distance_dm is not None and any(time.frame == seen.frame for time in asked):
                    self.attribute(seen, "distance_m", seen.mark.distance_dm / 10)
            case "start" | "span" | "start_view" | "seconds_between":
                for time in asked:
                    if time.action is not None:
                        self._action(seen, time.action)

    def _action(self, seen: Sighting, action: str) -> None:
        """What somebody does of what is asked: of postures the one that is seen, of other actions that it is seen."""
        if action in POSES:
            self.attribute(seen, "action", seen.mark.pose)
        elif action in seen.mark.actions:
            self.attribute(seen, "action", action)


def placed(look: Look, seen: Sighting) -> dict[str, Any]:
    """The keys of a call that say where somebody is; of a person over the seam of a panorama the larger part."""
    x = seen.box.x
    if look.panorama:
        x -= look.width * ((x + seen.box.w / 2) // look.width)
    return {"observation": look.name, "box": write_box(seen.box._replace(x=x), look.width, look.height)}


def attribute_of(condition: Condition) -> tuple[str, str | float]:
    """Name and value of the attribute that says what a condition says."""
    if condition.action is not None:
        return "action", condition.action
    if condition.interaction is not None:
        return "interaction", condition.interaction
    if condition.object is not None:
        return "object", f"{condition.verb}: {condition.object}"
    assert condition.attribute is not None and condition.value is not None, "a condition names one of these"
    return condition.attribute, condition.value if isinstance(condition.value, str) else float(condition.value)
