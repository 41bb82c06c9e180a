"""How many calls a server gets at a time: fewer once replies no longer come in time, slowly more again."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Pass:
    """An admitted call. `others`: calls in flight beside it when it was admitted; `halvings`: timeouts until then."""

    others: int
    halvings: int


class Gate:
    """Admits every call until one times out, then half of those in flight; each round of replies admits one more.

    A server that has more requests than it can finish in time finishes none: each waits until its client gives up.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._limit = math.inf
        self._active = 0
        self._halvings = 0

    @contextlib.contextmanager
    def admitted(self) -> Iterator[Pass]:
        """Wait for a place among the calls in flight, and hold it for the block."""
        with self._changed:
            self._changed.wait_for(lambda: self._active + 1 <= self._limit)
            self._active += 1
            own = Pass(self._active - 1, self._halvings)
        try:
            yield own
        finally:
            with self._changed:
                self._active -= 1
                self._changed.notify()

    def timed_out(self, own: Pass) -> None:
        """Halve the calls in flight. Calls that were admitted together and time out together halve them once."""
        with self._changed:
            if own.halvings == self._halvings:
                self._halvings += 1
                self._limit = max(1.0, self._active // 2)

    def replied(self) -> None:
        """Admit a little more; nothing changes before a first timeout."""
        with self._changed:
            self._limit += 1 / self._limit
            self._changed.notify()
