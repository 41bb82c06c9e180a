"""time.shift and time.drop of questions that hold the person and move the stated later time."""

from __future__ import annotations

import numpy as np

from jrdb_avr.engine.generate.candidates import Candidates, Effect, PerturbationResult, choice_codes, compared
from jrdb_avr.engine.generate.chains import beyond, both_ways
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.scene import NOBODY, find_sorted, ints


def held_person_proofs(context: SearchContext, candidates: Candidates) -> list[PerturbationResult]:
    """Both shifts and the drop."""
    shifts = [_shift(context, candidates, by) for by in both_ways(context)]
    # A candidate without a row has no answer at any keyframe: where the person who is read is never in clear view.
    read = context.query("necessity", f"{candidates.template.time_queries}_drop")
    row = find_sorted(candidates.people[candidates.template.target], ints(read, "at0"))
    defined, answers = (np.append(ints(read, name), 0)[row] for name in ("defined", "answers"))
    return [*shifts, PerturbationResult.of_drop(defined, answers)]


def _shift(context: SearchContext, candidates: Candidates, by: int) -> PerturbationResult:
    """Read the answer with t1 moved; the person and t0 stay.

    The query leaves out unknown answers, and returns none where the person who is read is absent.
    """
    scene, t0, t1 = context.scene, candidates.frames["t0"], candidates.frames["t1"]
    read = context.query("necessity", f"{candidates.template.time_queries}_shift", by=by)
    moments = {"at0": candidates.people[candidates.template.target]}
    moments["at1"] = moments["at0"] + np.searchsorted(scene.keyframes, t1) - np.searchsorted(scene.keyframes, t0)
    key, keys = np.zeros(len(t0), dtype=np.int64), np.zeros(len(read), dtype=np.int64)
    # Rows are ordered by these columns, of which some queries read but the second.
    for name in [name for name in moments if name in read.column_names]:
        key, keys = key * scene.moment_count + moments[name], keys * scene.moment_count + ints(read, name)
    row = find_sorted(key, keys)
    # A last row stands for NOBODY.
    answer = np.append(choice_codes(read["answer"]), np.int8(NOBODY))[row]
    nothing = (answer == NOBODY) & (row != NOBODY)
    outcome = np.where(nothing, Effect.EMPTY, compared(answer, candidates.answer)).astype(np.int8)
    return PerturbationResult.of_shift(by, outcome, answer, (t1 + by <= t0) | beyond(context, t1 + by))
