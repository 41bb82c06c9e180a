"""Evidence of a store as one table, which lies in a file per sequence; all files of a generation; blocked files."""

import os
import shutil

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.tables import PRIVATE, QUESTIONS


def all_evidence(store):
    """The evidence of all questions, by question and frame."""
    questions = store.questions("questions")
    tables = [store.evidence(name, questions) for name in questions["sequence"].unique().to_pylist()]
    return pa.concat_tables([QUESTIONS["evidence"].empty_table(), *tables]).sort_by(
        [("question_id", "ascending"), ("frame", "ascending")]
    )


def write_evidence(store, table, metadata=None):
    """Write evidence of questions that are written already, also where some have none."""
    questions = store.questions("questions")
    for name in questions["sequence"].unique().to_pylist():
        ids = questions.filter(pc.field("sequence") == name)["question_id"].combine_chunks()
        own = table.filter(pc.is_in(table["question_id"], value_set=ids))
        write_table(store.evidence_path(name), own, QUESTIONS["evidence"], metadata)


def question_files(store):
    """The paths of all files of a generation in `questions/`, by name."""
    folder = store.question_path("questions").parent
    return {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*.parquet"))}


def blocked_store(original, path):
    """Copy a store without its runs, with a named pipe in place of each private file: whatever opens one hangs."""
    shutil.copytree(original, path, ignore=shutil.ignore_patterns("runs"))
    store = Store(path)
    private = [store.question_path(name) for name in PRIVATE]
    files = [file for place in private for file in (place.iterdir() if place.is_dir() else [place])]
    for place in [*files, store.graph_path, *store.path.glob("annotations/**/*.parquet")]:
        place.unlink(missing_ok=True)
        os.mkfifo(place)
    return store
