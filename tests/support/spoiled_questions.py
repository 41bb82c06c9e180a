"""Question files with rows left out or rewritten."""

import pyarrow as pa
import pyarrow.parquet as pq


def rewrite(store, name, change, schema=None):
    """Apply `change` to the rows of a table; its metadata stay."""
    path = store.question_path(name)
    table = pq.read_table(path)
    rows = table.to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows, schema=schema or table.schema), path)


def keep_only(store, ids):
    """Keep these questions, and the evidence of their targets."""

    def keep(rows):
        rows[:] = [row for row in rows if row["question_id"] in ids]

    for name in ("questions", "answers"):
        rewrite(store, name, keep)
    sequences = {row["question_id"]: row["sequence"] for row in store.questions("questions").to_pylist()}
    targets = {(sequences[row["question_id"]], row["target_track"]) for row in store.questions("answers").to_pylist()}

    def drop_others(rows):
        rows[:] = [row for row in rows if (row["sequence"], row["track"]) in targets]

    rewrite(store, "evidence", drop_others)
