"""Run a function over sequences on a Ray cluster.

Its machines see the command's folders under the same paths.
Ray is an extra: `pip install 'jrdb-avr[ray]'`. A function whose worker or machine dies is run again, so it must bear
that: it writes files whole (`files.write_atomic`), or returns what it found.
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from jrdb_avr.schema.errors import InputError, StoreError

_A = TypeVar("_A")
_R = TypeVar("_R")

RETRIES: Final = 3
"""How often an item is given to another worker before its loss is an error."""


def map_on_cluster(
    address: str, function: Callable[[_A], _R], items: Sequence[_A], order: Sequence[int]
) -> Iterator[tuple[int, _R]]:
    """Yield (index of the item, result) as results come from the cluster at `address`, begun in `order`.

    `address`: "ray" for the cluster that the environment variable RAY_ADDRESS names, or else one on this machine;
    "ray://HOST:PORT" for the client's port of another. Errors of the function are raised here. Raises InputError
    without Ray or where no cluster answers, StoreError where an item's workers died again and again.
    """
    with connected(address) as ray:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_at_place)
        place = str(Path.cwd())
        waiting = {task.remote(place, function, items[i]): i for i in order}
        try:
            while waiting:
                (done,), _ = ray.wait(list(waiting), num_returns=1)
                yield waiting.pop(done), _result(ray, done)
        finally:
            for left in waiting:
                ray.cancel(left, force=True)


def _at_place(place: str, function: Callable[[_A], _R], item: _A) -> _R:
    # Paths of items may be relative; a worker has a process of its own. Absolute ones do not need the folder.
    with contextlib.suppress(OSError):
        os.chdir(place)
    return function(item)


def _result(ray: Any, done: Any) -> Any:
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except ray.exceptions.RayError:
        raise StoreError(f"workers of the cluster died {RETRIES + 1} times on one sequence (out of memory?)") from None


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """The module `ray`, connected to the cluster at an address; disconnected afterwards where it was not before.

    Raises InputError as `map_on_cluster`.
    """
    # It reports its use to its makers unless it is told not to.
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
        # Ray starts a cluster with a token wherever a user has one, and joins none with it unless it is told to.
        reason = str(error).splitlines()[0].rstrip(".")
        raise InputError(
            f"no Ray cluster answers at {address}: {reason}; where the cluster has a token, set RAY_AUTH_MODE=token",
            field="executor",
        ) from None
    try:
        yield ray
    finally:
        ray.shutdown()
