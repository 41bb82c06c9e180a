"""Client of OpenAI-compatible chat servers.

A call is a pure function of its request (temperature 0), so a call that finishes cleanly is stored under the sha256 of
the whole request and never paid for twice. The client repeats what the transport or the server breaks (no connection,
timeout, cut-off or unreadable reply, 5xx) and waits longer for a busy server (429). Any other refusal is an
EndpointError at once. The key comes from the environment and goes only into the request's header.
"""

from __future__ import annotations

import functools
import ipaddress
import math
import os
import queue
import random
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar
from urllib.parse import urlsplit

import msgspec

from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.conventions import CONTRACT, DEFAULTS, Convention, Options
from jrdb_avr.agent.model.messages import Message, fingerprint, wire
from jrdb_avr.agent.model.reply import Reply, read_completion, spoken
from jrdb_avr.schema.errors import EndpointError

if TYPE_CHECKING:
    import ssl

    import httpx2

T = TypeVar("T")

KEY_VARIABLE: Final = "OPENAI_API_KEY"
MOST_BYTES: Final = 16 << 20
"""Longest reply accepted; a few thousand tokens take some kilobytes."""

_LONGEST_PAUSE_S: Final = 60.0
_LONGEST_BUSY_S: Final = 4.0
"""Longest pause before the next try at a busy server that names none: a place is free as soon as any reply ends."""
_BUSY_S: Final = 120.0
"""Sum of the pauses that one call grants a busy server: each of many calls in flight waits for the others."""
_LEAST_PAUSE_S: Final = 0.5
_CONNECT_S: Final = 20.0
_PROBE_TIMEOUT_S: Final = 180.0
_PROBE_RETRIES: Final = 1
_VERSION_TIMEOUT_S: Final = 5.0
_SECRET: Final = 16
"""Shortest key that is hidden; shorter ones, such as "EMPTY" or "x", are words that a reply may hold."""
_NO_CREDIT: Final = "insufficient_quota"
"""The error code of a 429 that waiting does not mend."""
_REMEDIES: Final = {
    401: f"; put the server's key into ${KEY_VARIABLE}",
    403: f"; put a key that may use the model into ${KEY_VARIABLE}",
    404: "; check --base-url (most end in /v1) and --model",
    429: "; the key's account has no credit left",
}


class Chat(Protocol):
    """Anything that completes a chat. `schema` is the JSON Schema that the reply should follow."""

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply: ...


@dataclass
class _BrokenError(Exception):
    """A failed try that may be repeated; `pause` is the server's Retry-After in seconds, `busy` marks a 429."""

    reason: str
    pause: float | None = None
    busy: bool = False


class Client:
    """Completes chats at `base_url` with `model`; safe for many threads at once.

    `convention` says how to switch thinking and which part of a reply is its answer. `cache` is a file of finished
    calls.
    """

    def __init__(
        self,
        base_url: str,
        model: str,
        options: Options = DEFAULTS,
        *,
        convention: Convention = CONTRACT,
        cache: Path | None = None,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self.base_url = _checked_url(base_url)
        self.model = model
        self.options = options
        self.convention = convention
        self._calls = None if cache is None else Calls(cache)
        self._key = _environment_key()
        self._secret = _secret_pattern(self._key)
        self._pause = pause
        self._served: dict[str, None] = {}
        # One connection per call in flight: the library's pool inspects all of its connections twice a call. The first
        # one is made at once, because the environment may be unusable.
        self._idle = [_connection(self.base_url)]

    def settings(self) -> dict[str, Any]:
        """Server and sampling settings for a run's manifest; they hold no secret."""
        return {
            "base_url": self.base_url,
            "temperature": 0,
            **asdict(self.options),
            "chat_template_kwargs": self.options.template(self.convention),
        }

    @property
    def served(self) -> tuple[str, ...]:
        """The model ids that replies have named so far, cached ones included, in the order of their first reply."""
        return tuple(self._served)

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat, from the cache where the same request has finished cleanly before.

        Raises EndpointError when the server cannot be reached after all retries or refuses the request.
        """
        request = self._request(schema)
        digest = ""
        if self._calls is not None:
            digest = self._calls.digest({**request, "messages": fingerprint(messages)})
            cached = self._calls.read(digest)
            if cached is not None and self._cacheable(cached):
                return self._noted(cached)
        reply = self._noted(self._send({**request, "messages": wire(messages)}, self.options.retries))
        if self._calls is not None and self._cacheable(reply):
            self._calls.append(digest, reply)
        return reply

    def _cacheable(self, reply: Reply) -> bool:
        """Whether a reply finished cleanly, has an answer, and comes from the first model that replied."""
        of_model = reply.model == next(iter(self.served), reply.model)
        return of_model and reply.finished and bool(spoken(reply, self.convention))

    def probe(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat without the cache and give up soon, as the server is still unknown.

        Raises EndpointError, as `complete`.
        """
        request = {**self._request(schema), "messages": wire(messages)}
        return self._noted(self._send(request, _PROBE_RETRIES, _PROBE_TIMEOUT_S))

    def server_version(self) -> str:
        """The version that the server reports at `/version`, as vLLM does; empty where it reports none."""
        import httpx2

        parts = urlsplit(self.base_url)

        def get() -> tuple[httpx2.Response, bytes]:
            with _connection(self.base_url) as http:
                return _exchange(http, _VERSION_TIMEOUT_S, "GET", f"{parts.scheme}://{parts.netloc}/version")

        try:
            response, data = within(_VERSION_TIMEOUT_S, get)
            version = msgspec.json.decode(data, type=dict[str, Any]).get("version")
        except (httpx2.HTTPError, EndpointError, TimeoutError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return ""
        return self._one_line(version)[:80] if response.status_code == 200 and isinstance(version, str) else ""

    def _noted(self, reply: Reply) -> Reply:
        # One step for the interpreter: no other thread sees it half done.
        self._served.setdefault(reply.model)
        return reply

    def _request(self, schema: Mapping[str, Any] | None) -> dict[str, Any]:
        request: dict[str, Any] = {"model": self.model, "temperature": 0, "max_tokens": self.options.max_tokens}
        if template := self.options.template(self.convention):
            request["chat_template_kwargs"] = template
        return request if schema is None else {**request, **self.options.response(schema)}

    def _send(self, request: Mapping[str, Any], retries: int, most_s: float = math.inf) -> Reply:
        # Encoded once and sent as bytes: a request may hold megabytes of pictures.
        body = msgspec.json.encode(request)
        timeout_s = min(self.options.timeout_s, most_s)
        # A busy server does not delay a probe either, or a call without retries.
        patience_s = _BUSY_S if retries and most_s == math.inf else 0.0
        tries = broken_tries = 0
        while True:
            try:
                return self._try(body, timeout_s)
            except _BrokenError as broken:
                tries += 1
                wait = broken.pause
                if wait is None:
                    wait = min(0.5 * 2.0 ** min(tries - 1, 10), _LONGEST_BUSY_S if broken.busy else _LONGEST_PAUSE_S)
                # The random share spreads calls that were refused together.
                wait = min(max(wait, _LEAST_PAUSE_S), _LONGEST_PAUSE_S) * random.uniform(1, 1.5)  # noqa: S311
                if broken.busy and patience_s > 0:
                    patience_s -= wait
                elif broken_tries < retries:
                    broken_tries += 1
                else:
                    raise EndpointError(
                        f"{self.base_url}: {broken.reason} ({tries} tries): "
                        "start the server or correct --base-url, then run again (evaluate with --resume)"
                    ) from None
                self._pause(wait)

    def _try(self, body: bytes, timeout_s: float) -> Reply:
        import httpx2

        try:
            # Sending the request, waiting for the reply and reading it may each take the whole time.
            response, data = within(min(timeout_s, _CONNECT_S) + 3 * timeout_s, lambda: self._post(body, timeout_s))
        except TimeoutError:
            raise _BrokenError(f"no whole reply within {timeout_s:g} s") from None
        except httpx2.ConnectTimeout:
            raise _BrokenError("cannot reach the server (it accepts no connection)") from None
        except httpx2.TimeoutException:
            raise _BrokenError(f"no reply within {timeout_s:g} s") from None
        except httpx2.HTTPError as error:
            raise _BrokenError(f"cannot reach the server, or its reply broke off ({self._one_line(error)})") from None
        except EndpointError as error:
            raise EndpointError(f"{self.base_url}: {error}") from None
        if self._secret is not None:
            # A server may echo its request, and replies are stored.
            data = self._secret.sub(lambda found: found[1] or b"[key]", data)
        if not response.is_success:
            raise self._refusal(response, data)
        try:
            return read_completion(data)
        except ValueError as error:
            kind = self._one_line(response.headers.get("content-type", "bytes").partition(";")[0])
            raise _BrokenError(f"the reply is no chat completion but {kind[:40]} ({self._one_line(error)})") from None

    def _post(self, body: bytes, timeout_s: float) -> tuple[httpx2.Response, bytes]:
        try:
            connection = self._idle.pop()
        except IndexError:
            connection = _connection(self.base_url)
        headers = {"Content-Type": "application/json"} | ({"Authorization": f"Bearer {self._key}"} if self._key else {})
        try:
            url = f"{self.base_url}/chat/completions"
            return _exchange(connection, timeout_s, "POST", url, content=body, headers=headers)
        finally:
            self._idle.append(connection)

    def _refusal(self, response: httpx2.Response, data: bytes) -> Exception:
        """Return the error for an unsuccessful HTTP response."""
        status, message, code = response.status_code, data.decode(errors="replace"), None
        try:
            match msgspec.json.decode(data):
                case {"error": dict(error)} | dict(error):
                    code = error.get("code")
                    message = error["message"] if isinstance(error.get("message"), str) else message
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            pass
        reason = f"HTTP {status}: {self._one_line(message.strip() or 'the server gives no reason')}"
        busy = status == 429 and code != _NO_CREDIT
        if busy or status >= 500:
            return _BrokenError(reason, _retry_after(response.headers.get("retry-after")), busy)
        return EndpointError(f"{self.base_url}: {reason}{_REMEDIES.get(status, '')}")

    def _one_line(self, error: object) -> str:
        # The key goes before the text is cut, or its beginning could stay.
        text = str(error).replace(self._key, "[key]") if self._key else str(error)
        return " ".join(text.split())[:300] or type(error).__name__


# -- one exchange over HTTP -------------------------------------------------------------------------------------------


def _connection(base_url: str) -> httpx2.Client:
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


def _exchange(
    http: httpx2.Client, timeout_s: float, method: str, url: str, **sent: Any
) -> tuple[httpx2.Response, bytes]:
    """Send a request and read the whole reply.

    Raises EndpointError for a redirect, which would take the request and its key elsewhere, for a reply over 16 MB and
    for a compressed one, of which few bytes may become many. Raises httpx2.ReadTimeout for a reply that has not ended
    in time: the library's timeouts bound each wait for bytes only.
    """
    import httpx2

    timeout = httpx2.Timeout(timeout_s, connect=min(timeout_s, _CONNECT_S))
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

_SECRETIVE: Final = re.compile(r"[?#]|^([^/]*//)?[^/]*@")
"""Parts of an address that may hold a password: user info, query, fragment."""


def _checked_url(base_url: str) -> str:
    import httpx2

    if _SECRETIVE.search(base_url):
        # The address is printed and stored with the run.
        raise EndpointError(f"--base-url must hold no password, query or fragment: put the key into ${KEY_VARIABLE}")
    try:
        parts = urlsplit(base_url)
        sound = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        (parts.hostname or "").encode("idna")
        httpx2.URL(base_url)
    except (ValueError, httpx2.InvalidURL):
        sound = False
    if not sound or not base_url.isprintable() or " " in base_url:
        raise EndpointError(f"{base_url!a} is no server address: give one like http://localhost:8000/v1")
    return base_url.rstrip("/")


def _is_loopback(base_url: str) -> bool:
    host = urlsplit(base_url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _environment_key() -> str:
    """The key of the environment. Raises EndpointError, without it, for one that a header cannot hold."""
    key = os.environ.get(KEY_VARIABLE, "").strip()
    if not all("!" <= character <= "~" for character in key):
        raise EndpointError(
            f"${KEY_VARIABLE} holds a character that no key has (a space, a line end, a letter beyond ASCII)"
        )
    return key


def _secret_pattern(key: str) -> re.Pattern[bytes] | None:
    """Matches the key in a reply, also with JSON's escapes, as some servers write / and +; None for a short key.

    Also matches an escaped backslash, as group 1, so that its second half is not taken for the escape of the key.
    """
    forms = (rf"(?:\\?{re.escape(character)}|\\u00(?i:{ord(character):02x}))" for character in key)
    return re.compile(("".join(forms) + r"|(\\\\)").encode()) if len(key) >= _SECRET else None


def _retry_after(value: str | None) -> float | None:
    try:
        seconds = float(value or "")
    except ValueError:
        return None
    return seconds if seconds >= 0 else None
