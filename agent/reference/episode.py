"""One question being played: turns of calls until a final answer is taken or the budget is used up.

The loop is the same in all variants. What differs is the memory, which says what a turn shows, takes what is written
down, judges the final answer and commits to one at the end, and whether there is anything to look with. Nothing but the
task and the model's replies decides what happens: a run that was killed replays its finished calls to the same
transcript.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import msgspec

from jrdb_avr.agent.beliefs.arguments import printable
from jrdb_avr.agent.methods.attempt import DUPLICATE_DEG, Attempt, ParsedReply
from jrdb_avr.agent.methods.requests import PANORAMAS, fixed_settings
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.reference.chat_memory import ChatMemory
from jrdb_avr.agent.reference.graph_memory import GraphMemory
from jrdb_avr.agent.reference.tool_calls import (
    FINAL,
    LOOK_SCHEMA,
    MOST_PER_TURN,
    WRITING,
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
    """looks: observations made; calls: tool calls carried out or refused, looks included, the plan left out, and turns
    that are no list of calls; repairs: tries after a refused plan; panoramas: those of a fixed context.
    """

    looks: int = 24
    calls: int = 80
    repairs: int = 3
    panoramas: int = PANORAMAS

    def model_calls(self, plans: bool) -> int:
        """Model calls at most: every turn costs a call at least."""
        return (1 + self.repairs if plans else 0) + self.calls

    def settings(self, looks: bool, plans: bool) -> dict[str, Any]:
        """What a run's manifest says of a variant's budgets."""
        calls = {"calls": self.calls, "calls_per_turn": MOST_PER_TURN}
        planned = {"repairs": self.repairs} if plans else {}
        seen = {"looks": self.looks, "duplicate_deg": DUPLICATE_DEG} if looks else fixed_settings(self.panoramas)
        return calls | {"model_calls": self.model_calls(plans)} | planned | seen


LIMITS: Final = Limits()
"""Those of the benchmark."""

Memory = ChatMemory | GraphMemory
"""What a variant remembers by."""


@dataclass
class AgentEpisode:
    """The loop over one question.

    refused: the last final answer that was not taken, where nothing has been looked at or written since; refusal: why
    the last final answer was not taken or the last turn not read; unread: whether it could not be read.
    """

    attempt: Attempt
    memory: Memory
    looking: bool
    limits: Limits = LIMITS
    views: dict[str, View] = field(default_factory=dict)
    used: int = 0
    refused: str = ""
    refusal: str = ""
    unread: bool = False
    ended: bool = False

    def play(self) -> Prediction:
        """Play to a final answer that is taken, or sent again as it was, or to the last call."""
        turn = self._turn([], list(self.views.values()), "")
        schema = self.memory.schema(LOOK_SCHEMA if self.looking else None)
        while self.used < self.limits.calls and not self.ended:
            reply = self.attempt.ask(self.memory.messages(turn), schema)
            self.memory.replied(reply)
            step = self.attempt.steps - 1
            try:
                calls = read_calls(decode.reply_object(reply, self.attempt.convention), self._tools())
            except DecodeError as error:
                self.used += 1
                self.memory.unread()
                self.refusal, self.unread = printable(str(error)), True
                turn = self._turn([], [], self.refusal)
                continue
            results: list[str] = []
            before = len(self.views)
            left = self.limits.calls - self.used
            for call in calls[:left]:
                taken = self._call(call, step, results)
                if taken is not None:
                    return self.attempt.prediction(taken)
            for call in calls[left:]:
                self._keep(call)
            turn = self._turn(results, list(self.views.values())[before:], "")
        return self._committed()

    def _committed(self) -> Prediction:
        """What the memory commits to, without a final answer that was taken."""
        reason = self.refusal or f"no final answer within {self.limits.calls} calls"
        parsed = self.memory.commit()
        return self.attempt.prediction(replace(parsed, faults=(reason,) if self.unread else (), refusal=reason))

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
        """Carry out or refuse one call; a final answer that is taken."""
        self.used += 1
        started = time.perf_counter()
        taken, result = None, "done"
        try:
            if call.tool == FINAL:
                taken = self._final(call, step)
            elif call.fault:
                raise DecodeError(call.fault)
            elif call.tool == "observe":
                result = self._look(call, step)
                self.refused = ""
            else:
                result = self.memory.carry_out(call, self.views, step)
                # What was written may have made the same answer a better one.
                self.refused = "" if call.tool in WRITING and result == "done" else self.refused
        except DecodeError as error:
            self.memory.refused(call, step, str(error))
            result = refusal(str(error))
        results.append(f"{call.tool}: {result}")
        self.attempt.record("tool", msgspec.Raw(call.text.encode()), result, started)
        return taken

    def _final(self, call: Call, step: int) -> ParsedReply:
        """A final answer that is taken. Raises DecodeError for any other, of which what can be read is kept."""
        self.ended = call.text == self.refused
        self.refused, self.unread = call.text, True
        try:
            if call.fault:
                self._keep(call)
                raise DecodeError(call.fault)
            self.memory.propose(call, self.views)
            self.unread = False
            return self.memory.judge(call, step)
        except DecodeError as error:
            self.refusal = printable(str(error))
            raise

    def _keep(self, call: Call) -> None:
        """Keep what can be read of a final answer that is not judged."""
        if call.tool == FINAL:
            with contextlib.suppress(DecodeError):
                self.memory.propose(call, self.views)

    def _look(self, call: Call, step: int) -> str:
        decode.only_keys(call.arguments, ("frame_id", "angle_deg"), "the call")
        frame, angle = self.attempt.read_look(call.arguments)
        if len(self.attempt.made) >= self.limits.looks:
            raise DecodeError("no looks are left")
        if reason := self.attempt.duplicate(frame, angle):
            raise DecodeError(reason)
        return self._name(self.attempt.look(frame, angle), step)
