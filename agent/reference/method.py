"""The reference agent as a method of the benchmark, in its four variants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.methods.requests import heading, history_settings, shared_settings, uniform_frames
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.prompts import frame_ranges, mode_text, render
from jrdb_avr.agent.perceive.fields import MOST_PEOPLE, fields_of, perceivable
from jrdb_avr.agent.reference.chat_memory import ChatMemory
from jrdb_avr.agent.reference.loop import LIMITS, AgentLoop, Limits, Memory
from jrdb_avr.agent.reference.planning import make_plan
from jrdb_avr.agent.reference.turns import MOST_CALLS
from jrdb_avr.agent.reference.world_memory import WorldMemory, world_heading
from jrdb_avr.schema.method import Prediction, Task

if TYPE_CHECKING:
    from jrdb_avr.agent.world.episode import WorldModel


@dataclass(frozen=True)
class ReferenceAgent:
    """The reference agent. The variant follows from `world` and `looks`.

    world: the world model of the run. None makes the variant without plan and world model, with a chat as its memory.
    looks: whether the agent looks. If not, it gets panoramas. advice: whether turns advise looks. history: number of
    newest pictures that a chat sends, None for all.
    """

    chat: Chat
    convention: Convention = CONTRACT
    world: WorldModel | None = None
    looks: bool = True
    limits: Limits = LIMITS
    advice: bool = True
    history: int | None = None

    @property
    def name(self) -> str:
        """The name of the variant."""
        return "agent" + ("" if self.looks else "-passive") + ("" if self.world else "-no-world")

    def settings(self) -> dict[str, Any]:
        """Return the method's settings for a run's manifest."""
        remembers = self.world is not None
        variant: dict[str, Any] = {"active_observation": self.looks, "world_model": remembers}
        if remembers:
            variant |= {"people_per_call": MOST_PEOPLE, **({"advice": self.advice} if self.looks else {})}
        else:
            variant |= history_settings(self.history)
        return variant | self.limits.settings(self.looks, remembers) | shared_settings(self.convention)

    def answer(self, task: Task) -> Prediction:
        """Play a question.

        Args:
            task: The question to answer.

        Returns:
            The prediction.
        """
        attempt = Attempt(task, self.chat, self.convention)
        loop = AgentLoop(attempt, self._memory(attempt), self.looks, self.limits)
        if not self.looks:
            loop.show(attempt.panoramas(self.limits.panoramas))
        return loop.play()

    def _memory(self, attempt: Attempt) -> Memory:
        task = attempt.task
        advice = self.advice and self.looks and self.world is not None
        heading = task_heading(task, self.limits, self.looks, advised=advice)
        system = system_prompt(task, self.limits, self.looks, remembers=self.world is not None, advice=advice)
        if self.world is None:
            return ChatMemory(attempt, system, heading, self.history)
        episode = self.world.episode(task.question, task.record_write)
        plan = perceivable(make_plan(attempt, self.limits.repairs, episode))
        fields = fields_of(plan, task.question.choices)
        heading = world_heading(heading, plan, fields)
        return WorldMemory(attempt, episode, fields, system, heading, advice, fixed=not self.looks)


# -- texts of the turns -----------------------------------------------------------------------------------------------


def system_prompt(task: Task, limits: Limits, looks: bool, remembers: bool, advice: bool = True) -> str:
    """Return the system message of a variant's turns.

    Args:
        task: The question.
        limits: The limits of a question.
        looks: Whether the variant looks.
        remembers: Whether the variant has a world model.
        advice: Whether turns advise looks.

    Returns:
        The text.
    """
    text = mode_text(task)
    panoramas = len(uniform_frames(task.sequence.frames, limits.panoramas))
    looking = render("agent_look" if looks else "agent_panoramas", panoramas=panoramas)
    if advice:
        looking = "A look is a square picture, 46 degrees wide, of one frame."
    observe = ("agent_observe_advised" if advice and remembers else "agent_observe") if looks else ""
    shared = {
        "looking": looking,
        "observe": render(observe) + "\n" if observe else "",
        "fps": f"{task.sequence.fps:g}",
        "most": MOST_CALLS,
        "answer_form": text.form,
        "answer_rule": text.rule,
        "budget": (f"{limits.looks} looks and " if looks else "") + f"{limits.turns} turns",
    }
    if not remembers:
        call = render("agent_call_observe" if looks else "agent_call_final", answer_form=text.form)
        return render("agent_chat", call=call, **shared)
    call = '{"tool": "observe"}' if advice and looks else '{"tool": "get_graph"}'
    return render("agent_world", call=call, people=MOST_PEOPLE, **shared)


def task_heading(task: Task, limits: Limits, looks: bool, advised: bool = False) -> str:
    """Return the lines that begin each question.

    Args:
        task: The question.
        limits: The limits of a question.
        looks: Whether the variant looks. If not, the legal frames are the frames of the panoramas.
        advised: Whether turns advise looks. Then the first and the last legal frame stand for all, to save tokens.

    Returns:
        The question, its choices and the legal frames.
    """
    frames = task.sequence.frames if looks else uniform_frames(task.sequence.frames, limits.panoramas)
    legal = f"{frames[0]:06d} to {frames[-1]:06d}" if advised and frames else frame_ranges(frames)
    return render("agent_task", heading=heading(task.question), frames=legal)
