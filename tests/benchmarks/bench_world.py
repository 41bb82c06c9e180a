"""Processor time of the world model in a run: `python tests/benchmarks/bench_world.py [STORE] [--smallest]`.

The method `agent` answers 192 questions with the simulated model and realistic errors, 64 at a time. The processor time
of a turn is that of its reads and writes, in the turn's thread and in the engine's own thread. Only one turn runs
statements at a time, because the time of the engine's thread must belong to one turn.

Exit code 1 if the median of turns is over 30 ms or the 99th percentile is over 150 ms. Without STORE, the questions are
about a sample.
"""

import argparse
import contextlib
import sys
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from unittest import mock

import numpy as np
from bench_agent import choose_questions, make_sample

from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.options import EvaluateOptions, QuestionSelection, RunOptions
from jrdb_avr.engine.run.overview import remove_run
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.questions import read_question_rows
from jrdb_avr.queries.store import Store

IN_FLIGHT, QUESTIONS = 64, 192
MEDIAN_MS, LATE_MS = 30.0, 150.0
THREADS = Path("/proc/self/task")


class Meter:
    """Processor seconds of each turn by kind of statement. Three methods replace methods of `WorldGraph`."""

    def __init__(self):
        self.turns, self.counts = [], defaultdict(int)
        self._open, self._begin = WorldGraph.open, WorldGraph.begin_turn
        self._engine, self._turn, self._lock = [], threading.local(), threading.Lock()

    def open(self, path):
        before = {*THREADS.iterdir()}
        graph = self._open(path)
        self._engine = [thread / "schedstat" for thread in {*THREADS.iterdir()} - before]
        assert self._engine, "the engine has threads of its own"
        return graph

    def begin_turn(self, graph):
        self._turn.times = {"reads": 0.0, "writes": 0.0}
        self.turns.append(self._turn.times)
        self._begin(graph)

    @contextlib.contextmanager
    def measured(self, kind, statements):
        with self._lock:
            began = self._seconds()
            yield
            seconds = self._seconds() - began
        self.counts[kind] += statements
        if hasattr(self._turn, "times"):
            self._turn.times[kind] += seconds

    def _seconds(self):
        nanoseconds = sum(int(file.read_text().split()[0]) for file in self._engine)
        return time.thread_time() + nanoseconds / 1e9


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", nargs="?", type=Path, metavar="STORE")
    parser.add_argument("--smallest", action="store_true", help="two questions")
    given = parser.parse_args()
    meter = Meter()
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as patches:
        store = Store(given.store or make_sample(Path(folder), given.smallest))
        ids = choose_questions(read_question_rows(store), 2 if given.smallest else QUESTIONS)
        for name, function in (
            ("open", staticmethod(meter.open)),
            ("begin_turn", lambda graph: meter.begin_turn(graph)),
            ("_measured", lambda graph, *counted: meter.measured(*counted)),
        ):
            patches.enter_context(mock.patch.object(WorldGraph, name, function))
        run = RunOptions(run_id=f"bench-world-{time.time_ns()}", concurrency=IN_FLIGHT)
        options = EvaluateOptions(selection=QuestionSelection(questions=ids), run=run)
        evaluate(store, "agent", "simulated:realistic", options)
        remove_run(store, run.run_id)
    times = {kind: [turn[kind] for turn in meter.turns] for kind in ("writes", "reads")}
    times["turn"] = [sum(turn.values()) for turn in meter.turns]
    print(f"{len(ids)} questions, {len(meter.turns)} turns\n        ms of processor: p50      p90      p99")
    for kind, values in times.items():
        median, high, late = 1000 * np.percentile(values, (50, 90, 99))
        print(f"{kind:7} {median:20.2f} {high:8.2f} {late:8.2f}")
    print("statements per turn:", ", ".join(f"{kind} {n / len(meter.turns):.1f}" for kind, n in meter.counts.items()))
    sys.exit(int(not given.smallest and (median > MEDIAN_MS or late > LATE_MS)))


if __name__ == "__main__":
    main()
