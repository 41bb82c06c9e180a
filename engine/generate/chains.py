"""Proofs about hops: what is read one hop early, with a hop left out, and at other times.

Paths are copied into the scene's graph as nodes, `(Path)-[:Of]->(Description)` and `(Path)-[:From]->(Moment)`, and the
perturbed programs walk from there along `Step` and `Fits`, which lead somewhere from every moment: to the one person
who can be meant, or to one of the nodes that say why there is none.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate import relations
from jrdb_avr.engine.generate.action_onsets import Watched, start_of
from jrdb_avr.engine.generate.candidates import (
    AMBIGUOUS,
    DIFFERENT,
    EMPTY,
    OUTSIDE,
    SAME,
    UNKNOWN,
    Codes,
    Perturbed,
    ask,
    ints,
)
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.answers import same_answer
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.templates import Template


@dataclass(frozen=True)
class Paths:
    """Candidates whose hops are to be proven, as columns.

    description: number of the distinct description; people: by node the moment at t0; relations: `r1`, ... as indices
    into RELATIONS; frames, segment and answer as in `Candidates`.
    """

    template: Template
    description: Ints
    people: Mapping[str, Ints]
    relations: Mapping[str, Ints]
    frames: Mapping[str, Ints]
    segment: Ints
    answer: Codes

    def __len__(self) -> int:
        return len(self.answer)

    def take(self, rows: Ints) -> Paths:
        """Only these rows."""
        return Paths(
            self.template,
            self.description[rows],
            {node: moments[rows] for node, moments in self.people.items()},
            {name: codes[rows] for name, codes in self.relations.items()},
            {name: numbers[rows] for name, numbers in self.frames.items()},
            self.segment[rows],
            self.answer[rows],
        )


_TABLES: Final = (
    "CREATE NODE TABLE Path(id INT64 PRIMARY KEY, t INT64, r1 STRING, r2 STRING, r3 STRING)",
    "CREATE REL TABLE `From`(FROM Path TO Moment)",
    "CREATE REL TABLE Of(FROM Path TO Description)",
)


@contextlib.contextmanager
def paths_in_graph(graph: Graph, paths: Paths) -> Iterator[None]:
    """The paths as nodes of the scene's graph, for as long as the block lasts."""
    for statement in _TABLES:
        graph.execute(statement)
    number = np.arange(len(paths))
    columns: dict[str, object] = {"id": number, "t": paths.frames["t0"]}
    for name in ("r1", "r2", "r3"):
        told = paths.relations.get(name)
        none = pa.nulls(len(paths), pa.string())
        columns[name] = none if told is None else pc.take(pa.array(RELATIONS, pa.string()), pa.array(told))
    graph.copy("Path", pa.table(columns))
    graph.copy("From", pa.table({"from": number, "to": paths.people["a"]}))
    graph.copy("Of", pa.table({"from": number, "to": paths.description}))
    try:
        yield
    finally:
        for table in ("From", "Of", "Path"):
            graph.execute(f"DROP TABLE `{table}`")


BLOCK: Final = 20_000
"""Paths whose perturbed programs are run at once: at every keyframe of a crowded scene they are millions."""


def in_blocks(paths: Paths, prove: Callable[[Paths], tuple[Perturbed, ...]]) -> tuple[Perturbed, ...]:
    """The proofs of all paths, made block by block."""
    starts = range(0, len(paths), BLOCK)
    blocks = [prove(paths.take(np.arange(start, min(start + BLOCK, len(paths))))) for start in starts]
    return tuple(
        replace(
            same[0],
            outcome=np.concatenate([proof.outcome for proof in same]),
            answer=np.concatenate([proof.answer for proof in same]),
        )
        for same in zip(*blocks, strict=True)
    )


def hop_proofs(scene: Scene, graph: Graph, paths: Paths, rules: Rules) -> tuple[Perturbed, ...]:
    """hop.stop for every earlier person of the path, hop.skip for every hop but the last; the paths are in the graph.

    To leave out the last hop is to stop one person early.
    """
    nodes = paths.template.people
    watched = Watched(scene)
    proofs = []
    for place, node in enumerate(nodes[:-1]):
        outcome, answer = _read(scene, watched, paths, [paths.people[node]])
        proofs.append(Perturbed("hop.stop", str(place), outcome, answer))
    for skipped in range(1, len(paths.template.edges)):
        found = ask(graph, "necessity", f"{_HOPS[len(nodes) - 1]}_skip", rules, skipped=skipped)
        stages = [paths.people["a"], *(placed(found, node, len(paths)) for node in nodes[1:-1])]
        outcome, answer = _read(scene, watched, paths, stages)
        proofs.append(Perturbed("hop.skip", str(skipped), outcome, answer))
    return tuple(proofs)


_HOPS: Final = {2: "two_hop", 3: "three_hop"}


def program_proofs(scene: Scene, graph: Graph, paths: Paths, rules: Rules) -> tuple[Perturbed, ...]:
    """time.shift and time.drop of the whole program: description and hops are read anew at other keyframes.

    The paths are in the graph.
    """
    name, nodes, step = paths.template.name, paths.template.people, frames(rules.shift_s)
    watched, proofs = Watched(scene), []
    for by in (-step, step):
        found = ask(graph, "necessity", f"{name}_shift", rules, by=by)
        stages = [placed(found, node, len(paths)) for node in nodes]
        outcome, answer = _read(scene, watched, paths, stages)
        moved = paths.frames["t0"] + by
        outside = (moved < scene.keyframes[0]) | (moved > scene.keyframes[-1])
        outcome[outside], answer[outside] = OUTSIDE, NOBODY
        proofs.append(Perturbed("time.shift", f"{by / FPS:+g} s", outcome, answer, either=True))
    found = ask(graph, "necessity", f"{name}_drop", rules)
    defined, answers = np.zeros(len(paths), np.int64), np.zeros(len(paths), np.int64)
    defined[ints(found, "id")], answers[ints(found, "id")] = ints(found, "defined"), ints(found, "answers")
    outcome = np.where(answers > 1, DIFFERENT, np.where(defined > 1, SAME, EMPTY)).astype(np.int8)
    proofs.append(Perturbed("time.drop", "all keyframes", outcome, np.full(len(paths), NOBODY, dtype=np.int8)))
    return tuple(proofs)


def placed(found: pa.Table, node: str, count: int) -> Ints:
    """A column of moments by the path's id; at a time that is no keyframe nothing is known."""
    moments = np.full(count, relations.UNKNOWN)
    moments[ints(found, "id")] = ints(found, node)
    return moments


def _read_start(scene: Scene, watched: Watched, paths: Paths, row: int, moment: int) -> int:
    """Outcome of looking for the start of the candidate's action at somebody else, by the moment at t0.

    Where no start of theirs is certain, it is unknown only if one could be near enough to score.
    """
    segment = int(paths.segment[row])
    stored = start_of(scene, segment)
    action = scene.segments["action"][segment].as_py()
    track = int(scene.tracks[scene.persons(np.array([moment]))[0]])
    start = watched.start(track, action, int(paths.frames["t0"][row]))
    if start is not None:
        return SAME if same_answer(start, stored) else DIFFERENT
    return UNKNOWN if watched.could_start(track, action, stored) else EMPTY


def _read(scene: Scene, watched: Watched, paths: Paths, stages: Sequence[Ints]) -> tuple[Codes, Codes]:
    """Outcome and answer of programs that pass through these people, by their moments, and read the last one."""
    outcome = np.full(len(paths), NOBODY, dtype=np.int8)
    for place, moment in enumerate(stages):
        back = np.zeros(len(paths), dtype=bool)
        for earlier in stages[:place]:
            back |= earlier == moment
        for why, reached in (
            (EMPTY, (moment == relations.EMPTY) | back),
            (AMBIGUOUS, moment == relations.SEVERAL),
            (UNKNOWN, moment == relations.UNKNOWN),
        ):
            outcome[(outcome == NOBODY) & reached] = why
    open_rows = outcome == NOBODY
    answer = np.full(len(paths), NOBODY, dtype=np.int8)
    if paths.template.spec.read == "start_view":
        for row in np.flatnonzero(open_rows).tolist():
            outcome[row] = _read_start(scene, watched, paths, row, int(stages[-1][row]))
        return outcome, answer
    last = stages[-1]
    if "t1" in paths.frames:
        at = np.searchsorted(scene.keyframes, paths.frames["t1"])
        last = scene.persons(last) * len(scene.keyframes) + at
    answer[open_rows] = scene.moment_poses[last[open_rows]]
    told = np.where(answer == NOBODY, UNKNOWN, np.where(answer == paths.answer, SAME, DIFFERENT))
    outcome[open_rows] = told[open_rows]
    # Of somebody who is absent at t1 nothing is read.
    outcome[open_rows] = np.where(scene.absent[last[open_rows]], EMPTY, outcome[open_rows])
    return outcome, answer
