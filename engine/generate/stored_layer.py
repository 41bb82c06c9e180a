"""The keyframe layer of a store's graph, made if it is missing or has other rules or sequences.

Workers read the scene from the graph and make the rows of the layer. Then one process copies the rows of all sequences
into a copy of the graph file, and renames the copy. If the process is killed, the graph file stays whole.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import pyarrow.parquet as pq

from jrdb_avr.engine.generate.asked import Question
from jrdb_avr.engine.generate.held_out import Extent
from jrdb_avr.engine.generate.layer import Layer
from jrdb_avr.loaders.graph import copy_staged, stage_rows, write_graph
from jrdb_avr.loaders.verify import checks_of
from jrdb_avr.queries.display import Progress, step_counter
from jrdb_avr.queries.graph.file import is_as_built
from jrdb_avr.queries.graph.handle import Graph, build_graph, hold_graph, open_worker_graph
from jrdb_avr.queries.keyframes import layer_stamp
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import Executor, map_in_order
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, table_ddl
from jrdb_avr.schema.rules import Rules

STAGE: Final = ".keyframes"
"""Folder of the staged rows inside the store. It is deleted after the layer is stored."""

SPAN: Final = 1_000_000_000
"""Number of node ids that are reserved for each sequence."""


@dataclass(frozen=True)
class Job:
    """Sequence for a worker.

    Attributes:
        store: Folder of the store.
        sequence: Name of the sequence.
        low: First id of a node of the sequence in the layer.
        rules: Rules of the layer.
        held_out: Extents of held-out questions about the sequence.
        limits: Numbers of candidates of each template that are enough.
        questions: Selected questions to make.
    """

    store: Path
    sequence: str
    low: int
    rules: Rules
    held_out: tuple[Extent, ...] = ()
    limits: tuple[tuple[str, int], ...] = ()
    questions: tuple[Question, ...] = ()

    def weigh(self) -> int:
        """Return the number of 2D boxes of the sequence. Larger sequences start first."""
        return int(pq.read_metadata(Store(self.store).interval_path("sightings", self.sequence)).num_rows)

    def layer(self, graph: Graph) -> Layer:
        """Make the layer of the sequence. `graph` has the scene of the sequence. Raises the errors of `Layer`."""
        return Layer(Store(self.store), graph, self.sequence, self.rules, self.low)


def layer_jobs(store: Store, rules: Rules) -> list[Job]:
    """Return a job for each sequence of a store, in the order of their names."""
    names = sorted(store.manifest().sequences)
    return [Job(store.path, name, number * SPAN, rules) for number, name in enumerate(names)]


def ensure_layer(store: Store, rules: Rules, workers: Executor, progress: Progress | None = None) -> list[Job]:
    """Make the keyframe layer of a store's graph, unless it is stored for these rules and sequences already.

    Args:
        store: Store that this process may write.
        rules: Rules of the layer.
        workers: Number of processes, or a Ray cluster.
        progress: Display of the progress.

    Returns:
        A job for each sequence, in the order of their names.

    Raises:
        StoreError: If the graph is missing or damaged, or if the disk is full.
        LockedError: If another process uses the graph.
    """
    stage = store.path / STAGE
    # A killed run may have left staged rows.
    shutil.rmtree(stage, ignore_errors=True)
    jobs = layer_jobs(store, rules)
    if not _is_stored(store, rules):
        advance = step_counter(progress, "keyframes", len(jobs))
        try:
            with hold_graph(store.graph_path, workers):
                map_in_order(_stage, jobs, workers, Job.weigh, advance)
            write_graph(store, partial(_copy, jobs))
        finally:
            shutil.rmtree(stage, ignore_errors=True)
    return jobs


def _is_stored(store: Store, rules: Rules) -> bool:
    """Return whether the graph has the layer of these rules and of all sequences. Verify a file that was changed."""
    # Check the file before it is opened here, because closing the file would drop the engine's lock on it.
    if not is_as_built(store.graph_path) and any(check.fault for check in checks_of(store)):
        raise StoreError(f"{store.graph_path} is damaged: run 'jrdb-avr load --verify --store {store.path}'")
    with Graph.open(store.graph_path, read_only=True) as graph:
        return layer_stamp(graph) == (sorted(store.manifest().sequences), rules)


def _stage(job: Job) -> None:
    with open_worker_graph(Store(job.store).graph_path) as graph:
        layer = job.layer(graph)
    for name, rows in layer.tables():
        stage_rows(job.store / STAGE, name, job.sequence, rows)


def _copy(jobs: Sequence[Job]) -> None:
    """Replace the layer of the graph by the staged rows."""
    store = Store(jobs[0].store)
    with build_graph(store.graph_path, extend=True) as graph:
        existing = graph.tables()
        with graph.transaction():
            for name in (*LAYER_RELS, *LAYER_NODES):
                if name in existing:
                    graph.execute(f"DROP TABLE `{name}`")
            for statement in table_ddl(LAYER_NODES, LAYER_RELS):
                graph.execute(statement)
        copy_staged(graph, store.path / STAGE, (*LAYER_NODES, *LAYER_RELS), [job.sequence for job in jobs])
