"""Run functions in other processes: one over many sequences (the sequence is the shard), or one alone.

The function and its items must be importable and picklable (plain data only travels between our own processes).
"""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerContext, SpawnContext
from typing import TypeVar

from jrdb_avr.queries.cluster import map_on_cluster
from jrdb_avr.schema.errors import StoreError

A = TypeVar("A")
R = TypeVar("R")

Workers = int | str
"""Where sequences are worked on: so many processes of this machine, or the address of a cluster (`cluster.py`)."""

context: SpawnContext | ForkServerContext = multiprocessing.get_context("spawn")
"""How a process starts: anew, not forked, as the engine's threads do not survive a fork. Tests put a context here whose
processes start with everything imported."""

is_worker = False
"""Whether this process is one of those made here, which ends with its work."""


def map_shards(
    function: Callable[[A], R], items: Sequence[A], workers: Workers, weight: Callable[[A], float]
) -> Iterator[tuple[int, R]]:
    """Yield (index of the item, result) as results come, heaviest items started first.

    Over half of all boxes lie in three sequences, so the order matters. Errors of the function are raised here; a
    worker that dies (killed, out of memory) raises StoreError, on a cluster where it dies again and again.
    """
    order = sorted(range(len(items)), key=lambda i: (-weight(items[i]), i))
    if isinstance(workers, str):
        yield from map_on_cluster(workers, function, items, order)
        return
    if workers <= 1 or len(items) <= 1:
        for i in order:
            yield i, function(items[i])
        return
    with ProcessPoolExecutor(min(workers, len(items)), mp_context=context, initializer=end_with_parent) as pool:
        futures = {pool.submit(function, items[i]): i for i in order}
        # Whoever watches the processes looks for new ones at each submission only, before it starts one. Without this
        # the last one could die unnoticed, and the others wait for ever for the lock of the queue that it held.
        pool.submit(int)
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise StoreError("a worker process died (killed, or out of memory): try fewer --workers") from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _in_new_process(function: Callable[[], R]) -> R:
    with ProcessPoolExecutor(1, mp_context=context, initializer=_become_quiet_worker) as pool:
        return pool.submit(function).result()


run_alone: Callable[[Callable[[], R]], R] = _in_new_process
"""Runs a function in a process of its own: an engine that ends its process ends that one alone.

Errors of the function are raised here, BrokenProcessPool where its process dies. Tests put a plain call here."""


def _become_quiet_worker() -> None:
    end_with_parent()
    # The engine writes to stderr when it gives up; who called reports that in one line.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


@contextlib.contextmanager
def without_collector() -> Iterator[None]:
    """Python's collector of cycles switched off.

    A sequence is millions of small objects, none of them in a cycle: looking through them again and again would be most
    of the work of loading one, and a quarter of that of generating from one.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def end_with_parent() -> None:
    """Make this process a worker, which ends when its parent is gone, even killed: an orphan would go on writing."""
    global is_worker
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    is_worker = True

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()
