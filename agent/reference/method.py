"""The reference agent as a method of the benchmark, in its four variants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from jrdb_avr.agent.beliefs.solver import BeliefSolver, beliefs_of
from jrdb_avr.agent.methods.attempt import Attempt, shared_settings
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.reference.chat_memory import ChatMemory
from jrdb_avr.agent.reference.episode import Episode, Memory
from jrdb_avr.agent.reference.graph_memory import GraphMemory
from jrdb_avr.agent.reference.limits import LIMITS, Limits
from jrdb_avr.agent.reference.planning import make_plan
from jrdb_avr.agent.reference.prompts import system_prompt, task_heading
from jrdb_avr.schema.method import Prediction, Question, Task

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.world_model import World


@dataclass(frozen=True)
class ReferenceAgent:
    """looks: whether it chooses where to look, or is shown panoramas; remembers: whether it has a plan and a world
    model, `world`, or a chat history in their place.
    """

    chat: Chat
    convention: Convention = CONTRACT
    world: World | None = None
    looks: bool = True
    limits: Limits = LIMITS
    solving: Callable[[World, Question], BeliefSolver] = beliefs_of

    @property
    def remembers(self) -> bool:
        return self.world is not None

    @property
    def name(self) -> str:
        return "agent" + ("" if self.looks else "-passive") + ("" if self.remembers else "-no-world")

    def settings(self) -> dict[str, Any]:
        """What the manifest of a run says of the method."""
        return {
            "active_observation": self.looks,
            "world_model": self.remembers,
            **self.limits.settings(self.looks, self.remembers),
            **shared_settings(self.convention),
        }

    def answer(self, task: Task) -> Prediction:
        """Play one question, within `limits.model_calls` model calls."""
        attempt = Attempt(task, self.chat, self.convention)
        system = system_prompt(task, self.limits, self.looks, self.remembers)
        heading = task_heading(task, self.limits, self.looks)
        if self.world is None:
            return self._play(attempt, ChatMemory(attempt, system, heading))
        world, solver = self.world.episode(task.question, task.record_write), self.solving(self.world, task.question)
        with world.together():
            plan = make_plan(attempt, self.limits.repairs, solver.check, world)
            if isinstance(plan, str):
                return attempt.invalid(f"no plan was accepted; the last was refused: {plan}")
            return self._play(attempt, GraphMemory(attempt, world, solver, plan, system, heading, fixed=not self.looks))

    def _play(self, attempt: Attempt, memory: Memory) -> Prediction:
        episode = Episode(attempt, memory, self.looks, self.limits)
        if not self.looks:
            episode.show(attempt.panoramas(self.limits.panoramas))
        return episode.play()
