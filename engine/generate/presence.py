"""Candidates of the template presence: somebody described at t0, and whether that person is in view at two later times.

Every description goes with every pair of later times, so the number of candidates grows with the cube of a sequence's
keyframes; whether one stands depends on the description, on the pair, or on the description and how far apart the two
times are. The graph gives the descriptions and the pairs; the candidates are put together here, as small numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.candidates import (
    VALUES,
    Candidates,
    Codes,
    PerturbationResult,
    choice_codes,
    compared,
    first_refusing,
    proven_rules,
)
from jrdb_avr.engine.generate.chains import beyond
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.keyframes import shift_frames
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, flags, ints
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import PRESENCE_ANSWERS
from jrdb_avr.schema.rules import frames
from jrdb_avr.schema.templates import Template


@dataclass(frozen=True)
class _Pairs:
    """Pairs of later times by person, first and second time: moments, and what is read there.

    spacing: how many frames the two lie apart, as a number among `spacings`. away: the person is in view at neither
    time, and whoever answers looks at the box at t0.
    """

    at1: Ints
    at2: Ints
    spacing: Ints
    spacings: Ints
    answer: Codes
    image: Bools
    ahead: Bools
    away: Bools

    @classmethod
    def of(cls, scene: Scene, found: pa.Table) -> _Pairs:
        at1, at2 = (scene.moments(ints(found, "a"), ints(found, time)) for time in ("t1", "t2"))
        spacings, spacing = np.unique(scene.frames(at2) - scene.frames(at1), return_inverse=True)
        away = np.asarray(pc.is_null(found["ahead"]).to_numpy(), dtype=bool)
        answer = choice_codes(found["answer"])
        return cls(at1, at2, spacing, spacings, answer, flags(found, "image"), flags(found, "ahead"), away)


def find_presence(context: SearchContext, template: Template) -> Candidates:
    """Search a scene's graph for the candidates of presence and judge them, by moment at t0, t1 and t2."""
    scene = context.scene
    described = context.query("generators", "described")
    pairs = _Pairs.of(scene, context.query("generators", "presence"))
    at0 = scene.moments(ints(described, "a"), ints(described, "t0"))
    # Pairs lie by person and first time: those of a description are the last ones of the person.
    after = np.searchsorted(scene.keyframes, scene.frames(at0) + frames(context.rules.min_wait_s))
    person = scene.people(at0)
    low = np.searchsorted(pairs.at1, person * len(scene.keyframes) + after)
    size = np.searchsorted(pairs.at1, (person + 1) * len(scene.keyframes)) - low
    row = np.repeat(np.arange(len(at0), dtype=np.int32), size)
    offset = (low - (np.cumsum(size) - size)).astype(np.int32)
    pair = np.arange(len(row), dtype=np.int32) + offset[row]
    times = {
        "t0": scene.frames(at0).astype(np.int32)[row],
        "t1": scene.frames(pairs.at1).astype(np.int32)[pair],
        "t2": scene.frames(pairs.at2).astype(np.int32)[pair],
    }
    perturbed = (
        *(_shift(context, pairs, pair, times, by) for by in shift_frames(context.rules)),
        _drop(scene, pairs, person, after, row, pair),
    )
    alone = {rule: flags(described, rule)[row] for rule in ("anchor", "evidence", "image", "ahead")}
    holds = {
        "anchor": alone["anchor"],
        "evidence": alone["evidence"],
        "image": alone["image"] & pairs.image[pair],
        "view.ahead": ~np.where(pairs.away[pair], alone["ahead"], pairs.ahead[pair]),
        **proven_rules(perturbed, context.rules),
    }
    none = np.broadcast_to(np.int64(NOBODY), row.shape)
    return Candidates(
        template=template,
        name=ints(described, "name").astype(np.int32)[row],
        people={"a": at0.astype(np.int32)[row]},
        relations={},
        segments=(none, none),
        frames=times,
        answer=pairs.answer[pair],
        value=np.broadcast_to(np.nan, row.shape),
        window=none,
        rule=first_refusing(holds, len(row)),
        perturbed=perturbed,
    )


def _shift(context: SearchContext, pairs: _Pairs, pair: Ints, times: dict[str, Ints], by: int) -> PerturbationResult:
    """Both times moved by so many frames, the person and t0 held."""
    scene = context.scene
    found = context.query("necessity", "presence_shift", by=by)
    seen = np.full(scene.moment_count, NOBODY)
    seen[scene.moments(ints(found, "a"), ints(found, "frame"))] = ints(found, "seen")
    first, second = seen[pairs.at1], seen[pairs.at2]
    known = (first != NOBODY) & (second != NOBODY)
    answer = np.where(known, _READ[2 * first + second], NOBODY).astype(np.int8)
    outside = beyond(context, scene.frames(pairs.at1) + by) | beyond(context, scene.frames(pairs.at2) + by)
    outside = outside[pair] | (times["t1"] + by <= times["t0"])
    return PerturbationResult.of_shift(by, compared(answer, pairs.answer)[pair], answer[pair], outside)


_READ = np.array([VALUES.index(answer) for answer in reversed(PRESENCE_ANSWERS)])
"""Answer by how the person is seen: 2 for the first time and 1 for the second."""


def _drop(scene: Scene, pairs: _Pairs, person: Ints, after: Ints, row: Ints, pair: Ints) -> PerturbationResult:
    """The pairs of keyframes equally far apart that could be t1 and t2. `person` and `after`, the first keyframe that
    could be t1, are those of the descriptions."""
    count, kinds = len(scene.keyframes), len(pairs.spacings)
    line = scene.people(pairs.at1) * kinds + pairs.spacing
    key = line * count + pairs.at1 % max(count, 1)
    order = np.argsort(key)
    lines = person[:, None] * kinds + np.arange(kinds)
    low = np.searchsorted(key[order], lines * count + after[:, None])
    high = np.searchsorted(key[order], (lines + 1) * count)
    answers = np.zeros(low.shape, np.int8)
    for answer in np.unique(pairs.answer):
        # How many pairs before each give this answer.
        before = np.append(0, np.cumsum(pairs.answer[order] == answer))
        answers += before[high] > before[low]
    drop = PerturbationResult.of_drop(high - low, answers)
    place = row, pairs.spacing[pair]
    return replace(drop, outcome=drop.outcome[place], answer=np.broadcast_to(np.int8(NOBODY), row.shape))
