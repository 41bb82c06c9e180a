"""Whom people are in a relation with over time: everybody they meet from a keyframe on, as long as that is known.

At a keyframe it is known who is in a relation with a person where the person has a box and those who could be in it are
exactly those who certainly are. An *encounter window* is a person's from one keyframe to the last one through which
that is known; it *meets* everybody who is in the relation at any keyframe of it. Where every frame is annotated,
whoever could be in it between two keyframes must be met at a keyframe too, or the number would not hold of all frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.relations import GROUP, KIND, RELATIONS, SOCIAL, Facts, find_facts, unknown_others
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, ints, masked, named
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.rules import Rules, frames


def encounter_tables(scene: Scene, facts: Facts, rules: Rules) -> dict[str, pa.Table]:
    """The graph's tables `Encounter`, `Begins` and `Meets`: the encounter windows that begin at any moment, reach over
    `long_wait_s` and meet `count_min` people or more.

    Encounter: the relation, and `until`, the last keyframe's frame. Meets, sorted by window and person: the first
    keyframe at which the meeting is certain (met), at which besides both are in clear view (clear_from), and by which
    it could have been between two keyframes (maybe); null for none.
    """
    every = _at_every_frame(scene)
    lines = np.unique(_lines_of(scene, facts, _counted(facts)))
    at_keyframes, between = _Rows.of(scene, facts, lines), _Rows.of(every, find_facts(every), lines)
    count, frames_between = len(scene.keyframes), _between(scene, every)
    pairs = np.union1d(at_keyframes.pair, between.pair)
    of_line, other = pairs // len(scene.tracks), pairs % len(scene.tracks)

    def marked(rows: _Rows, which: Bools, place: Ints) -> Bools:
        marks = np.zeros((len(pairs), count), bool)
        marks[np.searchsorted(pairs, rows.pair[which]), place[rows.keyframe[which]]] = True
        return marks

    certain = marked(at_keyframes, at_keyframes.certain, np.arange(count))
    could = marked(between, frames_between[between.keyframe] != NOBODY, frames_between)
    both = certain & scene.present[lines[of_line] // len(RELATIONS)] & scene.present[other]
    met, clear, maybe = _next(certain), _next(both), _next(could) + 1
    until = _known_until(scene, lines, at_keyframes, between, frames_between)
    within = met <= until[of_line]
    people = np.zeros((len(lines), count), np.int64)
    np.add.at(people, of_line, within)
    reach = np.where(until == NOBODY, 0, scene.keyframes[until] - scene.keyframes)
    begins = (reach >= frames(rules.long_wait_s)) & (people >= rules.count_min)
    line, start = np.nonzero(begins)
    number = np.full(begins.shape, NOBODY)
    number[begins] = np.arange(len(line))
    row, place = np.nonzero((within | (maybe <= until[of_line])) & begins[of_line])
    order = np.lexsort((other[row], number[of_line[row], place]))
    row, place = row[order], place[order]
    clock = np.append(scene.keyframes, [NOBODY, NOBODY])
    times = {name: clock[first[row, place]] for name, first in (("met", met), ("clear_from", clear), ("maybe", maybe))}
    windows = {
        "id": np.arange(len(line)),
        "relation": named(lines[line] % len(RELATIONS), RELATIONS),
        "until": scene.keyframes[until[line, start]],
    }
    meets = {
        "from": number[of_line[row], place],
        "to": other[row],
        **{name: masked(column) for name, column in times.items()},
        "image": scene.has_image(times["clear_from"]),
    }
    moment = lines[line] // len(RELATIONS) * count + start
    edges = {"from": moment, "to": windows["id"]}
    return {"Encounter": pa.table(windows), "Begins": pa.table(edges), "Meets": pa.table(meets)}


@dataclass(frozen=True)
class _Rows:
    """Facts of the lines of a scene (a line is a person with a relation): line, other person, keyframe's number."""

    line: Ints
    pair: Ints
    keyframe: Ints
    certain: Bools
    unknown: Ints

    @classmethod
    def of(cls, scene: Scene, facts: Facts, lines: Ints) -> _Rows:
        """`unknown` is (lines, keyframes): how many others could be in the relation for want of knowledge alone."""
        rows = _counted(facts)
        rows = rows[np.isin(_lines_of(scene, facts, rows), lines)]
        line = np.searchsorted(lines, _lines_of(scene, facts, rows))
        source, target = facts.source[rows], facts.target[rows]
        count = len(scene.keyframes)
        moments = (lines // len(RELATIONS))[:, None] * count + np.arange(count)
        unknown = unknown_others(scene, facts.known)[KIND[lines % len(RELATIONS)][:, None], moments]
        unknown[scene.moment_rows[moments] == NOBODY] = 0
        # Those of whom nothing is known and who have a fact are known by it.
        np.subtract.at(unknown, (line, source % count), facts.unread[rows])
        pair = line * len(scene.tracks) + target // count
        return cls(line, pair, source % count, facts.certain[rows], unknown)


def _counted(facts: Facts) -> Ints:
    """The facts of relations whose people may be counted."""
    return np.flatnonzero(np.isin(KIND[facts.relation], (SOCIAL, GROUP)))


def _lines_of(scene: Scene, facts: Facts, rows: Ints) -> Ints:
    return facts.source[rows] // len(scene.keyframes) * len(RELATIONS) + facts.relation[rows]


def _at_every_frame(scene: Scene) -> Scene:
    """The scene as if every frame with a box were a keyframe, without the relations that are not counted."""
    every = np.union1d(scene.keyframes, ints(scene.boxes, "frame"))
    return replace(scene, keyframes=every, beside=scene.beside.slice(0, 0))


def _between(scene: Scene, every: Scene) -> Ints:
    """Per frame, the number of the keyframe before it; NOBODY at a keyframe, before the first and after the last."""
    before = np.searchsorted(scene.keyframes, every.keyframes, side="right") - 1
    outside = np.isin(every.keyframes, scene.keyframes) | (before == len(scene.keyframes) - 1)
    return np.where(outside, NOBODY, before)


def _known_until(scene: Scene, lines: Ints, at_keyframes: _Rows, between: _Rows, frames_between: Ints) -> Ints:
    """(lines, keyframes): the last keyframe through which it is known from this one on who is met, or NOBODY."""
    count = len(scene.keyframes)
    moments = (lines // len(RELATIONS))[:, None] * count + np.arange(count)
    known = (scene.moment_rows[moments] != NOBODY) & (at_keyframes.unknown == 0)
    unsure = ~at_keyframes.certain
    known[at_keyframes.line[unsure], at_keyframes.keyframe[unsure]] = False
    # Where nothing is known of somebody between two keyframes, nothing leads from the one to the other.
    broken = np.zeros((len(lines), count), bool)
    line, frame = np.nonzero((between.unknown > 0) & (frames_between != NOBODY))
    broken[line, frames_between[frame]] = True
    return np.where(known, np.minimum(_next(~known) - 1, _next(broken)), NOBODY)


def _next(marks: Bools) -> Ints:
    """Per row and place the first place from there on that is marked; the number of places where there is none."""
    count = marks.shape[1]
    places = np.where(marks, np.arange(count), count)
    return np.minimum.accumulate(places[:, ::-1], axis=1)[:, ::-1]
