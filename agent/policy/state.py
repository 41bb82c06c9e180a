"""State of one question while a policy works on it: the plan, what was seen, and what could not be read."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from jrdb_avr.agent.policy.explorer import BudgetExhausted, Explorer
from jrdb_avr.schema.labels import answer_of_choice
from jrdb_avr.schema.plan import Condition, Plan

_CLOSE_FRAMES: Final = 28
"""A search for a moment ends when it is known to this many frames: half of them is within a second."""


@dataclass
class EpisodeState:
    """One question: its plan and choices, what has been seen, and notes of what could not be read.

    `beside`: whether a look a second away may stand for one in which somebody is hidden. `misses` counts the tries of
    a search in time since the person was last seen. `close` is the number of frames to which a moment is to be known.
    """

    plan: Plan
    choices: Sequence[str]
    explorer: Explorer
    missing: list[str] = field(default_factory=list)
    beside: bool = False
    misses: int = 0
    close: int = _CLOSE_FRAMES

    def frame_of(self, name: str) -> int:
        """A stated time's frame."""
        frame = self.plan.times[name].frame
        assert frame is not None, "reads use stated times only"
        return frame

    @property
    def t0(self) -> int:
        """The frame of the description: the first that is stated."""
        return min(time.frame for time in self.plan.times.values() if time.frame is not None)

    @property
    def description(self) -> tuple[Condition, ...]:
        """The conditions of the described person."""
        return next(node.conditions for node in self.plan.nodes if node.id == self.plan.root)

    def note_unseen(self) -> None:
        """Note which stated times no picture shows, where pictures cannot be chosen."""
        for name, time in sorted(self.plan.times.items()):
            if time.frame is not None and self.explorer.legal(time.frame) != time.frame:
                self.note(f"not shown: {name}")

    def note(self, reason: str) -> None:
        """Add a reason why something could not be read, each one once; "" is none."""
        if reason and reason not in self.missing:
            self.missing.append(reason)

    @contextlib.contextmanager
    def budget(self, lack: str) -> Iterator[None]:
        """End a `with` block where looks run out, and note what that leaves undone."""
        try:
            yield
        except BudgetExhausted:
            self.note(f"budget: {lack}")

    @property
    def offered(self) -> list[str]:
        """The answers that the choices say."""
        return [answer_of_choice(choice) for choice in self.choices]

    def choose(self, text: str | None, wrong: Collection[str | None] = ()) -> int:
        """The number of the choice that says this, else of the first that is not known to be wrong."""
        if text in self.offered:
            return self.offered.index(text) + 1
        return next((n for n, answer in enumerate(self.offered, 1) if answer not in wrong), 1)
