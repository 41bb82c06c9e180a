"""Prove a question again: evaluate every perturbation of its plan from the annotation tables.

A perturbation changes a plan: it takes another target, omits a hop or a condition, or moves the times. The people of
the changed plan are found and its answer is read as for any plan. The outcome compares this answer with the answer of
the question. Kinds and variants have the names that questions store.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from msgspec.structs import replace as changed

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.plan import ResolvedPlan, find_people, join
from jrdb_avr.engine.rederive.reads import compare_action, reading_of
from jrdb_avr.engine.rederive.truth import FALSE, SLACK, TRUE, Outcome, Undefined
from jrdb_avr.schema.answer_modes import decode_answer, same_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.panorama import CROP, WIDTH, crop_left
from jrdb_avr.schema.plan import Edge, Plan, Time
from jrdb_avr.schema.questions import NeededBox, Proof
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, Rules, frames

_PROVING: Final = ("different", "ambiguous", "empty")
"""Outcomes of perturbed plans that certainly do not lead to the answer of the question."""

_AHEAD_DEG: Final = 180.0
"""Panorama angle of the direction straight ahead of the robot."""


def prove_again(
    annotations: Annotations, plan: Plan, template: str, rules: Rules, result: Outcome
) -> tuple[Proof, ...]:
    """Compute every proof of a question a second time.

    Args:
        annotations: Annotations of the sequence.
        plan: Plan of the question.
        template: Name of the template.
        rules: Thresholds.
        result: Result of `rederive` for the question.

    Returns:
        The proofs in the order of the stored questions.
    """
    perturbed = _Perturbed(find_people(annotations, plan, template, rules), result)
    clear = all(annotations.clear(box.track, box.frame) for box in result.needed)
    return (
        Proof("anchor", "match", True, "same", result.answer),
        *perturbed.conditions(),
        Proof("evidence", "clear views", clear, "same" if clear else "unknown", result.answer if clear else None),
        *perturbed.hops(),
        *perturbed.times(),
        *perturbed.views(),
        Proof("rederive", "annotations", True, "same", result.answer),
    )


@dataclass(frozen=True, slots=True)
class _Perturbed:
    """A plan with its people, and the result that the results of its perturbations are compared with."""

    resolved: ResolvedPlan
    result: Outcome

    def conditions(self) -> Iterator[Proof]:
        """Yield one proof per condition: without it, two people or more could match the other conditions."""
        plan, annotations = self.resolved.plan, self.resolved.annotations
        stated = next(node.conditions for node in plan.nodes if node.id == plan.root)
        for condition in stated:
            rest = [kept for kept in stated if kept is not condition]
            several = len(annotations.could_match(rest, self.resolved.t0)) >= 2
            yield Proof("anchor", f"without {condition.words}", several, "ambiguous" if several else "same")

    def hops(self) -> Iterator[Proof]:
        """Yield the proofs that read the answer at an earlier person, or leave out a hop."""
        edges, target = self.resolved.plan.edges, self.resolved.plan.target
        if not edges:
            return
        for index, node in enumerate(list(self.resolved.people)[:-1]):
            yield self._prove("hop.stop", str(index), partial(_stopped, self.resolved, node))
        # Because a path without its last hop equals the path that stops one person early. A fork has two last hops.
        joins = sum(edge.target == target for edge in edges) > 1
        for index, edge in enumerate(edges, start=1):
            if joins or edge.target != target:
                yield self._prove("hop.skip", str(index), partial(_skipped, self.resolved, edge))

    def times(self) -> Iterator[Proof]:
        """Yield the proofs at other times: shifted both ways, and at every keyframe.

        The times after the description move, and the people stay the same. If there are no such times, the time of the
        description moves, and all people are found again. If the answer is itself a time, no time moves.
        """
        resolved, stated = self.resolved, self.resolved.stated
        answer = resolved.plan.answer
        if answer.read == "count" or any(name not in stated for name in answer.times):
            yield from (Proof(kind, "by construction", None, "not_run") for kind in ("time.shift", "time.drop"))
            return
        later = [frame for name, frame in stated.items() if name != resolved.described]
        keyframes = sorted(resolved.annotations.keyframes) or [resolved.t0]
        moved, earliest = (later, resolved.t0 + 1) if later else ([resolved.t0], keyframes[0])
        step = frames(resolved.rules.shift_s)
        for by in (-step, step):
            variant = f"{by / FPS:+g} s"
            if min(moved) + by < max(earliest, keyframes[0]) or max(moved) + by > keyframes[-1]:
                yield Proof("time.shift", variant, False, "outside")
            else:
                yield self._prove("time.shift", variant, partial(_moved, resolved, by))
        begin = resolved.t0 + frames(resolved.rules.min_wait_s) if later else keyframes[0]
        moves = [frame - min(moved) for frame in keyframes if frame >= begin]
        proofs = [self._prove("time.drop", "", partial(_moved, resolved, by)) for by in moves]
        outcomes = [(proof.outcome, proof.answer) for proof in proofs if proof.outcome in ("same", "different")]
        outcome = "different" if len(set(outcomes)) > 1 else "same" if len(outcomes) > 1 else "empty"
        yield Proof("time.drop", "all keyframes", outcome in _PROVING, outcome)

    def views(self) -> Iterator[Proof]:
        """Yield two proofs: the forward view lacks a decisive box, and every single view lacks a needed box."""
        share, needed = self.resolved.rules.visible_share, self.result.needed
        ahead = all(_shows(box, share)[int(crop_left(_AHEAD_DEG))] for box in needed if box.decisive)
        yield Proof("view.ahead", "180", not ahead, "same" if ahead else "empty", self.result.answer if ahead else None)
        single = bool(np.logical_and.reduce([_shows(box, share) for box in needed]).any())
        outcome, answer = ("same", self.result.answer) if single else ("empty", None)
        yield Proof("view.single", "any angle", not single, outcome, answer)

    def _prove(self, kind: str, variant: str, perturb: Callable[[], ResolvedPlan]) -> Proof:
        """Return the proof with the plan that `perturb` makes, and with the answer of that plan.

        If the answer is an action, the proof has it only if the outcome is "same", because a person may perform several
        actions.
        """
        outcome, answer = "unknown", None
        try:
            perturbed = perturb()
            if perturbed.plan.answer.read == "start_view":
                outcome = self._compare_starts(perturbed)
            elif perturbed.plan.answer.read == "action":
                outcome = compare_action(perturbed, self.result.answer or "")
                answer = self.result.answer if outcome == "same" else None
            else:
                answer = reading_of(perturbed).answer
                outcome = "same" if answer == self.result.answer else "different"
        except Undefined as reason:
            outcome = reason.outcome
        return Proof(kind, variant, outcome in _PROVING, outcome, answer)

    def _compare_starts(self, perturbed: ResolvedPlan) -> str:
        """Compare two starts. Without a certain start, the outcome is "unknown" if a possible start could score."""
        stored = decode_answer("frame_viewpoint", self.result.answer or "")
        try:
            again = decode_answer("frame_viewpoint", reading_of(perturbed).answer)
        except Undefined:
            could = isinstance(stored, FrameViewpoint) and _could_start(perturbed, stored)
            return "unknown" if could else "empty"
        return "same" if same_answer(again, stored) else "different"


# -- perturbed plans ------------------------------------------------------------------------------------------------


def _stopped(resolved: ResolvedPlan, node: str) -> ResolvedPlan:
    """Return the plan with the person at `node` as its target."""
    plan = resolved.plan
    times = {name: changed(time, of=node) if time.of == plan.target else time for name, time in plan.times.items()}
    return replace(resolved, plan=changed(plan, target=node, times=times, answer=changed(plan.answer, of=node)))


def _skipped(resolved: ResolvedPlan, skipped: Edge) -> ResolvedPlan:
    """Return the plan without a hop and without its target. The next hops begin at the source of the hop."""
    plan = resolved.plan
    edges = [edge for edge in plan.edges if edge is not skipped]
    if skipped.target == plan.target:
        people = {node: track for node, track in resolved.people.items() if node != plan.target}
        resolved = replace(resolved, people=people)
        people[plan.target] = join(resolved, [edge for edge in edges if edge.target == plan.target])
        return resolved
    edges = [changed(edge, source=skipped.source) if edge.source == skipped.target else edge for edge in edges]
    nodes = tuple(node for node in plan.nodes if node.id != skipped.target)
    plan = changed(plan, nodes=nodes, edges=tuple(edges))
    return find_people(resolved.annotations, plan, resolved.template, resolved.rules)


def _moved(resolved: ResolvedPlan, by: int) -> ResolvedPlan:
    """Return the plan with moved times: the times after the description, or all times if there is only one."""
    whole = len(resolved.stated) == 1
    stated = {name: at + by if whole or name != resolved.described else at for name, at in resolved.stated.items()}
    if not resolved.annotations.keyframes.issuperset(stated.values()):
        raise Undefined("unknown", "a time is not a keyframe")
    if not whole:
        return replace(resolved, stated=stated)
    times = {name: Time(frame=frame) for name, frame in stated.items()}
    return find_people(resolved.annotations, changed(resolved.plan, times=times), resolved.template, resolved.rules)


# -- possible starts, and boxes in a view -----------------------------------------------------------------------------


def _could_start(perturbed: ResolvedPlan, stored: FrameViewpoint) -> bool:
    """Return whether the person could start the action near the stored start in time and in direction.

    A start is possible in a frame if the action is not false in it and not certain one second earlier. If labels come
    once per second, a start is up to half a second before its first label.
    """
    annotations, track = perturbed.annotations, perturbed.target
    action = perturbed.plan.times[perturbed.plan.answer.times[0]].action or ""
    late = 0 if annotations.step == 1 else KEYFRAME_STEP // 2
    for frame in range(stored.frame - KEYFRAME_STEP, stored.frame + KEYFRAME_STEP + late + 1):
        if annotations.box(track, frame) is None:
            continue
        near = same_answer(FrameViewpoint(stored.frame, annotations.angle(track, frame)), stored)
        begins = annotations.state(track, action, frame) != FALSE
        if near and begins and annotations.state(track, action, frame - KEYFRAME_STEP) != TRUE:
            return True
    return False


def _shows(box: NeededBox, share: float) -> Bools:
    """Return for each column whether the crop with this left edge shows at least `share` of the box's width."""
    begin = (box.x - np.arange(WIDTH)) % WIDTH
    # Because the box may begin in the crop, or before the crop and reach across its left edge.
    shown = np.clip(CROP - begin, 0, box.w) + np.clip(begin - WIDTH + box.w, 0, CROP)
    return np.asarray(shown >= share * box.w - SLACK)
