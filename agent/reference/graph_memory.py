"""Memory in the world model: every turn shows the graph, and a solver judges the final answer by it.

Every write, accepted or refused, goes to the episode of the world model, which alone decides whether it is grounded. A
final answer that the graph does not give is refused, and kept. At the end the memory commits to the first that there is
of: the plan's answer; the answer of the person who fits best; the kept one; a guess.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, get_args

import msgspec

from jrdb_avr.agent.beliefs.display import shown_graph
from jrdb_avr.agent.beliefs.solver import NEAR_FRAMES
from jrdb_avr.agent.methods.attempt import Attempt, ParsedReply, stitched_evidence
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.decode import BOX_SCHEMA, box_key, read_box
from jrdb_avr.agent.model.messages import Message, Part
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.reference.tool_calls import (
    FINAL,
    WRITING,
    Call,
    Turn,
    View,
    call_schema,
    compact_json,
    refusal,
    turn_schema,
    view_parts,
)
from jrdb_avr.schema.answers import Answer
from jrdb_avr.schema.beliefs import Tool
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Question, Verdict
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan, canonical

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.solver import Belief, BeliefSolver
    from jrdb_avr.agent.beliefs.world_model import BeliefEpisode

_NAME: Final = {"type": "string", "pattern": "^[A-Za-z0-9_-]{1,32}$"}
OBSERVATION_SCHEMA: Final = {"type": "string", "pattern": "^o[0-9]+$"}


_MOST: Final = 0.5
"""Share of a plan's conditions and edges; an answer is supported where more of them hold of its person."""

_TOOLS: Final[dict[str, Tool]] = {name: name for name in get_args(Tool)}
"""The tools whose refused calls are recorded."""


@dataclass
class GraphMemory:
    """The world model's episode of one question, and its solver.

    fixed: whether all turns show the same pictures; latest: those that were made last; proposed, entity: the newest
    readable answer, and of whom it is. weighed: the plan at the frames that stand for the stated ones, and what the
    beliefs come to by the episode; compiled: the same by the compiled plan. Both are None where something has been seen
    or written since.
    """

    tools: ClassVar = (*WRITING, "get_graph", FINAL)
    attempt: Attempt
    world: BeliefEpisode
    solver: BeliefSolver
    plan: Plan
    system: str
    heading: str
    fixed: bool = False
    latest: tuple[View, ...] = ()
    proposed: Answer | None = None
    entity: str = ""
    weighed: tuple[Plan, Belief] | None = None
    compiled: Belief | None = None

    # -- what the model is sent ---------------------------------------------------------------------------------------

    def messages(self, turn: Turn) -> list[Message]:
        """Question, plan, graph, results of the last turn, the latest pictures, and what is left.

        What never changes comes first, so that a server can keep its work on the common beginning.
        """
        self.latest = tuple(turn.fresh) or self.latest
        pictures = view_parts(self.latest)
        parts: list[Part] = [
            self.heading,
            *(pictures if self.fixed else []),
            f"Plan: {canonical(self.plan)}",
            f"Graph: {compact_json(shown_graph(self.world.rows(), self._weighed()[1].missing))}",
            turn.result_lines(),
            *([] if self.fixed else pictures),
            turn.state(),
        ]
        return [Message("system", (self.system,)), Message("user", tuple(parts))]

    def replied(self, reply: Reply) -> None:
        """What is not in the graph is forgotten."""

    def unread(self) -> None:
        """Nor is a reply that could not be read kept."""

    def schema(self, looks: Mapping[str, Any] | None) -> dict[str, Any]:
        """The JSON Schema of a turn; `looks` is that of a look, where there are looks."""
        nodes = [node.id for node in self.plan.nodes]
        return graph_turn_schema(self.attempt.task.question, nodes, looks)

    # -- what is written down -----------------------------------------------------------------------------------------

    def named(self, seen: Observation | Panorama, step: int) -> str:
        self._changed()
        return self.world.observed(seen, step)

    def refused(self, call: Call, step: int, reason: str) -> None:
        if call.tool in _TOOLS:
            self.world.refused(_TOOLS[call.tool], call.arguments, reason, step)

    def carry_out(self, call: Call, views: Mapping[str, View], step: int) -> str:
        if call.tool == "get_graph":
            decode.only_keys(call.arguments, (), "get_graph")
            self.world.noted("get_graph", call.arguments, step, True)
            return "done"
        arguments, box = self._with_box(call.arguments, views) if call.tool == "add_entity" else (call.arguments, "")
        result = self.world.add(_TOOLS[call.tool], arguments, step, box)
        if not result.accepted:
            return refusal(result.text)
        self._changed()
        return "done"

    def _with_box(self, arguments: Mapping[str, Any], views: Mapping[str, View]) -> tuple[dict[str, Any], Box | str]:
        """The arguments under the contract's key, and the box in pixels of the named observation, or its fault."""
        convention = self.attempt.convention
        key = box_key(arguments, convention, "box")
        contract = {("box" if name == key else name): value for name, value in arguments.items()}
        name = contract.get("observation")
        view = views.get(name) if isinstance(name, str) else None
        if view is None:
            return contract, "the box is of no observation"
        try:
            return contract, read_box(contract.get("box"), view.image.size, convention, key)
        except DecodeError as error:
            return contract, str(error)

    # -- what is read from it -----------------------------------------------------------------------------------------

    def propose(self, call: Call, views: Mapping[str, View]) -> None:
        """Read a final answer, and keep it. Raises DecodeError for what cannot be read."""
        part = decode.only_keys(call.arguments, ("answer", "entity"), "the call")
        self.proposed, self.entity = self.attempt.read_answer(part["answer"]), ""
        if not isinstance(part["entity"], str):
            raise DecodeError("entity must be the id of the plan's target")
        self.entity = part["entity"]

    def judge(self, call: Call, step: int) -> ParsedReply:
        """What was just proposed, if the graph gives it. Raises DecodeError with what is missing."""
        assert self.proposed is not None, "an answer is proposed before it is judged"
        belief = self._solved()
        if reason := self.solver.fault(self.plan, belief, self.proposed, self.entity):
            raise DecodeError(reason)
        verdict = self._verdict(belief)
        self.world.answered(call.arguments, step, verdict)
        return _parsed(self.proposed, belief, verdict)

    def commit(self) -> ParsedReply:
        """Return the answer that counts where no final answer was taken; nothing where nobody is in the graph."""
        parsed, entity = self._likeliest()
        if parsed.verdict is not None:
            arguments = {"answer": msgspec.to_builtins(parsed.answer), "entity": entity}
            self.world.answered(arguments, self.attempt.steps - 1, parsed.verdict)
        return parsed

    def _likeliest(self) -> tuple[ParsedReply, str]:
        """The answer to commit to, and the entity that it is of, "" where it is of none."""
        target = self.plan.target
        belief = self._solved()
        answer, verdict = self.solver.answer(self.plan, belief), self._verdict(belief)
        if answer is not None and verdict != "guess":
            return _parsed(answer, belief, verdict), belief.people[target]
        likeliest = self._guess("")
        if likeliest is None:
            return ParsedReply(self.proposed, verdict=None if self.proposed is None else "guess"), ""
        answer = self.solver.answer(self.plan, likeliest)
        if answer is not None and likeliest.held > _MOST:
            return _parsed(answer, likeliest, "supported"), likeliest.people[target]
        if self.proposed is not None:
            likeliest = self._guess(self.entity) or likeliest
            return _parsed(self.proposed, likeliest, "guess"), likeliest.people[target]
        answer = answer or self.solver.prior(self.plan, likeliest)
        return _parsed(answer, likeliest, "guess"), likeliest.people[target]

    def _guess(self, entity: str) -> Belief | None:
        """What is read of an entity, or of the likeliest one for "", at the frames nearest to the stated ones."""
        rows, started = self.world.rows(), time.perf_counter()
        nearest = self.solver.placements(self.plan, rows, anywhere=True)[0]
        belief = self.solver.guess(nearest, rows, entity)
        self.attempt.record("solve", {"guess": entity or self.plan.target}, msgspec.to_builtins(belief), started)
        return belief

    def _verdict(self, belief: Belief) -> Verdict:
        """What an answer that the plan gives is called; a plan that describes nobody proves nothing."""
        if not self.plan.edges and not any(node.conditions for node in self.plan.nodes):
            return "guess"
        stated = {name: time.frame for name, time in self.plan.times.items() if time.frame is not None}
        moved = max(abs(belief.times.get(name, frame) - frame) for name, frame in stated.items())
        return "certain" if moved <= NEAR_FRAMES else "supported"

    def _changed(self) -> None:
        self.weighed = self.compiled = None

    def _weighed(self) -> tuple[Plan, Belief]:
        """The plan's first placement that the episode's own state answers, else the first, and what it comes to."""
        if self.weighed is None:
            rows = self.world.rows()
            plans = self.solver.placements(self.plan, rows, anywhere=self.fixed)
            weighed = ((plan, self.solver.weigh(plan, rows)) for plan in plans)
            first = next(weighed)
            found = (one for one in itertools.chain([first], weighed) if one[1].outcome == "defined")
            self.weighed = next(found, first)
        return self.weighed

    def _solved(self) -> Belief:
        """What an answer is judged by: the compiled plan's, which runs where there may be one."""
        if self.compiled is None:
            started = time.perf_counter()
            plan, weighed = self._weighed()
            self.world.settle()
            defined = weighed.outcome == "defined"
            self.compiled = self.solver.solve(plan, self.world.rows()) if defined else weighed
            query = {"read": self.plan.answer.read, "of": self.plan.answer.of}
            self.attempt.record("solve", query, msgspec.to_builtins(self.compiled), started)
        return self.compiled


def _parsed(answer: Answer, belief: Belief, verdict: Verdict) -> ParsedReply:
    """An answer with a belief's box."""
    evidence = None if belief.seen is None else stitched_evidence(*belief.seen)
    return ParsedReply(answer, evidence, verdict=verdict)


def graph_turn_schema(question: Question, nodes: Sequence[str], looks: Mapping[str, Any] | None) -> dict[str, Any]:
    """The JSON Schema of a turn on a plan with these nodes; `looks` is that of a look, where there are looks."""
    node = {"type": "string", "enum": list(nodes)}
    text, seen = {"type": "string"}, {"observation": OBSERVATION_SCHEMA}
    entity = {"id": _NAME, "kind": text, "node": node, **seen, "box": BOX_SCHEMA}
    value = {"type": ["string", "number"]}
    answer = decode.answer_schema(question.answer_mode, question.choices)
    calls = [
        call_schema("add_entity", entity, optional=("node",)),
        call_schema("add_attribute", {"entity": _NAME, "name": text, "value": value, **seen}),
        call_schema("add_relation", {"source": _NAME, "name": text, "target": _NAME, **seen}),
        call_schema("get_graph", {}),
        call_schema(FINAL, {"answer": answer, "entity": _NAME}),
    ]
    return turn_schema([*([looks] if looks else []), *calls])
