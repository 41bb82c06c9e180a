"""How fast loading is, as ratios of one run.

    python tests/benchmarks/bench_load.py [--scale 0.25] [--root ROOT] [--workers 2]

The yardstick is decoding the same files with msgspec typed structs, garbage collector off, nothing kept: once in one
process, and once in as many worker processes as the load gets. Without ROOT a synthetic root without images is made;
scale 1 is the size of the full data set (27 sequences, about 957,000 boxes). Printed: wall times, their ratios to both
yardsticks, and peak memory of the workers and of the parent.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import multiprocessing
import resource
import shutil
import tempfile
import time
from pathlib import Path

import msgspec

from jrdb_avr.loaders import load as loading
from jrdb_avr.loaders.layers import find_root
from jrdb_avr.loaders.shards import map_shards
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules


class Attributes2D(msgspec.Struct, gc=False):
    area: float = 0.0
    interpolated: bool = False
    no_eval: bool = False
    occlusion: str | None = None
    truncated: str | bool | None = None


class Group(msgspec.Struct, gc=False):
    cluster_ID: int  # noqa: N815
    cluster_stat: int | str


class Person2D(msgspec.Struct, gc=False):
    label_id: str
    box: tuple[float, float, float, float]
    file_id: str | None = None
    attributes: Attributes2D | None = None
    action_label: dict[str, int | str | float] | None = None
    social_activity: dict[str, float | str] | None = None
    social_group: Group | None = None


class Box3D(msgspec.Struct, gc=False):
    cx: float
    cy: float
    cz: float
    l: float  # noqa: E741
    w: float
    h: float
    rot_z: float


class Attributes3D(msgspec.Struct, gc=False):
    distance: float | None = None
    interpolated: bool = False
    no_eval: bool = False
    num_points: int | None = None


class Person3D(msgspec.Struct, gc=False):
    label_id: str
    box: Box3D
    file_id: str | None = None
    attributes: Attributes3D | None = None
    observation_angle: float | None = None


class File2D(msgspec.Struct, gc=False):
    labels: dict[str, list[Person2D]]


class File3D(msgspec.Struct, gc=False):
    labels: dict[str, list[Person3D]]


TYPES = {"2d": File2D, "3d": File3D}


def decode(files):
    """The yardstick's work on one sequence: records decoded."""
    gc.disable()
    records = 0
    for layer, path in files.labels.items():
        decoded = msgspec.json.decode(Path(path).read_bytes(), type=TYPES[layer])
        records += sum(map(len, decoded.labels.values()))
    return records


def tables_only(shard):
    """Files to tables and intervals on disk; peak memory of this process in MB."""
    loading.load_shard(shard)
    return peak()


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@contextlib.contextmanager
def stopwatch(times, name):
    start = time.perf_counter()
    yield
    times[name] = time.perf_counter() - start


def warm_pool(workers):
    """Workers that have imported everything: starting an interpreter is not what is measured."""
    pool = multiprocessing.get_context("spawn").Pool(workers)
    pool.map(_import, range(workers * 4), chunksize=1)
    return pool


def _import(_):
    time.sleep(0.05)
    return loading.STAGING


def measure(root, workers, folder):
    files = sorted(find_root(root).sequences, key=lambda f: -f.weight)
    size = sum(f.weight for f in files) / 1e6
    times = {}
    with stopwatch(times, "decode, 1 process"):
        records = sum(map(decode, files))
    with warm_pool(workers) as pool, stopwatch(times, f"decode, {workers} processes"):
        pool.map(decode, files, chunksize=1)
    shards = [loading.Shard(f, str(folder / "tables"), LoadRules()) for f in files]
    with stopwatch(times, "tables, 1 process"):
        for shard in shards:
            loading.load_shard(shard)
    shutil.rmtree(folder / "tables")
    with warm_pool(workers) as pool, stopwatch(times, f"tables, {workers} processes"):
        peaks = pool.map(tables_only, shards, chunksize=1)
    store = Store(folder / "store")
    with stopwatch(times, f"whole load, {workers} processes"):
        loading.load(find_root(root), store, LoadRules(), workers)
    rows = store.manifest().graph
    print(f"{len(files)} sequences, {size:.0f} MB, {records:,} records, graph rows {rows}")
    ones, many = times["decode, 1 process"], times[f"decode, {workers} processes"]
    print(f"{'':32}{'seconds':>9}{'/ 1 process':>14}{f'/ {workers} processes':>14}")
    for name, seconds in times.items():
        print(f"{name:32}{seconds:9.2f}{seconds / ones:14.2f}{seconds / many:14.2f}")
    print(f"peak memory: worker {max(peaks):.0f} MB, parent {peak():.0f} MB")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--root", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = options.root
        if root is None:
            root = Path(folder) / "root"
            sample(root, options.scale, options.workers)
        measure(root, options.workers, Path(folder))


def sample(root, scale, workers):
    """A synthetic root; every sequence keeps its number of people, and a share of its frames."""
    from jrdb_avr.loaders.sample.writer import FULL_SCALE, plan, write

    sizes = [(max(60, round(frames * scale)), people) for frames, people in FULL_SCALE]
    for _ in write(plan(root, sizes, 0, images="none"), workers):
        pass


if __name__ == "__main__":
    assert map_shards  # the load spawns workers through it
    main()
