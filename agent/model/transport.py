"""HTTP exchanges with a model's server: addresses, keys that messages must not show, and waits that end.

No redirect is followed and no compressed reply is unpacked. A key is replaced in whatever a server sends back.
"""

from __future__ import annotations

import functools
import ipaddress
import os
import queue
import re
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Final, TypeVar
from urllib.parse import urlsplit

from jrdb_avr.schema.errors import EndpointError

if TYPE_CHECKING:
    import ssl

    import httpx2

T = TypeVar("T")

MOST_BYTES: Final = 16 << 20
"""Longest reply accepted; a few thousand tokens take some kilobytes."""
CONNECT_S: Final = 20.0
_SECRET: Final = 16
"""Shortest key that is hidden; shorter ones, such as "EMPTY" or "x", are words that a reply may hold."""


def open_connection(base_url: str) -> httpx2.Client:
    """A connection that follows no redirect. Raises EndpointError where the environment names no usable proxy."""
    import httpx2

    # A proxy of the environment cannot reach this machine's own loopback address.
    environment = not _is_loopback(base_url)
    try:
        return httpx2.Client(
            trust_env=environment,
            verify=_certificates(environment),
            follow_redirects=False,
            headers={"Accept": "application/json", "Accept-Encoding": "identity"},
        )
    except (httpx2.InvalidURL, ValueError, ImportError):
        raise EndpointError(
            "the environment names a proxy that cannot be used: correct HTTP_PROXY, HTTPS_PROXY or ALL_PROXY"
        ) from None


@functools.cache
def _certificates(environment: bool) -> ssl.SSLContext:
    """The trusted certificates, shared by all connections: loading them takes as long as many calls."""
    import httpx2

    return httpx2.create_ssl_context(trust_env=environment)


def exchange(
    http: httpx2.Client, timeout_s: float, method: str, url: str, **sent: Any
) -> tuple[httpx2.Response, bytes]:
    """Send a request and read the whole reply.

    Raises EndpointError for a redirect, which would take the request and its key elsewhere, for a reply over 16 MB and
    for a compressed one, of which few bytes may become many. Raises httpx2.ReadTimeout for a reply that has not ended
    in time: the library's timeouts bound each wait for bytes only.
    """
    import httpx2

    timeout = httpx2.Timeout(timeout_s, connect=min(timeout_s, CONNECT_S))
    with http.stream(method, url, timeout=timeout, **sent) as response:
        if response.has_redirect_location:
            raise EndpointError(
                f"the server redirects to another address (HTTP {response.status_code}): give that one as --base-url"
            )
        if response.headers.get("content-encoding", "").strip().lower() not in ("", "identity"):
            raise EndpointError("the reply is compressed, but the request accepts no compression: switch it off there")
        data, end = bytearray(), time.monotonic() + timeout_s
        for chunk in response.iter_raw():
            data += chunk
            if len(data) > MOST_BYTES:
                raise EndpointError(f"the reply is longer than {MOST_BYTES >> 20} MB: is this a chat server?")
            if time.monotonic() > end:
                raise httpx2.ReadTimeout(f"the reply did not end within {timeout_s:g} s")
        return response, bytes(data)


def within(seconds: float, work: Callable[[], T]) -> T:
    """Run `work` in another thread and return its result, or raise what it raises.

    Raises TimeoutError where it does not end in time, and abandons the thread. The library's timeouts do not bound how
    many bytes the head of a reply and the announcements before it (102 Processing) may have.
    """
    done: Future[T] = Future()
    try:
        # Threads are reused: starting one takes longer than much of a call.
        tasks = _idle_threads.pop()
    except IndexError:
        tasks = queue.SimpleQueue()
        threading.Thread(target=_serve, args=(tasks,), daemon=True).start()
    tasks.put((work, done))
    return done.result(seconds)


_Tasks = queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]]

_idle_threads: Final[list[_Tasks]] = []
"""The queues that idle threads wait for."""

# A forked process has none of the threads.
os.register_at_fork(after_in_child=_idle_threads.clear)


def _serve(tasks: _Tasks) -> None:
    while True:
        work, done = tasks.get()
        finish: Callable[[], None]
        try:
            finish = functools.partial(done.set_result, work())
        except BaseException as error:
            finish = functools.partial(done.set_exception, error)
        # Idle before the caller goes on, which may have more work at once.
        _idle_threads.append(tasks)
        finish()
        # Results do not stay alive while the thread waits.
        del work, done, finish


# -- address and key --------------------------------------------------------------------------------------------------

_SECRETIVE: Final = re.compile(r"#|^([^/]*//)?[^/?]*@")
"""Parts of an address that may hold a password: user info, fragment."""

_SECRET_NAME: Final = re.compile(r"(?i)key|token|secret|pass|pw|sig|auth|cred|code")
_LONGEST_VALUE: Final = 40
"""Longest value of a query's parameter; longer ones may be keys."""


def checked_url(base_url: str) -> str:
    """The address without a slash at its end. Raises EndpointError for one that cannot be used or holds a password."""
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
    """Join a path to a base address; the base address's query stays at the end."""
    parts = urlsplit(base_url)
    return parts._replace(path=parts.path + path).geturl()


def _is_loopback(base_url: str) -> bool:
    host = urlsplit(base_url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def environment_key(variable: str) -> str:
    """The key that an environment variable holds. Raises EndpointError, without it, for one that no header can hold."""
    key = os.environ.get(variable, "").strip()
    if not all("!" <= character <= "~" for character in key):
        raise EndpointError(
            f"${variable} holds a character that no key has (a space, a line end, a letter beyond ASCII)"
        )
    return key


def environment_header(name: str, variable: str) -> str:
    """A header's value from the environment. Raises EndpointError where there is none, or no header can hold it."""
    value = os.environ.get(variable, "").strip()
    if not value or not all(" " <= character <= "~" for character in value):
        raise EndpointError(f"--header {name}={variable}: ${variable} holds no value that a header can have")
    return value


def secrets_of(key: str, headers: Iterable[str]) -> list[str]:
    """The texts that must not be shown: the key, and header values with their words; the longest first."""
    words = {word for value in headers for word in (value, *value.split()) if len(word) >= _SECRET // 2}
    return sorted({key, *words} - {""}, key=lambda word: (-len(word), word))


def secret_pattern(secrets: Sequence[str]) -> re.Pattern[bytes] | None:
    """Matches secrets in a reply, also with JSON's escapes, as some servers write / and +; None without a long one.

    Also matches an escaped backslash, as group 1, so that its second half is not taken for the escape of a secret.
    """
    long = ["".join(map(_forms, secret)) for secret in secrets if len(secret) >= _SECRET]
    return re.compile(("|".join(long) + r"|(\\\\)").encode()) if long else None


def _forms(character: str) -> str:
    """A character as a server may write it."""
    return rf"(?:\\?{re.escape(character)}|\\u00(?i:{ord(character):02x}))"


def retry_after(value: str | None) -> float | None:
    """Seconds of a Retry-After header; None where it names none."""
    try:
        seconds = float(value or "")
    except ValueError:
        return None
    return seconds if seconds >= 0 else None
