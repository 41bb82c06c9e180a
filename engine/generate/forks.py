"""Forks: two people reached from the one described, the fourth whom a relation of each singles out, and the proofs that
no part of this can be left out.

The walks run in the scene's graph, along `Step` and `Fits`; the joins at their ends are read from masks (`joins`). The
hops of a fork are numbered as its edges are: 1 and 2 lead to b and c, 3 and 4 join d to them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate import relations
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
from jrdb_avr.engine.generate.chains import Paths, placed
from jrdb_avr.engine.generate.fork_join import Joins, count
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.rules import FPS, Rules, frames


def find_forks(graph: Graph, joins: Joins, rules: Rules) -> pa.Table:
    """The candidates of fork_join.

    For this search the scene's graph has (Moment)-[:Joined {a, c, r3, r4}]->(Moment), from b to the d whom r3 of b and
    r4 of c single out beside a.
    """
    forks = ask(graph, "generators", "fork", rules)
    graph.execute("CREATE REL TABLE Joined(FROM Moment TO Moment, a INT64, c INT64, r3 STRING, r4 STRING)")
    graph.copy("Joined", joins.table(*(ints(forks, node) for node in "abc")))
    found = ask(graph, "generators", "fork_join", rules)
    graph.execute("DROP TABLE Joined")
    return found


def fork_proofs(scene: Scene, graph: Graph, joins: Joins, paths: Paths, rules: Rules) -> tuple[Perturbed, ...]:
    """hop.stop at a, b and c, hop.skip of every hop, and time.shift and time.drop of the program of paths in the graph.

    It is enough that one of b and c has another pose: the two branches have no order.
    """
    a, b, c = (paths.people[node] for node in "abc")
    proofs = []
    for place, moment in enumerate((a, b, c)):
        outcome, answer = _read(scene, paths, moment)
        proofs.append(Perturbed("hop.stop", str(place), outcome, answer, either=place > 0))
    proofs.append(Perturbed("hop.skip", "1", *_read_joined(scene, joins, paths, (a, a, c), (a, c))))
    proofs.append(Perturbed("hop.skip", "2", *_read_joined(scene, joins, paths, (a, b, a), (a, b))))
    none = np.full(len(paths), NOBODY, np.int8)
    for skipped, source, relation in (("3", c, "r4"), ("4", b, "r3")):
        # What is left holds of the target, so nobody else for certain means that it cannot be told.
        _, sure = joins.others(source, paths.relations[relation], (a, b, c))
        proofs.append(Perturbed("hop.skip", skipped, _where(count(sure) >= 2, AMBIGUOUS, UNKNOWN), none))
    return (*proofs, *_program_proofs(scene, graph, joins, paths, rules))


def _program_proofs(scene: Scene, graph: Graph, joins: Joins, paths: Paths, rules: Rules) -> list[Perturbed]:
    none = np.full(len(paths), NOBODY, np.int8)
    proofs, step = [], frames(rules.shift_s)
    for by in (-step, step):
        found = ask(graph, "necessity", "fork_join_shift", rules, by=by)
        a, b, c = (placed(found, node, len(paths)) for node in "abc")
        outcome, answer = _read_joined(scene, joins, paths, (a, b, c), (a, b, c))
        moved = paths.frames["t0"] + by
        outside = (moved < scene.keyframes[0]) | (moved > scene.keyframes[-1])
        outcome[outside], answer[outside] = OUTSIDE, NOBODY
        proofs.append(Perturbed("time.shift", f"{by / FPS:+g} s", outcome, answer, either=True))
    found = ask(graph, "necessity", "fork_join_drop", rules)
    number = ints(found, "id")
    a, b, c = (ints(found, node) for node in "abc")
    _, answer = _read_joined(scene, joins, paths.take(number), (a, b, c), (a, b, c))
    told = answer != NOBODY
    other = told & (answer != paths.answer[number])
    defined, others = (np.bincount(number[which], minlength=len(paths)) for which in (told, other))
    outcome = np.where(others > 0, DIFFERENT, np.where(defined > 1, SAME, EMPTY)).astype(np.int8)
    return [*proofs, Perturbed("time.drop", "all keyframes", outcome, none)]


def _read_joined(
    scene: Scene, joins: Joins, paths: Paths, people: Sequence[Ints], apart: Sequence[Ints]
) -> tuple[Codes, Codes]:
    """Outcome and answer of programs whose a, b and c are these people, or nobody for one of the reasons in
    `relations`, while those in `apart` are no d.

    The branches have no order: where one leads to nobody there is no d, whatever the other does.
    """
    a, b, c = people
    d = np.where(a < 0, a, relations.UNKNOWN)
    for why in (relations.SEVERAL, relations.EMPTY):
        d = np.where((a >= 0) & ((b == why) | (c == why)), why, d)
    d = np.where((a >= 0) & (b >= 0) & (b == c), relations.EMPTY, d)
    open_rows = np.flatnonzero((a >= 0) & (b >= 0) & (c >= 0) & (b != c))
    r3, r4 = (paths.relations[name][open_rows] for name in ("r3", "r4"))
    left_out = [moments[open_rows] for moments in apart]
    d[open_rows] = joins.joined(b[open_rows], r3, c[open_rows], r4, left_out)
    return _read(scene, paths, d)


def _read(scene: Scene, paths: Paths, moment: Ints) -> tuple[Codes, Codes]:
    """Outcome and answer of reading the pose of these people, or nobody, at t0."""
    answer = np.where(moment >= 0, scene.moment_poses[moment], NOBODY).astype(np.int8)
    outcome = _where(answer == paths.answer, SAME, DIFFERENT)
    outcome[answer == NOBODY] = UNKNOWN
    outcome[moment == relations.EMPTY] = EMPTY
    outcome[moment == relations.SEVERAL] = AMBIGUOUS
    return outcome, answer


def _where(which: Bools, yes: int, no: int) -> Codes:
    return np.where(which, yes, no).astype(np.int8)
