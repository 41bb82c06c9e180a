"""The memory of the process that selects and publishes does not grow with the number of sequences."""

import multiprocessing
import random
import re
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from keyframe_layers import layers_in_memory
from loaded_stores import graphless_store
from random_worlds import lively_world

from jrdb_avr.engine.generate import found, publish, run
from jrdb_avr.engine.generate.sequence import SequenceJob, SequenceResult, search_sequence
from jrdb_avr.queries.manifest import SequenceEntry
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import Rules

NAME = "yard-2020-01-01_0"

PADDING = " " * (1 << 17)
"""Padding of every record, so that the memory for sequences stands out from what Python itself takes."""


@pytest.mark.slow
def test_twenty_times_the_sequences_take_the_same_memory(tmp_path):
    store = graphless_store(tmp_path, lively_world(random.Random(5), NAME))
    with layers_in_memory():
        result = search_sequence(SequenceJob(store.path, NAME, 0, Rules()))
    assert len(result.pool) > 20 < len(result.examples)
    once, many = (measured(store, result, names) for names in ([NAME], [f"{NAME}{n}" for n in range(20)]))
    assert many["questions"] >= 10 * once["questions"] > 0
    assert many["megabytes"] < 1.2 * once["megabytes"]


def measured(store, result, names):
    """Questions and highest resident memory of a generation whose sequences all have this result."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(publish_copies, store.path, result, names).result()


def publish_copies(path, result, names):
    store = Store(path)
    manifest = store.manifest()
    (entry,) = manifest.sequences.values()
    store.write_manifest(
        msgspec.structs.replace(manifest, sequences=dict.fromkeys(names, SequenceEntry(entry.layers, {})))
    )
    for folder in (*(path / "intervals").iterdir(), *(path / "annotations").iterdir()):
        for name in names:
            if not (folder / f"{name}.parquet").exists():
                (folder / f"{name}.parquet").symlink_to(f"{NAME}.parquet")
    found.search_sequence = lambda job: copied(result, job.sequence)
    # As many rows as there are few sequences of.
    publish.QUESTION_GROUP = run.REFUSALS_AT_ONCE = 8
    with layers_in_memory():
        questions = sum(row["kept"] for row in run.generate(store, workers=1).selection)
    peak = re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
    return {"questions": questions, "megabytes": int(peak[1]) / 1024}


def copied(result, name):
    """The result as of a sequence of another name, the first of its candidates alone, and their records large."""
    pool = result.pool.slice(0, 40)
    for column, values in {
        "sequence": pa.repeat(pa.scalar(name), len(pool)),
        "key": pc.binary_join_element_wise(name, pool["key"], " "),
        "question_id": pc.binary_join_element_wise(name, pool["question_id"], " "),
        "proofs": pc.binary_join_element_wise(pool["proofs"], PADDING, ""),
    }.items():
        pool = pool.set_column(pool.column_names.index(column), column, values)
    head = {**result.head, "sequence": name}
    examples = [{**row, "sequence": name, "detail": PADDING} for row in result.examples[:20]]
    return SequenceResult(head, pool.cast(result.pool.schema), examples, result.counts)
