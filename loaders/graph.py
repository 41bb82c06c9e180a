"""Construction of the graph's scene tables from the interval tables of a store.

The graph is only an index. It holds the content of the folder `intervals/` and adds keys for traversal. Therefore the
graph can be built again from this folder at any time. The graph is built in two steps:

1. Staging: the process that derives the interval tables of a sequence also writes the rows of these tables to Parquet
   files, in the form of the graph's tables.
2. Copying: one process copies the staged rows of all sequences into the graph with COPY statements. It then counts the
   rows of each table.

A table of edges is copied with as few statements as possible, because every further COPY statement
rewrites the table. For example, four statements for 950,000 sightings took twice as long as one statement. The rows of
edges are passed to the engine in files, because passing Arrow tables took half a gigabyte more memory. Key points of
poses are left out, because they would be the largest part of the graph.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Final, TypeVar

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.queries import workers as processes
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store, read_table, safe_sequence
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, SCENE_RELS, STORAGE_VERSION, scene_ddl
from jrdb_avr.schema.labels import ACTIONS, POSES
from jrdb_avr.schema.tables import INTERVALS

STAGE: Final = "scene"
"""Folder inside the store for the staged rows. It is deleted after the graph is built."""

NODES: Final = SCENE_NODES | LAYER_NODES
"""Tables of nodes of the scene and of the keyframe layer."""
RELS: Final = SCENE_RELS | LAYER_RELS
"""Tables of edges of the scene and of the keyframe layer."""

R = TypeVar("R")

BATCH_ROWS: Final = 1_200_000
"""Maximum rows per COPY statement. A file with more rows gets its own statement. The engine needs 700 bytes per row."""


def build_scene(graph: Graph, store: Store, sequences: Sequence[str]) -> dict[str, int | str]:
    """Fill an empty graph with the scenes of the given sequences.

    The function changes the working folder of the process while it runs.

    Args:
        graph: empty graph.
        store: store with the interval tables.
        sequences: names of sequences. If a sequence is not staged yet, the function stages it.

    Returns:
        The number of rows of each table of the graph, by name of the table. The additional key `storage_version` holds
        the version of the storage format.

    Raises:
        StoreError: If the number of rows of a table differs from the number of rows that were copied into it.
    """
    stage = store.path / STAGE
    try:
        for sequence in sequences:
            if not (stage / "Sequence" / f"{safe_sequence(sequence)}.parquet").exists():
                stage_scene(store, sequence, {kind: store.interval(kind, sequence) for kind in INTERVALS})
        # A transaction per table would write to the disk once per table.
        with graph.transaction():
            for statement in scene_ddl():
                graph.execute(statement)
        names: set[str] = set()
        for path in (stage / "Person Performs").glob("*.parquet"):
            names |= set(read_table(path, ["to"])["to"].unique().to_pylist())
        stage_rows(stage, "Action", sequences[0], _actions(names))
        copied = copy_staged(graph, stage, ("Action", *_SOURCES), sequences)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return {**copied, "storage_version": STORAGE_VERSION}


def stage_scene(store: Store, sequence: str, intervals: Mapping[str, pa.Table]) -> None:
    """Write the rows of one sequence to staged files, for every table of the graph except `Action`.

    Args:
        store: store that has the folder of staged rows.
        sequence: name of the sequence.
        intervals: interval tables of the sequence by name.

    Raises:
        StoreError: If a file cannot be written.
    """
    for source, (kind, _) in _SOURCES.items():
        if intervals[kind].num_rows:
            stage_rows(store.path / STAGE, source, sequence, _shape(source, intervals))


def stage_rows(stage: Path, source: str, sequence: str, rows: pa.Table) -> None:
    """Write the rows of one sequence for one table to a file in the folder of staged rows.

    If there are no rows, no file is written.

    Args:
        stage: folder of the staged rows.
        source: text that names a table of the graph. For a table of nodes, it is the name of the table, such as
            "Person". For a table of edges, it is the name of the table of nodes from which the edges start, a space,
            and the name of the table of edges, such as "Person SeenIn".
        sequence: name of the sequence.
        rows: rows with the columns of the table.

    Raises:
        StoreError: If the file cannot be written.
    """
    path = stage / source / f"{safe_sequence(sequence)}.parquet"
    try:
        if rows.num_rows:
            path.parent.mkdir(parents=True, exist_ok=True)
            # The engine scans a whole row group for every null, so groups of 256 rows cut the time to a third.
            at_once = 256 if source == "Object SeenIn" else None
            pq.write_table(rows, path, compression="snappy", row_group_size=at_once)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {str(error).splitlines()[0]}; free some space") from None


def copy_staged(graph: Graph, stage: Path, sources: Iterable[str], sequences: Sequence[str]) -> dict[str, int]:
    """Copy staged rows into the graph. Then compare the number of rows of each table with the number of copied rows.

    Args:
        graph: graph with empty tables.
        stage: folder of the staged rows.
        sources: sources as in `stage_rows`, in the order of copying. Tables of nodes must come before tables of edges.
        sequences: names of the sequences to copy.

    Returns:
        The number of copied rows for each table of the graph, by name of the table.

    Raises:
        StoreError: If the number of rows of a table differs from the number of rows that were copied into it.
    """
    copied: Counter[str] = Counter()
    for source in sources:
        *start, table = source.split()
        paths = [path for sequence in sequences if (path := stage / source / f"{sequence}.parquet").exists()]
        copied[table] += 0
        for files, rows in batches(((path.name, pq.read_metadata(path).num_rows) for path in paths), BATCH_ROWS):
            if table in NODES:
                # The engine reads files in parallel, which changes the order of nodes. One table keeps the order.
                graph.copy(table, pa.concat_tables(read_table(stage / source / name) for name in files))
            else:
                graph.copy_files(table, stage / source, files, (*start, RELS[table][1]) if start else ())
            copied[table] += rows
    graph.execute("CHECKPOINT")
    counts = graph.count_rows()
    for table, expected in copied.items():
        if (rows := counts[table]) != expected:
            raise StoreError(f"the graph holds {rows} rows of {table} instead of {expected}: run the command again")
    return copied


def write_graph(store: Store, write: Callable[[], R]) -> R:
    """Run, in a separate process, a function that writes a graph.

    A fault of the graph engine may end the process that writes. The calling process then goes on.

    Args:
        store: store of the graph. If the separate process dies, its unfinished graph files are deleted.
        write: function without arguments, which must be importable in another process.

    Returns:
        The result of the function.

    Raises:
        StoreError: If the separate process died.
    """
    try:
        return processes.run_alone(write)
    except BrokenProcessPool:
        for unfinished in store.path.glob(".graph.kuzu.building*"):
            unfinished.unlink(missing_ok=True)
        raise StoreError(
            f"the graph could not be written into {store.path}: is the disk or the memory full? "
            'Free some space and run the command again (and in a script call this under `if __name__ == "__main__":`)'
        ) from None


def batches(sizes: Iterable[tuple[str, int]], most: int) -> Iterator[tuple[list[str], int]]:
    """Divide files into batches of a limited number of rows.

    Args:
        sizes: name and number of rows of each file.
        most: maximum number of rows of a batch. A file with more rows forms a batch alone.

    Yields:
        For each batch, the names of its files, and the total number of rows of these files.
    """
    batch: list[str] = []
    rows = 0
    for name, more in sizes:
        if batch and rows + more > most:
            yield batch, rows
            batch, rows = [], 0
        batch.append(name)
        rows += more
    if batch:
        yield batch, rows


def column_names(table: str) -> list[str]:
    """Return the column names of a table of the graph.

    In a table of nodes, the first column is the key. In a table of edges, the first two columns are `from` and `to`.
    """
    if table in RELS:
        return ["from", "to", *(column.split()[0] for column in RELS[table][2])]
    return [column.split()[0] for column in NODES[table].split(", ")]


# -- shapes ------------------------------------------------------------------------------------------------------

Column = str | Callable[[pa.Table], pa.ChunkedArray | pa.Array]
"""Column of an interval table, or a function that makes one column of a table of the graph from the interval table."""


def _number_key(name: str) -> Column:
    """Return a function that makes a key `<sequence>/<id>` for each row.

    The argument `name` is the name of the column that has the ids.
    """
    return lambda rows: pc.binary_join_element_wise(rows["sequence"], rows[name].cast(pa.string()), "/")


def _frame_key(rows: pa.Table) -> pa.ChunkedArray:
    """Return, for each row, the key of the row's frame: `<sequence>/<frame as six digits>`."""
    return pc.binary_join_element_wise(rows["sequence"], pc.utf8_lpad(rows["frame"].cast(pa.string()), 6, "0"), "/")


def _object_key(rows: pa.Table) -> pa.ChunkedArray:
    """Return, for each row, the key of the thing that the row is about: `<sequence>/<category id>:<track>`."""
    thing = pc.binary_join_element_wise(rows["category_id"].cast(pa.string()), rows["object"].cast(pa.string()), ":")
    return pc.binary_join_element_wise(rows["sequence"], thing, "/")


def _box(rows: pa.Table) -> pa.Array:
    return pa.StructArray.from_arrays([rows[name].combine_chunks() for name in "xywh"], names=list("xywh"))


_PERFORMS: Final[dict[str, Column]] = {"from": _number_key("track"), "to": "action"}
_BELONGS: Final[dict[str, Column]] = {"from": _number_key("track"), "to": _number_key("cluster")}
_PAIR: Final[dict[str, Column]] = {"from": _number_key("source"), "to": _number_key("target")}
_HANDLES: Final[dict[str, Column]] = {"from": _number_key("track"), "to": _object_key}

_SOURCES: Final[dict[str, tuple[str, dict[str, Column]]]] = {
    "Sequence": ("sequence", {}),
    "Frame": ("frames", {"id": _frame_key}),
    "Person": ("persons", {"id": _number_key("track")}),
    "Object": ("objects", {"id": _object_key, "track": "object"}),
    "SocialGroup": ("memberships", {"id": _number_key("cluster")}),
    "Person SeenIn": ("sightings", {"from": _number_key("track"), "to": _frame_key, "box": _box}),
    "Object SeenIn": ("object_sightings", {"from": _object_key, "to": _frame_key, "box": _box}),
    "Person Present": ("presences", {"from": _number_key("track"), "to": "sequence"}),
    "Person Absent": ("absences", {"from": _number_key("track"), "to": "sequence"}),
    "Person Performs": ("actions", _PERFORMS),
    "Person MayPerform": ("possible_actions", _PERFORMS),
    "Person MemberOf": ("memberships", _BELONGS),
    "Person MayBelong": ("possible_memberships", _BELONGS),
    "Person Interacts": ("interactions", _PAIR),
    "Person MayInteract": ("possible_interactions", _PAIR),
    "Person Handles": ("handles", _HANDLES),
    "Person MayHandle": ("possible_handles", _HANDLES),
    "Person Beside": ("beside", _PAIR),
}
"""For each source, the name of an interval table, and functions for the columns that the interval table lacks.

Sources are named as in `stage_rows`. Sources of nodes come before sources of edges. `Action` is missing, because its
rows are collected from all sequences.
"""


def _shape(source: str, intervals: Mapping[str, pa.Table]) -> pa.Table:
    """Return the rows of one sequence for a table of the graph, with the columns of this table.

    The argument `source` names the table, and is a key of `_SOURCES`. In sightings of things, the columns that
    describe people are null.
    """
    kind, made = _SOURCES[source]
    rows = _groups(intervals["memberships"], intervals["group_info"]) if source == "SocialGroup" else intervals[kind]
    if source == "Object SeenIn":
        rows = pa.concat_tables([rows, INTERVALS["sightings"].empty_table()], promote_options="permissive")
    columns = column_names(source.split()[-1])
    sources = {name: made.get(name, name) for name in columns}
    shaped = pa.table({name: rows[of] if isinstance(of, str) else of(rows) for name, of in sources.items()})
    # The graph stores whole numbers with 64 bits.
    fields = [pa.field(f.name, pa.int64()) if pa.types.is_integer(f.type) else f for f in shaped.schema]
    return shaped.cast(pa.schema(fields))


def _actions(names: set[str]) -> pa.Table:
    """Return the rows of the table `Action`.

    The table has one row per action of the vocabulary, and one per action in `names` that is not in the vocabulary.
    """
    actions = sorted(names | set(ACTIONS))
    return pa.table({"name": actions, "pose": [name in POSES for name in actions]})


def _groups(memberships: pa.Table, group_info: pa.Table) -> pa.Table:
    """Return one row for each group that has a member.

    A group's row is null in the column of an attribute if no value of this attribute was chosen for the group.
    """
    clusters = memberships.group_by(["sequence", "cluster"]).aggregate([]).sort_by("cluster")
    chosen = group_info.filter(group_info["chosen"]).sort_by([("cluster", "ascending"), ("value", "ascending")])
    for name in ("venue", "aim", "bpc", "ssc", "location", "inter"):
        rows = chosen.filter(pc.equal(chosen["attribute"], name)).group_by("cluster", use_threads=False)
        values = rows.aggregate([("value", "list")])
        if name == "venue":
            values = values.set_column(
                values.schema.get_field_index("value_list"), "value_list", pc.list_element(values["value_list"], 0)
            )
        row = pc.index_in(clusters["cluster"], values["cluster"].combine_chunks())
        clusters = clusters.append_column(name, values["value_list"].combine_chunks().take(row.combine_chunks()))
    return clusters
