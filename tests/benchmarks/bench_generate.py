"""How long generation takes, what memory it holds, and whether its time grows with the boxes alone.

    python tests/benchmarks/bench_generate.py [--store STORE] [--workers 2] [--scale 0.25 | --smallest]

STORE is a loaded store, which is only read. Without it a synthetic one of every layer is made (scale 1: 27 sequences,
about 957,000 boxes). Measured are all sequences, a third and a ninth of them (every third and every ninth by size).
Printed for each part, for the keyframe layer and for the rest of `generate`: wall and processor seconds, processor
seconds per million boxes, and the highest resident memory of all processes together, sampled fifty times a second.

On a machine that is busy with other things processor seconds hold better than wall seconds.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import msgspec
import pyarrow.parquet as pq
from bench_load import Clock, Memory, sample

from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.generate.stored_layer import ensure_layer
from jrdb_avr.loaders.graph import build_scene
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.graph.handle import build_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules, Rules

RULES = Rules()


def part_of(store, names, folder):
    """Return a store of some of the sequences whose tables are those of another one."""
    folder.mkdir()
    for name in ("annotations", "intervals"):
        (folder / name).symlink_to((store.path / name).resolve())
    part = Store(folder)
    whole = store.manifest()
    part.write_manifest(msgspec.structs.replace(whole, sequences={name: whole.sequences[name] for name in names}))
    with build_graph(part.graph_path) as graph:
        build_scene(graph, part, names)
    return part


def count_boxes(store, sequence):
    return pq.read_metadata(store.interval_path("sightings", sequence)).num_rows


def measure(store, workers, folder):
    """Print the costs of whole generations of all sequences, of a third and of a ninth of them."""
    by_size = sorted(store.manifest().sequences, key=lambda name: (count_boxes(store, name), name))
    print(
        f"{'sequences':>9}{'boxes':>11}{'':>7}{'wall s':>9}{'cpu s':>9}{'cpu s / million':>17}"
        f"{'peak MB':>9}{'questions':>11}"
    )
    for step in (1, 3, 9):
        names = by_size[step // 2 :: step]
        if not names:
            continue
        # In a process of its own, as this one would keep the memory that it took.
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            part = pool.submit(part_of, store, names, folder / f"every-{step}").result()
        clock, memories = Clock(), {}
        with Memory() as memories["layer"], clock("layer"):
            ensure_layer(part, RULES, workers)
        with Memory() as memories["rest"], clock("rest"):
            report = generate(part, RULES, workers=workers)
        number = sum(count_boxes(store, name) for name in names)
        questions = {"rest": f"{sum(row['questions'] for row in report.templates):,}"}
        for stage, memory in memories.items():
            wall, busy = clock.seconds[stage]
            line = f"{len(names):9}{number:11,}{stage:>7}{wall:9.1f}{busy:9.1f}{busy / number * 1e6:17.1f}"
            print(f"{line}{memory.all:9.0f}{questions.get(stage, ''):>11}")
        assert not report.faults, report.faults[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--smallest", action="store_true", help="one sequence of 180 frames")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if options.store is None:
            sample(folder / "root", options.scale, options.workers, options.smallest)
            load(find_root(folder / "root"), folder / "store", LoadRules(), options.workers)
        measure(Store(options.store or folder / "store"), options.workers, folder)


if __name__ == "__main__":
    main()
