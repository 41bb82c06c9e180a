"""Question files with rows left out or rewritten."""

import pyarrow as pa
import pyarrow.parquet as pq


def rewrite(store, name, change, schema=None):
    """Apply `change` to the rows of a table, keeping its metadata."""
    path = store.question_path(name)
    table = pq.read_table(path)
    rows = table.to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows, schema=schema or table.schema), path)


def keep_only(store, name, ids):
    def change(rows):
        rows[:] = [row for row in rows if row["question_id"] in ids]

    rewrite(store, name, change)
