"""The plan stage: what a model is shown, and what its plan must keep to before anything is looked at."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from jrdb_avr.agent.methods.attempt import Attempt, heading
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.model.prompts import frame_ranges, render
from jrdb_avr.agent.reference.labels import check_labels, vocabulary
from jrdb_avr.agent.reference.tool_calls import one_line, printable
from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.method import Task
from jrdb_avr.schema.plan import Plan, canonical, parse_plan, plan_json_schema

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.world_model import Episode as WorldEpisode

LONGEST_SHOWN: Final = 4000
"""Characters of a refused plan that are shown again."""

MOST_ASKED: Final = 32
"""Conditions and edges of a plan: a question's has a dozen, and the engine's work grows with them."""


def make_plan(attempt: Attempt, repairs: int, check: Callable[[Plan], None], episode: WorldEpisode) -> Plan | str:
    """The model's plan for the question, or why the last of `1 + repairs` tries was refused.

    Each try is one model call, which is shown the plan before it and what was wrong with that one. `check` raises
    PlanError for a plan that the solver cannot run. The episode keeps every try.
    """
    task = attempt.task
    system, schema = plan_prompt(task), plan_form()
    refusal, text = "", ""
    for _ in range(1 + repairs):
        user = render(
            "agent_plan_task",
            heading=heading(task.question),
            frames=frame_ranges(task.sequence.frames),
            refusal=f"Your last plan: {text}\nYour plan was refused: {refusal}" if refusal else "",
        )
        reply = attempt.ask([Message("system", (system,)), Message("user", (user,))], schema)
        step, started = attempt.steps - 1, time.perf_counter()
        given: dict[str, Any] = {}
        text = printable(attempt.raw)
        try:
            given = decode.reply_object(reply, attempt.convention)
            text = one_line(given)
            plan = read_plan(text, task)
            check(plan)
        except (DecodeError, PlanError) as error:
            refusal = printable(str(error))
            episode.refused("plan", given if len(text) <= LONGEST_SHOWN else {}, refusal, step)
            attempt.record("tool", {"tool": "plan"}, {"refused": refusal}, started)
            text = text[:LONGEST_SHOWN]
        else:
            episode.plan(plan, step)
            attempt.record("tool", {"tool": "plan"}, {"accepted": canonical(plan)}, started)
            return plan
    return refusal


def read_plan(text: str, task: Task) -> Plan:
    """The plan of a JSON text, fit for the question. Raises PlanError naming the field.

    Beyond `schema.plan.validate`: its mode is the question's, its labels are known, its frames lie in the sequence.
    """
    plan = parse_plan(text)
    mode, frame_count = task.question.answer_mode, task.sequence.frame_count
    if plan.answer.mode != mode:
        raise PlanError("answer.mode", f"the question asks for {mode!r}, not {plan.answer.mode!r}")
    for name, moment in plan.times.items():
        if moment.frame is not None and moment.frame >= frame_count:
            raise PlanError(f"times.{name}.frame", f"the last frame of the video is {frame_count - 1}")
    if plan.answer.of != plan.target:
        raise PlanError("answer.of", f"the answer is read of the target, {plan.target!r}")
    asked = sum(len(node.conditions) for node in plan.nodes) + len(plan.edges)
    if asked > MOST_ASKED:
        raise PlanError("plan", f"at most {MOST_ASKED} conditions and edges are taken, not {asked}")
    check_labels(plan)
    return plan


def plan_prompt(task: Task) -> str:
    """The system message of the plan stage."""
    mode = task.question.answer_mode
    return render(
        "agent_plan",
        fps=f"{task.sequence.fps:g}",
        mode=mode,
        reads=render(f"agent_reads_{mode}"),
        vocabulary=vocabulary(),
        schema=json.dumps(plan_form(), separators=(",", ":")),
    )


@cache
def plan_form() -> dict[str, Any]:
    """The plan's JSON Schema, without prose, and with keys left out where the full one allows null."""
    form: dict[str, Any] = _plain(plan_json_schema())
    return form


def _plain(node: Any) -> Any:
    if isinstance(node, list):
        return [_plain(entry) for entry in node]
    if not isinstance(node, dict):
        return node
    kept = {key: _plain(value) for key, value in node.items() if key not in _LEFT_OUT}
    either = kept.pop("anyOf", None)
    if either is not None:
        named = [option for option in either if option != {"type": "null"}]
        kept |= {"anyOf": named} if len(named) > 1 else named[0]
    return kept


_LEFT_OUT: Final = frozenset({"title", "description", "default", "propertyNames", "minLength", "maxLength"})
