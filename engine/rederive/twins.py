"""Time twins: two questions that differ in one asked time and in their answers."""

from __future__ import annotations

from msgspec.structs import replace

from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import QuestionRecord
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.wording.text import stated_frames


def compare_twins(first: QuestionRecord, second: QuestionRecord, rules: Rules) -> str | None:
    """Find out why two questions are no time twins.

    Both have equal choices and one true choice. So each answer is false in the other question if the answers differ.

    Args:
        first: Question with a valid plan.
        second: Another question with a valid plan.
        rules: Rules of the questions.

    Returns:
        The first reason, or None if the questions are time twins.
    """
    for column in ("sequence", "template", "target_track", "choices"):
        if getattr(first, column) != getattr(second, column):
            return f"differ in {column}"
    plan, moved = parse_plan(first.plan), parse_plan(second.plan)
    asked = {name: moved.times[name] for name in moved.answer.times}
    if moved != replace(plan, times=plan.times | asked):
        return "differ in more of the plan than the times asked"
    near = frames(rules.near_presence_s if first.template == "presence" else rules.near_duplicate_s)
    apart = [abs(a - b) for a, b in zip(stated_frames(plan), stated_frames(moved), strict=False) if a != b]
    if len(apart) != 1 or apart[0] <= near:
        return "do not differ in exactly one time asked, by more than near-duplicates"
    return "have the same answer" if first.answer == second.answer else None
