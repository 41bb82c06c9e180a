"""Client of OpenAI-compatible chat servers.

A call that finishes cleanly is stored under the sha256 of the whole request and never paid for twice. The client
repeats a call if the transport or the server breaks it (timeout, unreadable reply, 5xx). It waits longer for a server
that is busy (429, 503, 529) or cannot be reached. Any other refusal is an EndpointError at once. Keys come from the
environment and go only into the request's headers.
"""

from __future__ import annotations

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
from jrdb_avr.agent.model.limits import RateLimit
from jrdb_avr.agent.model.messages import Message, fingerprint, wire
from jrdb_avr.agent.model.options import DEFAULTS, EndpointOptions
from jrdb_avr.agent.model.reply import ErrorReply, Reply, answer_text, read_completion, server_reason
from jrdb_avr.agent.model.transport import (
    BOUNDS,
    Bounds,
    Connections,
    address_of,
    checked_url,
    environment_header,
    environment_key,
    retry_after,
    secret_pattern,
    secrets_of,
)
from jrdb_avr.schema.errors import EndpointError, RunStoppedError

if TYPE_CHECKING:
    import httpx2
    from tenacity import RetryCallState

_PAUSE_S: Final = (0.5, 60.0)
"""Minimum and maximum pause before a call is repeated."""
_BUSY_PAUSE_S: Final = 4.0
"""Maximum pause before a busy server gets the call again, if it names no pause: any reply that ends frees a slot."""
_PATIENCE_S: Final = 120.0
"""Maximum sum of a call's pauses for a server that is busy or cannot be reached, and may be restarting."""
_PROBE_RETRIES: Final = 1
_VERSION_TIMEOUT_S: Final = 5.0
_BUSY: Final = (429, 503, 529)
"""Statuses of a server that will take the request later: too many requests, a model that loads, an overload."""
_NO_CREDIT: Final = "insufficient_quota"
"""The error code of a 429 that waiting does not mend."""
_REMEDIES: Final = {
    401: "; put the server's key into ${key}",
    403: "; put a key that may use the model into ${key}",
    404: "; check --base-url (most end in /v1) and --model",
    429: "; the key's account has no credit left",
}

_LONGER_NAME: Final = "max_completion_tokens"
"""The newer name of `max_tokens`; a server that requires it says so."""

_Fault = Literal["unreachable", "busy", "timeout", "broken"]
_NEXT: Final[Mapping[_Fault, str]] = {
    "unreachable": "start the server or correct --base-url, then run again",
    "busy": "run again when it is less busy, or with a smaller --concurrency",
    "timeout": "run again with a smaller --concurrency or a larger --timeout",
    "broken": "look into the server's log, then run again",
}
"""The remedy for a fault that stays."""


class Chat(Protocol):
    """A model that completes a chat."""

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Return the reply to a chat; `schema` is the JSON Schema that it should follow."""
        ...


@dataclass
class _BrokenError(Exception):
    """A failed try that may be repeated; `pause` is the server's Retry-After in seconds."""

    reason: str
    fault: _Fault = "broken"
    pause: float | None = None

    @property
    def passing(self) -> bool:
        """Whether the server may recover soon, so that the call waits for it."""
        return self.fault in ("unreachable", "busy")


class _TokenParameterError(EndpointError):
    """The server refuses the older name of the reply's token limit."""


class Client:
    """Completes chats at `base_url` with `model`; safe for many threads at once."""

    def __init__(
        self,
        base_url: str,
        model: str,
        options: EndpointOptions = DEFAULTS,
        *,
        convention: Convention = CONTRACT,
        cache: Path | None = None,
        bounds: Bounds = BOUNDS,
        pause: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare a client; nothing is sent yet.

        Args:
            base_url: The server's address.
            model: The model id that requests name.
            options: The request settings.
            convention: How the model switches thinking, and which part of a reply is its answer.
            cache: The file of finished calls; None keeps no calls.
            bounds: Maxima of each exchange with the server.
            pause: Waits a number of seconds.
            clock: Returns the time in seconds.

        Raises:
            EndpointError: The address, the environment's proxy, or the value of a key or header cannot be used.
        """
        self.base_url = checked_url(base_url)
        self.model = model
        self.options = options
        self.convention = convention
        self._calls = None if cache is None else Calls(cache)
        self._headers = {"Content-Type": "application/json"}
        headers = {name: environment_header(name, variable) for name, variable in options.headers.items()}
        key = environment_key(options.api_key_env)
        if key and "authorization" not in map(str.lower, headers):
            self._headers["Authorization"] = f"Bearer {key}"
        self._headers |= headers
        self._secrets = secrets_of(key, headers.values())
        self._secret = secret_pattern(self._secrets)
        self._limit = RateLimit(options.rpm, options.tpm, clock, pause)
        self.spent = self._spent_before = 0.0
        """Dollars that the calls of this client have cost."""
        if options.price is not None and self._calls is not None:
            self._spent_before = options.price.cost(*self._calls.tokens())
        self._longer_name = False
        self._pause = pause
        self._served: dict[str, None] = {}
        self._lock = threading.Lock()
        self._replies = 0
        self._bounds = bounds
        self._connections = Connections(self.base_url, bounds)

    def settings(self) -> dict[str, Any]:
        """Return the server and sampling settings for a run's manifest; they hold no secret."""
        return {"base_url": self.base_url, **self.options.settings(self.convention)}

    @property
    def served(self) -> tuple[str, ...]:
        """The model ids that replies, cached ones included, have named so far, in the order of their first reply."""
        return tuple(self._served)

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat, from the cache if the same request has finished cleanly before.

        Args:
            messages: The chat.
            schema: The JSON Schema that the reply should follow.

        Returns:
            The reply.

        Raises:
            EndpointError: The server refuses the request, or breaks after all retries.
            RunStoppedError: The server could not be reached, or was busy, for two minutes in which no other call
                succeeded either; or the calls have cost the maximum.
        """
        request = self.options.request(self.model, self.convention, schema)
        digest = ""
        if self._calls is not None:
            digest = self._calls.digest({**request, "messages": fingerprint(messages)})
            cached = self._calls.read(digest)
            if cached is not None and self._cacheable(cached):
                return self._noted(cached)
        reply = self._noted(self._send({**request, "messages": wire(messages)}))
        if self._calls is not None and self._cacheable(reply):
            self._calls.append(digest, reply)
        return reply

    def _cacheable(self, reply: Reply) -> bool:
        """Whether a reply finished cleanly, has an answer, and comes from the first model that replied."""
        of_model = reply.model == next(iter(self.served), reply.model)
        return of_model and reply.finished and bool(answer_text(reply, self.convention))

    def probe(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat without the cache and give up soon, because the server is still unknown.

        Args:
            messages: The chat.
            schema: The JSON Schema that the reply should follow.

        Returns:
            The reply.

        Raises:
            EndpointError: As in `complete`.
        """
        request = {**self.options.request(self.model, self.convention, schema), "messages": wire(messages)}
        return self._noted(self._send(request, probe=True))

    def server_version(self) -> str:
        """Return the version that the server reports at `/version`, as vLLM does, or ""."""
        import httpx2

        parts = urlsplit(self.base_url)
        timeout_s = min(self.options.timeout_s, _VERSION_TIMEOUT_S)
        try:
            response, data = self._connections.exchange(timeout_s, "GET", f"{parts.scheme}://{parts.netloc}/version")
            version = msgspec.json.decode(data, type=dict[str, Any]).get("version")
        except (httpx2.HTTPError, EndpointError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return ""
        return self._one_line(version)[:80] if response.status_code == 200 and isinstance(version, str) else ""

    def _noted(self, reply: Reply) -> Reply:
        # One step for the interpreter: no other thread sees it half done.
        self._served.setdefault(reply.model)
        return reply

    def _send(self, request: Mapping[str, Any], *, probe: bool = False) -> Reply:
        """Send a request, under the newer name of the token limit if the server refuses the older one."""
        while True:
            longer = self._longer_name
            try:
                # Encoded once, because a request may hold megabytes of pictures.
                return self._repeat(_encoded(request, longer), probe)
            except _TokenParameterError:
                if longer:
                    raise
                self._longer_name = True

    def _repeat(self, body: bytes, probe: bool) -> Reply:
        """Try a request until it gets a reply, is refused, or has failed too often."""
        from tenacity import Retrying, retry_if_exception_type

        options = self.options
        retries = _PROBE_RETRIES if probe else options.retries
        timeout_s = min(options.timeout_s, self._bounds.probe_s) if probe else options.timeout_s
        patience_s = _PATIENCE_S if retries and not probe else 0.0
        replies, faults = self._replies, 0

        def is_last(state: RetryCallState) -> bool:
            nonlocal faults, patience_s
            # While a passing fault is waited for, it uses up no retry.
            if _broken(state).passing and patience_s > 0:
                patience_s -= state.upcoming_sleep
            else:
                faults += 1
            return faults > retries

        retrying = Retrying(
            retry=retry_if_exception_type(_BrokenError),
            wait=_pause_s,
            stop=is_last,
            sleep=self._pause,
            reraise=True,
        )
        try:
            return retrying(self._try, body, timeout_s)
        except _BrokenError as broken:
            # If no other call got through meanwhile, the next question would fare no better.
            kind = RunStoppedError if broken.passing and self._replies == replies else EndpointError
            tries = retrying.statistics["attempt_number"]
            # A probe belongs to no run that could be resumed.
            resume = "" if probe else " (evaluate with --resume)"
            raise kind(
                f"{self.base_url}: {broken.reason} ({tries} {'try' if tries == 1 else 'tries'}): "
                f"{_NEXT[broken.fault]}{resume}"
            ) from None

    def _try(self, body: bytes, timeout_s: float) -> Reply:
        import httpx2

        check_cost(self._spent_before + self.spent, self.options.max_cost)
        sent = self._limit.admit()
        try:
            response, data = self._connections.exchange(
                timeout_s, "POST", address_of(self.base_url, "/chat/completions"), content=body, headers=self._headers
            )
        except httpx2.ConnectTimeout:
            raise _BrokenError("cannot reach the server (it accepts no connection)", "unreachable") from None
        except httpx2.TimeoutException:
            raise _BrokenError(f"no whole reply within {timeout_s:g} s", "timeout") from None
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
            # Some servers and proxies send an error with the status of a success.
            status = error.code if isinstance(error.code, int) and 400 <= error.code < 600 else 502
            raise self._refusal(response, status, str(error), error.code) from None
        except ValueError as error:
            kind = self._one_line(response.headers.get("content-type", "bytes").partition(";")[0])
            raise _BrokenError(f"the reply is no chat completion but {kind[:40]} ({self._one_line(error)})") from None
        self._replies += 1
        self._limit.count(sent, reply.prompt_tokens + reply.completion_tokens)
        if (price := self.options.price) is not None:
            with self._lock:
                self.spent += price.cost(reply.prompt_tokens, reply.completion_tokens)
        return reply

    def _refusal(self, response: httpx2.Response, status: int, message: str, code: object) -> Exception:
        """Return the error for the HTTP status, message and code of a reply."""
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
    """Raise RunStoppedError if a run's calls have cost their maximum.

    Args:
        spent: The cost so far in dollars.
        most: The maximum in dollars; None sets no maximum.

    Raises:
        RunStoppedError: The maximum is reached.
    """
    if most is not None and spent >= most:
        raise RunStoppedError(
            f"the calls have cost {spent:.4g} dollars, and --max-cost is {most:g}: "
            "give more, then run again with --resume"
        )


def _broken(state: RetryCallState) -> _BrokenError:
    assert state.outcome is not None, "a try has ended"
    broken = state.outcome.exception()
    assert isinstance(broken, _BrokenError), "only these are repeated"
    return broken


def _pause_s(state: RetryCallState) -> float:
    """Return the pause that the server asks for, or one that doubles with each try."""
    broken, (least, most) = _broken(state), _PAUSE_S
    wait = broken.pause
    if wait is None:
        wait = min(least * 2.0 ** min(state.attempt_number - 1, 10), _BUSY_PAUSE_S if broken.passing else most)
    # The random share spreads calls that were refused together.
    return min(max(wait, least), most) * random.uniform(1, 1.5)  # noqa: S311


def _encoded(request: Mapping[str, Any], longer: bool) -> bytes:
    """Return a request's body, with the older or the longer name of the token limit."""
    if longer:
        request = {_LONGER_NAME if name == "max_tokens" else name: value for name, value in request.items()}
    return msgspec.json.encode(request)
