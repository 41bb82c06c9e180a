"""Evidence of a store as one table, the files of a generation, and files that are changed, removed or blocked."""

import os
import shutil

import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.tables import PRIVATE, QUESTIONS


def all_evidence(store):
    """The evidence of all questions: a row per question and frame, in this order."""
    questions, answers, evidence = store.question_tables("questions", "answers", "evidence")
    targets = questions.select(["question_id", "sequence"]).join(
        answers.select(["question_id", "target_track"]), "question_id", join_type="inner"
    )
    joined = targets.join(evidence, ["sequence", "target_track"], ["sequence", "track"], join_type="inner")
    names = ["question_id", *QUESTIONS["evidence"].names[2:]]
    return joined.select(names).sort_by([("question_id", "ascending"), ("frame", "ascending")])


def question_files(store):
    """The paths of all files of a generation in `questions/`, by name."""
    folder = store.question_path("questions").parent
    return {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*.parquet"))}


def blocked_store(original, path):
    """Copy a store without its runs, with a named pipe in place of each private file: whatever opens one hangs."""
    shutil.copytree(original, path, ignore=shutil.ignore_patterns("runs"))
    store = Store(path)
    private = [store.question_path(name) for name in PRIVATE]
    for place in [*private, store.graph_path, *store.path.glob("annotations/**/*.parquet")]:
        place.unlink(missing_ok=True)
        os.mkfifo(place)
    return store


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
