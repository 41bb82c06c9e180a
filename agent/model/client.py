"""Client of OpenAI-compatible servers.

A call is a pure function of its request (temperature 0), so a call that finished cleanly is kept on disk under the
sha256 of the whole request and never paid for twice. Retried: what the transport or the server broke (no connection,
timeout, cut-off or unreadable reply, 5xx), and, for longer, what a busy server puts off (429). Anything else that the
server refuses is an EndpointError at once. The key is read from the environment and goes nowhere but into the request's
header.
"""

from __future__ import annotations

import functools
import ipaddress
import math
import os
import random
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol
from urllib.parse import urlsplit

import msgspec

from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.limits import limit, within
from jrdb_avr.agent.model.messages import Message, fingerprint, wire
from jrdb_avr.agent.model.options import DEFAULTS, Options
from jrdb_avr.agent.model.reply import Reply as Reply
from jrdb_avr.agent.model.reply import read_completion, spoken
from jrdb_avr.schema.errors import EndpointError

if TYPE_CHECKING:
    import ssl

    import httpx2
    import openai

KEY_VARIABLE: Final = "OPENAI_API_KEY"
_ACCOUNT_VARIABLES: Final = ("OPENAI_ORG_ID", "OPENAI_PROJECT_ID")
"""What the client's library reads of the environment by itself, and sends along."""

_UNSAID: Final = tuple(
    f"X-Stainless-{name}"
    for name in (
        "Arch",
        "Async",
        "Lang",
        "OS",
        "Package-Version",
        "Read-Timeout",
        "Retry-Count",
        "Runtime",
        "Runtime-Version",
    )
)
"""Headers by which the client's library would tell of itself and this machine: nothing that a model's server needs, and
each takes time in every call.
"""

_LONGEST_PAUSE_S: Final = 60.0
_LONGEST_BUSY_S: Final = 4.0
"""Before a busy server is asked again, if it does not say when: a place becomes free as soon as any reply is done."""
_BUSY_S: Final = 120.0
"""Pauses in all that one call grants a busy server. Of many questions in flight each waits for the others."""
_LEAST_PAUSE_S: Final = 0.5
_CONNECT_S: Final = 20.0
_PROBE_TIMEOUT_S: Final = 180.0
_PROBE_RETRIES: Final = 1
_VERSION_TIMEOUT_S: Final = 5.0
_SECRET: Final = 16
"""Characters of a key from which on it is one; shorter ones, as "EMPTY" or "x", are words that a reply may hold."""
_NO_CREDIT: Final = "insufficient_quota"
"""The error code of a 429 that no waiting mends."""
_REMEDIES: Final = {
    401: f"; put the server's key into ${KEY_VARIABLE}",
    403: f"; put a key that may use the model into ${KEY_VARIABLE}",
    404: "; check --base-url (most end in /v1) and --model",
    429: "; the key's account has no credit left",
}


class Chat(Protocol):
    """Anything that completes a chat. `schema` is the JSON Schema the reply should keep to."""

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply: ...


class _BrokenError(Exception):
    """A try that may be repeated, with the pause that the server asks for (seconds); `busy`: it is only put off."""

    def __init__(self, reason: str, pause: float | None = None, busy: bool = False) -> None:
        super().__init__(reason)
        self.reason = reason
        self.pause = pause
        self.busy = busy


class Client:
    """Completes chats at `base_url` with `model`; used by many threads at once.

    `convention` says how the model is told to think or not, and what of a reply is its answer. `cache` is a file for
    finished calls.
    """

    def __init__(
        self,
        base_url: str,
        model: str,
        options: Options = DEFAULTS,
        *,
        convention: Convention = CONTRACT,
        cache: Path | None = None,
        key_variable: str = KEY_VARIABLE,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self.base_url = _checked_url(base_url)
        self.model = model
        self.options = options
        self.convention = convention
        self._calls = None if cache is None else Calls(cache)
        self._key = _checked_key(key_variable)
        for variable in _ACCOUNT_VARIABLES:
            _checked_key(variable)
        self._pause = pause
        self._served: dict[str, None] = {}
        self._lock = threading.Lock()
        # A connection each for calls in flight: the library's pool looks at all of its connections, the idle ones by a
        # poll, twice a call. The first is made at once, as an environment may be refused.
        self._idle = [self._connect()]

    def _connect(self) -> openai.OpenAI:
        import openai

        return openai.OpenAI(
            base_url=self.base_url,
            api_key=self._key or "none",
            max_retries=0,
            timeout=self.options.timeout_s,
            http_client=_transport(self.base_url),
        )

    def settings(self) -> dict[str, Any]:
        """What the manifest of a run says of the server and the sampling; no secret is in it."""
        return {
            "base_url": self.base_url,
            "temperature": 0,
            **self.options.settings(),
            "chat_template_kwargs": dict(self.options.template(self.convention)),
        }

    @property
    def served(self) -> tuple[str, ...]:
        """The model ids that the server has named so far, kept calls included, in the order of their first reply."""
        with self._lock:
            return tuple(self._served)

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat, from the cache where the same request finished cleanly before.

        Raises EndpointError when the server cannot be reached after all retries or refuses the request.
        """
        request = self._request(schema)
        if self._calls is None:
            return self._noted(self._send({**request, "messages": wire(messages)}, self.options.retries))
        digest = self._calls.digest({**request, "messages": fingerprint(messages)})
        kept = self._calls.read(digest)
        if kept is not None and self._stands(kept):
            return self._noted(kept)
        reply = self._noted(self._send({**request, "messages": wire(messages)}, self.options.retries))
        if self._stands(reply):
            self._calls.keep(digest, reply)
        return reply

    def _stands(self, reply: Reply) -> bool:
        """Whether a reply is worth keeping: it finished cleanly, said something, and is of the model first met."""
        of_model = reply.model == next(iter(self.served), reply.model)
        return of_model and reply.finished and bool(spoken(reply, self.convention))

    def ask(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat now, whatever is kept, and give up soon: of a server of which nothing is known yet.

        Raises EndpointError, as `complete`.
        """
        request = {**self._request(schema), "messages": wire(messages)}
        return self._noted(self._send(request, _PROBE_RETRIES, _PROBE_TIMEOUT_S))

    def server_version(self) -> str:
        """What the server says of its version at `/version`, as vLLM does; empty where it says nothing."""
        import httpx2

        parts = urlsplit(self.base_url)
        try:
            with _transport(self.base_url) as http:
                answer = http.get(f"{parts.scheme}://{parts.netloc}/version", timeout=_VERSION_TIMEOUT_S)
            version = msgspec.json.decode(answer.content, type=dict[str, Any]).get("version")
        except (httpx2.HTTPError, EndpointError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return ""
        return self._one_line(version)[:80] if answer.status_code == 200 and isinstance(version, str) else ""

    def _noted(self, reply: Reply) -> Reply:
        with self._lock:
            self._served.setdefault(reply.model)
        return reply

    def _request(self, schema: Mapping[str, Any] | None) -> dict[str, Any]:
        request: dict[str, Any] = {"model": self.model, "temperature": 0, "max_tokens": self.options.max_tokens}
        if template := self.options.template(self.convention):
            request["chat_template_kwargs"] = dict(template)
        return request if schema is None else {**request, **self.options.response(schema)}

    def _send(self, request: Mapping[str, Any], retries: int, most_s: float = math.inf) -> Reply:
        # Encoded once and sent as bytes: a request may hold megabytes of pictures.
        body = msgspec.json.encode(request)
        timeout_s = min(self.options.timeout_s, most_s)
        # A probe, and who wants no retries, is not kept waiting by a busy server either.
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
                # Not all that were refused together come back together.
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
        import openai

        def post() -> httpx2.Response:
            try:
                connection = self._idle.pop()
            except IndexError:
                connection = self._connect()
            try:
                response: httpx2.Response = connection.post(
                    f"{self.base_url}/chat/completions",
                    content=body,
                    cast_to=httpx2.Response,
                    options={
                        "headers": dict.fromkeys(_UNSAID, openai.Omit()),
                        "timeout": httpx2.Timeout(timeout_s, connect=min(timeout_s, _CONNECT_S)),
                    },
                )
                return response
            finally:
                self._idle.append(connection)

        try:
            # To send a request, to wait for the reply, to read it: each has its own time.
            response = within(min(timeout_s, _CONNECT_S) + 3 * timeout_s, post)
            data = response.content
        except TimeoutError:
            raise _BrokenError(f"no whole reply within {timeout_s:g} s") from None
        except openai.APITimeoutError as error:
            if isinstance(error.__cause__, httpx2.ConnectTimeout):
                raise _BrokenError("cannot reach the server (nothing takes the connection)") from None
            raise _BrokenError(f"no reply within {timeout_s:g} s") from None
        except openai.APIConnectionError as error:
            if isinstance(error.__cause__, EndpointError):
                raise EndpointError(f"{self.base_url}: {error.__cause__}") from None
            raise _BrokenError(f"cannot reach the server ({self._one_line(error.__cause__ or error)})") from None
        except openai.APIStatusError as error:
            reason = f"HTTP {error.status_code}: {self._one_line(error.message)}"
            busy = error.status_code == 429 and error.code != _NO_CREDIT
            if busy or error.status_code >= 500:
                raise _BrokenError(reason, _retry_after(error.response.headers.get("retry-after")), busy) from None
            raise EndpointError(f"{self.base_url}: {reason}{_REMEDIES.get(error.status_code, '')}") from None
        except httpx2.HTTPError as error:
            raise _BrokenError(f"the reply broke off ({self._one_line(error)})") from None
        if len(self._key) >= _SECRET:
            # A server may echo what it was sent, and a reply is stored.
            data = data.replace(self._key.encode(), b"[key]")
        try:
            return self._without_key(read_completion(data))
        except ValueError as error:
            kind = self._one_line(response.headers.get("content-type", "bytes").partition(";")[0])
            raise _BrokenError(f"the reply is no chat completion but {kind[:40]} ({self._one_line(error)})") from None

    def _without_key(self, reply: Reply) -> Reply:
        """The reply without a key that was written in JSON's escapes, as some servers write / and +."""
        if len(self._key) < _SECRET:
            return reply
        texts = {name: text for name, text in msgspec.structs.asdict(reply).items() if isinstance(text, str)}
        return msgspec.structs.replace(
            reply, **{name: text.replace(self._key, "[key]") for name, text in texts.items() if self._key in text}
        )

    def _one_line(self, error: object) -> str:
        # The key goes before the text is cut, or its beginning could stay.
        text = str(error)
        return _one_line(text.replace(self._key, "[key]") if self._key else text) or type(error).__name__


def _transport(base_url: str) -> httpx2.Client:
    import httpx2
    import openai

    # A proxy of the environment cannot reach this machine's own loopback address.
    environment = not _is_loopback(base_url)
    try:
        return openai.DefaultHttpxClient(
            trust_env=environment,
            verify=_certificates(environment),
            event_hooks={"response": [limit]},
            headers={"Accept-Encoding": "identity"},
        )
    except (httpx2.InvalidURL, ValueError, ImportError):
        raise EndpointError(
            "the environment names a proxy that cannot be used: correct HTTP_PROXY, HTTPS_PROXY or ALL_PROXY"
        ) from None


@functools.cache
def _certificates(environment: bool) -> ssl.SSLContext:
    """The certificates to trust. Loading them takes as long as many calls do, and all clients may share them."""
    import httpx2

    return httpx2.create_ssl_context(trust_env=environment)


_SECRETIVE: Final = re.compile(r"[?#]|^([^/]*//)?[^/]*@")
"""What of an address may hold a password: user info, query, fragment."""


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


def _checked_key(variable: str) -> str:
    """The key of the environment. Raises EndpointError, without it, for one that cannot stand in a header."""
    key = os.environ.get(variable, "").strip()
    if not all("!" <= character <= "~" for character in key):
        raise EndpointError(
            f"${variable} holds a character that no key has (a space, a line end, a letter beyond ASCII)"
        )
    return key


def _is_loopback(base_url: str) -> bool:
    host = urlsplit(base_url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _retry_after(value: str | None) -> float | None:
    try:
        seconds = float(value or "")
    except ValueError:
        return None
    return seconds if seconds >= 0 else None


def _one_line(error: object) -> str:
    return " ".join(str(error).split())[:300]
