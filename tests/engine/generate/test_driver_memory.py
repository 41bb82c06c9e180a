"""The process that selects and publishes keeps some kilobytes of each candidate, and no more."""

import contextlib
import multiprocessing
import random
import re
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import msgspec
import pyarrow as pa
import pytest
from keyframe_layers import make_all, search_one
from loaded_stores import graphless_store
from random_worlds import lively_world

from jrdb_avr.engine.generate import run
from jrdb_avr.engine.generate.question import COLUMNS
from jrdb_avr.engine.generate.stored_layer import Job
from jrdb_avr.engine.report.hashes import hash_of
from jrdb_avr.queries.manifest import SequenceEntry
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import Rules

NAME = "yard-2020-01-01_0"
KILOBYTES = 60
"""Most memory per candidate: ten times what its row takes in the pool."""


@pytest.mark.slow
def test_a_candidate_more_takes_some_kilobytes(tmp_path):
    store = graphless_store(tmp_path, lively_world(random.Random(5), NAME))
    found, candidates = search_one(store, NAME, Rules())
    assert len(candidates) > 20 and found.refused
    rows, _ = make_all(store, NAME, Rules(), candidates, found.counts)
    once, many = (measured(store, found, rows[0], count) for count in (5, 65))
    more = 60 * len(candidates)
    assert many["questions"] > 8 * once["questions"] > 0
    assert (many["kilobytes"] - once["kilobytes"]) / more < KILOBYTES


def measured(store, found, row, count):
    """Questions and highest resident memory of a generation over so many sequences that all have this result."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(publish_copies, store.path, found, row, [f"{NAME}{n}" for n in range(count)]).result()


def publish_copies(path, found, row, names):
    store = Store(path)
    manifest = store.manifest()
    (entry, *_) = manifest.sequences.values()
    store.write_manifest(
        msgspec.structs.replace(manifest, sequences=dict.fromkeys(names, SequenceEntry(entry.layers, {})))
    )
    for folder in (*(path / "intervals").iterdir(), *(path / "annotations").iterdir()):
        for name in names:
            if not (folder / f"{name}.parquet").exists():
                (folder / f"{name}.parquet").symlink_to(f"{NAME}.parquet")
    run.ensure_layer = lambda store, rules, *_: [Job(store.path, name, 0, rules) for name in names]
    run.hold_graph = lambda *_: contextlib.nullcontext()
    run.search_sequence = lambda job: copied(found, job.sequence)
    run.make_questions = lambda job: (made(job, row), {})
    questions = sum(row["reached"] for row in run.generate(store, workers=1).selection)
    peak = re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
    return {"questions": questions, "kilobytes": int(peak[1])}


def made(job, row):
    """Questions that differ in their ids only."""
    own = [(one.key, one.candidate) for one in job.questions]
    rows = [
        row | {"key": key, "question_id": f"{hash_of(key):016x}", "sequence": one.sequence, "template": one.template}
        for key, one in own
    ]
    return pa.Table.from_pylist(rows, schema=COLUMNS)


def copied(found, name):
    """The result as of a sequence of another name."""
    candidates = run._CANDIDATES.decode(found.pool)
    own = [one._replace(sequence=name, key=f"{name} {one.key}") for one in candidates]
    refused = [{**row, "sequence": name} for row in found.refused]
    return found._replace(head={**found.head, "sequence": name}, pool=msgspec.msgpack.encode(own), refused=refused)
