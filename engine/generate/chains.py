"""Proofs about hops: the answer one hop early, with a hop left out, and at other times.

The statements give the answer of each perturbed program as a text: an answer, or the outcome where there is none.
"""

from __future__ import annotations

import re

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.action_onsets import start_of
from jrdb_avr.engine.generate.candidates import OUTCOMES, Candidates, Codes, Effect, PerturbationResult
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.keyframes import shift_frames
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.scene import NOBODY, Ints, coded, ints, masked, match_rows
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.arrays import Bools


def text_proofs(kind: str, found: pa.Table, paths: Candidates) -> list[PerturbationResult]:
    """The proofs of a kind that a statement answers in columns such as `stop_0`; `found` are the rows of the paths."""
    columns = [name for name in found.column_names if re.fullmatch(rf"{kind.removeprefix('hop.')}_\d", name)]
    return [PerturbationResult.of_texts(kind, name[-1], found[name], paths.answer) for name in columns]


def start_proofs(context: SearchContext, found: pa.Table, paths: Candidates) -> list[PerturbationResult]:
    """hop.stop and hop.skip of candidates whose answer is a start: that of somebody else is looked for."""
    a, b = (context.scene.tracks[context.scene.people(paths.people[node])] for node in "ab")
    skipped, outcome = ints(found, "skip_1_person"), coded(found["skip_1"], OUTCOMES)
    read = [("hop.stop", "0", a), ("hop.stop", "1", b), ("hop.skip", "1", skipped)]
    none = np.full(len(paths), NOBODY, dtype=np.int8)
    return [
        PerturbationResult(kind, variant, _starts(context, paths, who, outcome), none) for kind, variant, who in read
    ]


def _starts(context: SearchContext, paths: Candidates, tracks: Ints, nobody: Ints) -> Codes:
    """Effect of looking for the start of each candidate's action at somebody else; where that is nobody, `nobody`.

    Where no start of theirs is certain, it is unknown only if one could be near enough to score.
    """
    effects = nobody.astype(np.int8)
    for row in np.flatnonzero(tracks != NOBODY).tolist():
        track, segment = int(tracks[row]), int(paths.segments[0][row])
        stored = start_of(context.scene, segment)
        action = context.scene.segments["action"][segment].as_py()
        start = context.onsets.start(track, action, int(paths.frames["t0"][row]))
        if start is not None:
            effects[row] = Effect.SAME if same_answer(start, stored) else Effect.DIFFERENT
        else:
            could = context.onsets.could_start(track, action, stored)
            effects[row] = Effect.UNKNOWN if could else Effect.EMPTY
    return effects


def program_proofs(context: SearchContext, paths: Candidates) -> list[PerturbationResult]:
    """time.shift both ways and time.drop of the whole program: description and hops are read at other keyframes."""
    queries, results = paths.template.time_queries, []
    for by in shift_frames(context.rules):
        found = context.query("necessity", f"{queries}_shift", by=by)
        texts = found["answer"].take(masked(path_rows(paths, found)))
        one = PerturbationResult.of_texts("time.shift", "", texts, paths.answer)
        outside = beyond(context, paths.frames["t0"] + by)
        results.append(PerturbationResult.of_shift(by, one.outcome, one.answer, outside))
    found = context.query("necessity", f"{queries}_drop")
    wanted = [context.descriptions.texts[1][paths.name], *paths.relations.values()]
    among = [ints(found, "description"), *(coded(found[name], RELATIONS) for name in paths.relations)]
    row = match_rows(wanted, among)
    defined, answers = (np.append(ints(found, name), 0)[row] for name in ("defined", "answers"))
    return [*results, PerturbationResult.of_drop(defined, answers)]


def path_rows(paths: Candidates, found: pa.Table) -> Ints:
    """Per candidate its row among those of a query, by its name and what else both have; NOBODY where there is none."""
    wanted, among = [paths.name], [ints(found, "name")]
    for name in [name for name in paths.relations if name in found.column_names]:
        wanted.append(paths.relations[name])
        among.append(coded(found[name], RELATIONS))
    if "t1" in found.column_names:
        wanted.append(paths.frames["t1"])
        among.append(ints(found, "t1"))
    return match_rows(wanted, among)


def beyond(context: SearchContext, times: Ints) -> Bools:
    """Whether each frame lies before the first keyframe or after the last one."""
    # As slices: a sequence without keyframes has none to compare with, and nothing to compare.
    keyframes = context.scene.keyframes
    return np.asarray((times < keyframes[:1]) | (times > keyframes[-1:]))
