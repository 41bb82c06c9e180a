"""World model of an agent: an append-only graph of what the agent read. Its statements decide the answer.

Each question has an episode. A write that names a look that was not made, or an entity without a sighting, is refused
and changes nothing. Statements sum the evidence of each slot of the plan for each entity and pair; `join` combines
them into bindings. The readings of the target, and with them the answer, are read from the graph too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import msgspec

from jrdb_avr.agent.look.answer import Conclusion, conclude, near_targets, needs_everyone
from jrdb_avr.agent.look.moments import group_changes
from jrdb_avr.agent.look.ranking import RankedHypothesis, SlotSupport, best_of_each
from jrdb_avr.agent.perceive.fields import perceivable
from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.perceive.votes import Tracks
from jrdb_avr.agent.world.derive import (
    Key,
    Slot,
    increments,
    read_relations,
    read_values,
    slots_of,
)
from jrdb_avr.agent.world.evidence import Evidence, assemble_tracks
from jrdb_avr.queries.beliefs.episode import EpisodeRows
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.answers import Answer, encode_answer
from jrdb_avr.schema.beliefs import (
    ALWAYS,
    AttributeRow,
    EntityRow,
    EpisodeRow,
    Fact,
    HypothesisRow,
    ListedRow,
    LookRow,
    RelationRow,
    SightingRow,
    Tool,
    Write,
    episode_hash,
)
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Question
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, center_angle
from jrdb_avr.schema.plan import Plan, canonical
from jrdb_avr.schema.repeats import USUAL_REPEATS, Repeats

MOST_ENTITIES: Final = 200
"""Maximum number of entities of an episode."""

LONGEST_ARGUMENTS: Final = 8_000
"""Maximum number of characters of a call's arguments in the record."""

_MOST_RANKED: Final = 5
"""Maximum number of bindings that are written together, each with another target."""

_NO_METRES: Final = -1.0
Record = Callable[[Write], None]


class WorldModel:
    """World models of one run.

    Attributes:
        graph: The graph.
        run_id: Id of the run.
        repeats: Weights of repeated readings.
    """

    def __init__(self, graph: WorldGraph, run_id: str, repeats: Repeats = USUAL_REPEATS) -> None:
        self.graph, self.run_id, self.repeats = graph, run_id, repeats

    def episode(self, question: Question, record: Record) -> WorldEpisode:
        """Begin the episode of a question.

        Args:
            question: The question.
            record: Function that records each write.

        Returns:
            The episode.
        """
        return WorldEpisode(self.graph, self.run_id, question, record, self.repeats)


class WorldEpisode:
    """World model of one question. Only one thread may use an episode.

    Attributes:
        key: Key of the episode.
        plan: The plan, as pictures can be read for it.
        tracks: All accepted readings, for geometry and advice. Answers are read from the graph.
    """

    def __init__(
        self, graph: WorldGraph, run_id: str, question: Question, record: Record, repeats: Repeats = USUAL_REPEATS
    ) -> None:
        self._graph, self._record = graph, record
        self._rows = EpisodeRows(run_id, question.question_id)
        self.key = self._rows.key
        self.plan: Plan | None = None
        self._accepted: Plan | None = None
        self.tracks = Tracks({}, {}, repeats)
        self._slots: tuple[Slot, ...] = ()
        self._looks: dict[str, LookRow] = {}
        self._entities: dict[str, EntityRow] = {}
        self._listed: set[str] = set()
        self._written: dict[Key, float] = {}
        self._waiting: list[tuple[Write, Fact]] = []
        self._evidence: Evidence | None = None
        self._step = 0
        self._ranks: list[tuple[str, float]] = []
        episode = EpisodeRow(self.key, run_id, question.question_id, question.sequence)
        self._write("begin", {"question": question.question}, 0, Fact(episode=episode))

    # -- writes -------------------------------------------------------------------------------------------------------

    def set_plan(self, plan: Plan, step: int) -> None:
        """Write the slots of an accepted plan. An episode has one plan."""
        self._accepted = plan
        self._set_slots(plan, perceivable(plan), step)

    def _set_slots(self, accepted: Plan, plan: Plan, step: int, look: LookRow | None = None) -> None:
        """Write the slots of a plan and, after a look, what follows for them. They replace older slots."""
        self.plan = plan
        self._slots = slots_of(plan, self.key, step, self._slots[-1].row.number + 1 if self._slots else 0)
        fact = Fact(slots=tuple(slot.row for slot in self._slots))
        if look is not None:
            fact = self._with_evidence(fact, look, self.tracks, [], step)
        self._write("plan", msgspec.json.decode(canonical(accepted)), step, fact)

    def _follow_events(self, look: LookRow, step: int) -> None:
        """Move facts at group events to the frames at which the likeliest people changed groups, by the readings."""
        accepted = self._accepted
        if accepted is None or not any(time.is_group_event for time in accepted.times.values()):
            return
        nodes = next((binding.nodes for binding in self.bindings()), {})
        plan = perceivable(accepted, group_changes(accepted, self.tracks, nodes))
        if plan != self.plan:
            self._set_slots(accepted, plan, step, look)

    def observed(self, view: Observation | Panorama, step: int) -> str:
        """Write a look that was made.

        Args:
            view: The crop or panorama.
            step: Index of the model call.

        Returns:
            The name of the look: "o1", "o2" and so on.
        """
        number = len(self._looks) + 1
        name = f"o{number}"
        columns = (180.0, 0, WIDTH)
        if isinstance(view, Observation):
            columns = (float(view.angle_deg), int(view.left), CROP)
        row = LookRow(f"{self.key}/looks/{name}", self.key, number, step, view.frame_index, *columns)
        self._looks[name] = row
        self._write("observe", {"frame": row.frame, "angle": row.angle}, step, Fact(looks=(row,)))
        return name

    def add_people(self, observation: str, people: Sequence[tuple[str, PersonReading]], step: int) -> None:
        """Write the people of a look, and what follows from them.

        Args:
            observation: Name of the look.
            people: Id and reading of each person. An id that is not known names a new entity.
            step: Index of the model call.

        Raises:
            DecodeError: If the look was not made, an entity already has a sighting in it, a box is outside it, or there
                are too many entities. Then nothing is written.
        """
        look = self._look(observation)
        for entity, reading in people:
            if reading.frame != look.frame or not _is_inside(reading.box, look):
                raise DecodeError(f"the box of {entity} is outside {observation}")
            if any(other.observation == observation for other in self.tracks.people.get(entity, ())):
                raise DecodeError(f"{entity} already has a box in {observation}")
        names = [entity for entity, _ in people]
        if len({*names}) < len(names):
            raise DecodeError("an entity is listed twice")
        if len({*self._entities, *names}) > MOST_ENTITIES:
            raise DecodeError(f"there are {MOST_ENTITIES} entities: no more are accepted")
        before, number = self.tracks, self._rows.written
        columns = None if observation in self._listed else SeenColumns(look.left, look.width)
        self.tracks = before.with_people(columns, look.frame, people)
        new = tuple(
            EntityRow(f"{self.key}/{name}", self.key, index, name, step)
            for index, name in enumerate((n for n in names if n not in self._entities), len(self._entities) + 1)
        )
        self._entities |= {row.name: row for row in new}
        sighted = tuple(
            SightingRow(*self._ends(entity, look), self.key, number, step, look.frame, Box(*map(float, reading.box)),
                        center_angle(reading.box.x, reading.box.w), reading.whole, reading.number,
                        _NO_METRES if reading.metres is None else reading.metres)
            for entity, reading in people
        )  # fmt: skip
        listed = () if columns is None else (ListedRow(self.key, look.id, self.key, number, step, look.frame),)
        self._listed.add(observation)
        fact = Fact(entities=new, listed=listed, sighted=sighted)
        arguments = {"observation": observation, "people": names}
        self._write("add_people", arguments, step, self._with_evidence(fact, look, before, people, step))
        self._follow_events(look, step)

    def add_attribute(self, entity: str, observation: str, label: ReadLabel, step: int) -> None:
        """Write an attribute of an entity that has a sighting in a look.

        Raises:
            DecodeError: If the look was not made, or the entity has no sighting in it.
        """
        reading = self._reading(entity, observation)
        readings = self.tracks.readings_at(entity, reading.frame)
        for later in readings[readings.index(reading) + 1 :]:
            # The first reading of a topic in a frame has the full weight, which cannot be taken back.
            if any(other.topic == label.topic for other in later.labels):
                raise DecodeError(f"{label.topic} of {entity} was already read in {later.observation}")
        before = self._replace(entity, reading, replace(reading, labels=(*reading.labels, label)))
        people = [(entity, replace(reading, labels=(label,), ties=()))]
        arguments = {"entity": entity, "observation": observation, "name": label.name, "value": label.value}
        fact = self._with_evidence(Fact(), self._look(observation), before, people, step)
        self._write("add_attribute", arguments, step, fact)

    def add_relation(self, source: str, observation: str, relation: str, target: str, step: int) -> None:
        """Write a relation between two entities that have a sighting in a look.

        Raises:
            DecodeError: If the look was not made, or an entity has no sighting in it.
        """
        reading, other = self._reading(source, observation), self._reading(target, observation)
        tie = ReadTie(relation, other.number)
        before = self._replace(source, reading, replace(reading, ties=(*reading.ties, tie)))
        pair = [(source, replace(reading, labels=(), ties=(tie,))), (target, replace(other, labels=(), ties=()))]
        arguments = {"source": source, "observation": observation, "name": relation, "target": target}
        look = self._look(observation)
        self._write("add_relation", arguments, step, self._with_evidence(Fact(), look, before, pair, step))
        self._follow_events(look, step)

    def refuse(self, tool: Tool, arguments: object, reason: str, step: int) -> None:
        """Record a refused call, which changes nothing."""
        self._write(tool, arguments, step, None, reason)

    def answered(self, proposed: Answer | None, conclusion: Conclusion | None, step: int) -> None:
        """Write the best bindings and the answer at the end of the episode.

        Args:
            proposed: Answer that the model proposed, or None.
            conclusion: Answer that the graph supports, or None.
            step: Index of the model call.
        """
        rows = self._ranked(self.bindings(), step, conclusion)
        arguments = {"answer": None if proposed is None else msgspec.to_builtins(proposed)}
        self._write("final_answer", arguments, step, Fact(hypotheses=rows))
        self._settle()

    def _ranked(
        self, bindings: Sequence[RankedHypothesis], step: int, conclusion: Conclusion | None = None
    ) -> tuple[HypothesisRow, ...]:
        """Return the rows of the likeliest bindings, each with another target."""
        assert self.plan is not None, "a plan is set before it is solved"
        best, number, rows = best_of_each(bindings, self.plan.target), self._rows.written, []
        for rank, (entity, hypothesis) in enumerate([*best.items()][:_MOST_RANKED], 1):
            nodes = ", ".join(f"{node}={name}" for node, name in hypothesis.nodes.items())
            answer: tuple[Any, ...] = ("", "", -1)
            if conclusion is not None and conclusion.entity == entity:
                answer = encode_answer(conclusion.answer), conclusion.verdict, conclusion.frame
            odds = hypothesis.log_odds, min(hypothesis.margin, float(ALWAYS))
            key = f"{self.key}/h{number}.{rank}"
            rows.append(HypothesisRow(key, self.key, number, step, rank, entity, nodes, *odds, *answer))
        return tuple(rows)

    def _with_evidence(
        self, fact: Fact, look: LookRow, before: Tracks, people: Sequence[tuple[str, PersonReading]], step: int
    ) -> Fact:
        """Return a fact with the edges of new readings, and with the increments that follow from them."""
        relations, implied = read_relations(before, self.tracks, people)
        values = [*read_values(before, people), *implied]
        slots = {slot.row.topic: slot.row for slot in self._slots}
        for key, change in increments(self._slots, self.tracks, self._written).items():
            topic, entity, other = key
            slot = slots[topic]
            self._written[key] = self._written.get(key, 0.0) + change
            if other:
                relations.append((entity, other, slot.frame, slot.name, change, change, "derived"))
            else:
                values.append((entity, slot.frame, topic, slot.name, slot.value, change, change, False, "derived"))
        shared: tuple[Any, ...] = (self.key, self._rows.written, step)
        has = tuple(AttributeRow(*self._ends(entity, look), *shared, *columns) for entity, *columns in values)
        related = tuple(
            RelationRow(*(f"{self.key}/{source}", f"{self.key}/{target}", *shared, *columns, look.id, origin))
            for source, target, *columns, origin in relations
        )
        return msgspec.structs.replace(fact, has=has, related=related)

    def _ends(self, entity: str, look: LookRow) -> tuple[str, str]:
        return f"{self.key}/{entity}", look.id

    def _look(self, name: str) -> LookRow:
        if name not in self._looks:
            made = ", ".join([*self._looks][-8:]) or "none yet"
            raise DecodeError(f"observation {name[:40]!r} has not been made; made: {made}")
        return self._looks[name]

    def _reading(self, entity: str, observation: str) -> PersonReading:
        self._look(observation)
        for reading in self.tracks.people.get(entity, ()):
            if reading.observation == observation:
                return reading
        raise DecodeError(f"{entity[:40]} has no box in {observation}: add the person first")

    def _replace(self, entity: str, reading: PersonReading, new: PersonReading) -> Tracks:
        """Put a reading in the place of another one. Return the tracks before."""
        before = self.tracks
        readings = tuple(new if item is reading else item for item in before.people[entity])
        self.tracks = Tracks({**before.people, entity: readings}, before.looks, before.repeats)
        return before

    def _write(self, tool: Tool, arguments: object, step: int, fact: Fact | None, reason: str = "") -> None:
        text = "" if fact is None else msgspec.json.encode(fact).decode()
        write = Write(self._rows.written, step, tool, _as_json(arguments), not reason, reason, text)
        self._rows.apply(write.number, fact)
        self._waiting.append((write, fact or Fact()))
        self._evidence, self._step = None, step

    def _settle(self) -> None:
        """Add the waiting rows to the graph in one transaction, then record their writes."""
        writes, self._waiting = self._waiting, []
        statements = [*self._rows.statements([fact for _, fact in writes])]
        if statements:
            self._graph.write(statements)
        for write, _ in writes:
            self._record(write)

    def begin_turn(self) -> None:
        """Count a turn of the model."""
        self._graph.begin_turn()

    # -- reads --------------------------------------------------------------------------------------------------------

    def bindings(self) -> tuple[RankedHypothesis, ...]:
        """Return the bindings of the plan by the statements over the graph, the best first.

        Returns:
            The bindings. Empty if the graph has no entity.
        """
        return self._read_evidence().bindings

    def slots(self, hypothesis: RankedHypothesis) -> list[SlotSupport]:
        """Return the support of each part of the plan under a binding, by the same rows as the bindings."""
        evidence, nodes = self._read_evidence(), hypothesis.nodes
        parts = [(slot.part, slot) for slot in self._slots if slot.part is not None]
        return [(part, evidence.support(slot, *(nodes.get(node, "") for node in part.nodes))) for part, slot in parts]

    def conclude(self, choices: Sequence[str], frames: Sequence[int]) -> Conclusion | None:
        """Return the answer that the graph supports.

        Args:
            choices: Choices of the question.
            frames: Frames at which looks can be made, ascending.

        Returns:
            The conclusion, or None if no entity fits the plan.
        """
        # The answer never depends on rows that were read before.
        self._evidence = None
        bindings = self.bindings()
        if self.plan is None or not bindings:
            return None
        people = None if needs_everyone(self._accepted or self.plan) else near_targets(self.plan, bindings)
        return conclude(self.plan, self.read_tracks(people), bindings, choices, frames, self.slots)

    def read_tracks(self, people: Sequence[str] | None = None) -> Tracks:
        """Return the readings that the graph has.

        Args:
            people: Entities. Their readings are returned, without relations. None for all.

        Returns:
            The tracks.
        """
        self._settle()
        values = {"everyone": people is None, "people": list(people or ("",))}
        sightings, attributes = (self._rows_of(name, values) for name in ("sightings", "attributes"))
        relations = self._rows_of("relations") if people is None else []
        return assemble_tracks(sightings, attributes, relations, self._rows_of("looks"), self.tracks.repeats)

    def statements(self, people: Set[str]) -> list[dict[str, Any]]:
        """Return the statements that gave the bindings: name, parameters, and the rows about the given people."""
        rows = self._read_evidence().rows
        return [
            {
                "name": f"reads/world/{name}.cypher",
                # The hash of the episode depends on the run, and shards of a run must have equal transcripts.
                "parameters": {"question": self._rows.question, "step": self._step},
                "rows": [row for row in rows[name] if people >= {row[end] for end in ends}],
            }
            for name, ends in (("slots", ("entity",)), ("pairs", ("source", "target")))
        ]

    def _rows_of(self, name: str, values: Mapping[str, Any] = MappingProxyType({})) -> list[dict[str, Any]]:
        own = {"hash": episode_hash(self.key), "step": ALWAYS}
        return self._graph.read(read_statement(f"reads/world/{name}.cypher"), {**own, **values})

    def _read_evidence(self) -> Evidence:
        self._settle()
        if self._evidence is None:
            assert self.plan is not None, "a plan is set before the graph is read"
            has_edges = any(slot.row.kind == "edge" for slot in self._slots)
            pairs = self._rows_of("pairs") if has_edges else []
            evidence = Evidence(self.plan, self._slots, self._rows_of("slots"), pairs, self.tracks.repeats)
            ranked = [(row.nodes, round(row.log_odds, 6)) for row in self._ranked(evidence.bindings, self._step)]
            if ranked != self._ranks:
                self._ranks = ranked
                self._write("rank", {}, self._step, Fact(hypotheses=self._ranked(evidence.bindings, self._step)))
            self._evidence = evidence
        return self._evidence


def _is_inside(box: Box, look: LookRow) -> bool:
    """Return whether a box in stitched pixels has columns of a look only. One pixel is allowed for rounding."""
    begin = (box.x - look.left + 1.0) % WIDTH
    return box.w > 0 and box.h > 0 and begin + box.w <= look.width + 2.0


def _as_json(arguments: object) -> str:
    """Return arguments as JSON in ASCII. Arguments of a refused call may be any values that a model wrote."""
    try:
        raw = bytes(arguments).decode() if isinstance(arguments, msgspec.Raw) else ""
        text = raw or json.dumps(arguments, allow_nan=False)
    except (TypeError, ValueError, RecursionError):
        text = json.dumps(f"unreadable {type(arguments).__name__}")
    return text if len(text) <= LONGEST_ARGUMENTS else json.dumps(text[: LONGEST_ARGUMENTS // 2] + "...")
