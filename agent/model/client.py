"""Client of OpenAI-compatible chat servers.

A call that finishes cleanly is stored under the sha256 of the whole request and never paid for twice. The client
repeats what the transport or the server breaks (timeout, cut-off or unreadable reply, 5xx) and waits longer for a
server that is busy (429, 503, 529) or not there. Any other refusal is an EndpointError at once. Keys come from the
environment and go only into the request's headers.
"""

from __future__ import annotations

import math
import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol
from urllib.parse import urlsplit

import msgspec

from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.gate import Gate
from jrdb_avr.agent.model.limits import RateLimit
from jrdb_avr.agent.model.messages import Message, fingerprint, wire
from jrdb_avr.agent.model.options import DEFAULTS, Options
from jrdb_avr.agent.model.reply import ErrorReply, Reply, read_completion, server_reason, spoken
from jrdb_avr.agent.model.transport import (
    CONNECT_S,
    address_of,
    checked_url,
    environment_header,
    environment_key,
    exchange,
    open_connection,
    retry_after,
    secret_pattern,
    secrets_of,
    within,
)
from jrdb_avr.schema.errors import EndpointError, RunStoppedError

if TYPE_CHECKING:
    import httpx2

_LONGEST_PAUSE_S: Final = 60.0
_LONGEST_BUSY_S: Final = 4.0
"""Longest pause before the next try at a busy server that names none: a place is free as soon as any reply ends."""
_BUSY_S: Final = 120.0
"""Sum of the pauses that one call grants a server that is busy or not there: others may fill it, or it restarts."""
_LEAST_PAUSE_S: Final = 0.5
_PROBE_TIMEOUT_S: Final = 180.0
_PROBE_RETRIES: Final = 1
_VERSION_TIMEOUT_S: Final = 5.0
_BUSY: Final = (429, 503, 529)
"""Statuses of a server that will take the request later: too many of them, a model that loads, an overload."""
_NO_CREDIT: Final = "insufficient_quota"
"""The error code of a 429 that waiting does not mend."""
_REMEDIES: Final = {
    401: "; put the server's key into ${key}",
    403: "; put a key that may use the model into ${key}",
    404: "; check --base-url (most end in /v1) and --model",
    429: "; the key's account has no credit left",
}

_LONGER_NAME: Final = "max_completion_tokens"
"""The newer name of `max_tokens`; a server that takes no other says so."""

_Fault = Literal["unreachable", "busy", "timeout", "broken"]
_NEXT: Final[Mapping[_Fault, str]] = {
    "unreachable": "start the server or correct --base-url, then run again",
    "busy": "run again when it is less busy, or with a smaller --concurrency",
    "timeout": "run again with a smaller --concurrency or a larger --timeout",
    "broken": "look into the server's log, then run again",
}
"""What a person does about a fault that stays."""


class Chat(Protocol):
    """Anything that completes a chat. `schema` is the JSON Schema that the reply should follow."""

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply: ...


@dataclass
class _BrokenError(Exception):
    """A failed try that may be repeated; `pause` is the server's Retry-After in seconds."""

    reason: str
    fault: _Fault = "broken"
    pause: float | None = None

    @property
    def passing(self) -> bool:
        """Whether the server may be well again soon, so that the call waits for it."""
        return self.fault in ("unreachable", "busy")


class _TokenParameterError(EndpointError):
    """The server refuses the limit of a reply by its older name."""


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
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.base_url = checked_url(base_url)
        self.model = model
        self.options = options
        self.convention = convention
        self._calls = None if cache is None else Calls(cache)
        self._headers = {"Content-Type": "application/json"}
        own = {name: environment_header(name, variable) for name, variable in options.headers.items()}
        key = environment_key(options.api_key_env)
        if key and "authorization" not in map(str.lower, own):
            self._headers["Authorization"] = f"Bearer {key}"
        self._headers |= own
        self._secrets = secrets_of(key, own.values())
        self._secret = secret_pattern(self._secrets)
        self._limit = RateLimit(options.rpm, options.tpm, clock, pause)
        self.spent = self._spent_before = 0.0
        """Dollars that the calls of this client have cost."""
        if options.price is not None and self._calls is not None:
            self._spent_before = options.price.cost(*self._calls.tokens())
        self._longer_name = False
        self._pause = pause
        self._served: dict[str, None] = {}
        self._gate = Gate()
        self._lock = threading.Lock()
        self._replies = 0
        # One connection per call in flight: the library's pool inspects all of its connections twice a call. The first
        # one is made at once, because the environment may be unusable.
        self._idle = [open_connection(self.base_url)]

    def settings(self) -> dict[str, Any]:
        """Server and sampling settings for a run's manifest; they hold no secret."""
        return {"base_url": self.base_url, **self.options.settings(self.convention)}

    @property
    def served(self) -> tuple[str, ...]:
        """The model ids that replies have named so far, cached ones included, in the order of their first reply."""
        return tuple(self._served)

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat, from the cache where the same request has finished cleanly before.

        Raises EndpointError when the server refuses the request or breaks after all retries; a RunStoppedError where
        it could not be reached, or was busy, for two minutes in which no other call succeeded either.
        """
        request = self.options.request(self.model, self.convention, schema)
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
        request = {**self.options.request(self.model, self.convention, schema), "messages": wire(messages)}
        return self._noted(self._send(request, _PROBE_RETRIES, _PROBE_TIMEOUT_S))

    def server_version(self) -> str:
        """The version that the server reports at `/version`, as vLLM does; empty where it reports none."""
        import httpx2

        parts = urlsplit(self.base_url)

        def get() -> tuple[httpx2.Response, bytes]:
            with open_connection(self.base_url) as http:
                return exchange(http, _VERSION_TIMEOUT_S, "GET", f"{parts.scheme}://{parts.netloc}/version")

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

    def _check_cost(self) -> None:
        check_cost(self._spent_before + self.spent, self.options.max_cost)

    def _send(self, request: Mapping[str, Any], retries: int, most_s: float = math.inf) -> Reply:
        # Encoded once and sent as bytes: a request may hold megabytes of pictures.
        longer = self._longer_name
        body = _encoded(request, longer)
        timeout_s = min(self.options.timeout_s, most_s)
        # A busy server does not delay a probe either, or a call without retries.
        patience_s = _BUSY_S if retries and most_s == math.inf else 0.0
        tries = broken_tries = 0
        replies = self._replies
        while True:
            self._check_cost()
            try:
                return self._try(body, timeout_s)
            except _TokenParameterError:
                if longer:
                    raise
                self._longer_name = longer = True
                body = _encoded(request, longer)
            except _BrokenError as broken:
                tries += 1
                wait = broken.pause
                if wait is None:
                    longest = _LONGEST_BUSY_S if broken.passing else _LONGEST_PAUSE_S
                    wait = min(0.5 * 2.0 ** min(tries - 1, 10), longest)
                # The random share spreads calls that were refused together.
                wait = min(max(wait, _LEAST_PAUSE_S), _LONGEST_PAUSE_S) * random.uniform(1, 1.5)  # noqa: S311
                if broken.passing and patience_s > 0:
                    patience_s -= wait
                elif broken_tries < retries:
                    broken_tries += 1
                else:
                    # Where no other call got through meanwhile, the next question would fare no better.
                    gone = broken.passing and self._replies == replies
                    # A probe belongs to no run that could be resumed.
                    resume = " (evaluate with --resume)" if most_s == math.inf else ""
                    raise (RunStoppedError if gone else EndpointError)(
                        f"{self.base_url}: {broken.reason} ({tries} {'try' if tries == 1 else 'tries'}): "
                        f"{_NEXT[broken.fault]}{resume}"
                    ) from None
                self._pause(wait)

    def _try(self, body: bytes, timeout_s: float) -> Reply:
        import httpx2

        with self._gate.admitted() as own:
            # Counted as it is sent, not when it began to wait for others.
            sent = self._limit.admit()
            try:
                # Sending the request, waiting for the reply and reading it may each take the whole time.
                response, data = within(min(timeout_s, CONNECT_S) + 3 * timeout_s, lambda: self._post(body, timeout_s))
            except httpx2.ConnectTimeout:
                raise _BrokenError("cannot reach the server (it accepts no connection)", "unreachable") from None
            except (TimeoutError, httpx2.TimeoutException) as error:
                self._gate.timed_out(own)
                whole = "" if isinstance(error, httpx2.TimeoutException) else " whole"
                beside = f" with {own.others} other calls in flight" if own.others else ""
                raise _BrokenError(f"no{whole} reply within {timeout_s:g} s{beside}", "timeout") from None
            except (httpx2.ConnectError, httpx2.ProxyError) as error:
                raise _BrokenError(f"cannot reach the server ({self._one_line(error)})", "unreachable") from None
            except httpx2.HTTPError as error:
                raise _BrokenError(f"the reply broke off ({self._one_line(error)})") from None
            except EndpointError as error:
                raise EndpointError(f"{self.base_url}: {error}") from None
        if self._secret is not None:
            # A server may echo its request, and replies are stored.
            data = self._secret.sub(lambda found: found[1] or b"[key]", data)
        if not response.is_success:
            raise self._refusal(response, response.status_code, *server_reason(data))
        try:
            reply = read_completion(data)
        except ErrorReply as error:
            # Some servers, and what stands before them, send an error with the status of a success.
            status = error.code if isinstance(error.code, int) and 400 <= error.code < 600 else 502
            raise self._refusal(response, status, str(error), error.code) from None
        except ValueError as error:
            kind = self._one_line(response.headers.get("content-type", "bytes").partition(";")[0])
            raise _BrokenError(f"the reply is no chat completion but {kind[:40]} ({self._one_line(error)})") from None
        self._replies += 1
        self._gate.replied()
        self._limit.count(sent, reply.prompt_tokens + reply.completion_tokens)
        if (price := self.options.price) is not None:
            with self._lock:
                self.spent += price.cost(reply.prompt_tokens, reply.completion_tokens)
        return reply

    def _post(self, body: bytes, timeout_s: float) -> tuple[httpx2.Response, bytes]:
        try:
            connection = self._idle.pop()
        except IndexError:
            connection = open_connection(self.base_url)
        try:
            url = address_of(self.base_url, "/chat/completions")
            return exchange(connection, timeout_s, "POST", url, content=body, headers=self._headers)
        finally:
            self._idle.append(connection)

    def _refusal(self, response: httpx2.Response, status: int, message: str, code: object) -> Exception:
        """Return the error for a reply that is one, by its HTTP status, message and code."""
        reason = f"HTTP {status}: {self._one_line(message.strip() or 'the server gives no reason')}"
        busy = status in _BUSY and code != _NO_CREDIT
        if busy or status >= 500:
            pause = retry_after(response.headers.get("retry-after"))
            return _BrokenError(reason, "busy" if busy else "broken", pause)
        remedy = _REMEDIES.get(status, "").format(key=self.options.api_key_env)
        if self.options.temperature is not None and "temperature" in message:
            remedy = "; if the model takes none, give --temperature none"
        kind = EndpointError
        if status == 401 or code == _NO_CREDIT:
            # The next question would be refused for the same reason.
            kind = RunStoppedError
        elif self.options.names_itself and _LONGER_NAME in message:
            kind = _TokenParameterError
        return kind(f"{self.base_url}: {reason}{remedy}")

    def _one_line(self, error: object) -> str:
        # The key goes before the text is cut, or its beginning could stay.
        text = str(error)
        for secret in self._secrets:
            text = text.replace(secret, "[key]")
        return " ".join(text.split())[:300] or type(error).__name__


def check_cost(spent: float, most: float | None) -> None:
    """Raise RunStoppedError where a run's calls have cost the dollars that they may cost at most."""
    if most is not None and spent >= most:
        raise RunStoppedError(
            f"the calls have cost {spent:.4g} dollars, and --max-cost is {most:g}: "
            "give more, then run again with --resume"
        )


def _encoded(request: Mapping[str, Any], longer: bool) -> bytes:
    """A request's body, the limit of the reply by its older or its `longer` name."""
    if longer:
        request = {_LONGER_NAME if name == "max_tokens" else name: value for name, value in request.items()}
    return msgspec.json.encode(request)
