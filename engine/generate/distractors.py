"""The four choices of a question: one is true, the others are wrong in ways that reveal how a method fails.

A distractor may be the answer of a perturbed program: at the description's time instead of the stated one, at a
shifted time, of a look-alike who could match when a condition is dropped; of sets that level the answers alike,
selection takes the one with the most of them. The others are poses known to be false for the target at the stated time.
Nothing unknown is ever a distractor, and no pose that the question states.

No two choices overlap each other. If only the true one were compared with the others, it would stand out as the pose
that overlaps none of them. For the same reason a pose question has several sets of choices, among which selection
picks one whose other members are true as often.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from jrdb_avr.engine.generate.candidates import VALUES, Candidates, stated_poses
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.scene import NOBODY, Scene
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS, choice_text, overlapping

CHOICE_COUNT: Final = 4

SETS: Final = 16
"""Sets of choices of one candidate that selection may pick from; those of the commonest poses."""

APART: Final = tuple(
    one
    for one in itertools.combinations(POSES, CHOICE_COUNT)
    if not any(other in overlapping(pose) for pose, other in itertools.combinations(one, 2))
)
"""Every four poses of which no two may be said of one person; the first hold the poses annotated most."""


@dataclass(frozen=True, slots=True)
class Choices:
    """The texts in their order, the number of the true one from 1, and per choice the perturbation that yields it."""

    texts: tuple[str, ...]
    true: int
    perturbations: tuple[str | None, ...]


def make_choices(context: SearchContext, candidates: Candidates, row: int, key: str) -> tuple[Choices, ...]:
    """The sets of four choices that a candidate may have; first those with most answers of perturbed programs."""
    truth = VALUES[candidates.answer[row]]
    sets: tuple[tuple[str, ...], ...] = (PRESENCE_ANSWERS if truth in PRESENCE_ANSWERS else DISTANCE_ANSWERS,)
    if candidates.template.pose_answer:
        (stated,) = stated_poses(context, candidates, slice(row, row + 1))
        barred = {POSES[code] for code in np.flatnonzero(stated).tolist()}
        frame = int(candidates.frames[candidates.template.decisive[-1]][row])
        barred |= context.onsets.possible_poses(_target(context.scene, candidates, row), frame) - {truth}
        sets = pose_sets(truth, frozenset(barred))
    return arrange(sets, truth, key, _perturbed(context, candidates, row))


def arrange(
    sets: tuple[tuple[str, ...], ...], truth: str, key: str, perturbed: Iterator[tuple[str, str]]
) -> tuple[Choices, ...]:
    """Order sets of answers by hash, those with most answers of perturbed programs first.

    Args:
        sets: Sets of four answers.
        truth: True answer.
        key: Key of the question, which is part of the hash.
        perturbed: Answers of perturbed programs with their names, the most telling first.

    Returns:
        The choices of each set.
    """
    texts = {text for one in sets for text in one}
    mistakes: dict[str, str] = {}
    for text, perturbation in perturbed:
        if text in texts and text != truth:
            mistakes.setdefault(text, perturbation)
        if len(mistakes) == len(texts) - 1:
            break
    ranks = {text: hashlib.sha256(f"{key}\n{text}".encode()).digest() for text in texts}
    found = [_ordered(one, truth, mistakes, ranks) for one in sets]
    return tuple(sorted(found, key=lambda choices: choices.perturbations.count(None)))


@lru_cache(1024)
def pose_sets(truth: str, barred: frozenset[str]) -> tuple[tuple[str, ...], ...]:
    """Return the sets of postures with a posture and without postures that may be no choice."""
    return tuple(one for one in APART if truth in one and not barred.intersection(one))[:SETS]


def _ordered(texts: tuple[str, ...], truth: str, mistakes: Mapping[str, str], ranks: Mapping[str, bytes]) -> Choices:
    """A set of choices in an order that says nothing."""
    order = sorted(texts, key=ranks.__getitem__)
    return Choices(tuple(map(choice_text, order)), order.index(truth) + 1, tuple(map(mistakes.get, order)))


def _target(scene: Scene, candidates: Candidates, row: int) -> int:
    """Track of the target."""
    return scene.track(int(candidates.people[candidates.template.target][row]))


def _perturbed(context: SearchContext, candidates: Candidates, row: int) -> Iterator[tuple[str, str]]:
    """(answer, perturbation) of every perturbed program that has an answer, the most telling first."""
    scene, template, name = context.scene, candidates.template, int(candidates.name[row])
    times = [int(frames[row]) for time, frames in sorted(candidates.frames.items()) if time.startswith("t")]
    read = _READERS[template.spec.read]
    answered = [result for result in candidates.perturbed if result.answer[row] != NOBODY]
    for kind in ("hop.stop", "hop.skip"):
        # The people nearest to the target on the path come first.
        for result in reversed([result for result in answered if result.kind == kind]):
            yield VALUES[result.answer[row]], f"{kind}({result.variant})"
    if template.pose_answer and template.read != ("t0",):
        own = _pose(context, _target(scene, candidates, row), times[:1])
        if own is not None:
            yield own, "pose at t0"
    for result in answered:
        if result.kind == "time.shift":
            yield VALUES[result.answer[row]], f"time.shift {result.variant}"
    if template.joins:
        return
    for condition, moments in context.descriptions.look_alikes(name):
        for moment in moments:
            end = _followed(context, candidates, row, moment)
            answer = read(context, scene.track(end), times) if end is not None else None
            if answer is not None:
                yield answer, f"look-alike without {condition.words}"


def _followed(context: SearchContext, candidates: Candidates, row: int, moment: int) -> int | None:
    """Where a candidate's relations lead from somebody else's moment; None where that is not certain."""
    path = [moment]
    for name in candidates.template.relations:
        reached = context.leads.get((path[-1], int(candidates.relations[name][row])))
        if reached is None or reached in path:
            return None
        path.append(reached)
    return path[-1]


# -- what the templates' programs read of a person at t0, t1, ...; None where it is unknown ---------------------------


def _pose(context: SearchContext, track: int, times: list[int]) -> str | None:
    line = context.scene.box_of(track, times[-1])
    pose = context.scene.poses[line] if line != NOBODY else NOBODY
    return POSES[pose] if pose != NOBODY else None


def _next_pose(context: SearchContext, track: int, times: list[int]) -> str | None:
    """The pose at the first keyframe at which a person no longer has that of t0."""
    held = _pose(context, track, times[:1])
    if held is None:
        return None
    keyframes = context.scene.keyframes
    later = keyframes[np.searchsorted(keyframes, times[0], side="right") :].tolist()
    return next((pose for pose in (_pose(context, track, [one]) for one in later) if pose != held), None)


def _presence(context: SearchContext, track: int, times: list[int]) -> str | None:
    scene, seen = context.scene, []
    for time in times[1:]:
        line = scene.box_of(track, time)
        clear = line != NOBODY and bool(scene.clear[line])
        if not clear and not scene.absent_at(track, time):
            return None
        seen.append(clear)
    return PRESENCE_ANSWERS[3 - 2 * seen[0] - seen[1]]


def _distance_change(context: SearchContext, track: int, times: list[int]) -> str | None:
    scene, rules = context.scene, context.rules
    lines = [scene.box_of(track, time) for time in times]
    before, after = (scene.distances.item(line) if line != NOBODY else math.nan for line in lines)
    if math.isnan(before):
        return None
    if scene.absent_at(track, times[1]):
        return DISTANCE_ANSWERS[3]
    if lines[1] == NOBODY or not scene.clear[lines[1]]:
        return None
    nearer = before - after
    if abs(nearer) >= rules.distance_changed_m:
        return DISTANCE_ANSWERS[0 if nearer > 0 else 1]
    return DISTANCE_ANSWERS[2] if abs(nearer) < rules.distance_same_m else None


_READERS: Final[dict[str, Callable[[SearchContext, int, list[int]], str | None]]] = {
    "action": _pose,
    "next_action": _next_pose,
    "presence": _presence,
    "distance_change": _distance_change,
}
