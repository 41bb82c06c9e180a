"""Candidates of the template presence: somebody described at t0, and whether that person is in view at two later times.

Every description goes with every pair of later times, so the number of candidates grows with the cube of a sequence's
keyframes; whether one stands depends on the description, on the pair, or on the description and how far apart the two
times are. The graph gives the descriptions and the pairs; the candidates are put together here, as small numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.candidates import (
    DIFFERENT,
    EMPTY,
    OUTSIDE,
    SAME,
    UNKNOWN,
    VALUES,
    Candidates,
    Codes,
    Perturbed,
    ask,
    codes,
    first_refusing,
    ints,
    proven_rules,
)
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, flags
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import PRESENCE_ANSWERS
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.templates import Template


@dataclass(frozen=True)
class _Pairs:
    """Pairs of later times by person, first and second time: moments, keyframes' numbers, and what is read there.

    spacing: how many frames the two lie apart, as a number among `spacings`.
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
        """`away`: the person is in view at neither time, and whoever answers looks at the box at t0."""
        at1, at2 = ints(found, "at1"), ints(found, "at2")
        spacings, spacing = np.unique(scene.frames(at2) - scene.frames(at1), return_inverse=True)
        away = np.asarray(pc.is_null(found["ahead"]).to_numpy(), dtype=bool)
        answer = codes(found["answer"])
        return cls(at1, at2, spacing, spacings, answer, flags(found, "image"), flags(found, "ahead"), away)


def find_presence(scene: Scene, graph: Graph, template: Template, rules: Rules) -> Candidates:
    """Search a scene's graph for the candidates of presence and judge them, by moment at t0, t1 and t2."""
    described = ask(graph, "generators", "described", rules)
    pairs = _Pairs.of(scene, ask(graph, "generators", "presence", rules))
    at0 = ints(described, "at0")
    # Pairs lie by person and first time: those of a description are the last ones of the person.
    after = np.searchsorted(scene.keyframes, scene.frames(at0) + frames(rules.min_wait_s))
    person = scene.persons(at0) * len(scene.keyframes)
    low = np.searchsorted(pairs.at1, person + after)
    size = np.searchsorted(pairs.at1, person + len(scene.keyframes)) - low
    row = np.repeat(np.arange(len(at0), dtype=np.int32), size)
    offset = (low - (np.cumsum(size) - size)).astype(np.int32)
    pair = np.arange(len(row), dtype=np.int32) + offset[row]
    times = {
        "t0": scene.frames(at0).astype(np.int32)[row],
        "t1": scene.frames(pairs.at1).astype(np.int32)[pair],
        "t2": scene.frames(pairs.at2).astype(np.int32)[pair],
    }
    answer = pairs.answer[pair]
    perturbed = (
        *(_shift(scene, graph, pairs, rules, row, pair, times, by) for by in _both_ways(rules)),
        _drop(scene, pairs, person // max(len(scene.keyframes), 1), after, row, pair),
    )
    holds = {
        "anchor": flags(described, "anchor")[row],
        "evidence": flags(described, "evidence")[row],
        "image": flags(described, "image")[row] & pairs.image[pair],
        "view.ahead": ~np.where(pairs.away[pair], flags(described, "ahead")[row], pairs.ahead[pair]),
        **proven_rules(perturbed),
    }
    none = np.broadcast_to(np.int64(NOBODY), row.shape)
    return Candidates(
        template=template,
        name=ints(described, "name").astype(np.int32)[row],
        people={"a": at0.astype(np.int32)[row]},
        relations={},
        segment=none,
        segment2=none,
        frames=times,
        answer=answer,
        value=np.broadcast_to(np.nan, row.shape),
        rule=first_refusing(holds, len(row)),
        perturbed=perturbed,
    )


def _both_ways(rules: Rules) -> tuple[int, int]:
    return -frames(rules.shift_s), frames(rules.shift_s)


def _shift(
    scene: Scene, graph: Graph, pairs: _Pairs, rules: Rules, row: Ints, pair: Ints, times: dict[str, Ints], by: int
) -> Perturbed:
    """Both times moved by so many frames, the person and t0 held."""
    found = ask(graph, "necessity", "presence_shift", rules, by=by)
    seen = np.full(scene.moment_count, NOBODY)
    seen[ints(found, "at")] = ints(found, "seen")
    first, second = seen[pairs.at1], seen[pairs.at2]
    known = (first != NOBODY) & (second != NOBODY)
    read = np.where(known, _READ[2 * first + second], NOBODY).astype(np.int8)
    outcome = np.where(known, np.where(read == pairs.answer, SAME, DIFFERENT), UNKNOWN).astype(np.int8)
    for at in (pairs.at1, pairs.at2):
        moved = scene.frames(at) + by
        # As slices: a sequence without keyframes has none to compare with, and nothing to compare.
        beyond = (moved < scene.keyframes[:1]) | (moved > scene.keyframes[-1:])
        outcome[beyond], read[beyond] = OUTSIDE, NOBODY
    outcome, read = outcome[pair], read[pair]
    before = times["t1"] + by <= times["t0"]
    outcome[before], read[before] = OUTSIDE, NOBODY
    return Perturbed("time.shift", f"{by / FPS:+g} s", outcome, read, either=True)


_READ = np.array([VALUES.index(answer) for answer in reversed(PRESENCE_ANSWERS)])
"""Answer by how the person is seen: 2 for the first time and 1 for the second."""


def _drop(scene: Scene, pairs: _Pairs, person: Ints, after: Ints, row: Ints, pair: Ints) -> Perturbed:
    """same: all pairs of keyframes equally far apart that could be asked after t0 give one answer; empty: there is no
    other. `person` and `after`, the first keyframe that could be t1, are those of the descriptions."""
    count, kinds = len(scene.keyframes), len(pairs.spacings)
    line = scene.persons(pairs.at1) * kinds + pairs.spacing
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
    outcome = np.where(answers > 1, DIFFERENT, np.where(high - low > 1, SAME, EMPTY)).astype(np.int8)
    drop = outcome[row, pairs.spacing[pair]]
    return Perturbed("time.drop", "all keyframes", drop, np.broadcast_to(np.int8(NOBODY), drop.shape))
