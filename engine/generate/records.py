"""Make the record of a question: its choices and proofs, the boxes it needs, and measures of its difficulty.

The set-wise search decides for all candidates; records are made only for the few that passed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jrdb_avr.engine.generate.candidates import Candidates
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.distractors import Choices, make_choices
from jrdb_avr.engine.generate.proofs import stored_proofs
from jrdb_avr.engine.generate.scene import NOBODY
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.questions import NeededBox, Proof, QuestionRecord
from jrdb_avr.schema.rules import KEYFRAME_STEP, rules_hash
from jrdb_avr.schema.wording.text import question_id, render


def choice_sets(context: SearchContext, candidates: Candidates, line: Mapping[str, Any]) -> tuple[Choices, ...]:
    """The sets of choices that a candidate may have, by its row of `to_table`: one without choices where its answer is
    none."""
    if candidates.template.answer is not None:
        return (Choices((), 0, ()),)
    return make_choices(context, candidates, line["row"], line["key"])


def make_record(
    context: SearchContext,
    candidates: Candidates,
    line: Mapping[str, Any],
    plan: Plan,
    rederived: Proof,
    choices: Choices,
) -> QuestionRecord:
    """The record of one candidate that all set-wise rules passed, by its row of `to_table`, and its plan. `rederived`
    is the proof by the second program."""
    scene, template, row = context.scene, candidates.template, line["row"]
    text = render(line["template"], plan, line["key"], scene.action_step == KEYFRAME_STEP)
    public: dict[str, Any] = {name: line[name] for name in ("sequence", "family", "template")}
    public |= {"question": text, "choices": choices.texts, "answer_mode": plan.answer.mode}
    needed = needed_boxes(context, candidates, row)
    t0, times = int(candidates.frames["t0"][row]), _times(context, candidates, row)
    target = [box for box in needed if box.node == template.target]
    angles = {box.frame: scene.geometry["angle"][scene.box_of(box.track, box.frame)] for box in target}
    turns = angle_error(np.array([angles[box.frame] for box in target if box.decisive]), angles[t0])
    conditions = context.conditions
    keyframe = conditions.keyframe[context.descriptions.sighting[candidates.name[row]]]
    return QuestionRecord(
        question_id=question_id(**public),
        **public,
        answer=encode_answer(Choice(choices.true)) if choices.true else line["answer"],
        target_track=line["target_track"],
        plan=line["plan"],
        proofs=(*stored_proofs(context, candidates, row, line["answer"], needed), rederived),
        distractors=choices.perturbations,
        rules=rules_hash(context.rules),
        hops=len(template.edges),
        time_gap_s=(max(times.values()) - t0) / scene.fps,
        separation_deg=float(np.max(turns)),
        people_in_scene=int(conditions.people[keyframe]),
        bindings=bindings(context, candidates, row),
        needed=needed,
    )


def needed_boxes(context: SearchContext, candidates: Candidates, row: int) -> tuple[NeededBox, ...]:
    """Everybody's box at t0, and the target's where it is read, by node and frame; where it is absent there is none.

    Each counted person is needed once, as nodes b1, b2, ... by track, and the target with them.
    """
    scene, template = context.scene, candidates.template
    frames = {name: int(column[row]) for name, column in candidates.frames.items()}
    counted = candidates.people_counted(context, row)

    def box(node: str, track: int, frame: int, decisive: bool) -> NeededBox:
        line = scene.box_of(track, frame)
        sides = {side: scene.geometry[side].item(line) for side in "xywh"}
        return NeededBox(node, track, frame, **sides, decisive=decisive)

    boxes = []
    for node, track in _tracks(context, candidates, row).items():
        decisive: set[int] = set()
        seen = {frames["t0"]}
        if node == template.target:
            there = {frames[name] for name in template.decisive if scene.box_of(track, frames[name]) != NOBODY}
            decisive = there or {frames["t0"]}
            seen |= decisive | {frame for _, frame in counted}
        boxes += [box(node, track, frame, frame in decisive) for frame in sorted(seen)]
    return (*boxes, *(box(f"b{i}", track, frame, False) for i, (track, frame) in enumerate(counted, start=1)))


def bindings(context: SearchContext, candidates: Candidates, row: int) -> dict[str, int]:
    """Track of everybody in the plan, by node, and frame of every time, by name."""
    return _tracks(context, candidates, row) | dict(sorted(_times(context, candidates, row).items()))


def _tracks(context: SearchContext, candidates: Candidates, row: int) -> dict[str, int]:
    """Track of everybody in the plan, by node."""
    return {node: context.scene.track(int(moments[row])) for node, moments in candidates.people.items()}


def _times(context: SearchContext, candidates: Candidates, row: int) -> dict[str, int]:
    """Frame of every time in the plan, by name."""
    template, frames = candidates.template, candidates.frames
    times = {time: int(frames[time][row]) for time in template.stated}
    times |= {time: int(frames[name][row]) for time, name in zip(template.events, template.read, strict=False)}
    if template.spec.read == "next_action":
        # What ends is the pose held until the last keyframe before the next one starts.
        keyframes = context.scene.keyframes
        times["t1"] = int(keyframes[np.searchsorted(keyframes, frames["first"][row]) - 1])
    return times
