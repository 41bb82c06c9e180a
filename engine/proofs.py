"""The record of a question: its proofs, the boxes it needs, and the numbers that tell how hard it is.

What the set-wise search has established for all candidates is written out here for the few that are kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import FPS, Rules

from . import views
from .candidates import OUTCOMES, VALUES, Candidates
from .descriptions import Descriptions
from .scene import NOBODY, Scene


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


_ROOT: Final = "a"


def make_record(
    scene: Scene, descriptions: Descriptions, candidates: Candidates, row: int, answer: str, rules: Rules
) -> Record:
    """The record of one candidate that all set-wise rules passed; `answer` as its proofs tell it."""
    name = int(candidates.name[row])
    track = target_track(scene, descriptions, name)
    needed = needed_boxes(scene, track, candidates, row)
    target_angles = scene.geometry["angle"][[scene.box_of(track, box.frame) for box in needed]]
    at_t0 = [box.frame for box in needed].index(int(candidates.frames["t0"][row]))
    decisive = [i for i, box in enumerate(needed) if box.decisive]
    turns = angle_error(target_angles[decisive], target_angles[at_t0])
    times = {key: int(values[row]) for key, values in candidates.frames.items() if key.startswith("t")}
    if candidates.segment[row] != NOBODY:
        times["t1"] = int(candidates.frames["start"][row])
        if "end" in candidates.template.read:
            times["t2"] = int(candidates.frames["end"][row])
    keyframe = descriptions.conditions.keyframe[descriptions.sighting[name]]
    return Record(
        proofs=tuple(_proofs(descriptions, candidates, row, answer, needed, rules)),
        needed=needed,
        bindings={_ROOT: track, **dict(sorted(times.items()))},
        hops=0,
        time_gap_s=(max(times.values()) - times["t0"]) / scene.fps,
        separation_deg=float(np.max(turns)),
        people_in_scene=int(np.count_nonzero(descriptions.conditions.slots[keyframe] != NOBODY)),
    )


def target_track(scene: Scene, descriptions: Descriptions, name: int) -> int:
    """Track of the person that a name describes."""
    return int(scene.tracks[descriptions.moment[name] // len(scene.keyframes)])


def needed_boxes(scene: Scene, track: int, candidates: Candidates, row: int) -> tuple[NeededBox, ...]:
    """The target's boxes at t0 and where it is read, by frame; where it is absent there is none."""
    template = candidates.template
    t0 = int(candidates.frames["t0"][row])
    decisive = {int(candidates.frames[name][row]) for name in template.decisive}
    decisive = {frame for frame in decisive if scene.box_of(track, frame) != NOBODY} or {t0}
    boxes = []
    for frame in sorted(decisive | {t0}):
        line = scene.box_of(track, frame)
        x, y, w, h = (float(scene.geometry[side][line]) for side in "xywh")
        boxes.append(NeededBox(_ROOT, track, frame, x, y, w, h, frame in decisive))
    return tuple(boxes)


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
    for shift in candidates.shifts:
        outcome = OUTCOMES[shift.outcome[row]]
        answer = VALUES[shift.answer[row]] if shift.answer[row] != NOBODY else None
        proves = outcome in ("different", "ambiguous", "empty")
        found.append(proof("time.shift", f"{shift.by / FPS:+g} s", proves, outcome, answer))
    if candidates.template.time_proof == "construction":
        # Asked is the time itself: at another time another answer would be right.
        found.append(proof("time.drop", "by construction", True, "different"))
    else:
        found.append(proof("time.drop", "all keyframes", True, OUTCOMES[candidates.drop[row]]))
    # Who looks one way only, and does not see what decides, has nothing to answer from.
    found.append(proof("view.ahead", "180", True, "empty"))
    x, w = np.array([box.x for box in needed]), np.array([box.w for box in needed])
    single = views.single_view(x, w, rules.visible_share)
    found.append(proof("view.single", "any angle", not single, "same" if single else "empty", own if single else None))
    return found


def condition_text(condition: Condition) -> str:
    """A condition in a word or two, as in "action sitting" or "sector left"."""
    if condition.attribute is not None:
        return f"{condition.attribute} {condition.value}"
    return f"action {condition.action}"
