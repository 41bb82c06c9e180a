"""A limit of requests and tokens a minute, kept by waiting before a request."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

MINUTE_S = 60.0


@dataclass
class Sent:
    """A request: when it was sent, and its tokens, as they are expected until they are counted."""

    at: float
    tokens: float


class RateLimit:
    """Admits at most `rpm` requests and `tpm` tokens in any minute; None for no limit.

    The tokens of a request are known with its reply. Until then it counts for the mean of all replies: a minute may
    hold more tokens than allowed by what requests in flight exceed the mean.
    """

    def __init__(
        self, rpm: int | None, tpm: int | None, clock: Callable[[], float], pause: Callable[[float], None]
    ) -> None:
        self._rpm, self._tpm = rpm, tpm
        self._clock, self._pause = clock, pause
        self._lock = threading.Lock()
        self._sent: deque[Sent] = deque()
        self._tokens = self._replies = 0

    def admit(self) -> Sent:
        """Wait until a request may be sent, and count it."""
        while True:
            with self._lock:
                now = self._clock()
                while self._sent and self._sent[0].at <= now - MINUTE_S:
                    self._sent.popleft()
                if (wait := self._wait(now)) <= 0:
                    self._sent.append(Sent(now, self._mean()))
                    return self._sent[-1]
            self._pause(wait)

    def count(self, sent: Sent, tokens: int) -> None:
        """Count the tokens of a request that has its reply."""
        with self._lock:
            sent.tokens = tokens
            self._tokens += tokens
            self._replies += 1

    def _mean(self) -> float:
        return self._tokens / self._replies if self._replies else 0.0

    def _wait(self, now: float) -> float:
        """Seconds to wait until the requests and tokens of the last minute are below the limits; 0.0 for no wait."""
        leaving = 0
        if self._rpm is not None:
            leaving = len(self._sent) + 1 - self._rpm
        if self._tpm is not None:
            tokens = sum(one.tokens for one in self._sent) + self._mean()
            for number, one in enumerate(self._sent):
                if tokens <= self._tpm:
                    break
                tokens -= one.tokens
                leaving = max(leaving, number + 1)
        return 0.0 if leaving <= 0 else self._sent[leaving - 1].at + MINUTE_S - now
