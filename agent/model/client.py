"""Client of OpenAI-compatible chat servers.

A call that finishes cleanly is stored under the sha256 of the whole request, so that it is never paid for twice. The
client repeats a call for about two minutes if the server is busy (429, 498, 503, 529) or cannot be reached. The client
repeats a call a few times if the call breaks (timeout, unreadable reply, 408, 409, 424, any other 5xx). Any other
refusal raises an exception immediately. API keys come from the environment. They are sent only in request headers.
"""

from __future__ import annotations

import random
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol
from urllib.parse import urljoin

import msgspec

from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.limits import RateLimit
from jrdb_avr.agent.model.messages import Message, fingerprint, wire
from jrdb_avr.agent.model.options import AUTO, DEFAULTS, EndpointOptions
from jrdb_avr.agent.model.prices import with_tokens
from jrdb_avr.agent.model.reply import ErrorReply, Reply, answer_text, read_completion
from jrdb_avr.agent.model.transport import BOUNDS, Bounds, Connections, Credentials, address_of, checked_url
from jrdb_avr.schema.errors import EndpointError, FilteredError, RunStoppedError

if TYPE_CHECKING:
    from tenacity import RetryCallState

_PAUSE_S: Final = (0.5, 60.0)
"""Minimum and maximum pause before a call is repeated."""
_BUSY_PAUSE_S: Final = 4.0
"""Maximum pause before a call to a busy server is repeated, if the server names no pause."""
_PATIENCE_S: Final = 120.0
"""Maximum sum of a call's pauses if the server is busy or cannot be reached, because the server may be restarting."""
_SECONDS: Final = re.compile(r"[0-9]{1,9}(\.[0-9]+)?")
"""Form of a Retry-After header that names a pause in seconds."""
_PROBE_RETRIES: Final = 1
_VERSION_TIMEOUT_S: Final = 5.0
_BUSY: Final = (429, 498, 503, 529)
"""Statuses of a server that will take the request later: too many requests, a model that loads, an overload."""
_NO_CREDIT: Final = re.compile(r"(?i)current_quota|insufficient.(quota|balance|credit|fund)|credit balance|arrear|余额")
"""Codes and reasons of a refusal if the account has no credit left, so that waiting does not help."""
_FILTERED: Final = re.compile(
    r"(?is)(?!.*\b(account|suspended)\b).*(content[ _-]?(filter|management|policy|exists risk)|data_?inspection_?failed"
    r"|sensitive_?content|moderation|responsible_?ai|(input|prompt|request) (was |is )?(flagged|blocked)|敏感)"
)
"""Codes and reasons of a refusal by a content filter."""
_REMEDIES: Final = {
    401: "; put the server's key into ${key}",
    403: "; put a key that may use the model into ${key}",
    404: "; check --base-url (most end in /v1) and --model",
}
_STREAMS: Final = "; replies are only read whole: set the server, or a gateway before it, to reply without a stream"
_HINTS: Final = {
    "temperature": "; if the model takes none, give --temperature none",
    "chat_template_kwargs|enable_thinking": "; give --thinking template: requests then hold no chat_template_kwargs",
    r"\bstream": _STREAMS,
}
"""Remedies by a regular expression for the reason of a refusal."""

_LONGER_NAME: Final = "max_completion_tokens"
"""The newer name of `max_tokens`. A server that requires the newer name says so in its refusal."""


_UNREACHABLE: Final = "start the server or correct --base-url, then run again"
_CROWDED: Final = "run again when it is less busy, or with a smaller --concurrency"
_LATE: Final = "run again with a smaller --concurrency or a larger --timeout"


class Chat(Protocol):
    """A model that completes a chat."""

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Return the reply to a chat. The reply should follow `schema`, a JSON Schema."""
        ...


@dataclass
class _BrokenError(Exception):
    """A failed attempt at a call. The call may be repeated.

    pause: the server's Retry-After in seconds, None if the server sends none.
    """

    reason: str
    remedy: str = "look into the server's log, then run again"
    pause: float | None = None


class _PassingError(_BrokenError):
    """A failure of a server that may recover soon. The client waits, and then repeats the call."""


class Client:
    """Client that completes chats at `base_url` with `model`. Many threads may share a client."""

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
        """Prepare a client. No request is sent yet.

        Args:
            base_url: The server's address.
            model: The model id that requests name.
            options: The request settings.
            convention: How thinking is turned on and off, and which part of a reply is the answer.
            cache: The file of finished calls. If it is None, no calls are stored.
            bounds: Maximum durations of an exchange with the server, and the maximum size of a reply.
            pause: Called with a number of seconds in order to wait that long.
            clock: Called in order to get the time in seconds.

        Raises:
            EndpointError: If the address, the environment's proxy, or the value of a key or header cannot be used.
        """
        self.base_url = checked_url(base_url)
        self.model = model
        self.options = options
        self.convention = options.delimited(convention)
        self._calls = None if cache is None else Calls(cache)
        self._credentials = Credentials(options.api_key_env, options.headers)
        self._limit = RateLimit(options.rpm, options.tpm, clock, pause)
        self._spent = 0.0
        """Cost in dollars of the calls of this client and of the stored calls of earlier clients."""
        if options.price is not None and self._calls is not None:
            self._spent = options.price.cost(*self._calls.tokens())
        self.estimates = 0
        """Number of replies with estimated tokens."""
        self._longer_name = False
        self._pause = pause
        self._served: dict[str, None] = {}
        self._lock = threading.Lock()
        self._replies = 0
        self.retries = 0
        """Number of requests that were repeated."""
        self._bounds = bounds
        self._connections = Connections(self.base_url, bounds)

    def settings(self) -> dict[str, Any]:
        """Return the settings of the server and of sampling for a run's manifest. They contain no secret."""
        return {"base_url": self.base_url, **self.options.settings(self.convention)}

    @property
    def served(self) -> tuple[str, ...]:
        """The model ids in all replies so far, including cached replies, in the order of their first occurrence."""
        return tuple(self._served)

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat, from the cache if the same request has finished cleanly before.

        Args:
            messages: The chat.
            schema: The JSON Schema that the reply should follow.

        Returns:
            The reply.

        Raises:
            EndpointError: If the server refuses the request, or if all retries fail.
            FilteredError: If a content filter of the server refuses the request.
            RunStoppedError: If the server was busy or could not be reached for two minutes, and no other call succeeded
                in this time. Also if the server refuses the key, if no credit is left, or if `max_cost` is spent.
        """
        request = self.options.request(self.model, self.convention, schema)
        if self._calls is None:
            return self._send(request, messages)
        digest = self._calls.digest({**request, "messages": fingerprint(messages, self.options.simulated)})
        reply = self._calls.read(digest)
        if reply is None or not self._cacheable(reply):
            reply = self._send(request, messages)
            if self._cacheable(reply):
                self._calls.append(digest, reply)
        self._served.setdefault(reply.model)
        return reply

    def _cacheable(self, reply: Reply) -> bool:
        """Return whether a reply finished cleanly, has an answer, and names the model of the client's first reply."""
        of_model = reply.model == next(iter(self.served), reply.model)
        return of_model and reply.finished and bool(answer_text(reply, self.convention))

    def probe(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat without the cache. Give up sooner than `complete`, because the server may be unusable.

        Args:
            messages: The chat.
            schema: The JSON Schema that the reply should follow.

        Returns:
            The reply.

        Raises:
            EndpointError: If the server refuses the request, or if all retries fail.
        """
        return self._send(self.options.request(self.model, self.convention, schema), messages, probe=True)

    def server_version(self) -> str:
        """Return the version that the server reports at `/version`, or "" if the server reports none."""
        import httpx2

        timeout_s = min(self.options.timeout_s, _VERSION_TIMEOUT_S)
        try:
            response, data = self._connections.exchange(timeout_s, "GET", urljoin(self.base_url, "/version"))
            version = msgspec.json.decode(data, type=dict[str, Any]).get("version")
        except (httpx2.HTTPError, EndpointError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return ""
        return self._one_line(version)[:80] if response.status_code == 200 and isinstance(version, str) else ""

    def _send(self, request: Mapping[str, Any], messages: Sequence[Message], *, probe: bool = False) -> Reply:
        """Send a request with messages and return the reply.

        If the server refuses the older name of the token limit, the request is sent again with the newer name.
        """
        longer = self._longer_name
        if longer:
            request = {_LONGER_NAME if name == "max_tokens" else name: value for name, value in request.items()}
        try:
            # The request is encoded only once, because it may hold megabytes of pictures.
            body = msgspec.json.encode({**request, "messages": wire(messages, self.options.simulated)})
            return self._repeat(body, messages, probe)
        except EndpointError as error:
            if longer or self.options.token_parameter != AUTO or _LONGER_NAME not in str(error):
                raise
        self._longer_name = True
        return self._send(request, messages, probe=probe)

    def _repeat(self, body: bytes, messages: Sequence[Message], probe: bool) -> Reply:
        """Send a request until it gets a reply, is refused, or has failed too often. Return the reply."""
        from tenacity import Retrying, retry_if_exception, retry_if_exception_type, stop_after_attempt

        retries = _PROBE_RETRIES if probe else self.options.retries
        timeout_s = min(self.options.timeout_s, self._bounds.probe_s) if probe else self.options.timeout_s
        # A probe is repeated after at most one pause.
        patience_s = 0.0 if not retries else _PAUSE_S[0] if probe else _PATIENCE_S
        replies = self._replies
        waiting = Retrying(
            retry=retry_if_exception_type(_PassingError),
            stop=lambda state: state.idle_for >= patience_s,
            wait=_pause_s,
            sleep=self._pause,
            before_sleep=self._count_retry,
            reraise=True,
        )
        repeating = waiting.copy(
            retry=retry_if_exception(lambda error: type(error) is _BrokenError),
            stop=stop_after_attempt(retries + 1),
        )
        try:
            return repeating(lambda: waiting(self._try, body, messages, timeout_s))
        except _BrokenError as broken:
            passing = isinstance(broken, _PassingError)
            # If no other call succeeded in this time, the calls of the next question would fail too.
            kind = RunStoppedError if passing and not probe and self._replies == replies else EndpointError
            tries = (waiting if passing else repeating).statistics["attempt_number"]
            # A probe belongs to no run that could be resumed.
            resume = "" if probe else " (evaluate with --resume)"
            raise kind(f"{self.base_url}: {broken.reason} (tries: {tries}): {broken.remedy}{resume}") from None

    def _count_retry(self, state: RetryCallState) -> None:
        with self._lock:
            self.retries += 1

    def _try(self, body: bytes, messages: Sequence[Message], timeout_s: float) -> Reply:
        import httpx2

        if self.options.max_cost is not None and self._spent >= self.options.max_cost:
            spent = f"{self._spent:.4g} dollars" + " by estimated tokens (no usage is sent)" * bool(self.estimates)
            raise RunStoppedError(
                f"the calls have cost {spent}, and --max-cost is {self.options.max_cost:g}: "
                "give more, then run again with --resume"
            )
        sent, url = self._limit.admit(), address_of(self.base_url, "/chat/completions")
        try:
            response, data = self._connections.exchange(
                timeout_s, "POST", url, content=body, headers=self._credentials.headers
            )
        except (httpx2.ConnectTimeout, httpx2.ConnectError, httpx2.ProxyError) as error:
            raise _PassingError(f"cannot reach the server ({self._one_line(error)})", _UNREACHABLE) from None
        except httpx2.TimeoutException:
            raise _BrokenError(f"no whole reply within {timeout_s:g} s", _LATE) from None
        except httpx2.HTTPError as error:
            raise _BrokenError(f"the reply broke off ({self._one_line(error)})") from None
        try:
            # Keys are hidden, because a server may quote the request in its reply, and replies are stored.
            reply = read_completion(self._credentials.hide_in_json(data), response.status_code)
        except ErrorReply as error:
            raise self._refusal(error, response.headers.get("retry-after", "")) from None
        except ValueError as error:
            kind = self._one_line(response.headers.get("content-type", "bytes").partition(";")[0])
            if kind == "text/event-stream":
                raise EndpointError(f"{self.base_url}: the server streams its reply{_STREAMS}") from None
            raise _BrokenError(f"the reply is no chat completion but {kind[:40]} ({self._one_line(error)})") from None
        self._served.setdefault(reply.model)
        reply = with_tokens(reply, messages, self.convention)
        self._limit.count(sent, reply.prompt_tokens + reply.completion_tokens)
        with self._lock:
            self._replies += 1
            self.estimates += reply.estimated
            if self.options.price is not None:
                self._spent += self.options.price.cost(reply.prompt_tokens, reply.completion_tokens)
        return reply

    def _refusal(self, error: ErrorReply, retry_after: str) -> Exception:
        """Return the exception to raise for a reply that reports an error."""
        reason = f"HTTP {error.status}: {self._one_line(error.reason.strip() or 'the server gives no reason')}"
        stated = f"{error.code} {error.reason}"
        # After a refusal for want of credit or of a valid key, the next question would be refused for the same reason.
        if error.status == 402 or _NO_CREDIT.search(stated):
            return RunStoppedError(f"{self.base_url}: {reason}; no credit is left: pay, then run again with --resume")
        busy = error.status in _BUSY
        # Time-outs, conflicts and failed dependencies may be gone at the next attempt, as errors of the server may.
        if busy or error.status >= 500 or error.status in (408, 409, 424, 425, 499):
            pause = float(retry_after) if _SECONDS.fullmatch(retry_after) else None
            return _PassingError(reason, _CROWDED, pause) if busy else _BrokenError(reason, pause=pause)
        if _FILTERED.match(stated):
            return FilteredError("refused: content filter")
        hints = [hint for pattern, hint in _HINTS.items() if re.search(pattern, error.reason)]
        remedy = [*hints, _REMEDIES.get(error.status, "").format(key=self.options.api_key_env)][0]
        return (RunStoppedError if error.status == 401 else EndpointError)(f"{self.base_url}: {reason}{remedy}")

    def _one_line(self, error: object) -> str:
        # The key is hidden before the text is cut. Otherwise the beginning of a key could stay visible.
        return " ".join(self._credentials.hide(str(error)).split())[:300] or type(error).__name__


def _pause_s(state: RetryCallState) -> float:
    """Return the pause in seconds: the server's Retry-After, or a pause that doubles with each attempt."""
    broken = state.outcome and state.outcome.exception()
    assert isinstance(broken, _BrokenError), "only these are repeated"
    least, most = _PAUSE_S
    longest = _BUSY_PAUSE_S if isinstance(broken, _PassingError) else most
    wait = min(least * 2.0 ** (state.attempt_number - 1), longest) if broken.pause is None else broken.pause
    # The random part spreads calls that were refused at the same time.
    return min(max(wait, least), most) * random.uniform(1, 1.5)  # noqa: S311
