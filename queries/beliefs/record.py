"""Replay `world.parquet`, the record of a run's world models, into a graph.

The record holds every write of an agent, accepted or refused, in order. Each row has the rows that the write added to
the world tables (`schema/beliefs.py`). A replay gives the same tables as the run itself wrote.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.beliefs.episode import EpisodeRows, world_schema
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS, Fact
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.tables import RUNS

_LINE: Final = ("run_id", "question_id", "number", "step", "tool", "arguments", "accepted", "reason")

BATCH_WRITES: Final = 150_000
"""Number of writes after which runs are copied, because a COPY rewrites its table and holds all its rows in memory."""


def read_record(store: Store, run_id: str) -> pa.Table:
    """Return the world rows of a finished run.

    Raises:
        StoreError: If the file is missing or broken, has other columns, or has writes of another run.
    """
    path, schema = store.run_path(run_id) / "world.parquet", RUNS["world"]
    rows = read_table(path)
    try:
        rows = rows.select(schema.names).cast(schema)
    except (KeyError, ValueError, pa.ArrowException) as error:
        raise StoreError(f"{path} is of another form ({str(error).splitlines()[0]}): evaluate again") from None
    if pc.any(pc.not_equal(rows["run_id"], run_id)).as_py():
        raise StoreError(f"{path} holds writes of another run: take it out of the store")
    return rows


# -- replay -----------------------------------------------------------------------------------------------------------


def replay(record: pa.Table) -> dict[str, pa.Table]:
    """Return the world tables that a record describes.

    Args:
        record: Rows of `world.parquet`.

    Returns:
        The tables by name, nodes first. Edges begin with the two keys, `from` and `to`.

    Raises:
        StoreError: If no run can have written the record.
    """
    record = record.sort_by([("run_id", "ascending"), ("question_id", "ascending"), ("number", "ascending")])
    rows: dict[str, list[tuple[Any, ...]]] = defaultdict(list)
    columns = [record[name].to_pylist() for name in _LINE]
    episodes: dict[tuple[str, str], EpisodeRows] = {}
    for (run, question, *line), fact in zip(zip(*columns, strict=True), _facts(record["fact"]), strict=True):
        episode = episodes.setdefault((run, question), EpisodeRows(run, question))
        episode.apply(line[0], fact)
        key = f"{episode.key}/{line[0]}"
        rows["Write"].append((key, episode.key, *line))
        rows["Wrote"].append((episode.key, key))
    for episode in episodes.values():
        for table, added in episode.tables(episode.facts).items():
            rows[table] += added
    return {name: _arrow(world_schema(name), rows[name]) for name in (*WORLD_NODES, *WORLD_RELS)}


def _facts(texts: pa.ChunkedArray) -> Iterator[Fact | None]:
    """Yield the facts. All are decoded together, because a call per row would cost more than the decoding."""
    joined = ",".join(text or "null" for text in texts.to_pylist())
    try:
        facts = msgspec.json.decode(f"[{joined}]".encode(), type=list[Fact | None])
    except (msgspec.DecodeError, UnicodeEncodeError) as error:
        raise StoreError(f"a record of a world model has an unreadable fact ({error})") from None
    if len(facts) != len(texts):
        raise StoreError("a record of a world model has two facts in one write")
    return iter(facts)


def _arrow(schema: pa.Schema, rows: Sequence[tuple[Any, ...]]) -> pa.Table:
    if not rows:
        return schema.empty_table()
    arrays = [
        pa.StructArray.from_arrays([pa.array(side, pa.float64()) for side in zip(*column, strict=True)], list("xywh"))
        if pa.types.is_struct(field.type)
        else pa.array(column, field.type)
        for field, column in zip(schema, zip(*rows, strict=True), strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


# -- into a graph -----------------------------------------------------------------------------------------------------


def merge_world(graph: Graph, run_id: str, record: pa.Table) -> None:
    """Replace the rows of a run in a graph by a replay of its record.

    Raises:
        StoreError: If the record cannot be replayed. Then nothing is changed.
    """
    tables = replay(record)
    with graph.transaction():
        drop_world(graph, run_id)
        _copy(graph, [tables])


def copy_all(graph: Graph, store: Store, run_ids: Sequence[str]) -> list[str]:
    """Replay the records of a store's runs into a graph without episodes. Skip runs without a record.

    Returns:
        One line for each run that was left out, because its record is broken.
    """
    faults: list[str] = []
    batch: list[Mapping[str, pa.Table]] = []
    for run_id in run_ids:
        if not (store.run_path(run_id) / "world.parquet").exists():
            continue
        try:
            batch.append(replay(read_record(store, run_id)))
        except StoreError as error:
            faults.append(f"the world model of run {run_id} was left out: {error}")
        if sum(tables["Write"].num_rows for tables in batch) >= BATCH_WRITES:
            _copy(graph, batch)
            batch = []
    _copy(graph, batch)
    return faults


def drop_world(graph: Graph, run_id: str) -> None:
    """Delete the rows of a run from a graph."""
    for name in ("writes", "entities", "looks", "slots", "hypotheses", "episodes"):
        graph.execute(read_statement(f"record/drop_{name}.cypher"), {"run": run_id})


def _copy(graph: Graph, runs: Sequence[Mapping[str, pa.Table]]) -> None:
    for name in (*WORLD_NODES, *WORLD_RELS):
        if rows := [tables[name] for tables in runs if tables[name].num_rows]:
            graph.copy(name, pa.concat_tables(rows))
