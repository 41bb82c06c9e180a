"""The reference agent as a method of the benchmark, in its four variants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from jrdb_avr.agent.beliefs.solver import BeliefSolver, beliefs_of
from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.methods.requests import heading, history_settings, shared_settings, uniform_frames
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.prompts import frame_ranges, mode_text, render
from jrdb_avr.agent.reference.belief_writer import BeliefWriter
from jrdb_avr.agent.reference.chat_memory import ChatMemory
from jrdb_avr.agent.reference.driven import DrivenEpisode
from jrdb_avr.agent.reference.episode import LIMITS, AgentEpisode, Limits, Memory
from jrdb_avr.agent.reference.graph_memory import GraphMemory
from jrdb_avr.agent.perceive.fields import MOST_PEOPLE, perceivable
from jrdb_avr.agent.reference.planning import make_plan
from jrdb_avr.agent.reference.tool_calls import MOST_PER_TURN
from jrdb_avr.queries.compiler.believed import find_believed
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import AGES, DISTANCE_WORDS, OTHER_ACTIONS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.method import Prediction, Question, Task

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.world_model import WorldModel

Policy = Literal["model", "guided", "driven"]
"""Who chooses the looks: the model, the model among the best that the harness finds, or the harness."""


@dataclass(frozen=True)
class ReferenceAgent:
    """The reference agent: a plan, looks or panoramas, and an answer from a world model or without one.

    looks: whether it looks, or is sent panoramas; world: None without a world model; policy: who chooses the looks
    (`make_method` passes "driven" where an agent looks); history: how many of the newest pictures a chat holds, None
    for all. Raises InputError for a harness that has no looks to choose.
    """

    chat: Chat
    convention: Convention = CONTRACT
    world: WorldModel | None = None
    looks: bool = True
    limits: Limits = LIMITS
    solving: Callable[[WorldModel, Question], BeliefSolver] = beliefs_of
    policy: Policy = "model"
    history: int | None = None

    def __post_init__(self) -> None:
        if self.driven and not self.looks:
            raise InputError(f"policy {self.policy!r}: a passive agent has no looks to choose", field="policy")

    @property
    def driven(self) -> bool:
        """Whether the harness finds the looks."""
        return self.policy != "model"

    @property
    def remembers(self) -> bool:
        return self.world is not None

    @property
    def name(self) -> str:
        return "agent" + ("" if self.looks else "-passive") + ("" if self.remembers else "-no-world")

    def settings(self) -> dict[str, Any]:
        """What the manifest of a run says of the method."""
        variant = {"active_observation": self.looks, "world_model": self.remembers, "policy": self.policy}
        if self.driven:
            budgets = {"looks": self.limits.looks, "repairs": self.limits.repairs, "people": MOST_PEOPLE}
            return variant | budgets | shared_settings(self.convention)
        variant |= history_settings(self.history)
        return variant | self.limits.settings(self.looks, self.remembers) | shared_settings(self.convention)

    def answer(self, task: Task) -> Prediction:
        """Play one question.

        Under the policy `model` within `limits.model_calls` model calls; else with the plan's tries and at most four
        calls for each look, two more where the model picks it.
        """
        attempt = Attempt(task, self.chat, self.convention)
        if self.driven:
            return self._drive(attempt)
        system = system_prompt(task, self.limits, self.looks, self.remembers)
        heading = task_heading(task, self.limits, self.looks)
        if self.world is None:
            return self._play(attempt, ChatMemory(attempt, system, heading, self.history))
        world, solver = self.world.episode(task.question, task.record_write), self.solving(self.world, task.question)
        with world.together():
            plan = make_plan(attempt, self.limits.repairs, solver.check, world)
            return self._play(attempt, GraphMemory(attempt, world, solver, plan, system, heading, fixed=not self.looks))

    def _drive(self, attempt: Attempt) -> Prediction:
        guided = self.policy == "guided"
        if self.world is None:
            plan = make_plan(attempt, self.limits.repairs, find_believed)
            return DrivenEpisode(attempt, perceivable(plan), self.limits.looks, guided=guided).play()
        world = self.world.episode(attempt.task.question, attempt.task.record_write)
        solver = self.solving(self.world, attempt.task.question)
        with world.together():
            plan = make_plan(attempt, self.limits.repairs, solver.check, world)
            read = perceivable(plan)
            writer = BeliefWriter(world, solver, plan, read, attempt.task, {})
            return DrivenEpisode(attempt, read, self.limits.looks, writer, guided).play()

    def _play(self, attempt: Attempt, memory: Memory) -> Prediction:
        episode = AgentEpisode(attempt, memory, self.looks, self.limits)
        if not self.looks:
            episode.show(attempt.panoramas(self.limits.panoramas))
        return episode.play()


# -- texts of the tool turns ------------------------------------------------------------------------------------------


def system_prompt(task: Task, limits: Limits, looks: bool, remembers: bool) -> str:
    """The system message of a variant's tool turns."""
    text = mode_text(task)
    shared = {
        "looking": render("agent_look")
        if looks
        else render("agent_panoramas", panoramas=len(uniform_frames(task.sequence.frames, limits.panoramas))),
        "observe": render("agent_observe") + "\n" if looks else "",
        "fps": f"{task.sequence.fps:g}",
        "most": MOST_PER_TURN,
        "answer_form": text.form,
        "answer_rule": text.rule,
        "budget": render("agent_budget", looks=f"{limits.looks} looks and " if looks else "", calls=limits.calls),
    }
    if not remembers:
        call = render("agent_call_observe" if looks else "agent_call_final", answer_form=text.form)
        return render("agent_chat", call=call, **shared)
    return render(
        "agent_world",
        poses=", ".join(POSES),
        actions=", ".join(OTHER_ACTIONS),
        ages=", ".join(AGES),
        sectors=", ".join(ROBOT_SECTORS),
        distances=", ".join(DISTANCE_WORDS),
        **shared,
    )


def task_heading(task: Task, limits: Limits, looks: bool) -> str:
    """The lines that open every task. Legal frames are those that can be looked at, or have been."""
    frames = task.sequence.frames
    text = mode_text(task)
    return render(
        "agent_task",
        heading=heading(task.question),
        frames=frame_ranges(frames if looks else uniform_frames(frames, limits.panoramas)),
        advice=text.advice,
    )
