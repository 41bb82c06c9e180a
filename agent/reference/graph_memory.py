"""Memory in the world model: every turn shows the graph, and a solver judges the final answer by it.

Every write, accepted or refused, goes to the episode of the world model, which alone decides whether it is grounded.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, get_args

import msgspec

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
from jrdb_avr.schema.beliefs import Tool
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Question
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan, canonical

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.solver import Belief, BeliefSolver
    from jrdb_avr.agent.beliefs.world_model import BeliefEpisode

_NAME: Final = {"type": "string", "pattern": "^[A-Za-z0-9_-]{1,32}$"}
OBSERVATION_SCHEMA: Final = {"type": "string", "pattern": "^o[0-9]+$"}


_TOOLS: Final[dict[str, Tool]] = {name: name for name in get_args(Tool)}
"""The tools whose refused calls are recorded."""


@dataclass
class GraphMemory:
    """The world model's episode of one question, and its solver.

    fixed: whether all turns show the same pictures; latest: those that were made last; weighed, compiled: what the
    beliefs come to by the episode and by the compiled plan, None where something has been seen or written since.
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
    weighed: Belief | None = None
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
            f"Graph: {compact_json(self.world.graph(self._weighed().missing))}",
            turn.result_lines(),
            *([] if self.fixed else pictures),
            turn.state(),
        ]
        return [Message("system", (self.system,)), Message("user", tuple(parts))]

    def replied(self, reply: Reply) -> None:
        """What is not in the graph is forgotten."""

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

    def judge(self, call: Call, views: Mapping[str, View], step: int) -> ParsedReply:
        part = decode.only_keys(call.arguments, ("answer", "entity"), "the call")
        proposed = self.attempt.read_answer(part["answer"])
        if not isinstance(part["entity"], str):
            raise DecodeError("entity must be the id of the plan's target")
        belief = self._solved()
        if reason := self.solver.fault(self.plan, belief, proposed, part["entity"]):
            raise DecodeError(reason)
        self.world.noted(FINAL, call.arguments, step, True)
        if belief.seen is None:
            return ParsedReply(proposed, None, ("the target has no box",))
        return ParsedReply(proposed, stitched_evidence(*belief.seen))

    def solved(self, reason: str) -> ParsedReply:
        """Return the answer of the solver; without a single target, that of the likeliest entity.

        An answer that cannot be read is None; the box stays.
        """
        belief = self._solved()
        if belief.seen is None:
            started = time.perf_counter()
            belief = self.solver.guess(self.plan, self.world.rows()) or belief
            self.attempt.record("solve", {"guess": self.plan.target}, msgspec.to_builtins(belief), started)
        answer = self.solver.answer(self.plan, belief)
        evidence = None if belief.seen is None else stitched_evidence(*belief.seen)
        return ParsedReply(answer, evidence, () if answer is not None and evidence is not None else (reason,))

    def _changed(self) -> None:
        self.weighed = self.compiled = None

    def _weighed(self) -> Belief:
        """What the beliefs come to by the episode's own state."""
        if self.weighed is None:
            self.weighed = self.solver.weigh(self.plan, self.world.rows())
        return self.weighed

    def _solved(self) -> Belief:
        """What an answer is judged by: the compiled plan's, which runs where there may be one."""
        if self.compiled is None:
            started = time.perf_counter()
            weighed = self._weighed()
            self.world.settle()
            defined = weighed.outcome == "defined"
            self.compiled = self.solver.solve(self.plan, self.world.rows()) if defined else weighed
            query = {"read": self.plan.answer.read, "of": self.plan.answer.of}
            self.attempt.record("solve", query, msgspec.to_builtins(self.compiled), started)
        return self.compiled


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
