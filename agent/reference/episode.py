"""One question being played: turns of calls until the final answer stands or the budget is used up.

The loop is the same in all variants. What differs is the memory, which says what a turn shows, takes what is written
down and judges the final answer, and whether there is anything to look with. Nothing but the task and the model's
replies decides what happens: a run that was killed replays its finished calls to the same transcript.

What a turn shows: observations under their names, results, and what is left of the budget.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import msgspec

from jrdb_avr.agent.methods.attempt import Attempt, Verdict, duplicate, panorama_line, panorama_picture
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Message, Part, Picture, crop_line, crop_picture
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.reference.limits import LIMITS, Limits
from jrdb_avr.agent.reference.tool_calls import FINAL, Call, call_schema, printable, read_calls, read_look, refusal
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Observation, Panorama, Prediction
from jrdb_avr.schema.panorama import CROP, WIDTH


@dataclass(frozen=True)
class View:
    """An observation as it is named and shown. left, width: its columns in the panorama; line: its metadata."""

    name: str
    kind: str
    frame: int
    left: int
    width: int
    line: str
    picture: Picture


def crop_view(name: str, observation: Observation) -> View:
    """A look."""
    line, picture = crop_line(observation), crop_picture(observation)
    return View(name, "Picture", observation.frame_index, observation.left, CROP, line, picture)


def panorama_view(name: str, panorama: Panorama) -> View:
    """A panorama of a fixed context."""
    line, picture = panorama_line(panorama), panorama_picture(panorama)
    return View(name, "Panorama", panorama.frame_index, 0, WIDTH, line, picture)


def view_parts(views: Sequence[View]) -> list[Part]:
    """Each picture behind the line that numbers, names and places it."""
    parts: list[Part] = []
    for number, view in enumerate(views, 1):
        parts += [f"{view.kind} {number}, observation {view.name}: {view.line}", view.picture]
    return parts


@dataclass(frozen=True)
class Turn:
    """What has changed since the last turn, and what is left.

    results: of the last turn's calls; fresh: the pictures that they made; looks, calls: made and left.
    """

    results: Sequence[str]
    fresh: Sequence[View]
    error: str
    looks: tuple[int, int]
    calls: tuple[int, int]

    def result_lines(self) -> str:
        """The results as numbered lines."""
        lines = [f"{number}. {result}" for number, result in enumerate(self.results, 1)]
        return "\n".join(["Results of your last calls:", *(lines or ["none"])])

    def state(self) -> str:
        """The lines that close every turn."""
        error = f"Your last turn was malformed, and a second such turn ends the question: {self.error}"
        return render(
            "agent_state",
            looks=self.looks[0],
            looks_left=self.looks[1],
            calls=self.calls[0],
            calls_left=self.calls[1],
            error=error if self.error else "",
        )


LOOK_SCHEMA: Final = call_schema("observe", {"frame_id": decode.FRAME_ID_SCHEMA, "angle_deg": {"type": "number"}})


class Memory(Protocol):
    """What a variant remembers by. `step` is the place of the turn's model call in the transcript."""

    @property
    def tools(self) -> Sequence[str]:
        """The tools that there are besides `observe`."""
        ...

    def schema(self, looks: Mapping[str, Any] | None) -> dict[str, Any]:
        """The JSON Schema of a turn; `looks` is that of a look, where there are looks."""
        ...

    def messages(self, turn: Turn) -> list[Message]:
        """What the model is sent."""
        ...

    def replied(self, reply: Reply) -> None:
        """Told what the model said."""
        ...

    def named(self, seen: Observation | Panorama, step: int) -> str:
        """The name of an observation that has been made."""
        ...

    def refused(self, call: Call, step: int, reason: str) -> None:
        """Told of a call that is refused outside of `carry_out`, or for which that raises DecodeError."""
        ...

    def carry_out(self, call: Call, views: Mapping[str, View], step: int) -> str:
        """Carry out a call but a look or a final answer; its result. Raises DecodeError where it is refused unseen."""
        ...

    def judge(self, call: Call, views: Mapping[str, View], step: int) -> Verdict:
        """The prediction that a legal final answer makes. Raises DecodeError where it is not legal."""
        ...

    def solved(self, reason: str) -> Verdict:
        """The prediction at the end of an episode that `reason` ended without a legal final answer."""
        ...


@dataclass
class Episode:
    """The loop over one question."""

    attempt: Attempt
    memory: Memory
    looking: bool
    limits: Limits = LIMITS
    views: dict[str, View] = field(default_factory=dict)
    made: list[tuple[int, float]] = field(default_factory=list)
    used: int = 0
    strikes: int = 0

    def __post_init__(self) -> None:
        self.legal = frozenset(self.attempt.task.sequence.frames)

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
                    return self.attempt.ended(verdict)
            turn = self._turn(results, list(self.views.values())[before:], "")
        return self._ended(f"no legal final answer within {self.limits.calls} calls")

    def show(self, panoramas: Sequence[Panorama]) -> None:
        """Make panoramas the first observations."""
        for panorama in panoramas:
            name = self.memory.named(panorama, self.attempt.steps - 1)
            self.views[name] = panorama_view(name, panorama)

    def _tools(self) -> Collection[str]:
        return (*(("observe",) if self.looking else ()), *self.memory.tools)

    def _turn(self, results: Sequence[str], fresh: Sequence[View], error: str) -> Turn:
        looks = (len(self.made), self.limits.looks - len(self.made) if self.looking else 0)
        return Turn(results, fresh, error, looks, (self.used, self.limits.calls - self.used))

    def _call(self, call: Call, step: int, results: list[str]) -> Verdict | None:
        """Carry out or refuse one call; the verdict of a legal final answer."""
        self.used += 1
        started = time.perf_counter()
        verdict, said = None, "done"
        try:
            if call.fault:
                raise DecodeError(call.fault)
            if call.tool == "observe":
                said = self._look(call, step)
            elif call.tool == FINAL:
                verdict = self.memory.judge(call, self.views, step)
            else:
                said = self.memory.carry_out(call, self.views, step)
        except DecodeError as error:
            self.memory.refused(call, step, str(error))
            said = refusal(str(error))
        results.append(f"{call.tool}: {said}")
        self.attempt.record("tool", msgspec.Raw(call.said.encode()), said, started)
        return verdict

    def _look(self, call: Call, step: int) -> str:
        frame, angle = read_look(call.arguments, self.legal)
        if len(self.made) >= self.limits.looks:
            raise DecodeError("no looks are left")
        if reason := duplicate(self.made, frame, angle):
            self.attempt.refuse_look(frame, angle, reason)
            raise DecodeError(reason)
        observation = self.attempt.look(frame, angle)
        self.made.append((frame, angle))
        name = self.memory.named(observation, step)
        self.views[name] = crop_view(name, observation)
        return name

    def _ended(self, reason: str) -> Prediction:
        return self.attempt.ended(self.memory.solved(reason))
