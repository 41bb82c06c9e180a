"""Candidates of a template in one scene, and which rule refuses each: all of it set-wise.

The generator query lists the candidates with what can be said of each by itself; the necessity queries read what the
perturbed programs answer, keyed by the moments they depend on, and are joined on here. The rules are tried in the
order of `RULES`; a candidate is refused by the first that fails.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.binding import parameters
from jrdb_avr.queries.handle import Graph
from jrdb_avr.schema.rules import Rules, frames
from jrdb_avr.schema.vocabulary import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS

from .scene import NOBODY, Bools, Ints, Scene
from .templates import Template, query_text, query_values

RULES: Final = ("anchor", "evidence", "image", "time.shift", "time.drop", "view.ahead")
"""Rules that refuse a candidate set-wise, in the order in which they are tried."""

PASSED: Final = len(RULES)

OUTCOMES: Final = ("same", "different", "ambiguous", "empty", "unknown", "outside")
_SAME, _DIFFERENT, _AMBIGUOUS, _EMPTY, _UNKNOWN, _OUTSIDE = range(len(OUTCOMES))

VALUES: Final = POSES + PRESENCE_ANSWERS + DISTANCE_ANSWERS
"""Every choice answer; coded columns are indices into it, NOBODY for none."""

Codes = npt.NDArray[np.int8]


@dataclass(frozen=True)
class Shift:
    """time.shift by a number of frames: per candidate the outcome and the answer that was read."""

    by: int
    outcome: Codes
    answer: Codes


@dataclass(frozen=True)
class Candidates:
    """All candidates of a template, one per entry of each column, in the generator's order.

    name: number of the description given; frames: by name, `t0`, the stated times and of events `start`, `end`,
    `first`, `last`; segment: row in the scene's segments or NOBODY; answer: index into VALUES, or NOBODY for events;
    rule: index into RULES of the first that refuses, else PASSED.
    """

    template: Template
    name: Ints
    segment: Ints
    frames: Mapping[str, Ints]
    answer: Codes
    rule: Codes
    shifts: tuple[Shift, ...]
    drop: Codes

    def __len__(self) -> int:
        return len(self.name)

    def refusals(self) -> dict[str, int]:
        """Candidates refused, by rule."""
        counts = np.bincount(self.rule, minlength=PASSED + 1)
        return {rule: int(count) for rule, count in zip(RULES, counts, strict=False) if count}


def find_candidates(scene: Scene, graph: Graph, template: Template, rules: Rules) -> Candidates:
    """Search a scene's graph for a template and judge what is found."""
    found = _ask(graph, "generators", template.name, rules)
    count = len(found)
    moments = {f"t{i}": _ints(found, f"at{i}") for i in range(3) if f"at{i}" in found.column_names}
    times = {name: scene.frames(moment) for name, moment in moments.items()}
    segment = np.full(count, NOBODY)
    if "segment" in found.column_names:
        segment = _ints(found, "segment")
        for name in ("first", "last", "start", "end"):
            times[name] = scene.segments[name].to_numpy().astype(np.int64)[segment]
    answer = np.full(count, NOBODY, dtype=np.int8)
    if template.answer is None:
        answer = _codes(found["answer"], VALUES)
    holds = {
        "anchor": _flags(found, "anchor"),
        "evidence": _flags(found, "evidence"),
        "image": _flags(found, "image"),
        "view.ahead": ~_flags(found, "ahead"),
    }
    shifts: tuple[Shift, ...] = ()
    drop = np.full(count, _DIFFERENT, dtype=np.int8)
    if template.time_proof == "moved" and count:
        step = frames(rules.shift_s)
        shifts = tuple(_shift(scene, graph, template, rules, moments, times, answer, by) for by in (-step, step))
        drop = _drop(scene, graph, template, rules, moments, times)
        proving = [np.isin(shift.outcome, (_DIFFERENT, _AMBIGUOUS, _EMPTY)) for shift in shifts]
        holds["time.shift"] = np.logical_or.reduce(proving)
        holds["time.drop"] = drop != _SAME
    rule = np.full(count, PASSED, dtype=np.int8)
    for number in reversed(range(len(RULES))):
        if RULES[number] in holds:
            rule[~holds[RULES[number]]] = number
    return Candidates(template, _ints(found, "name"), segment, times, answer, rule, shifts, drop)


def _ask(graph: Graph, folder: str, name: str, rules: Rules, **more: int) -> pa.Table:
    text = query_text(folder, name)
    assert text is not None, f"queries/{folder}/{name}.cypher is part of the package"
    values = query_values(rules) | more
    return graph.query(text, {key: values[key] for key in parameters(text)})


def _shift(
    scene: Scene,
    graph: Graph,
    template: Template,
    rules: Rules,
    moments: Mapping[str, Ints],
    times: Mapping[str, Ints],
    stored: Codes,
    by: int,
) -> Shift:
    """Read the answer with all asked times moved together; the person and t0 stay.

    The query leaves out what is unknown, and gives no answer where the person who is read is absent.
    """
    read = _ask(graph, "necessity", f"{template.name}_shift", rules, by=by)
    row = _rows(read, {f"at{name[1:]}": moment for name, moment in moments.items()}, limit=scene.moment_count)
    found = row != NOBODY
    answer = np.full(len(row), NOBODY, dtype=np.int8)
    answer[found] = _codes(read["answer"], VALUES)[row[found]]
    outcome = np.where(answer == stored, _SAME, np.where(answer == NOBODY, _EMPTY, _DIFFERENT)).astype(np.int8)
    outcome[~found] = _UNKNOWN
    asked = [frame + by for name, frame in times.items() if name != "t0"]
    outside = np.zeros(len(row), dtype=bool)
    for frame in asked:
        outside |= (frame <= times["t0"]) | (frame < scene.keyframes[0]) | (frame > scene.keyframes[-1])
    outcome[outside] = _OUTSIDE
    answer[outside] = NOBODY
    return Shift(by, outcome, answer)


def _drop(
    scene: Scene,
    graph: Graph,
    template: Template,
    rules: Rules,
    moments: Mapping[str, Ints],
    times: Mapping[str, Ints],
) -> Codes:
    """same: every other keyframe at which the answer is known gives the same one; empty: it is known nowhere else."""
    read = _ask(graph, "necessity", f"{template.name}_drop", rules)
    keys = {"at0": moments["t0"]}
    if "t2" in times:
        keys["spacing"] = times["t2"] - times["t1"]
    row = _rows(read, keys, limit=max(scene.moment_count, int(scene.keyframes[-1]) + 1))
    # Every candidate is among the keyframes counted, so each has its row.
    defined, answers = _ints(read, "defined")[row], _ints(read, "answers")[row]
    outcome = np.where(answers > 1, _DIFFERENT, np.where(defined > 1, _SAME, _EMPTY))
    return outcome.astype(np.int8)


def _rows(read: pa.Table, keys: Mapping[str, Ints], limit: int) -> Ints:
    """For each entry of `keys`, the row of `read` with the same values in the columns they share, else NOBODY.

    All values are below `limit`, and no two rows of `read` are alike in these columns.
    """
    count = len(next(iter(keys.values())))
    given, wanted = np.zeros(len(read), dtype=np.int64), np.zeros(count, dtype=np.int64)
    for name, values in keys.items():
        if name in read.column_names:
            given = given * limit + _ints(read, name)
            wanted = wanted * limit + values
    if len(read) == 0:
        return np.full(count, NOBODY)
    order = np.argsort(given, kind="stable")
    place = np.minimum(np.searchsorted(given[order], wanted), len(read) - 1)
    row = order[place]
    return np.where(given[row] == wanted, row, NOBODY)


def _ints(table: pa.Table, name: str) -> Ints:
    return np.asarray(table[name].to_numpy(), dtype=np.int64)


def _flags(table: pa.Table, name: str) -> Bools:
    return np.asarray(pc.fill_null(table[name], False).to_numpy(), dtype=bool)


def _codes(column: pa.ChunkedArray, words: tuple[str, ...]) -> Codes:
    found = pc.index_in(column.cast(pa.string()), value_set=pa.array(words))
    return np.asarray(pc.fill_null(found, NOBODY).to_numpy(), dtype=np.int8)
