"""The agent's world model: what it saw and believes, written under the grounding rule and never otherwise.

A write is accepted only if it names an observation that its own episode has made; all of it is checked before it goes
into the world tables, its line of the record after what it made. What is refused leaves that line and nothing else.
Each write goes to `record` once what it made is in the tables.

An episode knows its rows by itself: it needs them to check a write, and `graph` and `rows` list them without the
engine. The tables, which the solver reads, hold the same.
"""

from __future__ import annotations

import contextlib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Final, NamedTuple

import msgspec

from jrdb_avr.agent.beliefs.arguments import (
    LONGEST_ARGUMENTS,
    as_json,
    printable,
    quoted,
    read_attribute,
    read_entity,
    read_relation,
)
from jrdb_avr.agent.beliefs.display import described
from jrdb_avr.queries.beliefs.episode import Edge, EpisodeRows
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.record import drop_world, writes_held
from jrdb_avr.schema.beliefs import (
    ALWAYS,
    TIMELESS,
    AttributeRow,
    EntityRow,
    EpisodeRow,
    Fact,
    HypothesisRow,
    ObservationRow,
    Origin,
    RelationRow,
    SightingRow,
    SlotRow,
    Tool,
    Write,
    name_of,
)
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.method import Observation, Panorama, Question, RecordWrite, Verdict
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, from_crop
from jrdb_avr.schema.plan import Plan, canonical
from jrdb_avr.schema.relations import RELATIONS

MOST_ENTITIES: Final = 64
MOST_WRITES: Final = 2000
"""Of an episode; writes that are accepted."""

MOST_WAITING: Final = 100
"""Of an episode; writes that are known to it, but not in the tables yet."""

_MIDDLE_DEG: Final = 180.0
"""The angle of a whole panorama: that of its middle column."""

_ROUNDING: Final = 1e-6
"""Pixels by which a box that was scaled to its image may end beyond it."""

_SEVERAL: Final = ("action", "interaction", "object")
"""Attributes that may have several values at one frame; an action that is a pose replaces the pose before."""

_ORDER: Final = {
    "sighted": ("frame", "written", "who"),
    "attributes": ("first", "who", "name", "value"),
    "relations": ("first", "source", "name", "target"),
    "looks": ("frame", "edge", "width"),
    "entities": ("who",),
}
"""The statements of `queries/reads/world`, and the columns that they order their rows by."""

_NO_FRAME: Final = -1


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a call: `text` is "done", or why it was refused."""

    accepted: bool
    text: str


class Backing(NamedTuple):
    """How far readings bear a written edge out: how many agree with it and how many do not, who states it, and whether
    it is what they come to. Of an edge that nothing speaks for, nothing is written but the end of the one in its place.
    """

    votes: int = 1
    against: int = 0
    origin: Origin = "model"
    wins: bool = True


READ: Final = Backing()
"""A single reading, which counts in place of those before it."""


class WorldModel:
    """The world model of a run; its episodes may be used from several threads, each from one."""

    def __init__(self, graph: WorldGraph, run_id: str) -> None:
        """Raises QueryError or StoreError, as all that reads the graph does."""
        self.graph = graph
        self.run_id = run_id
        self._begun = set(writes_held(graph.graph, run_id))

    def episode(self, question: Question, record: RecordWrite) -> BeliefEpisode:
        """Begin a question's episode; what an earlier try of it left is taken away.

        Raises QueryError or StoreError, as all writes of an episode do, where the graph cannot be written.
        """
        if question.question_id in self._begun:
            with self.graph.graph.transaction():
                drop_world(self.graph.graph, self.run_id, [question.question_id])
        self._begun.add(question.question_id)
        return BeliefEpisode(self.graph, self.run_id, question, record)


class BeliefEpisode:
    """The beliefs of one question, written and read by the agent. Made by `WorldModel.episode`."""

    def __init__(self, graph: WorldGraph, run_id: str, question: Question, record: RecordWrite) -> None:
        self._graph = graph
        self._record = record
        self._rows = EpisodeRows(run_id, question.question_id)
        self.key = self._rows.key
        # Writes that are known here, but not in the tables yet.
        self._waiting: list[tuple[Write, Fact]] = []
        # Writes whose lines are not in the tables yet, which nobody reads while the episode goes on.
        self._unlisted: list[Write] = []
        # The beginning waits for what follows it.
        self._together = True
        self._accepted = 0
        self._nodes: frozenset[str] = frozenset()
        # The edges that are current, each under what it is that a later write of the same replaces.
        self._current: dict[Hashable, Edge] = {}
        begun = EpisodeRow(self.key, run_id, question.question_id, question.sequence, "", "")
        self._write("begin", {"question_id": question.question_id}, 0, Fact(episode=begun))
        self._together = False

    # -- what is not the model's own ----------------------------------------------------------------------------------

    def plan(self, plan: Plan, step: int) -> None:
        """Take the plan: its text, and a slot for each of its goals. To be called once."""
        fact = Fact(episode=self._changed(plan=canonical(plan)), slots=_slots(plan, self.key))
        self._write("plan", msgspec.to_builtins(plan), step, fact)
        self._nodes = frozenset(node.id for node in plan.nodes)

    def answered(
        self, arguments: object, step: int, verdict: Verdict, hypotheses: Sequence[HypothesisRow] = ()
    ) -> None:
        """Write the final answer of the episode with its verdict and the ranked hypotheses. To be called once."""
        fact = Fact(episode=self._changed(verdict=verdict), hypotheses=tuple(hypotheses))
        self._write("final_answer", arguments, step, fact)

    def _changed(self, **columns: str) -> EpisodeRow:
        assert self._rows.begun is not None, "an episode begins with its row"
        return msgspec.structs.replace(self._rows.begun, **columns)

    def observed(self, observation: Observation | Panorama, step: int) -> str:
        """Take an observation that has been made; the name by which the model is to call it: "o1", "o2", ...

        This writes the record's line of an accepted look; `noted` writes all other lines.
        """
        number = len(self._rows.observations) + 1
        place = (_MIDDLE_DEG, 0, WIDTH)
        if isinstance(observation, Observation):
            place = (observation.angle_deg, observation.left, CROP)
        look = ObservationRow(f"{self.key}/o{number}", self.key, number, step, observation.frame_index, *place)
        self._write("observe", described(look.frame, look.angle, look.width), step, Fact(observation=look))
        return f"o{number}"

    def noted(self, tool: Tool, arguments: object, step: int, accepted: bool, reason: str = "") -> None:
        """Record a call that writes nothing: a look refused, get_graph."""
        self._write(tool, arguments, step, None, accepted, printable(reason, LONGEST_ARGUMENTS))

    def refused(self, tool: Tool, arguments: object, reason: str, step: int) -> Result:
        """Record a call that is refused."""
        self.noted(tool, arguments, step, False, reason)
        return Result(False, printable(reason, LONGEST_ARGUMENTS))

    # -- the model's writes -------------------------------------------------------------------------------------------

    def add(self, tool: Tool, arguments: object, step: int, box: Box | str = "", backing: Backing = READ) -> Result:
        """Carry out a writing tool, or refuse it.

        `add_entity` adds an entity, or another sighting of one that is there, with the kind and node that it has from
        now on; `add_attribute` what is seen of an entity in an observation; `add_relation` what joins two in one.

        arguments: as the model wrote them, any JSON; box: of an entity, in pixels of the observation's image, or why
        the one in the arguments cannot be read.
        """
        try:
            if tool == "add_entity":
                fact = self._sighting(arguments, box, step, backing)
            elif tool == "add_attribute":
                fact = Fact(has=self._attribute(arguments, step, backing))
            else:
                fact = Fact(related=self._relation(arguments, step, backing))
        except DecodeError as error:
            return self.refused(tool, arguments, str(error), step)
        edge = fact.sighted or fact.has or fact.related
        assert edge is not None, "every writing tool makes an edge"
        place = _place(edge)
        before = self._current.get(place)
        replaced = () if before is None else (before.write,)
        if not backing.votes:
            if before is None:
                return Result(True, "done")
            del self._current[place]
            fact = Fact()
        elif backing.wins:
            self._current[place] = edge
        else:
            replaced = (edge.write,)
        self._accepted += 1
        self._write(tool, arguments, step, msgspec.structs.replace(fact, replaced=replaced))
        return Result(True, "done")

    def _sighting(self, arguments: object, box: Box | str, step: int, backing: Backing) -> Fact:
        name, kind, node, observation = read_entity(arguments)
        look = self._look(observation)
        if isinstance(box, str):
            raise DecodeError(box)
        self._check_room()
        if node and node not in self._nodes:
            known = ", ".join(sorted(self._nodes)) or "there is no plan"
            raise DecodeError(f"node {quoted(node)} is none of the plan's: {known}")
        key, entities = f"{self.key}/{name}", self._rows.entities
        there = entities.get(key)
        if there is None and len(entities) >= MOST_ENTITIES:
            raise DecodeError(f"there are {MOST_ENTITIES} entities already, and no more are taken")
        place = _stitched(look, box)
        row = there or EntityRow(key, self.key, name, len(entities) + 1, kind, node, step)
        row = msgspec.structs.replace(row, kind=kind, node=node or row.node)
        angle = center_angle(place.x, place.w)
        sighted = SightingRow(key, look.id, *self._made(step, backing), look.frame, place, angle)
        return Fact(
            entity=None if there else row,
            changed=row if there not in (None, row) else None,
            freed=tuple(one.id for one in entities.values() if row.node and one.node == row.node and one.id != key),
            sighted=sighted,
        )

    def _attribute(self, arguments: object, step: int, backing: Backing) -> AttributeRow:
        name, attribute, value, number, observation = read_attribute(arguments)
        look = self._look(observation)
        key = self._sighted(name, look)
        self._check_room()
        frames = (0, ALWAYS) if attribute in TIMELESS else (look.frame, look.frame)
        return AttributeRow(key, look.id, *self._made(step, backing), attribute, value, number, *frames)

    def _relation(self, arguments: object, step: int, backing: Backing) -> RelationRow:
        first, relation, second, observation = read_relation(arguments)
        look = self._look(observation)
        source, target = self._sighted(first, look), self._sighted(second, look)
        self._check_room()
        return RelationRow(source, target, *self._made(step, backing), relation, look.id, look.frame, look.frame)

    def _made(self, step: int, backing: Backing) -> tuple[str, int, int, int, int, Origin]:
        """The columns of an edge that do not say what it states."""
        return self.key, self._rows.written, step, backing.votes, backing.against, backing.origin

    # -- the grounding rule -------------------------------------------------------------------------------------------

    def _look(self, name: str) -> ObservationRow:
        """An observation of this episode. Raises DecodeError."""
        looks = self._rows.observations
        if f"{self.key}/{name}" not in looks:
            made = ", ".join([name_of(key) for key in looks][-8:]) or "none yet"
            raise DecodeError(f"observation {quoted(name)} has not been made; made: {made}")
        return looks[f"{self.key}/{name}"]

    def _sighted(self, name: str, look: ObservationRow) -> str:
        """The key of an entity that has been sighted at an observation's frame. Raises DecodeError."""
        key = f"{self.key}/{name}"
        if key not in self._rows.entities:
            raise DecodeError(f"there is no entity {quoted(name)}: add it first")
        if ("sighted", key, look.frame) not in self._current:
            raise DecodeError(f"{name} has no sighting at frame {look.frame:06d}: add it to {name_of(look.id)} first")
        return key

    def _check_room(self) -> None:
        """Raises DecodeError where no more writes are taken."""
        if self._accepted >= MOST_WRITES:
            raise DecodeError(f"{MOST_WRITES} writes have been made, and no more are taken")

    # -- writing ------------------------------------------------------------------------------------------------------

    def _write(
        self, tool: Tool, arguments: object, step: int, fact: Fact | None, accepted: bool = True, reason: str = ""
    ) -> None:
        text = "" if fact is None else msgspec.json.encode(fact).decode()
        write = Write(self._rows.written, step, tool, as_json(arguments), accepted, reason, text)
        self._rows.apply(write.number, step, fact)
        self._waiting.append((write, fact or Fact()))
        if not self._together or len(self._waiting) >= MOST_WAITING:
            self.settle()

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Collect the writes of a `with` block and put them into the tables together, at its end at the latest.

        They go earlier when `settle` is called or `MOST_WAITING` writes wait. A statement takes as long for many rows
        as for a few. An error inside the block undoes nothing.
        """
        self._together = True
        try:
            yield
        finally:
            self._together = False
            self.settle()

    def settle(self) -> None:
        """Put what waits into the tables, then record it: what the writes made at once, their lines not before the end
        of what is written together, or when so many wait. Raises as all writes do.
        """
        made, self._waiting = self._waiting, []
        self._unlisted += (write for write, _ in made)
        statements = list(self._rows.statements(made)) if made else []
        if not self._together or len(self._unlisted) >= MOST_WAITING:
            statements += self._rows.lines(self._unlisted)
            self._unlisted = []
        if statements:
            # In one transaction, which waits for the disk once.
            self._graph.write(statements)
        for write, _ in made:
            self._record(write)

    # -- what is believed ---------------------------------------------------------------------------------------------

    def rows(self) -> dict[str, list[Mapping[str, Any]]]:
        """Return the current beliefs as rows, by the names of the statements in `queries/reads/world`."""
        rows: dict[str, list[Mapping[str, Any]]] = {name: [] for name in _ORDER}
        for edge in self._current.values():
            name, row = _read_row(edge)
            rows[name].append(row)
        rows["looks"] = [
            {"frame": one.frame, "edge": one.left, "width": one.width, "look": one.number, "angle": one.angle}
            for one in self._rows.observations.values()
        ]
        rows["entities"] = [
            {"who": one.name, "kind": one.kind, "node": one.node, "number": one.number}
            for one in self._rows.entities.values()
        ]
        return {name: sorted(rows[name], key=itemgetter(*columns)) for name, columns in _ORDER.items()}


# -- rows -------------------------------------------------------------------------------------------------------------


def _place(edge: Edge) -> Hashable:
    """What the edge is a statement of: a later one of the same place takes it.

    At a frame an entity has one sighting, one pose, and one value of every attribute but those of `_SEVERAL`; gender
    and age it has once. Of one source there is one first person to the left and one to the right; two people stand in
    one place of the source's own view, and otherwise in several relations, of which some hold both ways.
    """
    match edge:
        case SightingRow():
            return ("sighted", edge.source, edge.frame)
        case AttributeRow() if edge.name in TIMELESS:
            return ("has", edge.source, edge.name)
        case AttributeRow() if edge.name == "action" and edge.value in POSES:
            return ("has", edge.source, "pose", edge.first)
        case AttributeRow() if edge.name in _SEVERAL:
            return ("has", edge.source, edge.name, edge.first, edge.value)
        case AttributeRow():
            return ("has", edge.source, edge.name, edge.first)
    relation = RELATIONS.get(edge.name)
    match relation and relation.kind:
        case "first":
            return ("related", edge.source, edge.name, edge.first)
        case "person":
            return ("related", edge.source, "view", edge.first, edge.target)
        case "social" | "group":
            return ("related", frozenset((edge.source, edge.target)), edge.name, edge.first)
    return ("related", edge.source, edge.name, edge.first, edge.target)


def _slots(plan: Plan, episode: str) -> tuple[SlotRow, ...]:
    """The slots of a plan: each node with its conditions, the edges, and the read.

    A slot's `name` is the attribute (or action, object, interaction), the relation or the read; `value` what it is to
    be, and of the read the names of its times. `frame` is the stated frame at which it holds, -1 where there is none.
    """
    rows: list[tuple[tuple[str, str, str, str, str], str | None]] = []
    for node in plan.nodes:
        rows.append((("node", node.id, "", "", ""), None))
        rows += [(("condition", node.id, "", *condition.wanted), condition.at) for condition in node.conditions]
    rows += [(("edge", edge.source, edge.target, edge.relation, ""), edge.at) for edge in plan.edges]
    answer = plan.answer
    rows.append((("read", answer.of, "", answer.read, ", ".join(answer.times)), answer.times[0]))
    stated = [None if time is None else plan.times[time].frame for _, time in rows]
    frames = [_NO_FRAME if frame is None else frame for frame in stated]
    return tuple(
        SlotRow(f"{episode}/{number}", episode, number, *row, frame)
        for number, ((row, _), frame) in enumerate(zip(rows, frames, strict=True))
    )


def _stitched(look: ObservationRow, box: Box) -> Box:
    """Convert a box of an observation's image to stitched pixels. Raises DecodeError for a box outside the image."""
    right, lower = box.x + box.w, box.y + box.h
    if not (0 <= box.x < right <= look.width + _ROUNDING and 0 <= box.y < lower <= HEIGHT + _ROUNDING):
        raise DecodeError("the box must lie in the observation's image and have an area")
    return Box(*map(float, from_crop(box, look.left)))


def _read_row(edge: Edge) -> tuple[str, dict[str, Any]]:
    """The statement of `queries/reads/world` that gives an edge, and the row that it gives."""
    ends = {"source": name_of(edge.source), "target": name_of(edge.target)}
    match edge:
        case SightingRow():
            place = {"frame": edge.frame, "box": edge.box._asdict(), "angle": edge.angle}
            return "sighted", {"who": ends["source"], **place, "look": _number(edge.target), "written": edge.write}
        case AttributeRow():
            row = {"who": ends["source"], "name": edge.name, "value": edge.value, "number": edge.number}
            held = {"first": edge.first, "last": edge.last, "look": _number(edge.target)}
            return "attributes", row | held | {"written": edge.write}
        case RelationRow():
            held = {"first": edge.first, "last": edge.last, "look": _number(edge.observation)}
            return "relations", ends | {"name": edge.name} | held | {"written": edge.write}


def _number(observation: str) -> int:
    """The number of an observation, from its key."""
    return int(name_of(observation).removeprefix("o"))
