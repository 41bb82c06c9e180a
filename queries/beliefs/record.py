"""`world.parquet` -> the world namespace of a graph: the record of runs' world models, replayed.

The record holds every write of an agent, accepted or refused, in order, each with the rows that it put into the tables
(`schema/beliefs.py`). Replay is a pure function from these rows to the rows of the tables as they were when the run had
ended, which are then copied in: the same tables as the run itself wrote, write by write.
"""

from __future__ import annotations

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
"""Writes from which on runs are copied: every further COPY of a table of edges rewrites what is there, and a million
writes at once would take gigabytes."""


def read_record(store: Store, run_id: str) -> pa.Table:
    """The world rows of a finished run.

    Raises StoreError where the file is missing, broken or of another form, or holds writes of another run.
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


def replayed(record: pa.Table) -> dict[str, pa.Table]:
    """The tables of the world namespace that hold what a record says, by name, nodes first.

    Columns are as in the graph; edges begin with the two keys, `from` and `to`. Raises StoreError for a record that
    no run can have written: a fact of no known form, a write twice, a row of another episode, an edge to nothing.
    """
    record = record.sort_by([("run_id", "ascending"), ("question_id", "ascending"), ("number", "ascending")])
    tables: dict[str, list[tuple[Any, ...]]] = {name: [] for name in (*WORLD_NODES, *WORLD_RELS)}
    columns = [record[name].to_pylist() for name in _LINE]
    episode: EpisodeRows | None = None
    for (run, question, *line), fact in zip(zip(*columns, strict=True), _facts(record["fact"]), strict=True):
        if episode is None or (episode.run, episode.question) != (run, question):
            if episode is not None:
                episode.add_to(tables)
            episode = EpisodeRows(run, question)
        number, step, *_ = line
        episode.apply(number, step, fact)
        key = f"{episode.key}/{number}"
        tables["Write"].append((key, episode.key, *line))
        tables["Wrote"].append((episode.key, key))
    if episode is not None:
        episode.add_to(tables)
    return {name: _arrow(world_schema(name), rows) for name, rows in tables.items()}


def _facts(texts: pa.ChunkedArray) -> Iterator[Fact | None]:
    """Decoded all at once: a call per row would cost more than the decoding."""
    joined = ",".join(text or "null" for text in texts.to_pylist())
    try:
        facts = msgspec.json.decode(f"[{joined}]".encode(), type=list[Fact | None])
    except (msgspec.DecodeError, UnicodeEncodeError) as error:
        raise StoreError(f"a record of a world model holds what is no fact ({error})") from None
    if len(facts) != len(texts):
        raise StoreError("a record of a world model holds two facts in one write")
    return iter(facts)


def _arrow(schema: pa.Schema, rows: Sequence[tuple[Any, ...]]) -> pa.Table:
    if not rows:
        return schema.empty_table()
    arrays = [
        _boxes(column) if pa.types.is_struct(f.type) else pa.array(column, f.type)
        for f, column in zip(schema, zip(*rows, strict=True), strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _boxes(column: Sequence[tuple[float, float, float, float]]) -> pa.Array:
    return pa.StructArray.from_arrays(
        [pa.array(side, pa.float64()) for side in zip(*column, strict=True)], list("xywh")
    )


# -- into a graph -----------------------------------------------------------------------------------------------------


def merge_world(graph: Graph, run_id: str, record: pa.Table) -> None:
    """Replay a record in place of what a graph holds of its run; nothing is changed where `replayed` refuses it."""
    tables = replayed(record)
    with graph.transaction():
        drop_world(graph, run_id)
        _copy(graph, [tables])


def copy_all(graph: Graph, store: Store, run_ids: Sequence[str]) -> list[str]:
    """Replay the records of a store's runs into a graph without episodes; returns a line per run that was left out,
    as its record is broken. A run without a record yet is passed over.
    """
    faults: list[str] = []
    batch: list[Mapping[str, pa.Table]] = []
    for run_id in run_ids:
        if not (store.run_path(run_id) / "world.parquet").exists():
            continue
        try:
            batch.append(replayed(read_record(store, run_id)))
        except StoreError as error:
            faults.append(f"the world model of run {run_id} was left out: {error}")
        if sum(tables["Write"].num_rows for tables in batch) >= BATCH_WRITES:
            _copy(graph, batch)
            batch = []
    _copy(graph, batch)
    return faults


def restore_world(graph: Graph, run_id: str, record: pa.Table) -> int:
    """Bring a run's episodes in a graph to what its record says: replay those that it lacks or holds in part, take away
    those that the record does not hold. Returns how many were replayed.

    Their number of writes tells: the record holds episodes that have ended, and what a write made is in the graph
    before its line, so where the numbers are equal, nothing is missing and nothing over. Raises StoreError as
    `replayed` does.
    """
    there = writes_held(graph, run_id)
    counts = record.group_by("question_id").aggregate([("number", "count")]).to_pylist()
    recorded = {row["question_id"]: row["number_count"] for row in counts}
    lacking = [question for question, writes in recorded.items() if there.get(question) != writes]
    tables = replayed(record.filter(pc.is_in(record["question_id"], pa.array(lacking, pa.string()))))
    stale = [question for question, writes in there.items() if recorded.get(question) != writes]
    with graph.transaction():
        if stale:
            drop_world(graph, run_id, stale)
        _copy(graph, [tables])
    return len(lacking)


def writes_held(graph: Graph, run_id: str) -> dict[str, int]:
    """The number of writes that a graph holds of each of a run's episodes, by question id."""
    rows = graph.query(read_statement("record/writes_held.cypher"), {"run": run_id}).to_pylist()
    return {row["question"]: row["writes"] for row in rows}


def drop_world(graph: Graph, run_id: str, questions: Sequence[str] | None = None) -> None:
    """Take a run's episodes out of a graph: all, or those of some questions."""
    # An empty list is no parameter that the engine can bind.
    values = {"run": run_id, "whole": questions is None, "questions": list(questions or ("",))}
    for what in ("writes", "entities", "observations", "slots", "hypotheses", "episodes"):
        graph.execute(read_statement(f"record/drop_{what}.cypher"), values)


def _copy(graph: Graph, runs: Sequence[Mapping[str, pa.Table]]) -> None:
    for name in (*WORLD_NODES, *WORLD_RELS):
        if rows := [tables[name] for tables in runs if tables[name].num_rows]:
            graph.copy(name, pa.concat_tables(rows))
