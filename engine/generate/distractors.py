"""The four choices of a question: one is true, the others are wrong in ways that tell how a method fails.

A distractor is first what a perturbed program answers: the description's time instead of the asked one, a shifted
time, a look-alike who could match when a condition is dropped. Only then follow other poses known to be false for the
target at the asked time. Nothing unknown is ever a distractor, and no pose that the question states.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from jrdb_avr.engine.generate.candidates import VALUES, Candidates
from jrdb_avr.engine.generate.descriptions import Descriptions
from jrdb_avr.engine.generate.proofs import condition_text, tracks_of
from jrdb_avr.engine.generate.relations import STATED_POSES, Steps
from jrdb_avr.engine.generate.scene import NOBODY, Scene
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS
from jrdb_avr.schema.rules import Rules

COUNT: Final = 4


@dataclass(frozen=True)
class Choices:
    """The texts in their order, the number of the true one from 1, and per choice the perturbation that yields it."""

    texts: tuple[str, ...]
    true: int
    perturbations: tuple[str | None, ...]


def make_choices(
    scene: Scene, steps: Steps, descriptions: Descriptions, candidates: Candidates, row: int, key: str, rules: Rules
) -> Choices | None:
    """The choices of one candidate; None where there are not enough wrong answers. `steps` are those of the scene."""
    truth = VALUES[candidates.answer[row]]
    wrong: dict[str, str | None] = {}
    for text, perturbation in _perturbed(scene, steps, descriptions, candidates, row, rules):
        if text != truth:
            wrong.setdefault(text, perturbation)
    if candidates.template.pose_answer:
        barred = _stated(descriptions, candidates, row)
        track = tracks_of(scene, candidates, row)[candidates.template.target]
        barred |= scene.possible_actions(track, int(candidates.frames[candidates.template.decisive[-1]][row]))
        for text in _common_poses(scene, key):
            if text != truth:
                wrong.setdefault(text, None)
        wrong = {text: perturbation for text, perturbation in wrong.items() if text not in barred}
    else:
        for text in PRESENCE_ANSWERS if truth in PRESENCE_ANSWERS else DISTANCE_ANSWERS:
            if text != truth:
                wrong.setdefault(text, None)
    if len(wrong) < COUNT - 1:
        return None
    chosen = {truth: None, **dict(list(wrong.items())[: COUNT - 1])}
    texts = tuple(sorted(chosen, key=lambda text: hashlib.sha256(f"{key}\n{text}".encode()).hexdigest()))
    return Choices(texts, texts.index(truth) + 1, tuple(chosen[text] for text in texts))


def _stated(descriptions: Descriptions, candidates: Candidates, row: int) -> set[str]:
    """Poses that the question's words name."""
    stated = descriptions.stated_poses[int(candidates.name[row])]
    for codes in candidates.relations.values():
        stated = stated | STATED_POSES[int(codes[row])]
    return {POSES[code] for code in np.flatnonzero(stated).tolist()}


def _perturbed(
    scene: Scene, steps: Steps, descriptions: Descriptions, candidates: Candidates, row: int, rules: Rules
) -> Iterator[tuple[str, str]]:
    """(answer, perturbation) of every perturbed program that has an answer, the most telling first."""
    name = int(candidates.name[row])
    times = [int(frames[row]) for time, frames in sorted(candidates.frames.items()) if time.startswith("t")]
    track = tracks_of(scene, candidates, row)[candidates.template.target]
    for kind in ("hop.stop", "hop.skip"):
        # The people nearest to the target on the path come first.
        for perturbed in reversed(candidates.perturbed):
            if perturbed.kind == kind and perturbed.answer[row] != NOBODY:
                yield VALUES[perturbed.answer[row]], f"{kind}({perturbed.variant})"
    if candidates.template.pose_answer and candidates.template.read != ("t0",):
        own = _pose(scene, track, times[0])
        if own is not None:
            yield own, "pose at t0"
    for perturbed in candidates.perturbed:
        if perturbed.kind == "time.shift" and perturbed.answer[row] != NOBODY:
            yield VALUES[perturbed.answer[row]], f"time.shift {perturbed.variant}"
    if candidates.template.joins:
        return
    described = scene.persons(candidates.people["a"][row : row + 1])
    for condition, moments in zip(descriptions.of(name), descriptions.look_alikes(name), strict=True):
        for moment in moments[scene.persons(moments) != described].tolist():
            found = _followed(scene, steps, candidates, row, moment)
            answer = _read(scene, candidates, found, times, rules) if found is not None else None
            if answer is not None:
                yield answer, f"look-alike without {condition_text(condition)}"


def _followed(scene: Scene, steps: Steps, candidates: Candidates, row: int, moment: int) -> int | None:
    """Track of whoever a candidate's relations lead to from somebody else's moment; None where that is not certain."""
    path = [moment]
    for name in candidates.template.relations:
        low, high = np.searchsorted(steps.source, [path[-1], path[-1] + 1])
        relation = int(candidates.relations[name][row])
        place = low + int(np.searchsorted(steps.relation[low:high], relation))
        if place == high or steps.relation[place] != relation or steps.target[place] < 0 or steps.target[place] in path:
            return None
        path.append(int(steps.target[place]))
    return int(scene.tracks[scene.persons(np.array(path[-1:]))[0]])


def _read(scene: Scene, candidates: Candidates, track: int, times: list[int], rules: Rules) -> str | None:
    """What the template's program reads of a person at t0, t1, ...; None where it is unknown."""
    match candidates.template.spec.read:
        case "action":
            return _pose(scene, track, times[-1])
        case "next_action":
            return _next_pose(scene, track, times[0])
        case "presence":
            first, second = (_present(scene, track, time) for time in times[1:])
            if first is None or second is None:
                return None
            return PRESENCE_ANSWERS[(0 if second else 1) if first else (2 if second else 3)]
        case "distance_change":
            return _distance_change(scene, track, times, rules)
        case unknown:
            raise ValueError(f"the read {unknown!r} has no choices")


def _pose(scene: Scene, track: int, frame: int) -> str | None:
    line = scene.box_of(track, frame)
    pose = scene.poses[line] if line != NOBODY else NOBODY
    return POSES[pose] if pose != NOBODY else None


def _next_pose(scene: Scene, track: int, frame: int) -> str | None:
    """The pose at the first keyframe at which a person no longer has that of `frame`."""
    held = _pose(scene, track, frame)
    if held is None:
        return None
    later = scene.keyframes[np.searchsorted(scene.keyframes, frame, side="right") :].tolist()
    return next((pose for pose in (_pose(scene, track, one) for one in later) if pose != held), None)


def _present(scene: Scene, track: int, frame: int) -> bool | None:
    line = scene.box_of(track, frame)
    if line != NOBODY and scene.clear[line]:
        return True
    return False if scene.absent[scene.moment_of(track, frame)] else None


def _distance_change(scene: Scene, track: int, times: list[int], rules: Rules) -> str | None:
    lines = [scene.box_of(track, time) for time in times]
    if lines[0] == NOBODY or np.isnan(scene.distances[lines[0]]):
        return None
    if scene.absent[scene.moment_of(track, times[1])]:
        return DISTANCE_ANSWERS[3]
    if lines[1] == NOBODY or np.isnan(scene.distances[lines[1]]):
        return None
    nearer = scene.distances[lines[0]] - scene.distances[lines[1]]
    if abs(nearer) >= rules.distance_changed_m:
        return DISTANCE_ANSWERS[0 if nearer > 0 else 1]
    return DISTANCE_ANSWERS[2] if abs(nearer) < rules.distance_same_m else None


def _common_poses(scene: Scene, key: str) -> list[str]:
    """All poses, the commonest of the scene first; equally common ones by hash."""
    counts = np.bincount(scene.poses[scene.poses != NOBODY], minlength=len(POSES))
    ranks = {pose: hashlib.sha256(f"{key}\n{pose}\nfill".encode()).hexdigest() for pose in POSES}
    return sorted(POSES, key=lambda pose: (-int(counts[POSES.index(pose)]), ranks[pose]))
