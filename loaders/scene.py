"""Interval tables -> the scene namespace of the graph, by COPY from Arrow, with every table's rows counted afterwards.

The graph is only an index: it holds what `intervals/` holds, keyed for traversal, and can be built again at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import SCENE_NODES, SCENE_RELS, STORAGE_VERSION, scene_ddl
from jrdb_avr.schema.vocabulary import ACTIONS, POSES

BATCH_ROWS: Final = 400_000
"""Rows per COPY at most, unless one sequence has more: fewer COPYs are faster, larger ones take more memory."""


def build_scene(graph: Graph, store: Store, sequences: Sequence[str]) -> dict[str, int | str]:
    """Fill an empty graph from the interval tables of `sequences`; returns rows per table and the storage version.

    Raises StoreError where the graph ends up with other row counts than the tables.
    """
    for statement in scene_ddl():
        graph.execute(statement)
    copied = dict.fromkeys((*SCENE_NODES, *SCENE_RELS), 0)

    def copy(table: str, rows: pa.Table) -> None:
        if rows.num_rows:
            graph.copy(table, rows)
            copied[table] += rows.num_rows

    for table, rows in scene_rows(store, sequences):
        copy(table, rows)
    # What was copied must be there: the engine has no page checksums.
    graph.execute("CHECKPOINT")
    for table, expected in copied.items():
        pattern = f"(n:{table})" if table in SCENE_NODES else f"()-[r:{table}]->()"
        found = graph.query(f"MATCH {pattern} RETURN count(*) AS n")["n"][0].as_py()
        if found != expected:
            raise StoreError(f"the graph holds {found} rows of {table} instead of {expected}: load again")
    return {**copied, "storage_version": STORAGE_VERSION}


def scene_rows(store: Store, sequences: Sequence[str]) -> Iterator[tuple[str, pa.Table]]:
    """Every table of the scene namespace as (name, rows) in batches, nodes before edges; columns as in the graph.

    Edges begin with the two keys, `from` and `to`. Raises StoreError where an interval table does not read.
    """
    names: set[str] = set(ACTIONS)
    for table, kind, shape in _NODES:
        for rows in _batches(store, kind, sequences):
            yield table, shape(rows)
    for rows in _batches(store, "actions", sequences):
        names |= set(rows["action"].unique().to_pylist())
    yield "Action", pa.table({"name": sorted(names), "pose": [name in POSES for name in sorted(names)]})
    for table, kind, shape in _RELS:
        for rows in _batches(store, kind, sequences):
            yield table, shape(rows)


def _batches(store: Store, kind: str, sequences: Sequence[str]) -> Iterator[pa.Table]:
    """One interval table of all sequences, in batches of whole sequences."""
    pending: list[pa.Table] = []
    rows = 0
    for sequence in sequences:
        table = store.interval(kind, sequence)
        if pending and rows + table.num_rows > BATCH_ROWS:
            yield pa.concat_tables(pending)
            pending, rows = [], 0
        pending.append(table)
        rows += table.num_rows
    if pending:
        yield pa.concat_tables(pending)


# -- nodes -------------------------------------------------------------------------------------------------------


def _sequences(rows: pa.Table) -> pa.Table:
    return _shaped(rows, ("sequence", "fps", "frame_count", "layers", "action_step"))


def _frames(rows: pa.Table) -> pa.Table:
    keyed = rows.append_column("id", _frame_keys(rows["sequence"], rows["frame"]))
    return _shaped(keyed, ("id", "sequence", "frame", "seconds", "keyframe", "annotated", "image"))


def _persons(rows: pa.Table) -> pa.Table:
    keyed = rows.append_column("id", _keys(rows["sequence"], rows["track"]))
    return _shaped(keyed, ("id", "sequence", "track", "gender", "age", "ethnicity", "first_frame", "last_frame"))


def _clusters(rows: pa.Table) -> pa.Table:
    distinct = rows.select(["sequence", "cluster"]).group_by(["sequence", "cluster"]).aggregate([])
    distinct = distinct.sort_by([("sequence", "ascending"), ("cluster", "ascending")])
    keyed = distinct.append_column("id", _keys(distinct["sequence"], distinct["cluster"]))
    none = pa.nulls(keyed.num_rows, pa.list_(pa.string()))
    keyed = keyed.append_column("venue", pa.nulls(keyed.num_rows, pa.string()))
    for name in ("aim", "bpc", "ssc", "location", "inter"):
        keyed = keyed.append_column(name, none)
    return _shaped(keyed, ("id", "sequence", "cluster", "venue", "aim", "bpc", "ssc", "location", "inter"))


# -- relationships: the two keys, then the columns of the DDL ------------------------------------------------------


def _seen_in(rows: pa.Table) -> pa.Table:
    sides = [pa.array(rows[name].to_numpy()) for name in "xywh"]
    rows = rows.append_column("box", pa.StructArray.from_arrays(sides, names=list("xywh")))
    rows = rows.append_column("from", _keys(rows["sequence"], rows["track"]))
    rows = rows.append_column("to", _frame_keys(rows["sequence"], rows["frame"]))
    return _shaped(rows, ("from", "to", *_columns("SeenIn")))


def _performs(rows: pa.Table) -> pa.Table:
    rows = rows.append_column("from", _keys(rows["sequence"], rows["track"]))
    rows = rows.append_column("to", rows["action"])
    return _shaped(rows, ("from", "to", *_columns("Performs")))


def _member_of(rows: pa.Table) -> pa.Table:
    rows = rows.append_column("from", _keys(rows["sequence"], rows["track"]))
    rows = rows.append_column("to", _keys(rows["sequence"], rows["cluster"]))
    return _shaped(rows, ("from", "to", *_columns("MemberOf")))


def _beside(rows: pa.Table) -> pa.Table:
    rows = rows.append_column("from", _keys(rows["sequence"], rows["source"]))
    rows = rows.append_column("to", _keys(rows["sequence"], rows["target"]))
    return _shaped(rows, ("from", "to", *_columns("Beside")))


_Shape = Callable[[pa.Table], pa.Table]

_NODES: Final[tuple[tuple[str, str, _Shape], ...]] = (
    ("Sequence", "sequence", _sequences),
    ("Frame", "frames", _frames),
    ("Person", "persons", _persons),
    ("SocialGroup", "memberships", _clusters),
)
_RELS: Final[tuple[tuple[str, str, _Shape], ...]] = (
    ("SeenIn", "sightings", _seen_in),
    ("Performs", "actions", _performs),
    ("MemberOf", "memberships", _member_of),
    ("Beside", "beside", _beside),
)


def _columns(table: str) -> list[str]:
    """Column names of a relationship table, in the order of its DDL."""
    return [column.split()[0] for column in SCENE_RELS[table][2]]


def _keys(sequence: pa.ChunkedArray, number: pa.ChunkedArray) -> pa.ChunkedArray:
    """`<sequence>/<number>`, as `person_key` writes it."""
    return pc.binary_join_element_wise(sequence, number.cast(pa.string()), "/")


def _frame_keys(sequence: pa.ChunkedArray, frame: pa.ChunkedArray) -> pa.ChunkedArray:
    """`<sequence>/<six digits>`, as `frame_key` writes it."""
    return pc.binary_join_element_wise(sequence, pc.utf8_lpad(frame.cast(pa.string()), 6, "0"), "/")


def _shaped(rows: pa.Table, names: Sequence[str]) -> pa.Table:
    """The columns in the order asked for, whole numbers as 64 bits, which is what the graph stores."""
    rows = rows.select(list(names))
    fields = [pa.field(f.name, pa.int64()) if pa.types.is_integer(f.type) else f for f in rows.schema]
    return rows.cast(pa.schema(fields))
