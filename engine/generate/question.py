"""Questions of proven proposals: choices, all proofs, the boxes that are needed, and measures of difficulty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import msgspec
import numpy as np
from msgspec.structs import replace

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.distractors import Choices, arrange, pose_sets
from jrdb_avr.engine.generate.layer import Layer
from jrdb_avr.engine.generate.perturb import NoAnswerError, Program, make_program, match, run
from jrdb_avr.engine.generate.propose import Proposal, Search
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import canonical
from jrdb_avr.schema.questions import NeededBox, Proof, QuestionRecord
from jrdb_avr.schema.relations import QUESTION_RELATIONS
from jrdb_avr.schema.rules import KEYFRAME_STEP, rules_hash
from jrdb_avr.schema.wording.text import question_id, render, stated_actions

_EVENTS: Final = ("start", "span", "start_view")
"""Reads of which only one question may be about one start."""


def make_row(search: Search, proposal: Proposal, proofs: list[Proof]) -> dict[str, Any] | None:
    """Make the row of the pool for a proven proposal.

    Args:
        search: Sequence of the proposal.
        proposal: Proven proposal.
        proofs: Its proofs about conditions, hops and times.

    Returns:
        The row, in the columns of `selection.POOL`, or None if fewer than three answers are certainly wrong.
    """
    sets = _choice_sets(search, proposal, proofs)
    if not sets:
        return None
    record = make_record(search, proposal, proofs, sets[0])
    template, frames = proposal.template, proposal.frames
    row: dict[str, Any] = {"key": proposal.key, "form": template.query, "answer_text": proposal.answer}
    row |= {"stated": list(stated_actions(proposal.plan)), "times": [frames[name] for name in template.stated]}
    row |= {"read_frames": list(proposal.read), "event": _event(search, proposal)}
    row["sets"] = [msgspec.json.encode(choices).decode() for choices in sets if choices.texts]
    return record.columns() | row


def _event(search: Search, proposal: Proposal) -> str | None:
    """Return the start of an action, or the count of people, that a question is about."""
    template = proposal.template
    if template.counts:
        return f"count {QUESTION_RELATIONS.index(proposal.relations[0])} {proposal.frames['t1']}"
    number = proposal.segments[0] - min(search.layer.segments) if template.spec.read in _EVENTS else None
    return None if number is None else f"start {number}"


def make_record(search: Search, proposal: Proposal, proofs: list[Proof], choices: Choices) -> QuestionRecord:
    """Make the record of a question.

    Args:
        search: Sequence of the proposal.
        proposal: Proven proposal.
        proofs: Its proofs about conditions, hops and times.
        choices: Choices of the question, without texts if the answer is not a choice.

    Returns:
        The record.
    """
    layer, template, plan = search.layer, proposal.template, proposal.plan
    text = render(template.name, plan, proposal.key, layer.action_step == KEYFRAME_STEP, layer.facts.judges_views)
    public: dict[str, Any] = {"sequence": proposal.sequence, "family": template.family, "template": template.name}
    public |= {"question": text, "choices": choices.texts, "answer_mode": plan.answer.mode}
    needed, times, begin = needed_boxes(layer, proposal), _times(layer, proposal), proposal.frames["t0"]
    angles = {box.frame: layer.boxes[box.track, box.frame]["angle"] for box in needed if box.node == template.target}
    decisive = [angles[box.frame] for box in needed if box.node == template.target and box.decisive]
    return QuestionRecord(
        question_id=question_id(**public),
        **public,
        answer=encode_answer(Choice(choices.true)) if choices.true else proposal.answer,
        target_track=proposal.target,
        plan=canonical(plan),
        proofs=_all_proofs(search, proposal, proofs, needed),
        distractors=choices.perturbations,
        rules=rules_hash(search.rules),
        hops=len(template.edges),
        time_gap_s=(max(times.values()) - begin) / layer.fps,
        separation_deg=float(np.max(angle_error(np.array(decisive), angles[begin]))),
        people_in_scene=len(layer.facts.people[begin]),
        bindings={**proposal.people, **dict(sorted(times.items()))},
        needed=needed,
    )


def _times(layer: Layer, proposal: Proposal) -> dict[str, int]:
    """Return the frame of every time in the plan, by name."""
    template, frames = proposal.template, proposal.frames
    times = {name: frames[name] for name in template.stated}
    times |= {time: frames[name] for time, name in zip(template.events, template.read, strict=False)}
    if template.spec.read == "next_action":
        # What ends is the posture held until the last keyframe before the next one starts.
        times["t1"] = max(frame for frame in layer.facts.keyframes if frame < frames["first"])
    return times


def needed_boxes(layer: Layer, proposal: Proposal) -> tuple[NeededBox, ...]:
    """Return the boxes that a question needs.

    Args:
        layer: Layer of the sequence.
        proposal: Proposal.

    Returns:
        Everybody's box at t0, then the boxes of the target in which the answer is read, by node and frame. Each counted
        person has one box, as nodes b1, b2, ... by track, and the target has one in the same frame.
    """
    template, frames = proposal.template, proposal.frames
    boxes = []
    for node, track in proposal.people.items():
        decisive, shown = set(), {frames["t0"]}
        if node == template.target:
            there = {frames[name] for name in template.decisive if (track, frames[name]) in layer.boxes}
            decisive = there or {frames["t0"]}
            shown |= decisive | {frame for _, frame in proposal.counted}
        boxes += [_needed(layer, node, track, frame, frame in decisive) for frame in sorted(shown)]
    counted = enumerate(proposal.counted, start=1)
    return (*boxes, *(_needed(layer, f"b{number}", track, frame, False) for number, (track, frame) in counted))


def _needed(layer: Layer, node: str, track: int, frame: int, decisive: bool) -> NeededBox:
    sides = {side: layer.boxes[track, frame][side] for side in "xywh"}
    return NeededBox(node, track, frame, **sides, decisive=decisive)


def _all_proofs(
    search: Search, proposal: Proposal, proofs: list[Proof], needed: tuple[NeededBox, ...]
) -> tuple[Proof, ...]:
    """Return all proofs in the order in which questions store them."""
    own = proposal.answer
    x, w = np.array([box.x for box in needed]), np.array([box.w for box in needed])
    single = bool(views.single_view(x, w, search.rules.visible_share))
    return (
        Proof("anchor", "match", True, "same", own),
        *(proof for proof in proofs if proof.kind == "anchor"),
        Proof("evidence", "clear views", True, "same", own),
        *(proof for proof in proofs if proof.kind != "anchor"),
        # A method that sees only the forward view, without the decisive boxes, has nothing to answer from.
        Proof("view.ahead", "180", True, "empty"),
        Proof("view.single", "any angle", not single, "same" if single else "empty", own if single else None),
        # The second program confirms each question that is chosen.
        Proof("rederive", "annotations", True, "same", own),
    )


# -- choices ----------------------------------------------------------------------------------------------------------


def _choice_sets(search: Search, proposal: Proposal, proofs: list[Proof]) -> tuple[Choices, ...]:
    """Return the sets of choices that a question may have: one without choices if its answer is not a choice."""
    template, truth = proposal.template, proposal.answer
    if template.answer is not None:
        return (Choices((), 0, ()),)
    sets: tuple[tuple[str, ...], ...] = (PRESENCE_ANSWERS if truth in PRESENCE_ANSWERS else DISTANCE_ANSWERS,)
    if template.pose_answer:
        barred: set[str] = {pose for pose in POSES if pose in stated_actions(proposal.plan)}
        frame = proposal.frames[template.decisive[-1]]
        doubtful = search.layer.doubtful.get(proposal.target, [])
        barred |= {pose for pose, first, last in doubtful if first <= frame <= last} - {truth}
        sets = pose_sets(truth, frozenset(barred))
    return arrange(sets, truth, proposal.key, _mistakes(search, proposal, proofs))


def _mistakes(search: Search, proposal: Proposal, proofs: list[Proof]) -> Iterator[tuple[str, str]]:
    """Yield the answer and the name of every perturbed program that has an answer, the most telling first."""
    template, facts = proposal.template, search.layer.facts
    answers = [(proof.kind, proof.variant, proof.answer) for proof in proofs if proof.answer is not None]
    for hop in ("hop.stop", "hop.skip"):
        # The people nearest to the target on the path come first.
        for kind, variant, answer in reversed(answers):
            if kind == hop:
                yield answer, f"{kind}({variant})"
    if template.pose_answer and template.read != ("t0",):
        own = facts.pose(proposal.target, proposal.frames["t0"])
        if own is not None:
            yield own, "pose at t0"
    for kind, variant, answer in answers:
        if kind == "time.shift":
            yield answer, f"time.shift {variant}"
    if not template.joins:
        yield from _look_alikes(search, proposal)


def _look_alikes(search: Search, proposal: Proposal) -> Iterator[tuple[str, str]]:
    """Yield the answers of the people whom a description may mean if one condition is left out."""
    facts = search.layer.facts
    program = make_program(proposal.sequence, proposal.plan, proposal.template)
    for condition in proposal.conditions:
        left = replace(program, conditions=tuple(one for one in proposal.conditions if one is not condition))
        for who in sorted(match(left, facts).could - {proposal.people["a"]}):
            if (answer := _answer_of(search, replace(program, held=who))) is not None:
                yield answer, f"look-alike without {condition.words}"


def _answer_of(search: Search, program: Program) -> str | None:
    """Return the answer of a program, or None if there is none."""
    facts = search.layer.facts
    try:
        if program.read != "next_action":
            return str(run(program, facts, search.rules))
    except NoAnswerError:
        return None
    held = facts.pose(program.held or 0, program.frame)
    later = (facts.pose(program.held or 0, frame) for frame in facts.keyframes if frame > program.frame)
    return None if held is None else next((pose for pose in later if pose != held), None)


def rows_of(search: Search, proven: list[tuple[Proposal, list[Proof]]]) -> Iterator[Mapping[str, Any]]:
    """Yield the rows of the pool for proven proposals that have enough wrong answers."""
    for proposal, proofs in proven:
        if (row := make_row(search, proposal, proofs)) is not None:
            yield row
