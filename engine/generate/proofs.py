"""The record of a question: its proofs, the boxes it needs, and the numbers that tell how hard it is.

What the set-wise search has established for all candidates is written out here for the few that are kept.

Which proofs a question has, by its template and plan, and which of them must hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.generate import views
from jrdb_avr.engine.generate.candidates import OUTCOMES, PROVING, VALUES, Candidates
from jrdb_avr.engine.generate.descriptions import Descriptions
from jrdb_avr.engine.generate.scene import NOBODY, Scene
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Condition, Plan
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import forms_of


@dataclass(frozen=True)
class NeededBox:
    """A box that whoever answers must see; `decisive` ones must not all be seen by looking straight ahead."""

    node: str
    track: int
    frame: int
    x: float
    y: float
    w: float
    h: float
    decisive: bool

    def plain(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("node", "track", "frame", "x", "y", "w", "h", "decisive")}


@dataclass(frozen=True)
class Record:
    """What is stored beside a question, private."""

    proofs: tuple[dict[str, Any], ...]
    needed: tuple[NeededBox, ...]
    bindings: dict[str, int]
    hops: int
    time_gap_s: float
    separation_deg: float
    people_in_scene: int


def make_record(
    scene: Scene, descriptions: Descriptions, candidates: Candidates, row: int, answer: str, rules: Rules
) -> Record:
    """The record of one candidate that all set-wise rules passed; `answer` as its proofs tell it."""
    name, template = int(candidates.name[row]), candidates.template
    needed = needed_boxes(scene, candidates, row)
    target = [box for box in needed if box.node == template.target]
    angles = {box.frame: scene.geometry["angle"][scene.box_of(box.track, box.frame)] for box in target}
    t0 = int(candidates.frames["t0"][row])
    turns = angle_error(np.array([angles[box.frame] for box in target if box.decisive]), angles[t0])
    times = {time: int(candidates.frames[time][row]) for time in template.stated}
    for event, column in zip(template.events, template.read, strict=False):
        times[event] = int(candidates.frames[column][row])
    if template.spec.read == "next_action":
        # What ends is the pose held until the last keyframe before the next one starts.
        keyframes = scene.keyframes
        times["t1"] = int(keyframes[np.searchsorted(keyframes, candidates.frames["first"][row]) - 1])
    keyframe = descriptions.conditions.keyframe[descriptions.sighting[name]]
    return Record(
        proofs=tuple(_proofs(descriptions, candidates, row, answer, needed, rules)),
        needed=needed,
        bindings={**tracks_of(scene, candidates, row), **dict(sorted(times.items()))},
        hops=len(template.edges),
        time_gap_s=(max(times.values()) - t0) / scene.fps,
        separation_deg=float(np.max(turns)),
        people_in_scene=int(np.count_nonzero(descriptions.conditions.slots[keyframe] != NOBODY)),
    )


def tracks_of(scene: Scene, candidates: Candidates, row: int) -> dict[str, int]:
    """Track of everybody in the plan, by node."""
    return {
        node: int(scene.tracks[scene.persons(moments[row : row + 1])[0]]) for node, moments in candidates.people.items()
    }


def needed_boxes(scene: Scene, candidates: Candidates, row: int) -> tuple[NeededBox, ...]:
    """Everybody's box at t0, and the target's where it is read, by node and frame; where it is absent there is none.

    Whoever is counted is needed once, as nodes b1, b2, ... by track, and the target with them.
    """
    template = candidates.template
    t0 = int(candidates.frames["t0"][row])
    boxes = []
    met = _counted(scene, candidates, row)
    for node, track in tracks_of(scene, candidates, row).items():
        decisive: set[int] = set()
        together: set[int] = set()
        if node == template.target:
            decisive = {int(candidates.frames[name][row]) for name in template.decisive}
            decisive = {frame for frame in decisive if scene.box_of(track, frame) != NOBODY} or {t0}
            together = {frame for _, frame in met}
        for frame in sorted(decisive | {t0} | together):
            boxes.append(_box(scene, node, track, frame, frame in decisive))
    boxes += [_box(scene, f"b{i}", track, frame, False) for i, (track, frame) in enumerate(met, start=1)]
    return tuple(boxes)


def _box(scene: Scene, node: str, track: int, frame: int, decisive: bool) -> NeededBox:
    line = scene.box_of(track, frame)
    x, y, w, h = (float(scene.geometry[side][line]) for side in "xywh")
    return NeededBox(node, track, frame, x, y, w, h, decisive)


def _counted(scene: Scene, candidates: Candidates, row: int) -> list[tuple[int, int]]:
    """Whom a candidate counts, by track, and the frame at which both are to be seen."""
    if candidates.counted is None:
        return []
    people = candidates.counted.people(row, int(candidates.frames["t2"][row]))
    return [(int(scene.tracks[person]), frame) for person, frame in people]


def proof(kind: str, variant: str, holds: bool, outcome: str, answer: str | None = None) -> dict[str, Any]:
    """One proof as it is stored. `answer` is what the perturbed program answers, where it does."""
    assert outcome in OUTCOMES, outcome
    return {"kind": kind, "variant": variant, "holds": holds, "outcome": outcome, "answer": answer}


def _proofs(
    descriptions: Descriptions,
    candidates: Candidates,
    row: int,
    own: str,
    needed: tuple[NeededBox, ...],
    rules: Rules,
) -> list[dict[str, Any]]:
    name = int(candidates.name[row])
    found = [proof("anchor", "match", True, "same", own)]
    for condition, left in zip(descriptions.of(name), descriptions.left[name], strict=False):
        found.append(proof("anchor", f"without {condition_text(condition)}", int(left) >= 2, "ambiguous"))
    found.append(proof("evidence", "clear views", True, "same", own))
    for perturbed in candidates.perturbed:
        outcome = OUTCOMES[perturbed.outcome[row]]
        answer = VALUES[perturbed.answer[row]] if perturbed.answer[row] != NOBODY else None
        found.append(proof(perturbed.kind, perturbed.variant, perturbed.outcome[row] in PROVING, outcome, answer))
    if candidates.template.time_proof == "construction":
        # Asked is the time itself: at another time another answer would be right.
        found.append(proof("time.drop", "by construction", True, "different"))
    # Who looks one way only, and does not see what decides, has nothing to answer from.
    found.append(proof("view.ahead", "180", True, "empty"))
    x, w = np.array([box.x for box in needed]), np.array([box.w for box in needed])
    single = views.single_view(x, w, rules.visible_share)
    found.append(proof("view.single", "any angle", not single, "same" if single else "empty", own if single else None))
    return found


def condition_text(condition: Condition) -> str:
    """A condition in a few words, as in "action sitting", "sector left" or "object bag (carrying)"."""
    if condition.attribute is not None:
        return f"{condition.attribute} {condition.value}"
    if condition.object is not None:
        return f"object {condition.object} ({condition.verb})"
    return f"interaction {condition.interaction}" if condition.action is None else f"action {condition.action}"


ALWAYS: Final = (
    ("anchor", "match"),
    ("evidence", "clear views"),
    ("view.ahead", "180"),
    ("view.single", "any angle"),
    ("rederive", "annotations"),
)
"""Proofs that every question has, as kind and variant."""


def expected_proofs(name: str, plan: Plan, rules: Rules) -> set[tuple[str, str]]:
    """Kind and variant of every proof that a question has."""
    expected = set(ALWAYS)
    for node in plan.nodes:
        expected |= {("anchor", f"without {condition_text(condition)}") for condition in node.conditions}
    template = forms_of(name)[0]
    if template.edges:
        expected |= {("hop.stop", str(place)) for place in range(len(template.people) - 1)}
        # To leave out the last hop of a path is to stop one person early; of a fork each can be left out.
        expected |= {("hop.skip", str(hop)) for hop in range(1, len(template.edges) + template.joins)}
    if template.time_proof == "construction":
        return expected | {("time.drop", "by construction")}
    shifts = {("time.shift", f"{sign * rules.shift_s:+g} s") for sign in (-1, 1)}
    return expected | shifts | {("time.drop", "all keyframes")}


def failing_proofs(name: str, holds: Mapping[tuple[str, str], bool]) -> list[str]:
    """What does not hold though it must: of both shifts one is enough, and of a fork read at b and at c."""
    template = forms_of(name)[0]
    either: dict[str, bool] = {}
    failing = []
    for (kind, variant), held in holds.items():
        if kind == "time.shift" or (template.joins and kind == "hop.stop" and variant != "0"):
            either[kind] = either.get(kind, False) or held
        elif not held and not (kind == "view.single" and template.single_view):
            failing.append(f"{kind} {variant}")
    return failing + [kind for kind, held in either.items() if not held]
