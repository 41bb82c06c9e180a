"""One stored question held against what it promises: choices, answer, plan, text, proofs and evidence.

A question is a row of `questions` with its private row of `answers`; what they claim of the scene is asked of the
annotation tables, by the second path.
"""

from __future__ import annotations

import re
from typing import Any, Final

import msgspec

from jrdb_avr.engine.generate.proofs import expected, failing
from jrdb_avr.engine.rederive import Annotations, NeededBox, rederive
from jrdb_avr.engine.validate.outcomes import Validation
from jrdb_avr.schema.answers import Answer, Choice, FrameAnswer, FrameViewpoint, Span, decode_answer, encode_answer
from jrdb_avr.schema.errors import AvrError
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan, canonical, parse_plan
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, rules_hash
from jrdb_avr.schema.templates import forms_of
from jrdb_avr.schema.wording import parse, question_key, render

CHOICE_COUNT: Final = 4

_STATED: Final = re.compile(r"(\S+) s \(frame (\d+)\)")
"""A stated time in a question's text: its seconds and its frame."""


def check_question(
    report: Validation,
    row: dict[str, Any],
    own: dict[str, Any],
    info: dict[str, Any],
    annotations: Annotations,
    rules: Rules,
) -> None:
    """Check a question by itself; `info` is its row of `sequences`."""
    name, mode, choices = row["question_id"], row["answer_mode"], row["choices"]
    report.check("rules", own["rules"] == rules_hash(rules), f"{name}: made under rules {own['rules']}")
    if mode == "multiple_choice":
        fine = len(choices) == len(set(choices)) == CHOICE_COUNT
        report.check("choices", fine, f"{name}: choices {choices}")
    else:
        report.check("choices", not choices, f"{name}: choices for an answer of mode {mode}")
    try:
        answer = decode_answer(mode, own["answer"])
    except AvrError as error:
        report.check("answers", False, f"{name}: {error}")
        return
    report.check("answers", _inside(answer, len(choices), info["frame_count"]), f"{name}: {own['answer']} is outside")
    try:
        plan = parse_plan(own["plan"])
        family = forms_of(row["template"])[0].family
    except AvrError as error:
        report.check("plans", False, f"{name}: {error}")
        return
    report.check("plans", canonical(plan) == own["plan"], f"{name}: the plan is not in its canonical form")
    report.check("plans", plan.answer.mode == mode, f"{name}: the plan's answer is of mode {plan.answer.mode}")
    report.check("plans", family == row["family"], f"{name}: template {row['template']!r} is of family {family!r}")
    _check_text(report, row, own, plan, info, annotations)
    _check_private(report, row, own, plan, answer, rules)
    found = rederive(annotations, plan, row["template"], rules)
    shown = choices[answer.choice - 1] if isinstance(answer, Choice) and answer.choice <= len(choices) else None
    said = shown if isinstance(answer, Choice) else encode_answer(answer)
    report.check(
        "rederive",
        found.outcome == "defined" and found.answer == said and found.target == own["target_track"],
        f"{name}: {found.outcome}, {found.answer} of person {found.target}; stored: {said} of {own['target_track']}"
        f" {'; '.join(found.faults)}",
    )
    report.check("rederive", not found.faults, f"{name}: {'; '.join(found.faults)}")
    report.check("rederive", _needed(own["needed"]) == set(found.needed), f"{name}: other boxes are needed")
    bound = _decoded(own["bindings"]) == dict(found.people) | dict(found.times)
    report.check("rederive", bound, f"{name}: bindings {own['bindings']} are others")


def _inside(answer: Answer, choices: int, frame_count: int) -> bool:
    match answer:
        case Choice(number):
            return number <= choices
        case FrameAnswer(frame) | FrameViewpoint(frame):
            return frame < frame_count
        case Span(start, end):
            return start <= end < frame_count
    return answer.value > 0


def _check_text(
    report: Validation,
    row: dict[str, Any],
    own: dict[str, Any],
    plan: Plan,
    info: dict[str, Any],
    annotations: Annotations,
) -> None:
    name, text = row["question_id"], row["question"]
    key = question_key(row["sequence"], own["target_track"], plan)
    about = annotations.step == KEYFRAME_STEP and "actions" in annotations.layers
    try:
        written, read = render(row["template"], plan, key, about), parse(text)
    except AvrError as error:
        report.check("text", False, f"{name}: {error}")
        return
    report.check("text", written == text, f"{name}: the plan reads {written!r}")
    report.check("text", (read[0], canonical(read[1])) == (row["template"], own["plan"]), f"{name}: says another plan")
    stated = _STATED.findall(text)
    seconds = all(said == f"{int(frame) / info['fps']:.1f}" for said, frame in stated)
    report.check("text", bool(stated) and seconds, f"{name}: stated seconds are not frame / fps")


def _check_private(
    report: Validation, row: dict[str, Any], own: dict[str, Any], plan: Plan, answer: Answer, rules: Rules
) -> None:
    name = row["question_id"]
    try:
        proofs = msgspec.json.decode(own["proofs"], type=list[dict[str, Any]])
        distractors = msgspec.json.decode(own["distractors"], type=list[str | None])
        bindings = msgspec.json.decode(own["bindings"], type=dict[str, int])
        _needed(own["needed"])
    except msgspec.DecodeError as error:
        report.check("proofs", False, f"{name}: {error}")
        return
    named = [(str(one.get("kind")), str(one.get("variant"))) for one in proofs]
    wanted = expected(row["template"], plan, rules)
    known = sorted(named) == sorted(wanted)
    odd = sorted(wanted.symmetric_difference(named)) or sorted(named)
    report.check("proofs", known, f"{name}: proofs missing, or not expected: {', '.join(map(' '.join, odd))}")
    holds = {key: one.get("holds") is True for key, one in zip(named, proofs, strict=True)}
    broken = failing(row["template"], holds)
    report.check("proofs", not broken, f"{name}: {', '.join(broken)} do not hold")
    fitting = len(distractors) == len(row["choices"])
    if fitting and isinstance(answer, Choice) and answer.choice <= len(distractors):
        fitting = distractors[answer.choice - 1] is None
    report.check("proofs", fitting, f"{name}: distractors {own['distractors']} do not fit the choices")
    names = {node.id for node in plan.nodes} | set(plan.times)
    bound = set(bindings) == names and bindings.get(plan.target) == own["target_track"]
    report.check("proofs", bound, f"{name}: bindings {own['bindings']} do not fit the plan")


def _decoded(text: str) -> dict[str, int] | None:
    try:
        return msgspec.json.decode(text, type=dict[str, int])
    except msgspec.DecodeError:
        return None


class _Needed(msgspec.Struct, forbid_unknown_fields=True):
    node: str
    track: int
    frame: int
    x: float
    y: float
    w: float
    h: float
    decisive: bool


def _needed(text: str) -> set[NeededBox]:
    try:
        boxes = msgspec.json.decode(text, type=list[_Needed])
    except msgspec.DecodeError:
        return set()
    return {NeededBox(b.node, b.track, b.frame, Box(b.x, b.y, b.w, b.h), b.decisive) for b in boxes}


def check_evidence(
    report: Validation,
    row: dict[str, Any],
    own: dict[str, Any],
    known: dict[int, Box],
    rows: int,
    annotations: Annotations,
) -> None:
    """Check a question's evidence: `known` are its boxes by frame, `rows` how many rows it has."""
    name, target = row["question_id"], own["target_track"]
    report.check("evidence", rows == len(known) > 0, f"{name}: {rows} rows for {len(known)} frames")
    report.check("evidence", known == annotations.boxes(target), f"{name}: not the boxes of person {target}")
