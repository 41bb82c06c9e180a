"""Proofs about hops: the answer one hop early, with a hop left out, and at other times.

Candidates are copied into the scene's graph as nodes, `(Path)-[:Of]->(Description)` and `(Path)-[:From]->(Moment)`, and
the perturbed programs walk from there along `Step` and `Fits`, which lead somewhere from every moment: to the one
person who can be meant, or to one of the nodes that stand for the reason why there is none.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.action_onsets import start_of
from jrdb_avr.engine.generate.candidates import Candidates, Codes, Effect, PerturbationResult, compared
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.scene import NO_MATCH, NOBODY, SEVERAL, UNDECIDED, Ints, ints, named
from jrdb_avr.engine.generate.search_graph import add_table
from jrdb_avr.schema.answers import same_answer
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.rules import frames

BLOCK: Final = 20_000
"""Paths whose perturbed programs are run at once: at every keyframe of a crowded scene they are millions."""

Read = tuple[Codes, Codes]
"""Effect and answer of a perturbed program, per candidate."""


@contextlib.contextmanager
def paths_in_graph(context: SearchContext, paths: Candidates) -> Iterator[None]:
    """The candidates as nodes of the scene's graph, for as long as the block lasts."""
    number = np.arange(len(paths))
    nowhere = np.full(len(paths), NOBODY)
    relations = {name: named(paths.relations.get(name, nowhere), RELATIONS) for name in ("r1", "r2", "r3")}
    tables = {
        "Path": {"id": number, "t": paths.frames["t0"], **relations},
        "From": {"from": number, "to": paths.people["a"]},
        "Of": {"from": number, "to": context.descriptions.texts[1][paths.name]},
    }
    for name, columns in tables.items():
        add_table(context.graph, name, pa.table(columns))
    try:
        yield
    finally:
        for name in reversed(tables):
            context.graph.execute(f"DROP TABLE `{name}`")


def in_blocks(
    context: SearchContext, paths: Candidates, prove: Callable[[Candidates], Sequence[PerturbationResult]]
) -> tuple[PerturbationResult, ...]:
    """The proofs of all candidates, made block by block, with the candidates of the block in the graph."""
    blocks = []
    for start in range(0, len(paths), BLOCK):
        block = paths.take(np.arange(start, min(start + BLOCK, len(paths))))
        with paths_in_graph(context, block):
            blocks.append(prove(block))
    return tuple(
        replace(
            same[0],
            outcome=np.concatenate([result.outcome for result in same]),
            answer=np.concatenate([result.answer for result in same]),
        )
        for same in zip(*blocks, strict=True)
    )


def chain_proofs(context: SearchContext, paths: Candidates) -> list[PerturbationResult]:
    """The proofs of candidates whose hops follow one another.

    hop.stop for every earlier person, hop.skip for every hop but the last: to leave out the last one is to stop one
    person early. time.shift and time.drop where the whole program moves.
    """

    def read(stages: Sequence[Ints]) -> Read:
        return read_people(context, paths, last_person(stages))

    nodes = paths.template.people
    stops = [PerturbationResult("hop.stop", str(i), *read([paths.people[node]])) for i, node in enumerate(nodes[:-1])]
    skips = []
    for skipped in range(1, len(paths.template.edges)):
        found = context.query("necessity", f"{_HOPS[len(nodes) - 1]}_skip", skipped=skipped)
        stages = [paths.people["a"], *(scatter_by_id(found, node, len(paths)) for node in nodes[1:-1])]
        skips.append(PerturbationResult("hop.skip", str(skipped), *read(stages)))
    if paths.template.time_proof != "program":
        return [*stops, *skips]
    shifts = program_shifts(context, paths, nodes, read)
    found = context.query("necessity", f"{paths.template.time_queries}_drop")
    defined, answers = (scatter_by_id(found, name, len(paths), 0) for name in ("defined", "answers"))
    return [*stops, *skips, *shifts, PerturbationResult.of_drop(defined, answers)]


_HOPS: Final = {2: "two_hop", 3: "three_hop"}


def program_shifts(
    context: SearchContext, paths: Candidates, nodes: Sequence[str], read: Callable[[Sequence[Ints]], Read]
) -> list[PerturbationResult]:
    """time.shift of the whole program, both ways: description and hops are read anew at another keyframe, which gives
    the people at these nodes."""
    results = []
    for by in both_ways(context):
        found = context.query("necessity", f"{paths.template.time_queries}_shift", by=by)
        outcome, answer = read([scatter_by_id(found, node, len(paths)) for node in nodes])
        outside = beyond(context, paths.frames["t0"] + by)
        results.append(PerturbationResult.of_shift(by, outcome, answer, outside))
    return results


def both_ways(context: SearchContext) -> tuple[int, int]:
    """By how many frames time.shift moves: earlier and later."""
    step = frames(context.rules.shift_s)
    return -step, step


def beyond(context: SearchContext, times: Ints) -> Bools:
    """Whether each frame lies before the first keyframe or after the last one."""
    # As slices: a sequence without keyframes has none to compare with, and nothing to compare.
    keyframes = context.scene.keyframes
    return np.asarray((times < keyframes[:1]) | (times > keyframes[-1:]))


def scatter_by_id(found: pa.Table, name: str, count: int, missing: int = UNDECIDED) -> Ints:
    """A column of a query's rows by the path's id; of moments, at a time that is no keyframe nothing is known."""
    numbers = np.full(count, missing)
    numbers[ints(found, "id")] = ints(found, name)
    return numbers


def last_person(stages: Sequence[Ints]) -> Ints:
    """Where programs that pass through these people end, by their moments; one that comes back to somebody is empty."""
    reached = stages[0]
    for place, moment in enumerate(stages[1:], 1):
        back = np.any([moment == earlier for earlier in stages[:place]], axis=0)
        reached = np.where(reached < 0, reached, np.where(back, NO_MATCH, moment))
    return reached


def read_people(context: SearchContext, paths: Candidates, moment: Ints) -> Read:
    """Effect and answer of reading these people, by their moments at t0, in place of the candidates' targets."""
    scene = context.scene
    answer = np.full(len(paths), NOBODY, dtype=np.int8)
    nobody = [moment == NO_MATCH, moment == SEVERAL]
    outcome = np.select(nobody, [Effect.EMPTY, Effect.AMBIGUOUS], Effect.UNKNOWN).astype(np.int8)
    there = np.flatnonzero(moment >= 0)
    if paths.template.spec.read == "start_view":
        for row in there.tolist():
            outcome[row] = _read_start(context, paths, row, int(moment[row]))
        return outcome, answer
    at = moment[there]
    if "t1" in paths.frames:
        keyframe = np.searchsorted(scene.keyframes, paths.frames["t1"][there])
        at = scene.people(at) * len(scene.keyframes) + keyframe
    answer[there] = scene.moment_poses[at]
    # Of somebody who is absent at t1 nothing is read.
    outcome[there] = np.where(scene.absent[at], Effect.EMPTY, compared(answer[there], paths.answer[there]))
    return outcome, answer


def _read_start(context: SearchContext, paths: Candidates, row: int, moment: int) -> Effect:
    """Effect of looking for the start of the candidate's action at somebody else, by the moment at t0.

    Where no start of theirs is certain, it is unknown only if one could be near enough to score.
    """
    segment = int(paths.segments[0][row])
    stored = start_of(context.scene, segment)
    action = context.scene.segments["action"][segment].as_py()
    track = context.scene.track(moment)
    start = context.onsets.start(track, action, int(paths.frames["t0"][row]))
    if start is not None:
        return Effect.SAME if same_answer(start, stored) else Effect.DIFFERENT
    return Effect.UNKNOWN if context.onsets.could_start(track, action, stored) else Effect.EMPTY
