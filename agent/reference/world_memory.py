"""Memory in the world model: every turn shows what the graph knows, and the graph decides the answer.

The episode of the world model checks each write. A write that names no observation of the question is refused and
changes nothing. A final answer that the graph does not support is refused once. After that, or at the end of the
budget, the answer is the one that the graph supports.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final, get_args

import msgspec

from jrdb_avr.agent.look.answer import Conclusion, guess_answer
from jrdb_avr.agent.look.attention import NextLook, next_looks
from jrdb_avr.agent.look.ranking import PlanPart, RankedHypothesis
from jrdb_avr.agent.methods.attempt import Attempt, ParsedReply, stitched_evidence
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Message, Part
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.perceive.fields import Field
from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.votes import UNIT
from jrdb_avr.agent.reference.tools import (
    GRAPH_TOOLS,
    listed,
    read_attribute,
    read_people,
    read_relation,
    world_schema,
)
from jrdb_avr.agent.reference.turns import Call, NamedView, Turn, compact_json, look_schema, printable, view_parts
from jrdb_avr.schema.answer_modes import mode_of, same_answer
from jrdb_avr.schema.answers import Answer
from jrdb_avr.schema.beliefs import Tool
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama
from jrdb_avr.schema.panorama import CROP, crop_left
from jrdb_avr.schema.plan import Plan, canonical

if TYPE_CHECKING:
    from jrdb_avr.agent.world.episode import WorldEpisode

MOST_LOOKS: Final = 3
"""Maximum number of advised looks in a turn."""

_MOST_PEOPLE: Final = 12
"""Maximum number of people in the line `World`. The tool `get_graph` lists all."""

_MOST_BINDINGS: Final = 2
"""Maximum number of likely bindings in the line `World`."""

_MOST_OPEN: Final = 6
"""Maximum number of open parts in the line `World`."""

_MOST_RECORDED: Final = 5
"""Maximum number of bindings in the transcript."""

_TOOLS: Final[dict[str, Tool]] = {name: name for name in get_args(Tool)}
"""Tools of the record of writes."""

_TOPICS: Final = ("gender", "age")
"""Topics that describe a person in the line `World`."""


@dataclass
class WorldMemory:
    """Memory of an agent with a world model: the episode of one question.

    heading: the lines that begin each user message. advises: whether turns advise looks. fixed: whether each turn shows
    all views, because no look can be made. shown: the views of the next turn: all, or the views about which nothing is
    written. counts: number of people listed per observation. proposed: the newest readable answer of the model.
    final_refused: whether a final answer was refused because the graph does not support it.
    """

    tools: ClassVar = GRAPH_TOOLS
    attempt: Attempt
    world: WorldEpisode
    fields: Sequence[Field]
    system: str
    heading: str
    advises: bool = True
    fixed: bool = False
    shown: list[NamedView] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    proposed: Answer | None = None
    final_refused: bool = False
    _bindings: tuple[RankedHypothesis, ...] | None = None

    @property
    def plan(self) -> Plan:
        """The plan as pictures are read for it. The frames of group events follow from what was read."""
        assert self.world.plan is not None, "a plan is set before the first turn"
        return self.world.plan

    # -- what the model gets ------------------------------------------------------------------------------------------

    def messages(self, turn: Turn) -> list[Message]:
        """Return the messages of a turn. The parts that never change come first, so that a server can cache them.

        Args:
            turn: The turn.

        Returns:
            The system message and one user message.
        """
        self.world.begin_turn()
        self.shown += turn.views
        views, looks = view_parts(self.shown), self.advised_looks(turn.looks[1])
        parts: list[Part] = [
            self.heading,
            *(views if self.fixed else []),
            f"World: {compact_json(self._world(looks))}",
            *([f"Looks: {compact_json([_look(look) for look in looks])}"] if self.advises else []),
            turn.result_lines(),
            *([] if self.fixed else views),
            turn.state(),
        ]
        return [Message("system", (self.system,)), Message("user", tuple(parts))]

    def replied(self, reply: Reply, readable: bool) -> None:
        """Do nothing, because the graph is the only memory."""

    def schema(self, looks: bool) -> dict[str, Any]:
        """Return the JSON Schema of a turn.

        Args:
            looks: Whether looks can be made.

        Returns:
            The schema.
        """
        look = look_schema(self.attempt.task.sequence.frames, self.advises) if looks else None
        return world_schema(self.attempt.answer_schema(), self.fields, look)

    def _world(self, looks: Sequence[NextLook]) -> dict[str, Any]:
        """Return what the line `World` states: also the supported answer, if no further look is advised."""
        bindings = self._likely()
        best = bindings[0] if bindings else None
        # A binding that is one reading ahead is shown alone, to save tokens.
        shown = bindings[: 1 if best is None or best.margin >= UNIT else _MOST_BINDINGS]
        likely = [{"nodes": dict(binding.nodes), "log_odds": round(binding.log_odds, 1)} for binding in shown]
        world = {
            "people": self._people(_MOST_PEOPLE, [] if best is None else list(best.nodes.values())),
            "likely": likely,
            "open": [] if best is None else self._open(best),
            "supported": None if looks and self.advises else self._supported(),
        }
        return world if self.advises or self.fixed else world | {"looks": self._made()}

    def _made(self) -> dict[str, list[float]]:
        """Return the angles of all looks by frame. An agent without advice chooses the next look by them."""
        made: dict[str, list[float]] = {}
        for frame, angle in self.attempt.made:
            made.setdefault(f"{frame:06d}", []).append(round(angle, 1))
        return made

    def _people(self, most: int | None, first: Collection[str]) -> dict[str, str]:
        """Describe people by their last place. `first` are the people that come first, then the last seen."""
        tracks = self.world.tracks
        last = {person: readings[-1] for person, readings in tracks.people.items()}
        people = {}
        for person in sorted(last, key=lambda person: (person not in first, -int(last[person].observation[1:])))[:most]:
            newest = last[person]
            values = [next(iter(odds)) for topic in _TOPICS if (odds := tracks.values(person, topic, None))]
            people[person] = ", ".join([*values, f"{newest.frame:06d} at {newest.angle:.0f}"])
        return people

    def _open(self, best: RankedHypothesis) -> list[str]:
        """Describe the parts of the plan that the best binding leaves open or contradicts."""
        slots = [(part, support.state) for part, support in self.world.slots(best)]
        lines = [f"{_part_text(part)}: {state}" for part, state in slots if state in ("open", "contradicted")]
        return lines[:_MOST_OPEN]

    def _supported(self) -> dict[str, Any] | None:
        """Return the answer that the graph supports, in the form of a final answer."""
        conclusion = self._conclude()
        if conclusion is None:
            return None
        return {
            "answer": mode_of(conclusion.answer).written(conclusion.answer),
            "entity": conclusion.entity,
            "verdict": conclusion.verdict,
        }

    # -- observations and writes --------------------------------------------------------------------------------------

    def name_view(self, observation: Observation | Panorama, step: int) -> str:
        """Write an observation to the graph, and return its name."""
        name = self.world.observed(observation, step)
        self.counts[name] = 0
        return name

    def refuse(self, call: Call, reason: str, step: int) -> None:
        """Record a refused call in the graph, unless it names no tool."""
        if (tool := _TOOLS.get(call.tool)) is not None:
            self.world.refuse(tool, _stored(call.arguments), reason, step)

    def carry_out(self, call: Call, views: Mapping[str, NamedView], step: int) -> str:
        """Carry out a call that writes, or `get_graph`.

        Args:
            call: The call.
            views: All observations by name.
            step: Index of the model call.

        Returns:
            The result.

        Raises:
            DecodeError: If the call is refused. The graph is then unchanged.
        """
        if call.tool == "get_graph":
            decode.only_keys(call.arguments, (), "get_graph")
            return compact_json(self._people(None, ()))
        result = "done"
        if call.tool == "add_people":
            result = self._add_people(call.arguments, self.fields, views, step)
        elif call.tool == "add_entity":
            result = self._add_people(listed(call.arguments), (), views, step)
        elif call.tool == "add_attribute":
            self.world.add_attribute(*read_attribute(call.arguments, views, self.fields), step)
        else:
            self.world.add_relation(*read_relation(call.arguments, views, self.fields), step)
        self._bindings = None
        return result

    def _add_people(
        self, arguments: Mapping[str, Any], fields: Sequence[Field], views: Mapping[str, NamedView], step: int
    ) -> str:
        """Write the people of a picture. A person with a fault is refused alone."""
        convention = self.attempt.convention
        observation, people, faults = read_people(arguments, views, fields, self.counts, convention)
        for name in [name for name, _ in people if self._is_written(name, observation)]:
            faults.append(({"id": name}, f"{name} already has a box in {observation}"))
            people = [entry for entry in people if entry[0] != name]
        if faults and not people:
            raise DecodeError("; ".join(reason for _, reason in faults))
        for person, reason in faults:
            refused = _stored({"observation": observation, "people": [person]})
            self.world.refuse("add_people", refused, printable(reason), step)
        self.world.add_people(observation, people, step)
        if not self.fixed:
            self.shown = [view for view in self.shown if view.name != observation]
        # The number of a refused person is not used again, because relations of other people may name it.
        self.counts[observation] += len(people) + len(faults)
        ending = "".join(f"; refused: {printable(reason)}" for _, reason in faults)
        return f"{observation}: {', '.join(name for name, _ in people) or 'nobody'} written{ending}"

    def _is_written(self, entity: str, observation: str) -> bool:
        return any(reading.observation == observation for reading in self.world.tracks.people.get(entity, ()))

    # -- what the graph supports --------------------------------------------------------------------------------------

    def _likely(self) -> tuple[RankedHypothesis, ...]:
        if self._bindings is None:
            self._bindings = self.world.bindings()
        return self._bindings

    def _conclude(self) -> Conclusion | None:
        """Return what the graph supports. The graph is read again, because only the graph decides an answer."""
        task = self.attempt.task
        conclusion = self.world.conclude(task.question.choices, task.sequence.frames)
        self._bindings = self.world.bindings()
        return conclusion

    def advised_looks(self, left: int) -> Sequence[NextLook]:
        """Return the looks that the graph expects to learn most from.

        Args:
            left: Number of looks that are left.

        Returns:
            At most three looks, the best first.
        """
        frames = self.attempt.task.sequence.frames
        choices = self.attempt.task.question.choices
        return next_looks(self.plan, self.world.tracks, self._likely(), left, frames, MOST_LOOKS, choices)

    def due_looks(self, left: int) -> Sequence[NextLook]:
        """Return the best look, and the next ones too while they search the same frame.

        The first look at a frame is alone, unless it identifies people, because it usually shows the person.

        Args:
            left: Number of looks that are left.

        Returns:
            At most three looks, as if the looks before showed nothing.
        """
        due: list[NextLook] = []
        tracks, frames = self.world.tracks, self.attempt.task.sequence.frames
        advised = self.advised_looks(left)[:1]
        while advised and (not due or (advised[0].frame, advised[0].purpose) == (due[0].frame, due[0].purpose)):
            due += advised
            columns = SeenColumns(int(crop_left(advised[0].angle)), CROP)
            tracks = tracks.with_people(columns, advised[0].frame, ())
            # Two looks at one person are alike, and the first look at a frame usually shows a person who is followed.
            searches = due[0].purpose == "identify" or due[0].frame in self.world.tracks.looks
            more = searches and due[0].purpose not in ("verify", "evidence") and len(due) < min(left, MOST_LOOKS)
            advised = next_looks(self.plan, tracks, self._likely(), left - len(due), frames, 1) if more else ()
        return due

    def finish(self, call: Call, views: Mapping[str, NamedView], left: int, step: int) -> ParsedReply:
        """Judge a final answer by the graph.

        Args:
            call: The call with `answer` and `entity`.
            views: All observations by name.
            left: Number of looks that are left.
            step: Index of the model call.

        Returns:
            The proposed answer if the graph supports it. Otherwise the answer that the graph supports, if an
            unsupported final answer was refused before.

        Raises:
            DecodeError: If the call cannot be read, or for the first answer that the graph does not support.
        """
        part = decode.only_keys(call.arguments, ("answer", "entity"), "the call")
        self.proposed = self.attempt.read_answer(part["answer"])
        if not isinstance(part["entity"], str):
            raise DecodeError("entity must be the id of the plan's target")
        conclusion = self._conclude()
        looks = self.advised_looks(left)
        reason = self._unsupported(conclusion, part["entity"], looks)
        if not reason:
            return self._answer(conclusion, self.proposed, "", step)
        if not self.final_refused:
            self.final_refused = True
            raise DecodeError(reason)
        return self._answer(conclusion, None, reason, step)

    def _unsupported(self, conclusion: Conclusion | None, entity: str, looks: Sequence[NextLook]) -> str:
        """Return why the graph does not support the proposed answer, or "".

        A guess is accepted only if no further look would help.
        """
        assert self.proposed is not None, "an answer is proposed before it is judged"
        if conclusion is None:
            reason = "the graph supports no answer, because it has no person who may be the target"
        elif (
            conclusion.entity == entity
            and same_answer(self.proposed, conclusion.answer)
            and (conclusion.verdict != "guess" or not looks)
        ):
            return ""
        else:
            support = compact_json(mode_of(conclusion.answer).written(conclusion.answer))
            reason = f"the graph supports the answer {support} of {conclusion.entity} ({conclusion.verdict})"
        best = self._likely()[0] if self._likely() else None
        if best is not None and (parts := self._open(best)):
            reason += f"; open: {', '.join(parts)}"
        if looks and self.advises:
            reason += f"; the best look: {compact_json(_look(looks[0]))}"
        return reason

    def commit(self, reason: str, step: int) -> ParsedReply:
        """Return the answer that the graph supports at the end of the budget.

        Args:
            reason: Why no final answer was accepted.
            step: Index of the last step.

        Returns:
            The answer.
        """
        return self._answer(self._conclude(), None, reason, step)

    def _answer(self, conclusion: Conclusion | None, accepted: Answer | None, reason: str, step: int) -> ParsedReply:
        """Write the answer of the question to the graph, and return it. Without a conclusion, it is a guess."""
        started = time.perf_counter()
        self.world.answered(self.proposed, conclusion, step)
        request = {"answer": "by the graph", "accepted": accepted is not None}
        self.attempt.record("solve", request, self._decision(conclusion), started)
        if conclusion is None:
            return ParsedReply(self._guess(), refusal=reason, verdict="guess", proposed=self.proposed)
        evidence = stitched_evidence(conclusion.frame, conclusion.box)
        answer = accepted or conclusion.answer
        return ParsedReply(answer, evidence, refusal=reason, verdict=conclusion.verdict, proposed=self.proposed)

    def _decision(self, conclusion: Conclusion | None) -> dict[str, Any]:
        """Return the end of the question as the transcript shows it: bindings, and the support of each part by each."""
        bindings = self._likely()[:_MOST_RECORDED]
        slots = [self.world.slots(binding) for binding in bindings]
        parts = [
            {"part": _part_text(row[0][0]), "support": [(support.log_odds, support.state) for _, support in row]}
            for row in zip(*slots, strict=True)
        ]
        decision = {"bindings": bindings, "conclusion": conclusion, "proposed": self.proposed, "parts": parts}
        people = {person for binding in bindings for person in binding.nodes.values()}
        return decision | {"statements": self.world.statements(people)}

    def _guess(self) -> Answer:
        """Return an answer that depends on the choices only. The frame of other modes is the middle frame."""
        question, frames = self.attempt.task.question, self.attempt.task.sequence.frames or (0,)
        return guess_answer(question.answer_mode, question.choices, frames[len(frames) // 2], 180.0)


def _stored(arguments: object) -> msgspec.Raw:
    """Return arguments of a model as JSON that every table can hold."""
    return msgspec.Raw(compact_json(arguments).encode())


def _part_text(part: PlanPart) -> str:
    """Write a part of the plan, such as "a gender female" or "a conversation b"."""
    return " ".join([part.nodes[0], part.name, part.value or part.nodes[-1]])


def _look(look: NextLook) -> dict[str, Any]:
    """Return an advised look as a turn states it."""
    return {"frame_id": f"{look.frame:06d}", "angle_deg": round(look.angle % 360.0, 1), "reason": look.reason}


def world_heading(heading: str, plan: Plan, fields: Sequence[Field]) -> str:
    """Return the lines that begin each user message of a question.

    Args:
        heading: The question, its choices and the legal frames.
        plan: The plan.
        fields: The fields that are read of each person.

    Returns:
        The text.
    """
    forms = {entry.key: entry.form() for entry in fields}
    return f"{heading}\nPlan: {canonical(plan)}\nFields: {compact_json(forms)}"
