"""The keyframe layer of a store's graph: made where it is missing or of other rules.

Workers make the rows of a sequence, one process copies them. Twice: the statements of `queries/search` run over what
was copied first, side by side, and what they find is copied as edges. Each time the graph file is copied, written and
renamed in, so that a kill leaves a whole one. The stamp, `Keyframes`, is written last: the rules.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.context import LayerJob, SearchContext
from jrdb_avr.engine.generate.fork_join import find_joins
from jrdb_avr.engine.generate.keyframes import keyframe_tables
from jrdb_avr.engine.generate.relations import RELATION_BITS, RELATIONS
from jrdb_avr.engine.generate.scene import UNDECIDED, Ints, coded, ints, load_scene
from jrdb_avr.loaders.graph import copy_staged, stage_rows, write_graph
from jrdb_avr.loaders.verify import checks_of
from jrdb_avr.queries.display import Progress, step_counter
from jrdb_avr.queries.graph.file import is_as_built
from jrdb_avr.queries.graph.handle import Graph, build_graph, hold_graph
from jrdb_avr.queries.keyframes import SPAN, layer_stamp
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import Executor, map_sequences
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, table_ddl
from jrdb_avr.schema.rules import Rules, rules_hash

STAGE: Final = ".keyframes"
"""Folder of the staged rows, inside the store; gone when the layer is made."""

DERIVED: Final = ("Step", "Leads", "Describes", "Joined")
"""Edges derived from the other tables: by statements, and `Joined` by `fork_join`."""


def ensure_layer(store: Store, rules: Rules, workers: Executor, progress: Progress | None = None) -> dict[str, int]:
    """Make the keyframe layer of a store's graph where it is not the one of these rules; the first id of each sequence.

    Raises StoreError where there is no sound graph or the disk refuses, LockedError where the graph is in use.
    """
    stage = store.path / STAGE
    # What a killed run left behind, the layer finished or not.
    shutil.rmtree(stage, ignore_errors=True)
    if lows := stored_layer(store, rules):
        return lows
    names = sorted(store.manifest().sequences)
    jobs = [LayerJob(store.path, name, number * SPAN, rules) for number, name in enumerate(names)]
    advance = step_counter(progress, "keyframes", 2 * len(jobs))
    try:
        for _ in map_sequences(_stage_tables, jobs, workers, lambda job: job.weight):
            advance(1)
        write_graph(store, partial(_copy_tables, jobs))
        with hold_graph(store.graph_path, workers):
            for _ in map_sequences(_stage_derived, jobs, workers, lambda job: job.weight):
                advance(1)
        write_graph(store, partial(_copy_derived, jobs))
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return {job.sequence: job.low for job in jobs}


def stored_layer(store: Store, rules: Rules) -> dict[str, int]:
    """The first id of each sequence of the stored layer; none where it is not the one of these rules and sequences.

    Raises as `ensure_layer`. A file that is not as it was built is verified first: agents wrote into it, or it is
    damaged.
    """
    # Before the graph is open here: closing the file would drop the engine's lock on it.
    if not is_as_built(store.graph_path) and any(check.fault for check in checks_of(store)):
        raise StoreError(f"{store.graph_path} is damaged: run 'jrdb-avr load --verify --store {store.path}'")
    with Graph.open(store.graph_path, read_only=True) as graph:
        lows, stamped = layer_stamp(graph)
    return lows if stamped == rules and sorted(lows) == sorted(store.manifest().sequences) else {}


def _stage_tables(job: LayerJob) -> None:
    context = SearchContext(load_scene(Store(job.store), job.sequence), job.rules, job.low)
    for name, rows in keyframe_tables(context):
        stage_rows(job.store / STAGE, name, job.sequence, rows)


def _stage_derived(job: LayerJob) -> None:
    with job.searching() as context:
        for name, rows in derived_tables(context).items():
            stage_rows(job.store / STAGE, name, job.sequence, rows)


def derived_tables(context: SearchContext) -> dict[str, pa.Table]:
    """The edges derived from a sequence's other tables."""
    low = context.low
    steps = context.query("search", "steps")
    target = ints(steps, "target")
    code = coded(steps["relation"], RELATIONS)
    edges = pa.table(
        {
            "from": ints(steps, "source") + low,
            "to": np.where(target < 0, target + SPAN, target) + low,
            "relation": steps["relation"],
            "bit": RELATION_BITS[code],
        }
    )
    # A relation that leads nowhere in the scene is of no use to any plan; what is undecided, `open` says.
    leading = np.isin(code, np.unique(code[target >= 0])) & (target != UNDECIDED)
    names = context.query("search", "anchors")
    describes = {"from": ints(names, "name") + low, "to": ints(names, "moment") + low, "anchor": names["anchor"]}
    general = ints(names.filter(names["general"]), "moment")
    joined = find_joins(context).table(*_forks(ints(steps, "source"), code, target, general))
    columns = [ints(joined, name) + low for name in ("from", "to", "a", "c")]
    return {
        "Step": edges.filter(pa.array(leading)),
        "Leads": edges.filter(pa.array(target >= 0)),
        "Describes": pa.table(describes),
        "Joined": pa.table([*columns, joined["r3"], joined["r4"]], joined.column_names),
    }


def _forks(source: Ints, relation: Ints, target: Ints, described: Ints) -> Iterator[Ints]:
    """The forks (a, b, c) that lead from somebody described to two different people, by two relations."""
    usable = (target >= 0) & np.isin(source, described)
    leads = pa.table([source[usable], relation[usable], target[usable]], ["a", "r1", "b"])
    forks = leads.join(leads.rename_columns(["a", "r2", "c"]), "a", join_type="inner")
    forks = forks.filter((pc.field("r1") != pc.field("r2")) & (pc.field("b") != pc.field("c")))
    return iter(np.unique(np.stack([forks[node].to_numpy() for node in "abc"]), axis=1))


def _copy_tables(jobs: Sequence[LayerJob]) -> None:
    """Copy all tables but those that statements find, in place of a layer that was there."""
    tables = [name for name in (*KEYFRAME_NODES, *KEYFRAME_RELS) if name not in DERIVED]
    with _extended(jobs) as graph:
        there = graph.tables()
        with graph.transaction():
            for name in (*KEYFRAME_RELS, *KEYFRAME_NODES):
                if name in there:
                    graph.execute(f"DROP TABLE `{name}`")
            for statement in table_ddl(KEYFRAME_NODES, KEYFRAME_RELS):
                graph.execute(statement)
        copy_staged(graph, jobs[0].store / STAGE, tables, [job.sequence for job in jobs])


def _copy_derived(jobs: Sequence[LayerJob]) -> None:
    """Copy the tables that statements found, and the stamp."""
    stage = jobs[0].store / STAGE
    with _extended(jobs) as graph:
        copy_staged(graph, stage, DERIVED, [job.sequence for job in jobs])
        text, digest = msgspec.json.encode(jobs[0].rules).decode(), rules_hash(jobs[0].rules)
        rows = [
            {"sequence": job.sequence, "low": job.low, "high": job.low + SPAN, "rules_hash": digest, "rules": text}
            for job in jobs
        ]
        graph.copy("Keyframes", pa.Table.from_pylist(rows))


def _extended(jobs: Sequence[LayerJob]) -> contextlib.AbstractContextManager[Graph]:
    return build_graph(Store(jobs[0].store).graph_path, extend=True)
