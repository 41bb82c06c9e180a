"""Seconds of scoring 25 runs of 2,098 predictions (bar: 2 s): `python tests/benchmarks/bench_score.py [--smallest]`.

Questions and predictions are made up (`many_runs.py`). The work is what `score` does before it writes its files, in
this process: the answers, a million boxes of evidence and the predictions are read and compared. Then the highest
resident memory of `score` and `report`, each a process of its own, for one run of as many questions and of five times
as many, over five times as many sequences. `bench_report.py` takes the
commands as a whole.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import many_runs

from jrdb_avr.engine.report.run_scores import read_submission, score_runs
from jrdb_avr.engine.report.truth import read_truth
from jrdb_avr.queries.runs import run_ids
from jrdb_avr.queries.store import Store

FOLDS = (1, 5)
SMALLEST = "--smallest" in sys.argv


def write(path, runs, fold=1):
    """Write a store in another process, as a child's peak of memory begins with that of its parent."""
    call = f"many_runs.write_runs({str(path)!r}, {runs})"
    small = f"vars(many_runs).update({many_runs.SMALLEST if SMALLEST else {}})"
    sizes = f"{small}; many_runs.QUESTION_COUNT *= {fold}; many_runs.SEQUENCES *= {fold}; many_runs.PEOPLE = 2"
    subprocess.run([sys.executable, "-c", f"import many_runs; {sizes}; {call}"], check=True, cwd=Path(__file__).parent)
    return Store(path)


def peak(*arguments):
    """Highest resident megabytes of a command."""
    line = [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()", *map(str, arguments)]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, code, usage = os.wait4(process.pid, 0)
    assert code == 0, arguments
    return usage.ru_maxrss / 1024


def main() -> None:
    if SMALLEST:
        vars(many_runs).update(many_runs.SMALLEST)
    with tempfile.TemporaryDirectory() as folder:
        peaks = {}
        for fold in FOLDS:
            store = write(f"{folder}/{fold}", 1, fold).path
            peaks[fold] = [peak(stage, "--store", store) for stage in ("score", "report")]
        store = write(f"{folder}/many", many_runs.RUN_COUNT)
        start, started = time.perf_counter(), time.process_time()
        runs = score_runs(
            read_truth(store), run_ids(store), lambda name: read_submission(store, name), 0.5, strict=True
        )
        took, busy = time.perf_counter() - start, time.process_time() - started
    assert len(runs) == many_runs.RUN_COUNT
    count = many_runs.QUESTION_COUNT
    print(f"{len(runs)} runs x {count}: {took:.2f} s in all (bar 2); {busy:.2f} CPU s")
    for fold, (score, report) in peaks.items():
        boxes = fold * count * many_runs.EVIDENCE_FRAMES
        print(f"one run of {fold * count:6,} questions, {boxes:9,} boxes: score {score:.0f} MB, report {report:.0f} MB")


if __name__ == "__main__":
    main()
