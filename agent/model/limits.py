"""Bounds on what a server may send, in bytes and in time."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final, TypeVar

from jrdb_avr.schema.errors import EndpointError

if TYPE_CHECKING:
    import httpx2

T = TypeVar("T")

MOST_BYTES: Final = 16 << 20
"""Of a reply: a few thousand tokens are some kilobytes."""


def limit(response: httpx2.Response) -> None:
    """Bound the body of a response that is about to be read: a hook for the transport's client.

    A body over 16 MB raises EndpointError, and so does a compressed one, of which few bytes may become many: the client
    asks for plain ones. One that has not ended when the request's read timeout is over raises
    httpx2.ReadTimeout: by itself that timeout bounds each wait alone, and lets a server drip for ever.
    """
    import httpx2

    encoding = response.headers.get("content-encoding", "").strip().lower()
    if encoding not in ("", "identity"):
        raise EndpointError("the reply is compressed, though a plain one was asked for: switch compression off there")
    stream = response.stream
    assert isinstance(stream, httpx2.SyncByteStream), "the client is a synchronous one"
    response.stream = _limited(stream, response.request)


def _limited(stream: httpx2.SyncByteStream, request: httpx2.Request) -> httpx2.SyncByteStream:
    import httpx2

    seconds = request.extensions["timeout"]["read"]
    end = time.monotonic() + seconds

    class Limited(httpx2.SyncByteStream):
        def __iter__(self) -> Iterator[bytes]:
            size = 0
            for chunk in stream:
                size += len(chunk)
                if size > MOST_BYTES:
                    raise EndpointError(f"the reply is longer than {MOST_BYTES >> 20} MB: is this a chat server?")
                if time.monotonic() > end:
                    raise httpx2.ReadTimeout(f"the reply did not end within {seconds:g} s", request=request)
                yield chunk

        def close(self) -> None:
            stream.close()

    return Limited()


def within(seconds: float, work: Callable[[], T]) -> T:
    """The result of `work`, which another thread does. Raises what that raises, and TimeoutError where it is not done
    in time: the thread is left to itself then.

    The transport's own timeouts bound each wait for a byte, and it waits for as many as a reply's head and the
    announcements before it (102 Processing) may have.
    """
    done: _Done = queue.SimpleQueue()
    try:
        # Threads are kept: to make one takes longer than much of a call.
        given = _idle.pop()
    except IndexError:
        given = queue.SimpleQueue()
        threading.Thread(target=_serve, args=(given,), daemon=True).start()
    given.put((work, done))
    try:
        result, error = done.get(timeout=seconds)
    except queue.Empty:
        raise TimeoutError from None
    if error is not None:
        raise error
    found: T = result
    return found


_Done = queue.SimpleQueue[tuple[Any, BaseException | None]]

_idle: Final[list[queue.SimpleQueue[tuple[Callable[[], Any], _Done]]]] = []
"""What threads that have nothing to do wait for."""

# A forked process has none of them.
os.register_at_fork(after_in_child=_idle.clear)


def _serve(given: queue.SimpleQueue[tuple[Callable[[], Any], _Done]]) -> None:
    while True:
        work, done = given.get()
        outcome: tuple[Any, BaseException | None]
        try:
            outcome = work(), None
        except BaseException as error:
            outcome = None, error
        _idle.append(given)
        done.put(outcome)
        # Nothing of the work is kept while waiting for more.
        del work, done, outcome
