"""One question being played: turns of calls until the final answer stands or the budget is used up.

The loop is the same in all variants. What differs is the memory, which says what a turn shows, takes what is written
down and judges the final answer, and whether there is anything to look with. Nothing but the task and the model's
replies decides what happens: a run that was killed replays its finished calls to the same transcript.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec

from jrdb_avr.agent.beliefs.arguments import printable
from jrdb_avr.agent.methods.attempt import DUPLICATE_DEG, PANORAMAS, Attempt, ParsedReply, fixed_settings
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.reference.chat_memory import ChatMemory
from jrdb_avr.agent.reference.graph_memory import GraphMemory
from jrdb_avr.agent.reference.tool_calls import (
    FINAL,
    LOOK_SCHEMA,
    MOST_PER_TURN,
    Call,
    Turn,
    View,
    read_calls,
    refusal,
    view_of,
)
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Prediction


@dataclass(frozen=True)
class Limits:
    """looks: observations made; calls: tool calls carried out or refused, looks included, the plan left out; repairs:
    tries after a refused plan; malformed: turns that are no list of calls, the last of which ends the question;
    panoramas: those of a fixed context.
    """

    looks: int = 24
    calls: int = 80
    repairs: int = 3
    malformed: int = 2
    panoramas: int = PANORAMAS

    def model_calls(self, plans: bool) -> int:
        """Model calls at most: a good turn has a call at least, and the last malformed one ends the question."""
        return (1 + self.repairs if plans else 0) + self.calls + self.malformed - 1

    def settings(self, looks: bool, plans: bool) -> dict[str, Any]:
        """What a run's manifest says of a variant's budgets."""
        calls = {"calls": self.calls, "calls_per_turn": MOST_PER_TURN, "malformed": self.malformed}
        planned = {"repairs": self.repairs} if plans else {}
        seen = {"looks": self.looks, "duplicate_deg": DUPLICATE_DEG} if looks else fixed_settings(self.panoramas)
        return calls | {"model_calls": self.model_calls(plans)} | planned | seen


LIMITS: Final = Limits()
"""Those of the benchmark."""

Memory = ChatMemory | GraphMemory
"""What a variant remembers by."""


@dataclass
class Episode:
    """The loop over one question."""

    attempt: Attempt
    memory: Memory
    looking: bool
    limits: Limits = LIMITS
    views: dict[str, View] = field(default_factory=dict)
    used: int = 0
    strikes: int = 0

    def play(self) -> Prediction:
        """Play to a legal final answer, to the second malformed turn, or to the last call."""
        turn = self._turn([], list(self.views.values()), "")
        schema = self.memory.schema(LOOK_SCHEMA if self.looking else None)
        while self.used < self.limits.calls:
            reply = self.attempt.ask(self.memory.messages(turn), schema)
            self.memory.replied(reply)
            step = self.attempt.steps - 1
            try:
                calls = read_calls(decode.reply_object(reply, self.attempt.convention), self._tools())
            except DecodeError as error:
                self.strikes += 1
                reason = printable(str(error))
                if self.strikes == self.limits.malformed:
                    return self._ended(f"{self.strikes} malformed turns, the last: {reason}")
                turn = self._turn([], [], reason)
                continue
            results: list[str] = []
            before = len(self.views)
            for call in calls[: self.limits.calls - self.used]:
                verdict = self._call(call, step, results)
                if verdict is not None:
                    return self.attempt.prediction(verdict)
            turn = self._turn(results, list(self.views.values())[before:], "")
        return self._ended(f"no legal final answer within {self.limits.calls} calls")

    def show(self, panoramas: Sequence[Panorama]) -> None:
        """Make panoramas the first observations."""
        for panorama in panoramas:
            self._name(panorama, self.attempt.steps - 1)

    def _name(self, seen: Observation | Panorama, step: int) -> str:
        name = self.memory.named(seen, step)
        self.views[name] = view_of(name, seen)
        return name

    def _tools(self) -> Collection[str]:
        return (*(("observe",) if self.looking else ()), *self.memory.tools)

    def _turn(self, results: Sequence[str], fresh: Sequence[View], error: str) -> Turn:
        made = len(self.attempt.made)
        looks = (made, self.limits.looks - made if self.looking else 0)
        return Turn(results, fresh, error, looks, (self.used, self.limits.calls - self.used))

    def _call(self, call: Call, step: int, results: list[str]) -> ParsedReply | None:
        """Carry out or refuse one call; the verdict of a legal final answer."""
        self.used += 1
        started = time.perf_counter()
        verdict, result = None, "done"
        try:
            if call.fault:
                raise DecodeError(call.fault)
            if call.tool == "observe":
                result = self._look(call, step)
            elif call.tool == FINAL:
                verdict = self.memory.judge(call, self.views, step)
            else:
                result = self.memory.carry_out(call, self.views, step)
        except DecodeError as error:
            self.memory.refused(call, step, str(error))
            result = refusal(str(error))
        results.append(f"{call.tool}: {result}")
        self.attempt.record("tool", msgspec.Raw(call.text.encode()), result, started)
        return verdict

    def _look(self, call: Call, step: int) -> str:
        decode.only_keys(call.arguments, ("frame_id", "angle_deg"), "the call")
        frame, angle = self.attempt.read_look(call.arguments)
        if len(self.attempt.made) >= self.limits.looks:
            raise DecodeError("no looks are left")
        if reason := self.attempt.duplicate(frame, angle):
            raise DecodeError(reason)
        return self._name(self.attempt.look(frame, angle), step)

    def _ended(self, reason: str) -> Prediction:
        return self.attempt.prediction(self.memory.solved(reason))
