"""HTTP exchanges with a model's server: connections, deadlines, addresses, and keys that messages must not show.

No redirect is followed and no compressed reply is unpacked. Servers are untrusted: a reply has a maximum size, and an
exchange a deadline.
"""

from __future__ import annotations

import functools
import ipaddress
import math
import os
import queue
import re
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from jrdb_avr.schema.errors import EndpointError

if TYPE_CHECKING:
    import ssl

    import httpx2

_SECRET: Final = 16
"""Minimum length of a key that is hidden in replies. Shorter ones, such as "EMPTY", are words that a reply may hold."""


@dataclass(frozen=True)
class Bounds:
    """Maxima of one exchange: seconds to connect, seconds of a probe, and bytes of a reply.

    A reply of a few thousand tokens has some kilobytes.
    """

    connect_s: float = 20.0
    probe_s: float = 180.0
    reply_bytes: int = 16 << 20


BOUNDS: Final = Bounds()


class Connections:
    """The HTTP connections of a client to one server; safe for many threads at once."""

    def __init__(self, base_url: str, bounds: Bounds) -> None:
        """Prepare connections that follow no redirect.

        Args:
            base_url: The server's address; a proxy of the environment is not used for this machine's own address.
            bounds: The maxima of each exchange.

        Raises:
            EndpointError: The environment names a proxy that cannot be used.
        """
        import httpx2

        self._bounds = bounds
        self._deadline = _Deadline()
        # 64 calls of a megabyte at a time take half the time if other threads than the callers' exchange them. An
        # executor's threads are no daemons: an interrupt would wait for replies.
        self._tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._idle = threading.Semaphore(0)
        weakref.finalize(self, self._tasks.put, None)
        environment = not _is_loopback(base_url)
        try:
            self._http = httpx2.Client(
                trust_env=environment,
                verify=_certificates(environment),
                follow_redirects=False,
                headers={"Accept": "application/json", "Accept-Encoding": "identity"},
                limits=httpx2.Limits(max_connections=None, max_keepalive_connections=None),
            )
        except (httpx2.InvalidURL, ValueError, ImportError):
            raise EndpointError(
                "the environment names a proxy that cannot be used: correct HTTP_PROXY, HTTPS_PROXY or ALL_PROXY"
            ) from None
        # httpx2 passes no network backend on to its pools.
        for transport in filter(None, [self._http._transport, *self._http._mounts.values()]):
            pool = transport._pool  # type: ignore[attr-defined]
            pool._network_backend = _BoundedBackend(pool._network_backend, self._deadline)

    def exchange(self, timeout_s: float, method: str, url: str, **request: Any) -> tuple[httpx2.Response, bytes]:
        """Send a request and read the whole reply.

        Args:
            timeout_s: Maximum seconds of the whole exchange.
            method: The HTTP method.
            url: The full address.
            request: Further arguments of `httpx2.Client.stream`.

        Returns:
            The response and the bytes of its body.

        Raises:
            EndpointError: A redirect, which would take the key elsewhere, a reply that is too long, or a compressed
                one (decompression bomb).
            httpx2.HTTPError: The server cannot be reached, or the reply breaks off or does not end in time.
        """
        done: Future[tuple[httpx2.Response, bytes]] = Future()
        self._tasks.put((functools.partial(self._exchange, timeout_s, method, url, request), done))
        if not self._idle.acquire(blocking=False):
            threading.Thread(target=_serve, args=(self._tasks, self._idle), daemon=True).start()
        return done.result()

    def _exchange(
        self, timeout_s: float, method: str, url: str, request: Mapping[str, Any]
    ) -> tuple[httpx2.Response, bytes]:
        import httpx2

        self._deadline.end = time.monotonic() + timeout_s
        timeout = httpx2.Timeout(timeout_s, connect=min(timeout_s, self._bounds.connect_s))
        with self._http.stream(method, url, timeout=timeout, **request) as response:
            if response.has_redirect_location:
                raise EndpointError(
                    f"the server redirects to another address (HTTP {response.status_code}): "
                    "give that one as --base-url"
                )
            if response.headers.get("content-encoding", "").strip().lower() not in ("", "identity"):
                raise EndpointError(
                    "the reply is compressed, but the request accepts no compression: switch it off there"
                )
            data = bytearray()
            for chunk in response.iter_raw():
                data += chunk
                if len(data) > self._bounds.reply_bytes:
                    size = self._bounds.reply_bytes / (1 << 20)
                    raise EndpointError(f"the reply is longer than {size:.3g} MB: is this a chat server?")
            return response, bytes(data)


def _serve(tasks: queue.SimpleQueue[Any], idle: threading.Semaphore) -> None:
    """Carry out tasks until the connections are collected."""
    while (task := tasks.get()) is not None:
        work, done = task
        finish: Callable[[], None]
        try:
            finish = functools.partial(done.set_result, work())
        except BaseException as error:
            finish = functools.partial(done.set_exception, error)
        # Idle before the caller goes on, which may have another call at once.
        idle.release()
        finish()
        # Results and the connections must not stay alive while the thread waits.
        del task, work, done, finish
    tasks.put(None)


@functools.cache
def _certificates(environment: bool) -> ssl.SSLContext:
    """Return the trusted certificates; loading them takes as long as many calls."""
    import httpx2

    return httpx2.create_ssl_context(trust_env=environment)


class _Deadline(threading.local):
    """The end of the calling thread's exchange, in seconds of `time.monotonic`."""

    end = math.inf

    def limit(self, timeout_s: float | None) -> float:
        """Return the seconds that a wait may take. Raise ReadTimeout if none are left."""
        left = self.end - time.monotonic()
        if left <= 0:
            import httpx2

            raise httpx2.ReadTimeout("the exchange did not end in time")
        return left if timeout_s is None else min(timeout_s, left)


class _BoundedBackend:
    """The network backend of a pool, with streams that keep to the deadline.

    Because httpx2 bounds each wait for bytes only, a server that sends a byte at a time, or endless announcements (102
    Processing), would otherwise hold a call for ever.
    """

    def __init__(self, backend: Any, deadline: _Deadline) -> None:
        self._backend, self._deadline = backend, deadline
        self.sleep = backend.sleep

    def connect_tcp(self, host: str, port: int, timeout: float | None = None, **options: Any) -> _BoundedStream:
        stream = self._backend.connect_tcp(host, port, self._deadline.limit(timeout), **options)
        return _BoundedStream(stream, self._deadline)


class _BoundedStream:
    """A network stream with waits that end at the deadline."""

    def __init__(self, stream: Any, deadline: _Deadline) -> None:
        self._stream, self._deadline = stream, deadline
        self.close, self.get_extra_info = stream.close, stream.get_extra_info

    def read(self, max_bytes: int, timeout: float | None = None) -> Any:
        return self._stream.read(max_bytes, self._deadline.limit(timeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        self._stream.write(buffer, self._deadline.limit(timeout))

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> _BoundedStream:
        stream = self._stream.start_tls(ssl_context, server_hostname, self._deadline.limit(timeout))
        return _BoundedStream(stream, self._deadline)


# -- address and key --------------------------------------------------------------------------------------------------

_SECRETIVE: Final = re.compile(r"#|^([^/]*//)?[^/?]*@")
"""Pattern of the parts of an address that may hold a password: user info and fragment."""

_SECRET_NAME: Final = re.compile(r"(?i)key|token|secret|pass|pw|sig|auth|cred|code")
_LONGEST_VALUE: Final = 40
"""Maximum length of a query's value; a longer one may be a key."""


def checked_url(base_url: str) -> str:
    """Check a server's address.

    Args:
        base_url: The address.

    Returns:
        The address without a slash at its end.

    Raises:
        EndpointError: The address cannot be used, or holds a password.
    """
    import httpx2

    query = base_url.partition("?")[2].partition("#")[0]
    named = [part.partition("=") for part in re.split("[&;]", query) if part]
    if _SECRETIVE.search(base_url) or any(
        _SECRET_NAME.search(name) or len(value) > _LONGEST_VALUE for name, _, value in named
    ):
        # The address is printed and stored with the run.
        raise EndpointError(
            "--base-url must hold no password, key or fragment: put the key into an environment variable, and give its "
            "name by --api-key-env or --header"
        )
    try:
        parts = urlsplit(base_url)
        sound = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        (parts.hostname or "").encode("idna")
        httpx2.URL(base_url)
    except (ValueError, httpx2.InvalidURL):
        sound = False
    if not sound or not base_url.isprintable() or " " in base_url:
        raise EndpointError(f"{base_url!a} is no server address: give one like http://localhost:8000/v1")
    return parts._replace(path=parts.path.rstrip("/")).geturl()


def address_of(base_url: str, path: str) -> str:
    """Join a path to a base address.

    Args:
        base_url: The address; its query stays at the end.
        path: The path, beginning with a slash.

    Returns:
        The full address.
    """
    parts = urlsplit(base_url)
    return parts._replace(path=parts.path + path).geturl()


def _is_loopback(base_url: str) -> bool:
    host = urlsplit(base_url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def environment_key(variable: str) -> str:
    """Read a key from the environment.

    Args:
        variable: The name of the environment variable.

    Returns:
        The key, or "".

    Raises:
        EndpointError: A header cannot hold the key. The message does not contain it.
    """
    key = os.environ.get(variable, "").strip()
    if not all("!" <= character <= "~" for character in key):
        raise EndpointError(
            f"${variable} holds a character that no key has (a space, a line end, a letter beyond ASCII)"
        )
    return key


def environment_header(name: str, variable: str) -> str:
    """Read the value of a header from the environment.

    Args:
        name: The header.
        variable: The name of the environment variable.

    Returns:
        The value.

    Raises:
        EndpointError: The variable has no value, or a header cannot hold it. The message does not contain it.
    """
    value = os.environ.get(variable, "").strip()
    if not value or not all(" " <= character <= "~" for character in value):
        raise EndpointError(f"--header {name}={variable}: ${variable} holds no value that a header can have")
    return value


def secrets_of(key: str, headers: Iterable[str]) -> list[str]:
    """List the texts that messages must not show.

    Args:
        key: The server's key.
        headers: The values of further headers.

    Returns:
        The key, the values and their longer words, the longest first.
    """
    words = {word for value in headers for word in (value, *value.split()) if len(word) >= _SECRET // 2}
    return sorted({key, *words} - {""}, key=lambda word: (-len(word), word))


def secret_pattern(secrets: Sequence[str]) -> re.Pattern[bytes] | None:
    """Return a pattern that matches secrets in a reply, also with JSON's escapes.

    Args:
        secrets: The secrets; short ones are left out.

    Returns:
        The pattern; None without a long secret. Its group 1 matches an escaped backslash; its second half would
        otherwise look like the escape of a secret.
    """
    long = ["".join(map(_forms, secret)) for secret in secrets if len(secret) >= _SECRET]
    return re.compile(("|".join(long) + r"|(\\\\)").encode()) if long else None


def _forms(character: str) -> str:
    """Return a pattern of the ways in which a server may write a character."""
    return rf"(?:\\?{re.escape(character)}|\\u00(?i:{ord(character):02x}))"


def retry_after(value: str | None) -> float | None:
    """Read a Retry-After header.

    Args:
        value: The header's value, or None.

    Returns:
        The seconds; None if the header does not state them.
    """
    try:
        seconds = float(value or "")
    except ValueError:
        return None
    return seconds if seconds >= 0 else None
