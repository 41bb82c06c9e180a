"""Questions of proven proposals: all proofs, the boxes that are needed, measures of difficulty, and choices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import msgspec
import numpy as np
from msgspec.structs import replace

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.asked import Question
from jrdb_avr.engine.generate.layer import Layer
from jrdb_avr.engine.generate.perturb import (
    NoAnswerError,
    Program,
    find_people,
    hops,
    make_program,
    match,
    run,
    shifts,
)
from jrdb_avr.engine.generate.propose import Proposal, Search
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.labels import choice_text
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import canonical
from jrdb_avr.schema.questions import NeededBox, Proof, QuestionRecord
from jrdb_avr.schema.rules import KEYFRAME_STEP, rules_hash
from jrdb_avr.schema.wording.text import question_id, render

Row = dict[str, Any]


def make_row(search: Search, proposal: Proposal, key: str, proofs: list[Proof]) -> Row:
    """Make the row of a question that lacks its choices.

    Args:
        search: Sequence of the proposal.
        proposal: Proven proposal.
        key: Key of the candidate.
        proofs: Its proofs about conditions, hops and times.

    Returns:
        The columns of the tables `questions` and `answers`, and those that `with_choices` reads.
    """
    layer, template, plan = search.layer, proposal.template, proposal.plan
    text = render(template.name, plan, proposal.key, layer.action_step == KEYFRAME_STEP)
    needed, times, begin = needed_boxes(layer, proposal), _times(layer, proposal), proposal.frames["t0"]
    angles = {box.frame: layer.boxes[box.track, box.frame]["angle"] for box in needed if box.node == template.target}
    decisive = [angles[box.frame] for box in needed if box.node == template.target and box.decisive]
    record = QuestionRecord(
        question_id="",
        sequence=proposal.sequence,
        family=template.family,
        template=template.name,
        question=text,
        choices=(),
        answer_mode=plan.answer.mode,
        answer=proposal.answer,
        target_track=proposal.target,
        plan=canonical(plan),
        proofs=_all_proofs(search, proposal, proofs, needed),
        distractors=(),
        rules=rules_hash(search.rules),
        hops=len(template.edges),
        time_gap_s=(max(times.values()) - begin) / layer.fps,
        separation_deg=float(np.max(angle_error(np.array(decisive), angles[begin]))),
        people_in_scene=len(layer.facts.people[begin]),
        bindings={**proposal.people, **dict(sorted(times.items()))},
        needed=needed,
    )
    mistakes = dict(reversed(list(_mistakes(search, proposal)))) if template.answer is None else {}
    return record.columns() | {"key": key, "mistakes": msgspec.json.encode(mistakes).decode()}


def with_choices(row: Row, question: Question) -> Row:
    """Add its choices to the row of a question.

    Args:
        row: Row of `make_row`.
        question: The selected question.

    Returns:
        The row with choices, answer, distractors and id.
    """
    row = dict(row)
    if question.wrong:
        labels, mistakes = question.choices, msgspec.json.decode(row["mistakes"])
        truth = labels.index(question.candidate.truth)
        row["choices"] = [choice_text(label) for label in labels]
        row["answer"] = encode_answer(Choice(truth + 1))
        names = [None if place == truth else mistakes.get(label) for place, label in enumerate(labels)]
        row["distractors"] = msgspec.json.encode(names).decode()
    row["question_id"] = question_id(**{name: row[name] for name in _PUBLIC})
    return row


_PUBLIC: Final = ("sequence", "family", "template", "question", "choices", "answer_mode")


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


# -- mistakes ---------------------------------------------------------------------------------------------------------


def _mistakes(search: Search, proposal: Proposal) -> Iterator[tuple[str, str]]:
    """Yield the answers of changed programs, each with the name of the change, the most telling first."""
    template, facts = proposal.template, search.layer.facts
    program = make_program(proposal.sequence, proposal.plan, template)
    if program.read == "next_action":
        return
    for kind in ("hop.stop", "hop.skip"):
        # The people nearest to the target on the path come first.
        for name, variant, hopped in reversed(list(hops(replace(program, held=proposal.people["a"])))):
            if name == kind:
                yield from _named(search, hopped, f"{kind}({variant})")
    if program.read == "action" and program.times[0] != program.frame:
        yield from _named(search, replace(program, times=(program.frame,)), "description's time")
    for variant, shifted in shifts(program, facts.keyframes, search.rules):
        if shifted is not None:
            yield from _named(search, shifted, f"time.shift {variant}")
    if template.joins:
        return
    for condition in proposal.conditions:
        left = replace(program, conditions=tuple(one for one in proposal.conditions if one is not condition))
        for who in sorted(match(left, facts).could - {proposal.people["a"]}):
            yield from _named(search, replace(program, held=who), f"look-alike without {condition.words}")


def _named(search: Search, program: Program, name: str) -> Iterator[tuple[str, str]]:
    """Yield the answers of a program with the name."""
    facts = search.layer.facts
    if not facts.keyframe_set.issuperset((program.frame, *program.times)):
        return
    try:
        if program.read != "action":
            yield str(run(program, facts, search.rules)), name
            return
        target = find_people(program, facts)[program.target]
    except NoAnswerError:
        return
    labels = facts.labels(target, program.times[0])
    yield from ((label, name) for label in sorted(labels.certain if labels else ()))
