"""The loop of the reference agent: turns of calls until a final answer is accepted or a limit is reached.

All variants use this loop. They differ in the memory, which shows the turn and takes the writes, and in whether looks
can be made. Only the task and the model's replies decide what happens, so a stopped run replays its finished calls to
the same transcript.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec

from jrdb_avr.agent.look.attention import NextLook
from jrdb_avr.agent.methods.attempt import DUPLICATE_DEG, Attempt, ParsedReply
from jrdb_avr.agent.methods.requests import PANORAMAS, fixed_settings
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.reference.chat_memory import ChatMemory
from jrdb_avr.agent.reference.turns import FINAL, MOST_CALLS, Call, NamedView, Turn, named_view, printable, read_calls
from jrdb_avr.agent.reference.world_memory import WorldMemory
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Prediction
from jrdb_avr.schema.panorama import angle_error

_ASIDE_DEG: Final = 1.6
"""Turn in degrees of an advised look that repeats an earlier look."""


@dataclass(frozen=True)
class Limits:
    """Limits of a question.

    looks: maximum number of looks. turns: maximum number of turns. refusals: number of turns in sequence without an
    accepted call that end the question. repairs: maximum number of tries after a refused plan. panoramas: number of
    panoramas of a variant that cannot look.
    """

    looks: int = 24
    turns: int = 50
    refusals: int = 4
    repairs: int = 3
    panoramas: int = PANORAMAS

    def settings(self, looks: bool, plans: bool) -> dict[str, Any]:
        """Return the limits that apply to a variant, for a run's manifest.

        Args:
            looks: Whether the variant looks.
            plans: Whether the variant makes a plan.

        Returns:
            The limits by name.
        """
        turns = {"turns": self.turns, "refusals": self.refusals, "calls_per_turn": MOST_CALLS}
        views = {"looks": self.looks, "duplicate_deg": DUPLICATE_DEG} if looks else fixed_settings(self.panoramas)
        return turns | ({"repairs": self.repairs} if plans else {}) | views


LIMITS: Final = Limits()
"""Limits of the benchmark."""


Memory = ChatMemory | WorldMemory
"""Memory of a variant. It shows the turns, takes the writes, advises looks, and gives the answer."""


@dataclass
class AgentLoop:
    """The loop over one question: its state, one turn, and the ends of the question.

    views: all observations by name. turns: number of turns made. refusals: number of last turns in sequence without an
    accepted call. refusal: why the last refused call or turn was refused. result: the end of the question, else None.
    """

    attempt: Attempt
    memory: Memory
    looking: bool
    limits: Limits = LIMITS
    views: dict[str, NamedView] = field(default_factory=dict)
    turns: int = 0
    refusals: int = 0
    refusal: str = ""
    result: ParsedReply | None = None

    def play(self) -> Prediction:
        """Play the question to its end.

        Returns:
            The prediction.
        """
        schema = self.memory.schema(self.looking)
        turn = self._state([], list(self.views.values()))
        while self.result is None and self.turns < self.limits.turns and self.refusals < self.limits.refusals:
            turn = self._turn(turn, schema)
        if self.result is None:
            reason = self.refusal or f"no final answer within {self.turns} turns"
            self.result = self.memory.commit(reason, self._step)
        return self.attempt.prediction(self.result)

    def show(self, panoramas: Sequence[Panorama]) -> None:
        """Make panoramas the first observations.

        Args:
            panoramas: The panoramas.
        """
        for panorama in panoramas:
            self._add_view(panorama)

    @property
    def _step(self) -> int:
        """The index of the last step of the transcript."""
        return max(self.attempt.steps - 1, 0)

    @property
    def _left(self) -> int:
        return self.limits.looks - len(self.attempt.made) if self.looking else 0

    def _state(self, results: Sequence[str], views: Sequence[NamedView], error: str = "") -> Turn:
        looks, turns = (len(self.attempt.made), self._left), (self.turns, self.limits.turns - self.turns)
        return Turn(results, views, error, looks, turns)

    # -- one turn -----------------------------------------------------------------------------------------------------

    def _turn(self, turn: Turn, schema: Mapping[str, Any]) -> Turn:
        """Make a model call, and carry out its calls. Return the next turn."""
        reply = self.attempt.ask(self.memory.messages(turn), schema)
        step = self._step
        self.turns += 1
        self.refusals += 1
        tools = (*(("observe",) if self.looking else ()), *self.memory.tools)
        try:
            calls = read_calls(decode.reply_object(reply, self.attempt.convention), tools)
        except DecodeError as error:
            self.refusal = printable(str(error))
            self.memory.replied(reply, readable=False)
            return self._state([], [], self.refusal)
        self.memory.replied(reply, readable=True)
        before = len(self.views)
        results = [self._carry_out(call, step) for call in calls]
        return self._state(results, list(self.views.values())[before:])

    def _carry_out(self, call: Call, step: int) -> str:
        """Carry out or refuse a call. Return its result."""
        started = time.perf_counter()
        try:
            if call.fault:
                raise DecodeError(call.fault)
            result = self._result(call, step)
            self.refusals, self.refusal = 0, ""
        except DecodeError as error:
            self.refusal = printable(str(error))
            self.memory.refuse(call, self.refusal, step)
            result = f"refused: {self.refusal}"
        self.attempt.record("tool", msgspec.Raw(call.text.encode()), result, started)
        return f"{call.tool}: {result}"

    def _result(self, call: Call, step: int) -> str:
        if call.tool == FINAL:
            self.result = self.memory.finish(call, self.views, self._left, step)
            return "accepted"
        if call.tool == "observe":
            return self._observe(call)
        return self.memory.carry_out(call, self.views, step)

    # -- looks --------------------------------------------------------------------------------------------------------

    def _observe(self, call: Call) -> str:
        """Make a look at the given frame and angle. Without frame and angle, make the look that the memory advises."""
        if self._left <= 0:
            raise DecodeError("no looks are left: give the final answer")
        if not call.arguments and self.memory.advises:
            return ", ".join(self._advised())
        look = decode.only_keys(call.arguments, ("frame_id", "angle_deg"), "observe")
        if self.memory.advises:
            # The turns of an advised agent do not list the legal frames.
            asked = decode.frame_id(look["frame_id"])
            nearest = min(self.attempt.task.sequence.frames, key=lambda frame: (abs(frame - asked), frame))
            look = {**look, "frame_id": f"{nearest:06d}"}
        frame, angle = self.attempt.read_look(look)
        if reason := self.attempt.duplicate(frame, angle):
            raise DecodeError(reason)
        return self._add_view(self.attempt.look(frame, angle))

    def _advised(self) -> list[str]:
        started = time.perf_counter()
        looks = self.memory.due_looks(self._left)
        due = [{"frame_id": f"{look.frame:06d}", "angle_deg": look.angle, "reason": look.reason} for look in looks]
        self.attempt.record("solve", {"looks_left": self._left}, due, started)
        if not looks:
            raise DecodeError("no further look would help: give the final answer")
        return [self._make(look) for look in looks]

    def _make(self, look: NextLook) -> str:
        """Make an advised look, turned to the side if it repeats an earlier look."""
        angle = look.angle
        made = [earlier for frame, earlier in self.attempt.made if frame == look.frame]
        while any(float(angle_error(earlier, angle)) <= DUPLICATE_DEG for earlier in made):
            angle = (angle + _ASIDE_DEG) % 360.0
        return self._add_view(self.attempt.look(look.frame, angle))

    def _add_view(self, observation: Observation | Panorama) -> str:
        name = self.memory.name_view(observation, self._step)
        self.views[name] = named_view(name, observation)
        return name
