"""time.shift and time.drop of questions that hold the person and move the stated later time."""

from __future__ import annotations

import numpy as np

from jrdb_avr.engine.generate.candidates import Candidates, Effect, PerturbationResult, choice_codes, compared
from jrdb_avr.engine.generate.chains import beyond
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.keyframes import shift_frames
from jrdb_avr.engine.generate.scene import NOBODY, ints, match_rows


def held_person_proofs(context: SearchContext, candidates: Candidates) -> list[PerturbationResult]:
    """Both shifts and the drop."""
    shifts = [_shift(context, candidates, by) for by in shift_frames(context.rules)]
    scene = context.scene
    track = scene.tracks[scene.people(candidates.people[candidates.template.target])]
    # A candidate without a row has no answer at any keyframe: where the person who is read is never in clear view.
    read = context.query_once("necessity", f"{candidates.template.time_queries}_drop")
    row = match_rows([track, candidates.frames["t0"]], [ints(read, "a"), ints(read, "t0")])
    defined, answers = (np.append(ints(read, name), 0)[row] for name in ("defined", "answers"))
    return [*shifts, PerturbationResult.of_drop(defined, answers)]


def _shift(context: SearchContext, candidates: Candidates, by: int) -> PerturbationResult:
    """Read the answer with t1 moved; the person and t0 stay.

    The query leaves out unknown answers, and returns none where the person who is read is absent.
    """
    scene, t0, t1 = context.scene, candidates.frames["t0"], candidates.frames["t1"]
    read = context.query_once("necessity", f"{candidates.template.time_queries}_shift", by=by)
    keys = {"a": scene.tracks[scene.people(candidates.people[candidates.template.target])], "t0": t0, "t1": t1}
    names = [name for name in keys if name in read.column_names]
    row = match_rows([keys[name] for name in names], [ints(read, name) for name in names])
    # A last row stands for NOBODY.
    answer = np.append(choice_codes(read["answer"]), np.int8(NOBODY))[row]
    nothing = (answer == NOBODY) & (row != NOBODY)
    outcome = np.where(nothing, Effect.EMPTY, compared(answer, candidates.answer)).astype(np.int8)
    return PerturbationResult.of_shift(by, outcome, answer, (t1 + by <= t0) | beyond(context, t1 + by))
