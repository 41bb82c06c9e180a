"""Calls of functions in other processes, on this machine or on a Ray cluster.

The other process imports the function by its name, and gets the pickled arguments. So functions must be defined in a
module, and arguments must be plain data. All machines of a cluster must find the store and the label files under the
same paths. Ray is an optional dependency: `pip install 'jrdb-avr[ray]'`.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar

from jrdb_avr.schema.errors import InputError, StoreError

A = TypeVar("A")
R = TypeVar("R")

Executor = int | str
"""Number of local processes, or the address of a Ray cluster: "ray" or "ray://HOST:PORT".

"ray" means the cluster that the environment variable RAY_ADDRESS names. If the variable is not set, Ray starts a
cluster on this machine.
"""

RETRIES: Final = 3
"""Maximum number of times that Ray starts the work on a sequence again because the worker process died."""

_CONTEXT: Final = multiprocessing.get_context("spawn")
"""Start method "spawn" for new processes. "fork" cannot be used, because a fork loses the graph engine's threads."""

is_worker = False
"""True in a process that this module started. Such a process ends when its work is done."""


def map_sequences(
    function: Callable[[A], R], sequences: Sequence[A], executor: Executor, weight: Callable[[A], float]
) -> Iterator[tuple[int, R]]:
    """Call a function once for each sequence, and yield the results as soon as they are complete.

    If a Ray worker dies, the function is called again for the same sequence. So the function must write files
    atomically (`write_atomic`), or write no files.

    Args:
        function: Function that is called with one item of `sequences`. An exception of the function is raised here.
        sequences: Items, one for each sequence.
        executor: Number of local processes, or the address of a Ray cluster.
        weight: Function that returns the amount of work for an item. The items with the most work start first, because
            three sequences of JRDB have over half of all boxes.

    Returns:
        An iterator over pairs. A pair has the index of an item in `sequences`, and the result of the function for
        this item.

    Raises:
        StoreError: If a local process died, or if Ray workers died more than `RETRIES` times on one sequence.
        InputError: If Ray is not installed, or there is no cluster at the address.
    """
    order = sorted(range(len(sequences)), key=lambda i: (-weight(sequences[i]), i))
    if isinstance(executor, str):
        return _map_on_ray(function, sequences, order, executor)
    # A daemonic process, such as a worker of multiprocessing.Pool, may start no process.
    if executor <= 1 or len(sequences) <= 1 or multiprocessing.current_process().daemon:
        return ((i, function(sequences[i])) for i in order)
    return _map_in_processes(function, sequences, order, executor)


def map_in_order(
    function: Callable[[A], R],
    sequences: Sequence[A],
    executor: Executor,
    weight: Callable[[A], float],
    advance: Callable[[int], None],
) -> list[R]:
    """Call a function once for each sequence, and return the results in the order of the sequences.

    `advance` is called with 1 after each result. `map_sequences` describes the other arguments and the errors.
    """
    results: dict[int, R] = {}
    for index, result in map_sequences(function, sequences, executor, weight):
        results[index] = result
        advance(1)
    return [results[index] for index in range(len(sequences))]


def _map_in_processes(
    function: Callable[[A], R], sequences: Sequence[A], order: Sequence[int], workers: int
) -> Iterator[tuple[int, R]]:
    size = min(workers, len(sequences))
    with ProcessPoolExecutor(size, mp_context=_CONTEXT, initializer=end_with_parent) as pool:
        with _without_main():
            futures = {pool.submit(function, sequences[i]): i for i in order}
            # ProcessPoolExecutor begins to watch a new worker only at the next call of submit(). Without this extra
            # call, the last worker could die unnoticed while it holds the lock of the queue. The others would wait
            # forever.
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
    # Paths in the argument may be relative to the folder of the command. If this machine lacks the folder, stay here.
    with contextlib.suppress(OSError):
        os.chdir(folder)
    return function(sequence)


@contextlib.contextmanager
def _connect(address: str) -> Iterator[Any]:
    """Connect to a Ray cluster, yield the module `ray`, and disconnect.

    If this process has a connection already, that connection is used and left open.
    """
    # Disable usage statistics, which Ray by default sends to its developers.
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
        # If the user has a token, the clusters that Ray starts require it. Ray joins them only if the mode is "token".
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
    """Call a function in a new process, so that a crash of the graph engine ends only the new process.

    In a daemonic process, which may start no process, the function is called directly.

    Args:
        function: Function without arguments. An exception of the function is raised here.

    Returns:
        The result of the function.

    Raises:
        BrokenProcessPool: If the process died.
    """
    if multiprocessing.current_process().daemon:
        return function()
    with ProcessPoolExecutor(1, mp_context=_CONTEXT, initializer=_become_quiet_worker) as pool:
        with _without_main():
            future = pool.submit(function)
        return future.result()


@contextlib.contextmanager
def _without_main() -> Iterator[None]:
    """Hide the main module of the program, so that processes that start inside a `with` block do not import it.

    A script without `if __name__ == "__main__":` would otherwise run again in each of them, and a script from standard
    input cannot be imported.
    """
    main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _become_quiet_worker() -> None:
    end_with_parent()
    # If the engine crashes, it writes to stderr. Discard this text, because the caller reports the crash in one line.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


@contextlib.contextmanager
def without_collector() -> Iterator[None]:
    """Disable Python's garbage collector inside a `with` block.

    The data of a sequence are millions of small objects without reference cycles. The collector's search for cycles
    would take most of the time of `load`, and a quarter of the time of `generate`.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def end_with_parent() -> None:
    """Mark this process as a worker, and end it when its parent process ends or is killed.

    A worker without a parent would otherwise continue to write into the store. If the process is not a child that
    `multiprocessing` started, the function does nothing.
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
