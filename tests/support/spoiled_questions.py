"""Question files with rows left out or rewritten."""

import pyarrow as pa
import pyarrow.parquet as pq


def rewrite(store, name, change, schema=None):
    """Apply `change` to the rows of a table, of evidence to those of one file; its metadata stay."""
    _rewrite(_files(store, name)[0], change, schema)


def keep_only(store, name, ids):
    """Keep the rows of these questions; of evidence no file stays without rows."""

    def change(rows):
        rows[:] = [row for row in rows if row["question_id"] in ids]

    for path in _files(store, name):
        if not _rewrite(path, change) and name == "evidence":
            path.unlink()


def _files(store, name):
    path = store.question_path(name)
    return sorted(path.iterdir()) if path.is_dir() else [path]


def _rewrite(path, change, schema=None):
    table = pq.read_table(path)
    rows = table.to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows, schema=schema or table.schema), path)
    return rows
