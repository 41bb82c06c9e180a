"""Functions that run in other processes: one for each sequence, on this machine or on a Ray cluster, or one alone.

The function and its arguments must be importable and picklable; only plain data travels between these processes.
The machines of a cluster must see the store and the label files under the same paths. Ray is an extra:
`pip install 'jrdb-avr[ray]'`.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Final, TypeVar

from jrdb_avr.schema.errors import InputError, StoreError

A = TypeVar("A")
R = TypeVar("R")

Executor = int | str
"""Number of local processes, or the address of a Ray cluster: "ray" or "ray://HOST:PORT".

"ray" is the cluster that the environment variable RAY_ADDRESS names. Without it, Ray starts one on this machine.
"""

RETRIES: Final = 3
"""Maximum number of times that a sequence is given to another Ray worker after its worker died."""

_CONTEXT: Final = multiprocessing.get_context("spawn")
"""Start method of processes. They are not forked, because the threads of the graph engine do not survive a fork."""

is_worker = False
"""True in a process that this module started, which ends after its work."""


def map_sequences(
    function: Callable[[A], R], sequences: Sequence[A], executor: Executor, weight: Callable[[A], float]
) -> Iterator[tuple[int, R]]:
    """Call a function for each sequence, and yield (index, result) pairs in order of completion.

    If the Ray worker of a sequence dies, the sequence is run again. So the function must write files whole
    (`write_atomic`), or return its results.

    Args:
        function: Function of one sequence; the errors it raises are raised here.
        sequences: Arguments of the calls.
        executor: Number of local processes, or the address of a Ray cluster.
        weight: Function that returns the scheduling weight of a sequence; heavier sequences start first, because three
            sequences hold over half of all boxes.

    Returns:
        An iterator with one pair for each sequence.

    Raises:
        StoreError: A local worker died, or the Ray workers of one sequence died more than `RETRIES` times.
        InputError: Ray is not installed, or no cluster answers at the address.
    """
    order = sorted(range(len(sequences)), key=lambda i: (-weight(sequences[i]), i))
    if isinstance(executor, str):
        return _map_on_ray(function, sequences, order, executor)
    if executor <= 1 or len(sequences) <= 1:
        return ((i, function(sequences[i])) for i in order)
    return _map_in_processes(function, sequences, order, executor)


def _map_in_processes(
    function: Callable[[A], R], sequences: Sequence[A], order: Sequence[int], workers: int
) -> Iterator[tuple[int, R]]:
    size = min(workers, len(sequences))
    with ProcessPoolExecutor(size, mp_context=_CONTEXT, initializer=end_with_parent) as pool:
        futures = {pool.submit(function, sequences[i]): i for i in order}
        # ProcessPoolExecutor starts to monitor a worker only at the next submit(). Without this call the last worker
        # could die unnoticed while it holds the lock of the queue, and the others would wait forever.
        pool.submit(int)
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise StoreError("a worker process died (killed, or out of memory): try fewer --workers") from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _map_on_ray(
    function: Callable[[A], R], sequences: Sequence[A], order: Sequence[int], address: str
) -> Iterator[tuple[int, R]]:
    with _connect(address) as ray:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_call_in_folder)
        pending = {task.remote(str(Path.cwd()), function, sequences[i]): i for i in order}
        try:
            while pending:
                (ready,), _ = ray.wait(list(pending), num_returns=1)
                yield pending.pop(ready), ray.get(ready)
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except ray.exceptions.RayError:
            message = f"workers of the cluster died {RETRIES + 1} times on one sequence (out of memory?)"
            raise StoreError(message) from None
        finally:
            for reference in pending:
                ray.cancel(reference, force=True)


def _call_in_folder(folder: str, function: Callable[[A], R], sequence: A) -> R:
    # Paths in the argument may be relative to the folder of the command. Absolute ones do not need it to exist here.
    with contextlib.suppress(OSError):
        os.chdir(folder)
    return function(sequence)


@contextlib.contextmanager
def _connect(address: str) -> Iterator[Any]:
    """Yield the module `ray`, connected to a cluster. Disconnect afterwards, unless it was connected before."""
    # Ray reports usage statistics to its makers by default.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError:
        raise InputError("--executor ray needs Ray: pip install 'jrdb-avr[ray]'", field="executor") from None
    if ray.is_initialized():
        yield ray
        return
    try:
        ray.init(address=None if address == "ray" else address, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        # Ray starts a cluster with a token if the user has one, but joins such a cluster only if it is told to.
        reason = str(error).splitlines()[0].rstrip(".")
        raise InputError(
            f"no Ray cluster answers at {address}: {reason}; if the cluster has a token, set RAY_AUTH_MODE=token",
            field="executor",
        ) from None
    try:
        yield ray
    finally:
        ray.shutdown()


def run_alone(function: Callable[[], R]) -> R:
    """Call a function in a new process, so that a crash of the graph engine ends only that process.

    Args:
        function: Function without arguments; the errors it raises are raised here.

    Returns:
        The result of the function.

    Raises:
        BrokenProcessPool: The process died.
    """
    with ProcessPoolExecutor(1, mp_context=_CONTEXT, initializer=_become_quiet_worker) as pool:
        return pool.submit(function).result()


def _become_quiet_worker() -> None:
    end_with_parent()
    # The engine writes to stderr when it crashes; the caller reports that in one line.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


@contextlib.contextmanager
def without_collector() -> Iterator[None]:
    """Disable the collector of reference cycles inside a `with` block.

    A sequence is millions of small objects without cycles. The collector's searches would take most of the time of
    `load`, and a quarter of that of `generate`.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def end_with_parent() -> None:
    """Make this process a worker that ends when its parent ends, even if the parent is killed.

    An orphan would continue to write into the store.
    """
    global is_worker
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    is_worker = True

    def end_after_parent() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end_after_parent, name="end-with-parent", daemon=True).start()
