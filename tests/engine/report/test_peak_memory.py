"""The memory of `score` and `report` does not grow with the number of sequences."""

import re
import subprocess
import sys

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from known_runs import BOX, Benchmark

from jrdb_avr.queries.runs import questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store, write_table
from jrdb_avr.schema.tables import QUESTIONS, RUNS

QUESTIONS_EACH, BOXES_EACH = 8, 20_000
"""More boxes in a sequence than are gathered for scoring, so that one of them takes what it takes to score any."""

PADDING = "x" * 200_000
"""A model's text, which no score needs."""

# The peak that the kernel reports for a child counts what its parent held when it began; this one does not.
MEASURED = """
import sys
from pathlib import Path
from jrdb_avr.engine.cli import main
try:
    main()
except SystemExit as end:
    assert not end.code
print(Path("/proc/self/status").read_text(), file=sys.stderr)
"""


def store_of(path, sequences):
    """A store with a run of so many sequences."""
    asked = [(f"q{s:02}-{n}", f"s{s:02}", "long_range") for s in range(sequences) for n in range(QUESTIONS_EACH)]
    store, benchmark = Store(path), Benchmark(asked)
    run = benchmark.run([(1, BOX, 7)] * len(asked))
    for name in ("questions", "sequences", "answers"):
        store.write_questions(name, benchmark.tables[name], {})
    for s in range(sequences):
        ids = [f"q{s:02}-{n}" for n in range(QUESTIONS_EACH)]
        sides = {side: np.full(QUESTIONS_EACH * BOXES_EACH, value) for side, value in zip("xywh", BOX, strict=True)}
        frames = np.tile(np.arange(BOXES_EACH), QUESTIONS_EACH)
        columns = {"question_id": np.repeat(ids, BOXES_EACH), "frame": frames, **sides}
        write_table(
            store.evidence_path(f"s{s:02}"), pa.table(columns).cast(QUESTIONS["evidence"]), QUESTIONS["evidence"]
        )
    rows = [row | {"raw": f"{n}{PADDING}"} for n, row in enumerate(benchmark.written["predictions"].to_pylist())]
    store.write_run("r", "predictions", pa.Table.from_pylist(rows, RUNS["predictions"]))
    write_run_manifest(store, msgspec.structs.replace(run.manifest, questions_sha256=questions_hash(store)))
    return path


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    folder = tmp_path_factory.mktemp("memory")
    return [store_of(folder / str(count), count) for count in (1, 20)]


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [("score",), ("report", "--table", "sequence")], ids=["score", "report"])
def test_twenty_times_the_sequences_take_the_same_memory(stores, arguments):
    few, many = (peak(*arguments, "--store", store) for store in stores)
    assert many < 1.2 * few, (few, many)


def peak(*arguments):
    """The highest resident megabytes of a command in a process of its own."""
    line = [sys.executable, "-c", MEASURED, *map(str, arguments)]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return int(re.search(r"VmHWM:\s*(\d+)", done.stderr)[1]) / 1024
