"""The texts of the tool turns: system messages of the variants, and the lines that open a task."""

from __future__ import annotations

from typing import Final

from jrdb_avr.agent.methods.attempt import heading, uniform_frames
from jrdb_avr.agent.model.prompts import frame_ranges, mode_text, render
from jrdb_avr.agent.reference.limits import Limits
from jrdb_avr.agent.reference.tool_calls import MOST_PER_TURN
from jrdb_avr.schema.labels import AGES, DISTANCE_WORDS, OTHER_ACTIONS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.method import Task

_LOOK_CALL: Final = '{"tool": "observe", "frame_id": "000150", "angle_deg": 210}'


def system_prompt(task: Task, limits: Limits, looks: bool, remembers: bool) -> str:
    """The system message of a variant's tool turns."""
    text = mode_text(task.question.answer_mode, task.sequence.frame_count)
    shared = {
        "looking": render("agent_look")
        if looks
        else render("agent_panoramas", panoramas=len(uniform_frames(task.sequence.frames, limits.panoramas))),
        "observe": render("agent_observe") + "\n" if looks else "",
        "fps": f"{task.sequence.fps:g}",
        "most": MOST_PER_TURN,
        "answer_form": text.form,
        "answer_rule": text.rule,
        "budget": _budget(limits, looks),
    }
    if not remembers:
        return render("agent_chat", call=_LOOK_CALL if looks else _final(text.form), **shared)
    return render(
        "agent_world",
        poses=", ".join(POSES),
        actions=", ".join(OTHER_ACTIONS),
        ages=", ".join(AGES),
        sectors=", ".join(ROBOT_SECTORS),
        distances=", ".join(DISTANCE_WORDS),
        **shared,
    )


def _final(form: str) -> str:
    return f'{{"tool": "final_answer", "answer": {form}, "observation": "o1", "box": [410, 230, 590, 700]}}'


def _budget(limits: Limits, looks: bool) -> str:
    looking = f"{limits.looks} looks and " if looks else ""
    return f"You may make {looking}{limits.calls} calls in all, a refused call included."


def task_heading(task: Task, limits: Limits, looks: bool) -> str:
    """The lines that open every task. Legal frames are those that can be looked at, or have been."""
    frames = task.sequence.frames
    text = mode_text(task.question.answer_mode, task.sequence.frame_count)
    return render(
        "agent_task",
        heading=heading(task.question),
        frames=frame_ranges(frames if looks else uniform_frames(frames, limits.panoramas)),
        advice=text.advice,
    )
