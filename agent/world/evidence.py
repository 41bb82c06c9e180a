"""Evidence that statements over a world model sum, and the bindings that follow from it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.agent.look.ranking import edges_of, join
from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.perceive.votes import Support, Tracks, Vote, fuse
from jrdb_avr.agent.world.derive import ENTITY_TOPIC, Slot
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import SYMMETRIC
from jrdb_avr.schema.repeats import Repeats

_DIGITS: Final = 9
"""Number of decimals to which sums of weights are rounded, because the engine adds in any order."""


Rows = Sequence[Mapping[str, Any]]
"""Rows of a statement."""


class Evidence:
    """Rows of the two statements that sum evidence, and the bindings that follow from them."""

    def __init__(self, plan: Plan, slots: Sequence[Slot], singles: Rows, pairs: Rows, repeats: Repeats) -> None:
        self._slots, self._repeats = slots, repeats
        singles, pairs = (
            [{**row, "weight": round(row["weight"], _DIGITS)} for row in rows] for rows in (singles, pairs)
        )
        self.rows = {"slots": singles, "pairs": pairs}
        self._votes: dict[tuple[int, str, str], list[Vote]] = defaultdict(list)
        numbered = {slot.row.number: slot for slot in slots}
        # Rows of replaced slots are left out.
        singles, pairs = ([row for row in rows if row["slot"] in numbered] for rows in (singles, pairs))
        for row in singles:
            self._votes[row["slot"], row["entity"], ""].append((row["frame"], row["weight"]))
        for row in pairs:
            ends = row["source"], row["target"]
            slot = numbered[row["slot"]].row
            symmetric = slot.name in SYMMETRIC and slot.origin == "model"
            for source, target in (ends, ends[::-1]) if symmetric else (ends,):
                self._votes[row["slot"], source, target].append((row["frame"], row["weight"]))
        edges = edges_of(plan)
        entities = {row["entity"] for row in singles if numbered[row["slot"]].row.topic == ENTITY_TOPIC}
        alone = {
            (node.id, entity): sum(
                sum(weight for _, weight in self._votes.get((slot.row.number, entity, ""), ()))
                if slot.part is None
                else slot.part.evidence(self.support(slot, entity).log_odds)
                for slot in slots
                if slot.row.node == node.id and slot.row.kind != "edge"
            )
            for node in plan.nodes
            for entity in entities
        }
        first = next((slot.row.number for slot in slots if slot.row.kind == "edge"), 0)
        table = {
            (number - first, source, target): edges[number - first].evidence(
                self.support(numbered[number], source, target).log_odds
            )
            for number, source, target in self._votes
            if target
        }
        self.bindings = join(plan, alone, table) if alone else ()

    def support(self, slot: Slot, entity: str, other: str = "") -> Support:
        """Return the support of a slot for an entity or a pair."""
        return Support(fuse(self._votes.get((slot.row.number, entity, other), ()), slot.frame, self._repeats))


def assemble_tracks(sightings: Rows, attributes: Rows, relations: Rows, looks: Rows, repeats: Repeats) -> Tracks:
    """Return the readings of an episode from the rows of four statements.

    Args:
        sightings: Boxes of entities.
        attributes: Attributes that a model read.
        relations: Relations that a model read.
        looks: Looks with a list of their people.
        repeats: Weights of repeated readings.

    Returns:
        The readings and looks.
    """
    labels: dict[tuple[str, int], list[ReadLabel]] = defaultdict(list)
    for row in attributes:
        labels[row["entity"], row["look"]].append(ReadLabel(row["name"], row["value"], row["log_odds"] > 0))
    numbers = {(row["entity"], row["look"]): row["number"] for row in sightings}
    ties: dict[tuple[str, int], list[ReadTie]] = defaultdict(list)
    for row in relations:
        look = int(row["look"].rpartition("/o")[2])
        ties[row["source"], look].append(ReadTie(row["name"], numbers[row["target"], look], row["log_odds"] > 0))
    people: dict[str, tuple[PersonReading, ...]] = {}
    for row in sightings:
        key = row["entity"], row["look"]
        metres = None if row["metres"] < 0 else row["metres"]
        details = tuple(labels[key]), tuple(ties[key]), metres, row["whole"]
        reading = PersonReading(f"o{row['look']}", numbers[key], row["frame"], Box(**row["box"]), *details)
        people[row["entity"]] = (*people.get(row["entity"], ()), reading)
    columns: dict[int, tuple[SeenColumns, ...]] = {}
    for row in looks:
        columns[row["frame"]] = (*columns.get(row["frame"], ()), SeenColumns(row["left"], row["width"]))
    return Tracks(people, columns, repeats)
