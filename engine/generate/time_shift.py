"""time.shift and time.drop of questions that hold the person and move the asked times."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jrdb_avr.engine.generate.candidates import (
    DIFFERENT,
    EMPTY,
    OUTSIDE,
    SAME,
    UNKNOWN,
    Codes,
    Perturbed,
    ask,
    codes,
    ints,
    rows_of,
)
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.templates import Template


def asked_proofs(
    scene: Scene, graph: Graph, template: Template, rules: Rules, moments: Mapping[str, Ints], stored: Codes
) -> tuple[Perturbed, ...]:
    """Both shifts and the drop. `moments`: the target's moment at t0 and at the asked times."""
    step = frames(rules.shift_s)
    shifts = [_shift(scene, graph, template, rules, moments, stored, by) for by in (-step, step)]
    return (*shifts, _drop(scene, graph, template, rules, moments))


def _shift(
    scene: Scene,
    graph: Graph,
    template: Template,
    rules: Rules,
    moments: Mapping[str, Ints],
    stored: Codes,
    by: int,
) -> Perturbed:
    """Read the answer with all asked times moved together; the person and t0 stay.

    The query leaves out what is unknown, and gives no answer where the person who is read is absent.
    """
    times = {name: scene.frames(moment) for name, moment in moments.items()}
    read = ask(graph, "necessity", f"{template.time_queries}_shift", rules, by=by)
    row = rows_of(read, {f"at{name[1:]}": moment for name, moment in moments.items()}, limit=scene.moment_count)
    found = row != NOBODY
    answer = np.full(len(row), NOBODY, dtype=np.int8)
    answer[found] = codes(read["answer"])[row[found]]
    outcome = np.where(answer == stored, SAME, np.where(answer == NOBODY, EMPTY, DIFFERENT)).astype(np.int8)
    outcome[~found] = UNKNOWN
    outside = np.zeros(len(row), dtype=bool)
    for name, frame in times.items():
        if name != "t0":
            moved = frame + by
            outside |= (moved <= times["t0"]) | (moved < scene.keyframes[0]) | (moved > scene.keyframes[-1])
    outcome[outside] = OUTSIDE
    answer[outside] = NOBODY
    return Perturbed("time.shift", f"{by / FPS:+g} s", outcome, answer, either=True)


def _drop(scene: Scene, graph: Graph, template: Template, rules: Rules, moments: Mapping[str, Ints]) -> Perturbed:
    """same: every other keyframe at which the answer is known gives the same one; empty: it is known nowhere else."""
    read = ask(graph, "necessity", f"{template.time_queries}_drop", rules)
    keys = {"at0": moments["t0"]}
    if "t2" in moments:
        keys["spacing"] = scene.frames(moments["t2"]) - scene.frames(moments["t1"])
    row = rows_of(read, keys, limit=max(scene.moment_count, int(scene.keyframes[-1]) + 1))
    # Every candidate is among the keyframes counted, so each has its row.
    defined, answers = ints(read, "defined")[row], ints(read, "answers")[row]
    outcome = np.where(answers > 1, DIFFERENT, np.where(defined > 1, SAME, EMPTY)).astype(np.int8)
    return Perturbed("time.drop", "all keyframes", outcome, np.full(len(row), NOBODY, dtype=np.int8))
