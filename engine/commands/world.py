"""`jrdb-avr world`: add the world models of runs to the graph of the store, or drop world models."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jrdb_avr.engine.cli import NamingGroup
from jrdb_avr.engine.commands._options import form_option, run_argument, store_option
from jrdb_avr.engine.console import RowFormat, note, print_rows, progress_bar

if TYPE_CHECKING:
    import pyarrow as pa

    from jrdb_avr.queries.graph.handle import Graph
    from jrdb_avr.queries.store import Store


@click.group(cls=NamingGroup)
def command() -> None:
    """Add the world models of runs to the graph of the store, or drop them from the graph.

    A world model holds what an agent believes about the people and the scene. The file runs/RUN/world.parquet records
    the world model of a run. A run writes its world model to the graph of the store, unless 'evaluate --world-db' names
    another graph file. 'load' makes a new graph and adds the recorded world models of all runs. 'cypher --list' lists
    queries of world models.

    Examples:
      jrdb-avr world merge agent-simulated --store S
      jrdb-avr world drop agent-simulated --store S
    """


@command.command(
    short_help="Add world models of runs to the graph of the store.",
    epilog="Example: jrdb-avr world merge agent-simulated agent-passive-simulated --store S",
)
@run_argument("run_ids", nargs=-1, required=True, metavar="RUN...")
@store_option()
@form_option
def merge(run_ids: tuple[str, ...], store: Store, form: RowFormat) -> None:
    """Add the world models of finished runs to the graph of the store.

    If the world model of a run is already in the graph, it is replaced.
    """
    from jrdb_avr.queries.beliefs.graph import open_graph
    from jrdb_avr.queries.beliefs.record import merge_world

    records = {run_id: _record(store, run_id) for run_id in dict.fromkeys(run_ids)}
    rows = []
    with open_graph(_graph_path(store)) as graph, progress_bar() as progress:
        for run_id, record in records.items():
            merge_world(graph, run_id, record)
            rows.append(_row(graph, run_id))
            progress("merging", len(rows), len(records))
    print_rows(rows, form=form)


@command.command(epilog="Example: jrdb-avr world drop agent-simulated --store S")
@run_argument("run_ids", nargs=-1, required=True, metavar="RUN...")
@store_option()
@form_option
def drop(run_ids: tuple[str, ...], store: Store, form: RowFormat) -> None:
    """Drop the world models of runs from the graph.

    The recorded world models stay in the folders of the runs. The next 'load' adds them to the graph again.
    """
    from jrdb_avr.queries.beliefs.graph import open_graph
    from jrdb_avr.queries.beliefs.record import drop_world
    from jrdb_avr.schema.errors import StoreError

    with open_graph(_graph_path(store)) as graph, progress_bar() as progress:
        rows = [_row(graph, run_id) for run_id in dict.fromkeys(run_ids)]
        if absent := [row["run"] for row in rows if not row["episodes"]]:
            raise StoreError(f"{store.graph_path} holds nothing of run {absent[0]!r}: see 'cypher world_runs'")
        for count, row in enumerate(rows, 1):
            # If the process is killed, each run has either its complete world model or none.
            with graph.transaction():
                drop_world(graph, row["run"])
            progress("dropping", count, len(rows))
    print_rows(rows, form=form)
    if not form:
        note("dropped; 'jrdb-avr load --rebuild' frees the space")


def _record(store: Store, run_id: str) -> pa.Table:
    """Return the recorded world model of a run. Raise StoreError if the run or its record is missing."""
    from jrdb_avr.engine.run.methods import WORLD_METHODS
    from jrdb_avr.queries.beliefs.record import read_record
    from jrdb_avr.queries.runs import read_run_manifest
    from jrdb_avr.schema.errors import StoreError

    finished = (store.run_path(run_id) / "world.parquet").exists()
    record = read_record(store, run_id) if finished else None
    if record is not None and record.num_rows:
        return record
    if not store.run_path(run_id).exists():
        # Read the manifest of the store first, because a missing store needs another message than a missing run.
        store.manifest()
    method = read_run_manifest(store, run_id).method
    if method not in WORLD_METHODS:
        raise StoreError(f"run {run_id!r} has no world model: only the methods {' and '.join(WORLD_METHODS)} keep one")
    if record is None:
        raise StoreError(f"run {run_id!r} is not finished: repeat its 'jrdb-avr evaluate' with --resume, then merge")
    return record


def _graph_path(store: Store) -> Path:
    """Return the path of the store's graph. Raise StoreError if the graph file is missing."""
    from jrdb_avr.schema.errors import StoreError

    if not store.graph_path.exists():
        raise StoreError(f"{store.path} has no graph: run 'jrdb-avr load --rebuild --store {store.path}'")
    return store.graph_path


def _row(graph: Graph, run_id: str) -> dict[str, Any]:
    """Return a row that counts the episodes and the writes of one run in a graph."""
    from jrdb_avr.queries.beliefs.record import writes_held

    held = writes_held(graph, run_id)
    return {"run": run_id, "episodes": len(held), "writes": sum(held.values())}
