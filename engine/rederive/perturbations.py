"""Prove a question again: evaluate every perturbation of its plan from the annotation tables.

A perturbation is another plan: another target, a hop left out, times moved, a condition dropped. Its people are found
and its answer is read as for any plan, and its outcome says how that answer compares with the question's own. Kinds and
variants have the names that questions store.
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
from jrdb_avr.engine.rederive.reads import reading_of
from jrdb_avr.engine.rederive.truth import FALSE, SLACK, TRUE, Outcome, Undefined
from jrdb_avr.schema.answer_modes import decode_answer, same_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.panorama import CROP, WIDTH, crop_left
from jrdb_avr.schema.plan import Edge, Plan, Time
from jrdb_avr.schema.questions import NeededBox, Proof
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, Rules, frames

_PROVING: Final = ("different", "ambiguous", "empty")
"""Outcomes of a perturbed plan that certainly does not give the question's answer."""

_AHEAD_DEG: Final = 180.0


def prove_again(annotations: Annotations, plan: Plan, template: str, rules: Rules, own: Outcome) -> tuple[Proof, ...]:
    """Compute every proof of a question a second time; `own` is what `rederive` returns for its plan."""
    perturbed = _Perturbed(find_people(annotations, plan, template, rules), own)
    clear = all(annotations.clear(box.track, box.frame) for box in own.needed)
    return (
        Proof("anchor", "match", True, "same", own.answer),
        *perturbed.conditions(),
        Proof("evidence", "clear views", clear, "same" if clear else "unknown", own.answer if clear else None),
        *perturbed.hops(),
        *perturbed.times(),
        *perturbed.views(),
        Proof("rederive", "annotations", True, "same", own.answer),
    )


@dataclass(frozen=True, slots=True)
class _Perturbed:
    """A plan with its people, and its outcome, with which the outcomes of its perturbations are compared."""

    found: ResolvedPlan
    own: Outcome

    def conditions(self) -> Iterator[Proof]:
        """Each condition left out: two people or more could match the others."""
        plan, annotations = self.found.plan, self.found.annotations
        stated = next(node.conditions for node in plan.nodes if node.id == plan.root)
        for condition in stated:
            others = annotations.could_match([one for one in stated if one is not condition], self.found.t0)
            several = len(others) >= 2
            yield Proof("anchor", f"without {condition.words}", several, "ambiguous" if several else "same")

    def hops(self) -> Iterator[Proof]:
        """The answer read at each earlier person, and each hop left out."""
        edges, target = self.found.plan.edges, self.found.plan.target
        if not edges:
            return
        for place, node in enumerate(list(self.found.people)[:-1]):
            yield self._prove("hop.stop", str(place), partial(_stopped, self.found, node))
        # To leave out the last hop of a path is to stop one person early; of a fork each of both can be left out.
        joins = sum(edge.target == target for edge in edges) > 1
        for number, edge in enumerate(edges, start=1):
            if joins or edge.target != target:
                yield self._prove("hop.skip", str(number), partial(_skipped, self.found, edge))

    def times(self) -> Iterator[Proof]:
        """Stated times moved, both ways and to every keyframe: those after the description's, with the people held, or
        else the description's, with everybody found anew. An answer that is itself a time proves that time matters."""
        found, stated = self.found, self.found.stated
        answer = found.plan.answer
        if answer.read == "count" or any(name not in stated for name in answer.times):
            yield from (Proof(kind, "by construction", None, "not_run") for kind in ("time.shift", "time.drop"))
            return
        later = [frame for name, frame in stated.items() if name != found.described]
        keyframes = sorted(found.annotations.keyframes) or [found.t0]
        moved, earliest = (later, found.t0 + 1) if later else ([found.t0], keyframes[0])
        step = frames(found.rules.shift_s)
        for by in (-step, step):
            variant = f"{by / FPS:+g} s"
            if min(moved) + by < max(earliest, keyframes[0]) or max(moved) + by > keyframes[-1]:
                yield Proof("time.shift", variant, False, "outside")
            else:
                yield self._prove("time.shift", variant, partial(_moved, found, by))
        begin = found.t0 + frames(found.rules.min_wait_s) if later else keyframes[0]
        moves = [frame - min(moved) for frame in keyframes if frame >= begin]
        answers = [self._prove("time.drop", "", partial(_moved, found, by)).answer for by in moves]
        known = [text for text in answers if text is not None]
        outcome = "different" if len(set(known)) > 1 else "same" if len(known) > 1 else "empty"
        yield Proof("time.drop", "all keyframes", outcome in _PROVING, outcome)

    def views(self) -> Iterator[Proof]:
        """Whether the forward view shows every decisive box, and any one view every needed box."""
        share, needed = self.found.rules.visible_share, self.own.needed
        ahead = all(_shows(box, share)[int(crop_left(_AHEAD_DEG))] for box in needed if box.decisive)
        yield Proof("view.ahead", "180", not ahead, "same" if ahead else "empty", self.own.answer if ahead else None)
        single = bool(np.logical_and.reduce([_shows(box, share) for box in needed]).any())
        outcome, answer = ("same", self.own.answer) if single else ("empty", None)
        yield Proof("view.single", "any angle", not single, outcome, answer)

    def _prove(self, kind: str, variant: str, perturb: Callable[[], ResolvedPlan]) -> Proof:
        """Return the proof by the plan that `perturb` makes; its answer, where it is a choice, is stored too."""
        outcome, answer = "unknown", None
        try:
            perturbed = perturb()
            if perturbed.plan.answer.read == "start_view":
                outcome = self._compare_starts(perturbed)
            else:
                answer = reading_of(perturbed).answer
                outcome = "same" if answer == self.own.answer else "different"
        except Undefined as reason:
            outcome = reason.outcome
        return Proof(kind, variant, outcome in _PROVING, outcome, answer)

    def _compare_starts(self, perturbed: ResolvedPlan) -> str:
        """Where no start is certain, the outcome is unknown only if a start could be near enough to score."""
        stored = decode_answer("frame_viewpoint", self.own.answer or "")
        try:
            again = decode_answer("frame_viewpoint", reading_of(perturbed).answer)
        except Undefined:
            could = isinstance(stored, FrameViewpoint) and _could_start(perturbed, stored)
            return "unknown" if could else "empty"
        return "same" if same_answer(again, stored) else "different"


# -- perturbed plans ------------------------------------------------------------------------------------------------


def _stopped(found: ResolvedPlan, node: str) -> ResolvedPlan:
    """The plan read at another of its people."""
    plan = found.plan
    times = {name: changed(time, of=node) if time.of == plan.target else time for name, time in plan.times.items()}
    return replace(found, plan=changed(plan, target=node, times=times, answer=changed(plan.answer, of=node)))


def _skipped(found: ResolvedPlan, skipped: Edge) -> ResolvedPlan:
    """The plan without a hop: the hops after it go out from where it began, and its person is nobody of the plan."""
    plan = found.plan
    edges = [edge for edge in plan.edges if edge is not skipped]
    if skipped.target == plan.target:
        people = {node: track for node, track in found.people.items() if node != plan.target}
        found = replace(found, people=people)
        people[plan.target] = join(found, [edge for edge in edges if edge.target == plan.target])
        return found
    edges = [changed(edge, source=skipped.source) if edge.source == skipped.target else edge for edge in edges]
    nodes = tuple(node for node in plan.nodes if node.id != skipped.target)
    return find_people(found.annotations, changed(plan, nodes=nodes, edges=tuple(edges)), found.template, found.rules)


def _moved(found: ResolvedPlan, by: int) -> ResolvedPlan:
    """The plan with its later times moved, or without such times the whole plan. Nothing is known between keyframes."""
    whole = len(found.stated) == 1
    stated = {name: at + by if whole or name != found.described else at for name, at in found.stated.items()}
    if not found.annotations.keyframes.issuperset(stated.values()):
        raise Undefined("unknown", "a time is no keyframe")
    if not whole:
        return replace(found, stated=stated)
    times = {name: Time(frame=frame) for name, frame in stated.items()}
    return find_people(found.annotations, changed(found.plan, times=times), found.template, found.rules)


# -- what a perturbed plan could read, and what a view shows --------------------------------------------------------


def _could_start(perturbed: ResolvedPlan, stored: FrameViewpoint) -> bool:
    """Whether the person could start the action within a second of the stored start, in nearly the same direction: the
    action is not false there, and not certainly true one keyframe earlier.

    Where labels come once per second, a start lies up to half a second before the label that shows it.
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
    """Per column of the panorama: whether the crop that begins there shows at least this share of a box's width."""
    begin = (box.x - np.arange(WIDTH)) % WIDTH
    # The box may begin in the crop, or before it and reach into it across the crop's left edge.
    seen = np.clip(CROP - begin, 0, box.w) + np.clip(begin - WIDTH + box.w, 0, CROP)
    return np.asarray(seen >= share * box.w - SLACK)
