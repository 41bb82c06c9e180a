"""How fast loading is and what memory it takes, as ratios of one run.

    python tests/benchmarks/bench_load.py [--scale 0.25] [--root ROOT] [--workers 2]

The yardstick is decoding the same files with msgspec structs of all their fields, garbage collector off, nothing kept:
once in one process, and once in as many worker processes as the load gets. Without ROOT a synthetic root of every layer
without images is made; scale 1 is the size of the full data set (27 sequences, about 957,000 boxes).

Printed: wall and processor seconds with ratios to the yardsticks; where the time of the tables goes, in one process;
where that of the graph goes, by table; and the highest resident memory of each process and of all together while
loading, sampled fifty times a second. On a machine that is busy with other things the ratios of processor seconds
hold better than those of wall seconds.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import multiprocessing
import os
import resource
import shutil
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from unittest import mock

import msgspec

from jrdb_avr.loaders import load as loading
from jrdb_avr.loaders import sequence as annotating
from jrdb_avr.loaders.graph import build_scene
from jrdb_avr.loaders.intervals import derive as deriving
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules

Code = int | str | float
Label = dict[str, Code]


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
    label_id: str | None = None
    box: tuple[float, float, float, float] | None = None
    file_id: str | None = None
    attributes: Attributes2D | None = None
    action_label: dict[str, Code] | None = None
    social_activity: dict[str, Code] | None = None
    social_group: Group | None = None


class Demographics(msgspec.Struct, gc=False):
    gender: Label | None = None
    age: Label | None = None
    race: Label | None = None


class Interaction(msgspec.Struct, gc=False):
    pair: str | None = None
    box_pair: list[float] | None = None
    inter_labels: Label | None = None


class GroupInfo(msgspec.Struct, gc=False):
    venue: Label | None = None
    aim: Label | None = None
    inter: Label | None = None
    BPC: Label | None = None
    SSC: Label | None = None
    location_pre: Label | None = None


class PersonSocial(Person2D, gc=False):
    demographics_info: list[Demographics] = []
    interactions: list[Interaction] | None = msgspec.field(default=None, name="H-interaction")
    group_info: list[GroupInfo] = []


class Thing(msgspec.Struct, gc=False):
    pair: list[int | str] | str | None = None
    box_pair: list[float] | None = None
    inter_labels: Label | None = None


class PersonReasoning(Person2D, gc=False):
    demographics_info: list[Demographics] = []
    people: list[Interaction] = msgspec.field(default_factory=list, name="HHI")
    things: list[Thing] = msgspec.field(default_factory=list, name="HOI")
    group_info: list[GroupInfo] = []
    group_size: int | None = None


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


class FileSocial(msgspec.Struct, gc=False):
    labels: dict[str, list[PersonSocial]]


class FileReasoning(msgspec.Struct, gc=False):
    labels: dict[str, list[PersonReasoning]]


class File3D(msgspec.Struct, gc=False):
    labels: dict[str, list[Person3D]]


class Image(msgspec.Struct, gc=False):
    id: int
    file_name: str
    width: int = 0
    height: int = 0


class Pose(msgspec.Struct, gc=False):
    id: int
    image_id: int
    track_id: int | str | None = None
    category_id: int = 1
    keypoints: list[float] = []
    num_keypoints: int = 0


class Runs(msgspec.Struct, gc=False):
    size: list[int] = []
    counts: str | list[int] = ""


class Segment(msgspec.Struct, gc=False):
    id: int
    image_id: int
    category_id: int
    tracking_id: int | str | None = None
    attributes: dict[str, Code | bool | None] | None = None
    segmentation: Runs | list[list[float]] | None = None
    area: float | None = None
    bbox: list[float] = []


class Category(msgspec.Struct, gc=False):
    id: int
    name: str
    isthing: int | bool | None = None
    supercategory: str | None = None


class FilePose(msgspec.Struct, gc=False):
    images: list[Image]
    annotations: list[Pose]
    categories: list[Category] = []


class FilePanoptic(msgspec.Struct, gc=False):
    images: list[Image]
    annotations: list[Segment]
    categories: list[Category] = []


TYPES = {
    "2d": File2D,
    "3d": File3D,
    "social": FileSocial,
    "reasoning": FileReasoning,
    "pose": FilePose,
    "panoptic": FilePanoptic,
}


def decode(files):
    """The yardstick's work on one sequence: records decoded. Timestamps and calibration are a few kilobytes."""
    gc.disable()
    records = 0
    for layer, path in files.labels.items():
        if layer in TYPES:
            decoded = msgspec.json.decode(Path(path).read_bytes(), type=TYPES[layer])
            several = [decoded.annotations] if layer in ("pose", "panoptic") else decoded.labels.values()
            records += sum(map(len, several))
    return records


class Clock:
    """Wall and processor seconds by name, added up; those of worker processes that have ended included."""

    def __init__(self):
        self.seconds = defaultdict(lambda: [0.0, 0.0])

    @contextlib.contextmanager
    def __call__(self, name):
        wall, busy = time.perf_counter(), _busy()
        yield
        spent = self.seconds[name]
        spent[0] += time.perf_counter() - wall
        spent[1] += _busy() - busy

    def timed(self, name, function):
        def call(*arguments, **named):
            with self(name):
                return function(*arguments, **named)

        return call


def _busy():
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


class Memory:
    """Highest resident megabytes of each child process and of this process with its children, while open."""

    def __init__(self):
        self.each, self.all = defaultdict(float), 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._stop.set()
        self._thread.join()

    def _watch(self):
        while not self._stop.wait(0.02):
            found = {pid: _resident(pid) for pid in (os.getpid(), *_children(os.getpid()))}
            for pid, size in found.items():
                self.each[pid] = max(self.each[pid], size)
            self.all = max(self.all, sum(found.values()))


def _children(pid):
    try:
        found = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        # Pools start their workers from threads.
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += [int(child) for child in (task / "children").read_text().split()]
    except OSError:
        return []
    found = sorted(set(found))
    return found + [grand for child in found for grand in _children(child)]


def _resident(pid):
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize() / 1e6
    except (OSError, IndexError):
        return 0.0


@contextlib.contextmanager
def warm_pool(workers):
    """Workers that have imported everything: starting an interpreter is not what is measured."""
    pool = multiprocessing.get_context("spawn").Pool(workers)
    try:
        pool.map(_import, range(workers * 4), chunksize=1)
        yield pool
    finally:
        pool.close()
        pool.join()


def _import(_):
    time.sleep(0.05)
    return loading.STAGING


def in_pool(clock, name, workers, function, items):
    """Time a function over items in warm workers; their processor seconds are theirs from first to last."""
    with warm_pool(workers) as pool:
        wall = time.perf_counter()
        busy = pool.map(_timed, [(function, item) for item in items], chunksize=1)
        clock.seconds[name] = [time.perf_counter() - wall, sum(busy)]


def _timed(call):
    function, item = call
    start = time.process_time()
    function(item)
    return time.process_time() - start


def measure(root, workers, folder):
    found = find_root(root)
    files = sorted(found.sequences, key=lambda f: -f.weight)
    size = sum(f.weight for f in files) / 1e6
    clock = Clock()
    with clock("decode, 1 process"):
        records = sum(map(decode, files))
    many = f"{workers} processes"
    in_pool(clock, f"decode, {many}", workers, decode, files)
    shards = [loading.Shard(f, str(folder / "tables"), LoadRules()) for f in files]
    in_pool(clock, f"tables, {many}", workers, loading.load_shard, shards)
    shutil.rmtree(folder / "tables")
    with Memory() as memory, clock(f"whole load, {many}"):
        loading.load(found, Store(folder / "store"), LoadRules(), workers)
    print(f"{len(files)} sequences, {size:.0f} MB, {records:,} records")
    _print(clock, ("decode, 1 process", f"decode, {many}"))
    sizes = sorted(memory.each.values(), reverse=True)
    print(
        f"peak memory while loading: {', '.join(f'{s:.0f}' for s in sizes)} MB by process, {memory.all:.0f} MB in all"
    )
    print("\nwhere the time of the tables goes, 1 process")
    _print(phases(shards), (None,))
    print("\nwhere the time of the graph goes")
    _print(graph_phases(folder / "tables", [f.sequence for f in files]), (None,))


def phases(shards):
    """Every step of every shard, one after another in this process."""
    clock = Clock()
    readers = {name: clock.timed(f"read {name}", read) for name, read in annotating.READERS.items()}
    steps = (
        mock.patch.object(annotating, "READERS", readers),
        mock.patch.object(annotating, "load_reasoning", clock.timed("read reasoning", annotating.load_reasoning)),
        *(
            mock.patch.object(deriving, name, clock.timed(f"derive {name.removesuffix('_table')}", step))
            for name, step in vars(deriving).items()
            if callable(step) and getattr(step, "__module__", "").startswith("jrdb_avr.loaders")
            if name.endswith(("_table", "_runs")) or name.startswith("read_")
        ),
        mock.patch.object(loading, "stage_scene", clock.timed("stage graph rows", loading.stage_scene)),
        *(
            mock.patch.object(Store, name, clock.timed("write tables", getattr(Store, name)))
            for name in ("write_annotation", "write_interval")
        ),
    )
    with contextlib.ExitStack() as stack, clock("all steps"):
        for step in steps:
            stack.enter_context(step)
        for shard in shards:
            loading.load_shard(shard)
    return clock


def graph_phases(tables, sequences):
    """COPY by table, from the rows that the shards have staged."""
    clock = Clock()

    def copied(function):
        def call(graph, table, *arguments):
            with clock(f"COPY {table}"):
                return function(graph, table, *arguments)

        return call

    with (
        mock.patch.object(Graph, "copy", copied(Graph.copy)),
        mock.patch.object(Graph, "copy_files", copied(Graph.copy_files)),
        clock("graph"),
        build_graph(tables / "graph.kuzu") as graph,
    ):
        print(build_scene(graph, Store(tables), sorted(sequences)))
    return clock


def _print(clock, yardsticks):
    """A row per name, with ratios of wall and processor seconds to each yardstick; None: shares of the longest."""
    longest = max(clock.seconds, key=lambda name: clock.seconds[name][0])
    names = [name or longest for name in yardsticks]
    print(f"{'':28}{'wall s':>9}{'cpu s':>9}" + "".join(f"{'/ ' + name:>28}" for name in names))
    for name, (wall, busy) in clock.seconds.items():
        ratios = [
            f"{wall / clock.seconds[other][0]:.2f} wall {busy / clock.seconds[other][1]:.2f} cpu" for other in names
        ]
        print(f"{name:28}{wall:9.2f}{busy:9.2f}" + "".join(f"{ratio:>28}" for ratio in ratios))


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
    from jrdb_avr.loaders.synthetic.write import FULL_SCALE, plan, write

    sizes = [(max(60, round(frames * scale)), people) for frames, people in FULL_SCALE]
    for _ in write(plan(root, sizes, 0, images="none"), workers):
        pass


if __name__ == "__main__":
    main()
