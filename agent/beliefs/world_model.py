"""The agent's world model: what it saw and believes, written under the grounding rule and never otherwise.

A write is accepted only if it names an observation that its own episode has made; all of it is checked before it goes
into the world tables, with its line of the record. What is refused leaves that line and nothing else. Each line is told
to `keep` once it is in the tables.

An episode knows its current facts by itself: it needs them to check a write, and `graph` shows them without asking the
engine. The tables, which the solver reads, hold the same.
"""

from __future__ import annotations

import contextlib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.agent.beliefs.believed import Believed, Edge, place_of, sighting_place
from jrdb_avr.agent.beliefs.grounding import (
    AttributeClaim,
    RelationClaim,
    as_json,
    one_line,
    read_attribute,
    read_entity,
    read_relation,
    shown,
)
from jrdb_avr.agent.beliefs.slots import slots_of
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.writes import drop_episode, episodes_of, write_statements
from jrdb_avr.schema.beliefs import (
    ALWAYS,
    TIMELESS,
    XYWH,
    AttributeRow,
    EntityRow,
    EpisodeRow,
    Fact,
    ObservationRow,
    RelationRow,
    SightingRow,
    Tool,
    Write,
    episode_key,
    name_of,
)
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Question, RecordWrite
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, from_crop
from jrdb_avr.schema.plan import Plan, canonical

MOST_ENTITIES: Final = 64
MOST_WRITES: Final = 2000
"""Of an episode; writes that are accepted."""

MOST_WAITING: Final = 100
"""Of an episode; writes that are known to it, but not in the tables yet."""

_MIDDLE_DEG: Final = 180.0
"""The angle of a whole panorama: that of its middle column."""


_ROUNDING: Final = 1e-6
"""Pixels by which a box that was scaled to its image may end beyond it."""


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a call: `said` is "done", or why it was refused."""

    accepted: bool
    said: str


@dataclass(frozen=True, slots=True)
class _Seen:
    """An observation of an episode: the columns of the panorama that it covers, and what a model is told of it."""

    name: str
    frame: int
    angle: float
    left: int
    width: int
    said: dict[str, Any]

    @classmethod
    def of(cls, name: str, observation: Observation | Panorama) -> _Seen:
        said: dict[str, Any] = {"frame_id": observation.frame_id}
        if isinstance(observation, Panorama):
            return cls(name, observation.frame_index, _MIDDLE_DEG, 0, WIDTH, said | {"panorama": True})
        angle, left = observation.angle_deg, observation.left
        return cls(name, observation.frame_index, angle, left, CROP, said | {"angle_deg": angle})

    def place(self, box: Box) -> XYWH:
        """A box of this image's pixels in stitched ones. Raises DecodeError for what is no box in the image."""
        right, lower = box.x + box.w, box.y + box.h
        if not (0 <= box.x < right <= self.width + _ROUNDING and 0 <= box.y < lower <= HEIGHT + _ROUNDING):
            raise DecodeError("the box must lie in the observation's image and have an area")
        return XYWH(*map(float, from_crop(box, self.left)))


DONE: Final = Result(True, "done")


class World:
    """The world model of a run; its episodes may be used from several threads, each from one."""

    def __init__(self, graph: WorldGraph, run_id: str) -> None:
        """Raises QueryError or StoreError, as all that reads the graph does."""
        self.graph = graph
        self.run_id = run_id
        self._begun = episodes_of(graph, run_id)

    def episode(self, question: Question, keep: RecordWrite) -> Episode:
        """Begin a question's episode; what an earlier try of it left is taken away.

        Raises QueryError or StoreError, as all writes of an episode do, where the graph cannot be written.
        """
        key = episode_key(self.run_id, question.question_id)
        if key in self._begun:
            drop_episode(self.graph, key)
        self._begun.add(key)
        return Episode(self.graph, self.run_id, question, keep)


class Episode:
    """What is believed about one question. Made by `World.episode`."""

    def __init__(self, graph: WorldGraph, run_id: str, question: Question, keep: RecordWrite) -> None:
        self.key = episode_key(run_id, question.question_id)
        self._graph = graph
        self._keep = keep
        self._writes = 0
        # Writes that are known here, but not in the tables yet.
        self._waiting: list[tuple[Write, Fact]] = []
        # The beginning waits for what follows it.
        self._together = True
        self._accepted = 0
        self._observations: dict[str, _Seen] = {}
        self._entities: dict[str, EntityRow] = {}
        self._nodes: frozenset[str] = frozenset()
        # The edges that are current, each under what it is that a later write of the same replaces.
        self._edges: dict[Hashable, Believed] = {}
        self._row = EpisodeRow(self.key, run_id, question.question_id, question.sequence, "")
        self._write("begin", {"question_id": question.question_id}, 0, Fact(episode=self._row))
        self._together = False

    # -- what is not the model's own ----------------------------------------------------------------------------------

    def plan(self, plan: Plan, step: int) -> None:
        """Take the plan: its text, and a slot for all that it asks for. To be called once."""
        text = canonical(plan)
        row = msgspec.structs.replace(self._row, plan=text)
        self._write("plan", msgspec.to_builtins(plan), step, Fact(episode=row, slots=slots_of(plan, self.key)))
        self._nodes = frozenset(node.id for node in plan.nodes)

    def observed(self, observation: Observation | Panorama, step: int) -> str:
        """Take an observation that has been made; the name by which the model is to call it: "o1", "o2", ...

        This is the record's line of an accepted look; `noted` is for those that were refused.
        """
        number = len(self._observations) + 1
        seen = _Seen.of(f"o{number}", observation)
        row = ObservationRow(
            f"{self.key}/{seen.name}", self.key, number, step, seen.frame, seen.angle, seen.left, seen.width
        )
        self._write("observe", seen.said, step, Fact(observation=row))
        self._observations[seen.name] = seen
        return seen.name

    def noted(self, tool: Tool, arguments: object, step: int, accepted: bool, reason: str = "") -> None:
        """Keep a line of the record of a call that writes nothing: a look refused, get_graph, final_answer."""
        self._line(Write(self._writes, step, tool, as_json(arguments), accepted, one_line(reason), ""), Fact())

    def refused(self, tool: Tool, arguments: object, reason: str, step: int) -> Result:
        """Keep a line of the record of a call that is refused."""
        kept = one_line(reason)
        self.noted(tool, arguments, step, False, kept)
        return Result(False, kept)

    # -- the model's writes -------------------------------------------------------------------------------------------

    def add_entity(self, arguments: object, box: Box | str, step: int) -> Result:
        """Add an entity, or another sighting of one that is there, with the kind and node that it has from now on.

        arguments: as the model wrote them, any JSON; box: in pixels of the observation's image, or why the one in the
        arguments cannot be read.
        """
        try:
            fact = self._sighting(arguments, box, step)
        except DecodeError as error:
            return self.refused("add_entity", arguments, str(error), step)
        return self._accept("add_entity", arguments, step, fact)

    def add_attribute(self, arguments: object, step: int) -> Result:
        """Say what is seen of an entity in an observation; arguments: as the model wrote them, any JSON."""
        try:
            fact = self._attribute(read_attribute(arguments), step)
        except DecodeError as error:
            return self.refused("add_attribute", arguments, str(error), step)
        return self._accept("add_attribute", arguments, step, fact)

    def add_relation(self, arguments: object, step: int) -> Result:
        """Say what joins two entities in an observation; arguments: as the model wrote them, any JSON."""
        try:
            fact = self._relation(read_relation(arguments), step)
        except DecodeError as error:
            return self.refused("add_relation", arguments, str(error), step)
        return self._accept("add_relation", arguments, step, fact)

    def _sighting(self, arguments: object, box: Box | str, step: int) -> Fact:
        claim = read_entity(arguments)
        seen = self._seen(claim.observation)
        if isinstance(box, str):
            raise DecodeError(box)
        self._room()
        if claim.node and claim.node not in self._nodes:
            known = ", ".join(sorted(self._nodes)) or "there is no plan"
            raise DecodeError(f"node {shown(claim.node)} is none of the plan's: {known}")
        there = self._entities.get(claim.id)
        if there is None and len(self._entities) >= MOST_ENTITIES:
            raise DecodeError(f"there are {MOST_ENTITIES} entities already, and no more are taken")
        place = seen.place(box)
        row = EntityRow(
            f"{self.key}/{claim.id}",
            self.key,
            claim.id,
            there.number if there else len(self._entities) + 1,
            claim.kind,
            claim.node or (there.node if there else ""),
            there.step if there else step,
        )
        sighted = SightingRow(
            row.id,
            f"{self.key}/{seen.name}",
            self.key,
            self._writes,
            step,
            seen.frame,
            place,
            center_angle(place.x, place.w),
        )
        return Fact(
            entity=None if there else row,
            changed=row if there not in (None, row) else None,
            freed=tuple(e.id for e in self._entities.values() if row.node and e.node == row.node and e.id != row.id),
            sighted=sighted,
            replaced=self._replaced(sighted),
        )

    def _attribute(self, claim: AttributeClaim, step: int) -> Fact:
        seen = self._seen(claim.observation)
        entity = self._sighted(claim.entity, seen)
        self._room()
        always = claim.name in TIMELESS
        has = AttributeRow(
            entity,
            f"{self.key}/{seen.name}",
            self.key,
            self._writes,
            step,
            claim.name,
            claim.value,
            claim.number,
            0 if always else seen.frame,
            ALWAYS if always else seen.frame,
        )
        return Fact(has=has, replaced=self._replaced(has))

    def _relation(self, claim: RelationClaim, step: int) -> Fact:
        seen = self._seen(claim.observation)
        source, target = self._sighted(claim.source, seen), self._sighted(claim.target, seen)
        self._room()
        related = RelationRow(
            source,
            target,
            self.key,
            self._writes,
            step,
            claim.name,
            f"{self.key}/{seen.name}",
            seen.frame,
            seen.frame,
        )
        return Fact(related=related, replaced=self._replaced(related))

    # -- the grounding rule -------------------------------------------------------------------------------------------

    def _seen(self, name: str) -> _Seen:
        """An observation of this episode. Raises DecodeError."""
        if name not in self._observations:
            made = ", ".join(list(self._observations)[-8:]) or "none yet"
            raise DecodeError(f"observation {shown(name)} has not been made; made: {made}")
        return self._observations[name]

    def _sighted(self, name: str, seen: _Seen) -> str:
        """The key of an entity that has been sighted at an observation's frame. Raises DecodeError."""
        entity = self._entities.get(name)
        if entity is None:
            raise DecodeError(f"there is no entity {shown(name)}: add it first")
        if sighting_place(entity.id, seen.frame) not in self._edges:
            raise DecodeError(f"{name} has no sighting at frame {seen.frame:06d}: add it to {seen.name} first")
        return entity.id

    def _room(self) -> None:
        """Raises DecodeError where no more writes are taken."""
        if self._accepted >= MOST_WRITES:
            raise DecodeError(f"{MOST_WRITES} writes have been made, and no more are taken")

    def _replaced(self, edge: Edge) -> tuple[int, ...]:
        """The write of the edge that this one takes the place of, if there is one."""
        before = self._edges.get(place_of(edge))
        return () if before is None else (before.edge.write,)

    # -- writing ------------------------------------------------------------------------------------------------------

    def _accept(self, tool: Tool, arguments: object, step: int, fact: Fact) -> Result:
        """Know what has been found good from now on, and write it."""
        self._accepted += 1
        for key in fact.freed:
            name = name_of(key)
            self._entities[name] = msgspec.structs.replace(self._entities[name], node="")
        for entity in (fact.entity, fact.changed):
            if entity is not None:
                self._entities[entity.name] = entity
        for edge in (fact.sighted, fact.has, fact.related):
            if edge is not None:
                self._edges[place_of(edge)] = Believed.of(edge)
        # Last: all that waits may be put into the tables now, and this with it.
        self._write(tool, arguments, step, fact)
        return DONE

    def _write(self, tool: Tool, arguments: object, step: int, fact: Fact) -> None:
        text = msgspec.json.encode(fact).decode()
        self._line(Write(self._writes, step, tool, as_json(arguments), True, "", text), fact)

    def _line(self, write: Write, fact: Fact) -> None:
        self._waiting.append((write, fact))
        self._writes += 1
        if not self._together or len(self._waiting) >= MOST_WAITING:
            self.settle()

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Put what is written inside into the tables at the end, when it is settled, or when `MOST_WAITING` writes
        wait: a statement takes as long for many rows as for a few. An error inside takes nothing back.
        """
        self._together = True
        try:
            yield
        finally:
            self._together = False
            self.settle()

    def settle(self) -> None:
        """Put what waits into the tables, and tell `keep` of it. Raises as all writes do."""
        made, self._waiting = self._waiting, []
        if made:
            self._graph.write(*write_statements(self.key, made, self._entities))
            for write, _ in made:
                self._keep(write)

    # -- what is believed ---------------------------------------------------------------------------------------------

    def rows(self) -> dict[str, list[Mapping[str, Any]]]:
        """What is currently believed, as the statements of `queries/reads/world` give it, by their names."""
        rows: dict[str, list[Mapping[str, Any]]] = {"sighted": [], "attributes": [], "relations": []}
        for one in self._edges.values():
            rows[one.kind].append(one.row)
        looks: list[Mapping[str, Any]] = [
            {"frame": seen.frame, "edge": seen.left, "width": seen.width} for seen in self._observations.values()
        ]
        entities: list[Mapping[str, Any]] = [
            {"who": entity.name, "node": entity.node} for entity in self._entities.values()
        ]
        return {
            "sighted": sorted(rows["sighted"], key=lambda row: (row["who"], row["frame"], row["written"])),
            "attributes": sorted(
                rows["attributes"], key=lambda row: (row["who"], row["name"], row["first"], row["value"])
            ),
            "relations": sorted(
                rows["relations"], key=lambda row: (row["source"], row["name"], row["target"], row["first"])
            ),
            "looks": sorted(looks, key=lambda row: (row["frame"], row["edge"], row["width"])),
            "entities": sorted(entities, key=lambda row: row["who"]),
        }

    # -- what is shown ------------------------------------------------------------------------------------------------

    def graph(self, missing: Sequence[str] = ()) -> dict[str, Any]:
        """What `get_graph` shows: observations and what is currently believed, and `missing`: what the plan still
        lacks.
        """
        sightings: dict[str, list[Mapping[str, Any]]] = {entity.id: [] for entity in self._entities.values()}
        attributes: dict[str, list[Mapping[str, Any]]] = {key: [] for key in sightings}
        relations = []
        for one in sorted(self._edges.values(), key=lambda one: one.edge.write):
            match one.edge:
                case SightingRow(source=source):
                    sightings[source].append(one.shown)
                case AttributeRow(source=source):
                    attributes[source].append(one.shown)
                case RelationRow():
                    relations.append(one.shown)
        return {
            "observations": [{"observation": name, **seen.said} for name, seen in self._observations.items()],
            "entities": [
                {
                    "id": entity.name,
                    "kind": entity.kind,
                    **({"node": entity.node} if entity.node else {}),
                    "sightings": sightings[entity.id],
                    "attributes": attributes[entity.id],
                }
                for entity in self._entities.values()
            ],
            "relations": relations,
            "missing": list(missing),
        }
