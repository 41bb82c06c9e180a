"""Scoring: `python tests/benchmarks/bench_score.py`. Prints seconds for 25 runs of 2,098 predictions (bar: 2 s).

Questions and predictions are made up (`many_runs.py`); the work is what `score` does between reading and writing its
files. `bench_report.py` takes the command as a whole.
"""

import time

import numpy as np
from many_runs import QUESTION_COUNT, RUN_COUNT, made_up_predictions, made_up_questions

from jrdb_avr.engine.report.scoring import Truth, score_predictions


def main() -> None:
    rng = np.random.default_rng(1)
    tables = made_up_questions(rng)
    runs = [made_up_predictions(tables["questions"], rng) for _ in range(RUN_COUNT)]
    ids = tables["questions"]["question_id"].to_pylist()
    start, started = time.perf_counter(), time.process_time()
    truth = Truth(*tables.values())
    prepared = time.perf_counter()
    for number, predictions in enumerate(runs):
        score_predictions(truth, f"r{number}", ids, predictions)
    end, ended = time.perf_counter(), time.process_time()
    print(
        f"{RUN_COUNT} runs x {QUESTION_COUNT}: {end - start:.2f} s in all (bar 2), {prepared - start:.2f} s of it once"
        f"; {ended - started:.2f} CPU s"
    )


if __name__ == "__main__":
    main()
