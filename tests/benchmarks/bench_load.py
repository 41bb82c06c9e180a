"""How fast loading is and what memory it takes, beside plain decoding of the same files.

    python tests/benchmarks/bench_load.py [--root ROOT] [--workers 2] [--scale 0.25 | --smallest]

The yardstick decodes the label files with msgspec in one process and keeps nothing. Without ROOT a synthetic root of
every layer without images is made; scale 1 is the size of the full data set (27 sequences, about 957,000 boxes).

Printed: wall and processor seconds with ratios to the yardstick, and the highest resident memory of each process and of
all together while loading, sampled fifty times a second. On a machine that is busy with other things the ratios of
processor seconds hold better than those of wall seconds.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path

import msgspec

from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.schema.rules import LoadRules


class Clock:
    """Wall and processor seconds by name, added up, with those of worker processes that have ended."""

    def __init__(self):
        self.seconds = defaultdict(lambda: [0.0, 0.0])

    @contextlib.contextmanager
    def __call__(self, name):
        wall, busy = time.perf_counter(), _busy()
        yield
        spent = self.seconds[name]
        spent[0] += time.perf_counter() - wall
        spent[1] += _busy() - busy


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


def measure(root, workers, folder):
    found = find_root(root)
    paths = sorted(Path(root).rglob("*.json"))
    clock, names = Clock(), ("decode, 1 process", f"load, {workers} processes")
    with clock(names[0]):
        for path in paths:
            msgspec.json.decode(path.read_bytes())
    with Memory() as memory, clock(names[1]):
        load(found, folder / "store", LoadRules(), workers)
    print(f"{len(found.sequences)} sequences, {sum(path.stat().st_size for path in paths) / 1e6:.0f} MB")
    wall_of_one, busy_of_one = clock.seconds[names[0]]
    for name in names:
        wall, busy = clock.seconds[name]
        ratios = f"{wall / wall_of_one:8.2f} x wall {busy / busy_of_one:8.2f} x cpu"
        print(f"{name:24}{wall:9.2f} wall s{busy:9.2f} cpu s{ratios}")
    sizes = ", ".join(f"{size:.0f}" for size in sorted(memory.each.values(), reverse=True))
    print(f"peak memory while loading: {sizes} MB by process, {memory.all:.0f} MB in all")


def sample(root, scale, workers, smallest=False):
    """Write a synthetic root; every sequence keeps its number of people, and a share of its frames."""
    from jrdb_avr.loaders.synthetic.write import FULL_SCALE, plan, write

    sizes = [(max(60, round(frames * scale)), people) for frames, people in FULL_SCALE]
    for _ in write(plan(root, [(180, 12)] if smallest else sizes, 0, images="none"), workers):
        pass


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--smallest", action="store_true", help="one sequence of 180 frames")
    parser.add_argument("--root", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = options.root or Path(folder) / "root"
        if options.root is None:
            sample(root, options.scale, options.workers, options.smallest)
        measure(root, options.workers, Path(folder))


if __name__ == "__main__":
    main()
