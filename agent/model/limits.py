"""Limit of requests and tokens per minute. A request waits until the limit permits it."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

MINUTE_S = 60.0


@dataclass
class Sent:
    """The time of a request in seconds, and the number of its tokens, which is estimated until the reply arrives."""

    at: float
    tokens: float


class RateLimit:
    """Limit of `rpm` requests and `tpm` tokens in any minute. If `rpm` or `tpm` is None, that number is not limited.

    Until the reply arrives, the tokens of a request are estimated by the mean of all earlier requests. A minute
    may therefore hold more than `tpm` tokens if its requests need more tokens than the mean.
    """

    def __init__(
        self, rpm: int | None, tpm: int | None, clock: Callable[[], float], pause: Callable[[float], None]
    ) -> None:
        self._rpm, self._tpm = rpm or math.inf, tpm or math.inf
        self._clock, self._pause = clock, pause
        self._lock = threading.Lock()
        self._sent: deque[Sent] = deque()
        """The requests of the last minute."""
        self._tokens = self._replies = 0

    def admit(self) -> Sent:
        """Wait until a request may be sent, and count the request.

        Returns:
            The record of the request. The caller passes it to `count` when the reply has arrived.
        """
        while True:
            with self._lock:
                now = self._clock()
                while self._sent and self._sent[0].at + MINUTE_S <= now:
                    self._sent.popleft()
                mean = self._tokens / max(self._replies, 1)
                # The sum is only made if it is needed, because a minute may hold thousands of requests.
                tokens = mean + sum(sent.tokens for sent in self._sent) if self._tpm < math.inf else 0.0
                # A request is always admitted if no other was sent in the last minute. Otherwise a request of more than
                # `tpm` tokens would wait for ever.
                if not self._sent or (len(self._sent) < self._rpm and tokens <= self._tpm):
                    self._sent.append(Sent(now, mean))
                    return self._sent[-1]
                wait = self._sent[0].at + MINUTE_S - now
            self._pause(wait)

    def count(self, sent: Sent, tokens: int) -> None:
        """Replace the estimated number of tokens of a request by the true number.

        Args:
            sent: The record of the request, as `admit` returned it.
            tokens: The number of tokens in the request and in its reply.
        """
        with self._lock:
            sent.tokens = tokens
            self._tokens += tokens
            self._replies += 1
