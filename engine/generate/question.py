"""Questions of selected candidates: proofs, needed boxes, measures of difficulty, and choices.

Two other programs confirm each candidate. The statements in `queries/necessity` run each perturbation of its plan over
the stored graph; their outcomes are the proofs that are stored. The second program (`engine.rederive`) derives the plan
again from the annotation tables.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.asked import Question
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.facts import Facts, Key
from jrdb_avr.engine.generate.perturb import MissingFactsError, NoAnswerError, Setting, prove
from jrdb_avr.engine.generate.proofs import failing
from jrdb_avr.engine.generate.propose import Proposal, program_of
from jrdb_avr.engine.generate.stored_layer import Job
from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.engine.report.hashes import hash_of
from jrdb_avr.queries.graph.handle import open_worker_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import without_collector
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.labels import choice_text
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Plan, canonical
from jrdb_avr.schema.questions import NeededBox, Proof, QuestionRecord
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, rules_hash
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import TEMPLATES
from jrdb_avr.schema.wording.text import question_id, render

COLUMNS: Final = pa.schema([*dict.fromkeys((*QUESTIONS["questions"], *QUESTIONS["answers"])), ("key", pa.string())])
"""Columns of the tables `questions` and `answers`, and `Question.key`."""


@without_collector()
def make_questions(job: Job) -> tuple[pa.Table, dict[str, str]]:
    """Make the selected questions of a sequence.

    Args:
        job: Selected questions of the sequence.

    Returns:
        The questions in the columns of `COLUMNS`. Also a line per question that is not confirmed, by its key, with the
        sequence, the plan, and the difference.

    Raises:
        StoreError: If a table or the graph is missing.
    """
    made, rows, faults = _make_records(job), [], {}
    # The layer is freed before the annotations are read, because both fill the memory.
    annotations = Annotations.read(Store(job.store), job.sequence, job.rules)
    for key, record, plan, answer, proofs in made:
        if fault := _fault_of(record, plan, answer, proofs, annotations, job.rules):
            faults[key] = f"{job.sequence} {record.plan}: {fault}"
        rows.append(record.columns() | {"key": key})
    return pa.Table.from_pylist(rows, schema=COLUMNS), faults


def _make_records(job: Job) -> list[tuple[str, QuestionRecord, Plan, str, list[Proof]]]:
    """Return the key, the record, the plan, the answer and the proofs by statements of each question."""
    with open_worker_graph(Store(job.store).graph_path) as graph:
        layer = job.layer(graph)
        proposals = {
            one.key: Proposal(layer, TEMPLATES[one.candidate.form], msgspec.msgpack.decode(one.candidate.row))
            for one in job.questions
        }
        expected, source = _Expected(layer.facts, set()), CypherFacts(graph, job.rules.load)
        for proposal in proposals.values():
            with contextlib.suppress(MissingFactsError):
                _prove(proposal, Setting(expected, layer.facts.keyframes, job.rules))
        source.complete(lambda: source.ask(list(expected.asked)))
        setting = Setting(source, layer.facts.keyframes, job.rules)
        proofs = source.complete_all({key: partial(_prove, proposal, setting) for key, proposal in proposals.items()})
    made = [(question, proposals[question.key], proofs[question.key]) for question in job.questions]
    return [(one.key, _make_record(of, one, own), of.plan, of.answer, own) for one, of, own in made]


class _Expected(NamedTuple):
    """Source of facts from the sets. It notes what proofs ask for, so that statements look all facts up together."""

    facts: Facts
    asked: set[Key]

    def ask(self, keys: Sequence[Key]) -> list[Any]:
        self.asked.update(keys)
        if keys[0][0] in ("start", "onsets"):
            raise MissingFactsError
        return self.facts.ask(keys)


def _prove(proposal: Proposal, setting: Setting) -> list[Proof]:
    """Return the proofs of a proposal, or no proofs if its program finds no single person."""
    try:
        return prove(*program_of(proposal), setting)
    except NoAnswerError:
        return []


def _fault_of(
    record: QuestionRecord, plan: Plan, answer: str, proofs: Sequence[Proof], annotations: Annotations, rules: Rules
) -> str | None:
    """Return which proofs by statements do not hold, or how the result of the second program differs."""
    if not proofs:
        return "statements find no single person"
    if lacking := failing(record.template, proofs, rules):
        return f"by statements, {', '.join(lacking)} do not hold"
    second = rederive(annotations, plan, record.template, rules, record.choices)
    if second.outcome != "defined":
        return f"answer {answer}, rederived {second.outcome}"
    if (second.answer, second.target) != (answer, record.target_track):
        return f"answer {answer} about {record.target_track}, rederived {second.answer} about {second.target}"
    faults = second.faults if set(second.needed) == set(record.needed) else ("other boxes are needed",)
    return next(iter(faults), None)


# -- rows -------------------------------------------------------------------------------------------------------------


def _make_record(proposal: Proposal, question: Question, proofs: list[Proof]) -> QuestionRecord:
    layer, template, plan = proposal.layer, proposal.template, proposal.plan
    needed, times, begin = _needed_boxes(proposal), _times(proposal), proposal.frames["t0"]
    angle = layer.boxes[proposal.target, begin]["angle"]
    turns = [angle_error(layer.boxes[box.track, box.frame]["angle"], angle) for box in needed if box.decisive]
    public: dict[str, Any] = {"sequence": proposal.sequence, "family": template.family, "template": template.name}
    about, in_view = layer.head["action_step"] == KEYFRAME_STEP, layer.facts.judges_views
    public["question"] = render(template.name, plan, (question.twin or proposal.key)[:64], about, in_view)
    labels = question.choices if question.wrong else ()
    answer = encode_answer(Choice(labels.index(proposal.answer) + 1)) if labels else proposal.answer
    public |= {"choices": tuple(map(choice_text, labels)), "answer_mode": plan.answer.mode}
    return QuestionRecord(
        question_id=question_id(**public),
        **public,
        answer=answer,
        target_track=proposal.target,
        plan=canonical(plan),
        proofs=_all_proofs(proposal, proofs, needed),
        rules=rules_hash(layer.rules),
        hops=len(template.edges),
        time_gap_s=(max(times.values()) - begin) / layer.head["fps"],
        separation_deg=max(turns),
        people_in_scene=len(layer.facts.people[begin]),
        bindings={**proposal.people, **dict(sorted(times.items()))},
        needed=needed,
        twin_id=None if question.twin is None else f"{hash_of(question.twin):016x}",
    )


def _times(proposal: Proposal) -> dict[str, int]:
    """Return the frame of every time in the plan, by name."""
    template, frames = proposal.template, proposal.frames
    times = {name: frames[name] for name in template.stated}
    times |= {time: frames[name] for time, name in zip(template.events, template.read, strict=False)}
    if template.spec.read == "next_action":
        # What ends is the posture held until the last keyframe before the next one starts.
        times["t1"] = max(frame for frame in proposal.layer.facts.keyframes if frame < frames["first"])
    return times


def _needed_boxes(proposal: Proposal) -> tuple[NeededBox, ...]:
    """Return the boxes of all people at t0, and of the target as the answer is read, by node and frame.

    Each counted person has one box, as nodes b1, b2, ... by track, and the target has one in the same frame.
    """
    template, frames, sightings = proposal.template, proposal.frames, proposal.layer.boxes
    boxes = []
    for node, track in proposal.people.items():
        decisive, shown = set(), {frames["t0"]}
        if node == template.target:
            there = {frames[name] for name in template.decisive if (track, frames[name]) in sightings}
            decisive = there or {frames["t0"]}
            shown |= decisive | {frame for _, frame in proposal.counted}
        boxes += [(node, track, frame, frame in decisive) for frame in sorted(shown)]
    boxes += [(f"b{number}", track, frame, False) for number, (track, frame) in enumerate(proposal.counted, start=1)]
    return tuple(
        NeededBox(node, track, frame, **{side: sightings[track, frame][side] for side in "xywh"}, decisive=decisive)
        for node, track, frame, decisive in boxes
    )


def _all_proofs(proposal: Proposal, proofs: list[Proof], needed: Sequence[NeededBox]) -> tuple[Proof, ...]:
    """Return all proofs in the order of the table `answers`."""
    own = proposal.answer
    x, w = np.array([box.x for box in needed]), np.array([box.w for box in needed])
    single = bool(views.single_view(x, w, proposal.layer.rules.visible_share))
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
