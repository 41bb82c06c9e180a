"""Costs of each stage as stores grow: `python tests/benchmarks/bench_scale.py [--fold 20 | --smallest] [--workers 2]`.

Two synthetic sequences of every layer without images, and so many times as many of the same size under other names
(and with other people), each loaded and generated from in processes of its own. Printed per stage and store: boxes,
questions, processor seconds of all processes, the highest resident memory of the process that leads and of the largest
of its workers, and bytes on disk; then the slopes between the two stores; selection alone, on what the searches of the
smaller store found, many times; what a question of `react` costs with the simulated model, on a small sample with
images; and what scoring and reporting cost, of 25 made-up runs. Synthetic, all of it: see docs/scale.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import many_runs
import msgspec
import pyarrow.parquet as pq

FRAMES, PEOPLE, SEQUENCES = 300, 20, 2
QUESTIONS, RUNS = 100, 25


def in_new_process(function, *arguments):
    """What a function prints with its costs: processor seconds, megabytes of itself and of its largest child."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_costs, function, arguments).result()


def _costs(function, arguments):
    function(*arguments)
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    busy = own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime
    peak = re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
    return {"cpu": busy, "leads": int(peak[1]) / 1024, "largest": others.ru_maxrss / 1024}


def write(root, count, workers):
    from jrdb_avr.loaders.synthetic.write import plan, write

    root.mkdir(parents=True)
    for _ in write(plan(root, [(FRAMES, PEOPLE)] * count, 0, images="none"), workers):
        pass


def load(root, store, workers):
    from jrdb_avr import load

    load(root, store, workers=workers)


def layer(store, workers):
    from jrdb_avr.engine.generate.stored_layer import ensure_layer
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import Rules

    ensure_layer(Store(store), Rules(), workers)


def generate(store, workers):
    from jrdb_avr import generate

    generate(store, workers=workers)


def size(folder):
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def measure(folder, count, workers):
    """The rows of one store, one per stage."""
    root, store = folder / "root", folder / "store"
    write(root, count, workers)
    parts = {"annotations": "load", "intervals": "load", "graph.kuzu": "layer", "questions": "generate"}
    rows = {
        "load": in_new_process(load, root, store, workers),
        "layer": in_new_process(layer, store, workers),
        "generate": in_new_process(generate, store, workers),
    }
    for row in rows.values():
        row["bytes"] = 0
    for name, stage in parts.items():
        rows[stage]["bytes"] += size(store / name) if (store / name).is_dir() else (store / name).stat().st_size
    boxes = sum(pq.read_metadata(path).num_rows for path in (store / "intervals" / "sightings").iterdir())
    questions = pq.read_metadata(store / "questions" / "questions.parquet").num_rows
    shutil.rmtree(folder)
    return boxes, questions, rows


def found_in(folder, workers):
    """What the searches of a small store find."""
    from jrdb_avr.engine.generate.run import search_sequence
    from jrdb_avr.engine.generate.stored_layer import ensure_layer
    from jrdb_avr.queries.graph.handle import hold_graph
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import Rules

    write(folder / "root", SEQUENCES, workers)
    load(folder / "root", folder / "store", workers)
    store = Store(folder / "store")
    jobs = ensure_layer(store, Rules(), workers)
    with hold_graph(store.graph_path, 1):
        return [search_sequence(job) for job in jobs]


def select_copies(found, copies):
    """Select among the same candidates many times, as of sequences of other names."""
    from jrdb_avr.engine.generate.asked import Candidate
    from jrdb_avr.engine.generate.guessers import LabelCounts
    from jrdb_avr.engine.generate.selection import select
    from jrdb_avr.schema.rules import Rules

    pool, counts = defaultdict(list), {}
    for copy, sequence in itertools.product(range(copies), found):
        name = f"{copy} {sequence.head['sequence']}"
        counts |= {(name, frame): actions for frame, actions in sequence.counts.items()}
        for row in msgspec.msgpack.decode(sequence.pool, type=list[Candidate]):
            contexts = tuple((text.replace(row.sequence, name), weight) for text, weight in row.contexts)
            pool[row.template].append(row._replace(sequence=name, key=f"{copy} {row.key}", contexts=contexts))
    select(pool, LabelCounts(counts), Rules(), "all", None)


def measure_selection(folder, workers):
    """Cost of selection among 50 and 200 times the candidates of the small store."""
    found = found_in(folder, workers)
    print("\nselection:", flush=True)
    for copies in (50, 200):
        row = in_new_process(select_copies, found, copies)
        print(f"{copies:5} copies {row['cpu']:8.1f} cpu s {row['leads']:8.0f} MB", flush=True)


def command(*arguments):
    """Run the command; returns what it prints, its processor seconds, and its highest resident megabytes."""
    line = [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()", *map(str, arguments)]
    with tempfile.TemporaryFile("w+b") as printed:
        process = subprocess.Popen(line, stdout=printed, stderr=subprocess.DEVNULL)
        _, code, usage = os.wait4(process.pid, 0)
        assert code == 0, f"{arguments} failed"
        printed.seek(0)
        return printed.read(), usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def reported(folder):
    """Slopes of scoring and reporting, between a fifth and all of the made-up runs."""
    # In another process: what this one holds would count as the peak of those that it starts.
    in_new_process(many_runs.write_runs, folder, RUNS)
    store = folder
    stages = {"score": ("score", "--store", store), "report": ("report", "--store", store, "--table", "all", "--json")}

    def least(stage):
        return [min(costs) for costs in zip(*(command(*stage)[1:] for _ in range(3)), strict=True)]

    many = {name: least(stage) for name, stage in stages.items()}
    for left in sorted((store / "runs").iterdir())[RUNS // 5 :]:
        shutil.rmtree(left)
    more = (RUNS - RUNS // 5) * many_runs.QUESTION_COUNT
    print("\nof each prediction:")
    for name, stage in stages.items():
        spent, held = (a - b for a, b in zip(many[name], least(stage), strict=True))
        print(f"{name:10}{spent / more * 1e6:9.0f} microseconds{held / more * 1e6:9.0f} bytes in memory")


def answered(folder):
    """Cost of one question of `react` with the simulated model."""
    root, store = folder / "root", folder / "store"
    command("sample", root, "--sequences", 2, "--frames", 450, "--people", 14, "--workers", 1)
    command("load", root, "--store", store, "--workers", 1)
    command("generate", "--store", store, "--workers", 1)
    run = ("evaluate", "--store", store, "--method", "react", "--model", "simulated", "--no-scores")
    few = command(*run, "--run-id", "few", "--limit", QUESTIONS // 10)[1]
    busy = command(*run, "--run-id", "many", "--limit", QUESTIONS)[1]
    sums = "sum(n_model_calls) AS calls, sum(prompt_tokens) AS read, sum(completion_tokens) AS written, count(*) AS n"
    (row,) = json.loads(
        command("sql", f"SELECT {sums} FROM predictions WHERE run_id = 'many'", "--store", store, "--json")[0]
    )
    n = row["n"]
    print(f"\nreact, simulated model, {n} questions; of each (processor seconds: beyond those of {QUESTIONS // 10}):")
    spent = (busy - few) / (n - QUESTIONS // 10)
    written = size(store / "runs" / "many") / n
    print(
        f"{spent:.3f} s of harness and simulated model, {row['calls'] / n:.1f} calls, {row['read'] / n:,.0f} tokens "
        f"read and {row['written'] / n:,.0f} written, {written:,.0f} bytes"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fold", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--smallest", action="store_true", help="short sequences, twice as many, and five runs")
    options = parser.parse_args()
    if options.smallest:
        options.fold = 2
        globals().update(FRAMES=90, PEOPLE=8, QUESTIONS=10, RUNS=5)
    with tempfile.TemporaryDirectory() as scratch:
        found = {}
        print(f"{'sequences':>9}{'boxes':>10}{'questions':>11}{'stage':>10}{'cpu s':>9}", end="")
        print(f"{'leads MB':>10}{'largest MB':>12}{'disk MB':>8}")
        for fold in (1, options.fold):
            count = fold * SEQUENCES
            boxes, questions, rows = found[fold] = measure(Path(scratch) / f"{fold}", count, options.workers)
            for stage, row in rows.items():
                line = f"{count:9}{boxes:10,}{questions:11,}{stage:>10}{row['cpu']:9.1f}{row['leads']:10.0f}"
                print(f"{line}{row['largest']:12.0f}{row['bytes'] / 1e6:8.1f}", flush=True)
        (few, _, before), (many, _, after) = found.values()
        print("\nslopes, for each million boxes more:")
        for stage, row in after.items():
            busy, kept, leads = (
                (row[name] - before[stage][name]) / (many - few) * 1e6 for name in ("cpu", "bytes", "leads")
            )
            print(f"{stage:10}{busy:9.1f} cpu s{kept / 1e6:9.1f} MB on disk{leads:9.1f} MB in the process that leads")
        measure_selection(Path(scratch) / "selected", options.workers)
        answered(Path(scratch) / "answered")
        reported(Path(scratch) / "reported")


if __name__ == "__main__":
    main()
