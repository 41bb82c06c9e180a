"""The graph of a store as Parquet files, for other graph engines.

nodes/<table>.parquet                  a row per node
edges/<table>_<start>_<end>.parquet    a row per edge; `from` and `to` are the keys of its nodes
schema.json                            each file with its table, its columns, and the keys of nodes
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from jrdb_avr.queries.files import new_folder, write_bytes
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.catalog import graph_tables


def export_graph(store: Store, folder: Path) -> list[dict[str, Any]]:
    """Write the nodes and edges of a store's graph as Parquet files.

    Args:
        store: The store.
        folder: The folder to write. It must be missing or empty.

    Returns:
        The content of `schema.json`: one entry per file, with the number of its rows.

    Raises:
        StoreError: If the graph is missing or damaged, or if the folder cannot be written.
        InputError: If the folder is not empty.
    """
    entries: list[dict[str, Any]] = []
    with Graph.open(store.graph_path, read_only=True) as graph, new_folder(folder, 0o700) as made:
        tables = [table for table in graph_tables() if table.name in graph.tables()]
        keys = {table.name: next(iter(table.columns)) for table in tables if table.ends is None}

        def write(name: str, file: str, pattern: str, columns: dict[str, str], about: dict[str, str]) -> None:
            returned = ", ".join(f"{value} AS `{column}`" for column, value in columns.items())
            rows: pa.Table = graph.query(f"MATCH {pattern} RETURN {returned}", ordered=False)
            write_table(made / file, rows, rows.schema)
            kinds = {field.name: str(field.type) for field in rows.schema}
            entries.append({"table": name, "file": file, **about, "columns": kinds, "rows": len(rows)})

        for table in tables:
            name, values = table.name, {column: f"t.`{column}`" for column in table.columns}
            if table.ends is None:
                write(name, f"nodes/{name}.parquet", f"(t:`{name}`)", values, {"key": keys[name]})
                continue
            for start, end in ((start, end) for start in table.ends[0] for end in table.ends[1]):
                values = {"from": f"a.`{keys[start]}`", "to": f"b.`{keys[end]}`", **values}
                pattern = f"(a:`{start}`)-[t:`{name}`]->(b:`{end}`)"
                write(name, f"edges/{name}_{start}_{end}.parquet", pattern, values, {"from": start, "to": end})
        write_bytes(made / "schema.json", msgspec.json.format(msgspec.json.encode(entries), indent=1))
    return entries
