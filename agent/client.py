"""Client of OpenAI-compatible servers.

A call is a pure function of its request (temperature 0), so a call that finished cleanly is kept on disk under the
sha256 of the whole request and never paid for twice. Retried: what the transport or the server broke (no connection,
timeout, cut-off reply, 429, 5xx). Anything else the server refuses is an EndpointError at once. The key is read from
the environment and goes nowhere but into the request's header.
"""

from __future__ import annotations

import hashlib
import ipaddress
import math
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol
from urllib.parse import urlsplit

import msgspec

from jrdb_avr.schema.errors import EndpointError

from .messages import Message, fingerprint, wire

if TYPE_CHECKING:
    import httpx2
    import openai

KEY_VARIABLE: Final = "OPENAI_API_KEY"
_LONGEST_PAUSE_S: Final = 60.0
_PROBE_TIMEOUT_S: Final = 60.0
_MOST_TOKENS: Final = 1 << 40
_REMEDIES: Final = {
    401: f"; put the server's key into ${KEY_VARIABLE}",
    403: f"; put a key that may use the model into ${KEY_VARIABLE}",
    404: "; check --base-url (most end in /v1) and --model",
}


class Reply(msgspec.Struct, frozen=True, omit_defaults=True):
    """What the server said: text fields as sent, why it stopped, tokens, and the model id that it names."""

    content: str = ""
    reasoning: str = ""
    finish_reason: str = ""
    model: str = ""
    prompt_tokens: int = 0
    completion_tokens: int = 0


class Chat(Protocol):
    """Anything that completes a chat. `schema` is the JSON Schema the reply should keep to."""

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply: ...


class _Text(msgspec.Struct):
    content: str | None = None
    reasoning: str | None = None
    reasoning_content: str | None = None


class _Choice(msgspec.Struct):
    message: _Text
    finish_reason: str | None = None


class _Completion(msgspec.Struct):
    choices: list[_Choice]
    model: str | None = None
    usage: Any = None


class _BrokenError(Exception):
    """A try that may be repeated, with the pause that the server asks for (seconds)."""

    def __init__(self, reason: str, pause: float | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.pause = pause


class Client:
    """Completes chats at `base_url` with `model`; used by many threads at once.

    `structured` says whether requests carry a JSON-schema response format. `cache` is a folder for finished calls.
    """

    def __init__(
        self,
        base_url: str,
        model: str,
        *,
        cache: Path | None = None,
        structured: bool = True,
        key_variable: str = KEY_VARIABLE,
        max_tokens: int = 2048,
        timeout_s: float = 300.0,
        retries: int = 4,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self.base_url = _checked_url(base_url)
        self.model = model
        self.structured = structured
        self._cache = cache
        self._key = _checked_key(key_variable)
        self._max_tokens = max_tokens
        self._timeout_s = timeout_s
        self._retries = retries
        self._pause = pause
        self._openai = self._connect()

    def _connect(self) -> openai.OpenAI:
        import openai

        # A proxy of the environment cannot reach this machine's own loopback address.
        http_client = openai.DefaultHttpxClient(trust_env=not _is_loopback(self.base_url))
        return openai.OpenAI(
            base_url=self.base_url,
            api_key=self._key or "none",
            max_retries=0,
            timeout=self._timeout_s,
            http_client=http_client,
        )

    def settings(self) -> dict[str, Any]:
        """What the manifest of a run says of the sampling; no secret is in it."""
        return {
            "base_url": self.base_url,
            "temperature": 0,
            "max_tokens": self._max_tokens,
            "timeout_s": self._timeout_s,
            "retries": self._retries,
            "json_schema": self.structured,
        }

    def complete(self, messages: Sequence[Message], schema: Mapping[str, Any] | None = None) -> Reply:
        """Complete a chat, from the cache where the same request finished cleanly before.

        Raises EndpointError when the server cannot be reached after all retries or refuses the request.
        """
        request = self._request(schema)
        place = self._place({**request, "messages": fingerprint(messages)})
        if place is not None and (kept := _read(place)) is not None:
            return kept
        reply = self._send({**request, "messages": wire(messages)}, self._retries)
        if place is not None and reply.finish_reason == "stop" and (reply.content or reply.reasoning):
            _write(place, reply)
        return reply

    def probe(self) -> str:
        """Ask for a word once: is the server there, and does it take a JSON schema? Returns the model id it names.

        A server that refuses the response format is asked without one from then on. Raises EndpointError in one line,
        soon: nothing has been asked yet that would be worth a long wait.
        """
        ask = [Message("user", ('Reply with the JSON object {"ok": true} and nothing else.',))]
        schema = {
            "type": "object",
            "properties": {"ok": {"type": "boolean"}},
            "required": ["ok"],
            "additionalProperties": False,
        }
        try:
            return self._send({**self._request(schema), "messages": wire(ask)}, 1, _PROBE_TIMEOUT_S).model
        except EndpointError as error:
            if not (self.structured and any(word in str(error) for word in ("response_format", "json_schema"))):
                raise
        self.structured = False
        return self._send({**self._request(None), "messages": wire(ask)}, 1, _PROBE_TIMEOUT_S).model

    def _request(self, schema: Mapping[str, Any] | None) -> dict[str, Any]:
        request: dict[str, Any] = {"model": self.model, "temperature": 0, "max_tokens": self._max_tokens}
        if schema is not None and self.structured:
            request["response_format"] = {
                "type": "json_schema",
                "json_schema": {"name": "reply", "schema": dict(schema), "strict": True},
            }
        return request

    def _place(self, request: Mapping[str, Any]) -> Path | None:
        if self._cache is None:
            return None
        key = hashlib.sha256(msgspec.json.encode(request, order="sorted")).hexdigest()
        return self._cache / key[:2] / f"{key}.json"

    def _send(self, request: Mapping[str, Any], retries: int, most_s: float = math.inf) -> Reply:
        # Encoded once and sent as bytes: a request may hold megabytes of pictures.
        body = msgspec.json.encode(request)
        timeout_s = min(self._timeout_s, most_s)
        for attempt in range(retries + 1):
            try:
                return self._try(body, timeout_s)
            except _BrokenError as broken:
                if attempt == retries:
                    raise EndpointError(
                        f"{self.base_url}: {broken.reason} ({attempt + 1} tries): "
                        "start the server or correct --base-url, then run again with --resume"
                    ) from None
                wait = broken.pause if broken.pause is not None else 0.5 * 2**attempt
                self._pause(min(max(wait, 0.0), _LONGEST_PAUSE_S))
        raise AssertionError("unreachable")

    def _try(self, body: bytes, timeout_s: float) -> Reply:
        import httpx2
        import openai

        try:
            response: httpx2.Response = self._openai.post(
                "/chat/completions",
                content=body,
                cast_to=httpx2.Response,
                options={"headers": {"Content-Type": "application/json"}, "timeout": timeout_s},
            )
            data = response.content
        except openai.APITimeoutError:
            raise _BrokenError(f"no reply within {timeout_s:g} s") from None
        except openai.APIConnectionError as error:
            raise _BrokenError(f"cannot reach the server ({self._one_line(error.__cause__ or error)})") from None
        except openai.APIStatusError as error:
            reason = f"HTTP {error.status_code}: {self._one_line(error.message)}"
            if error.status_code == 429 or error.status_code >= 500:
                raise _BrokenError(reason, _retry_after(error.response.headers.get("retry-after"))) from None
            raise EndpointError(f"{self.base_url}: {reason}{_REMEDIES.get(error.status_code, '')}") from None
        except httpx2.HTTPError as error:
            raise _BrokenError(f"the reply broke off ({self._one_line(error)})") from None
        return _parse(data)

    def _one_line(self, error: object) -> str:
        # The key goes before the text is cut, or its beginning could stay.
        text = str(error)
        return _one_line(text.replace(self._key, "[key]") if self._key else text) or type(error).__name__


def _parse(data: bytes) -> Reply:
    try:
        completion = msgspec.json.decode(data, type=_Completion)
        choice = completion.choices[0]
    except (msgspec.DecodeError, UnicodeDecodeError, IndexError, RecursionError) as error:
        raise _BrokenError(f"the reply is no chat completion ({_one_line(error)})") from None
    return Reply(
        content=choice.message.content or "",
        reasoning=choice.message.reasoning_content or choice.message.reasoning or "",
        finish_reason=choice.finish_reason or "",
        model=completion.model or "",
        prompt_tokens=_tokens(completion.usage, "prompt_tokens"),
        completion_tokens=_tokens(completion.usage, "completion_tokens"),
    )


def _tokens(usage: object, name: str) -> int:
    """A count of tokens; 0 where the server gives none, or nonsense: a good reply is not refused for it."""
    count = usage.get(name) if isinstance(usage, dict) else None
    return count if type(count) is int and 0 <= count <= _MOST_TOKENS else 0


def _checked_url(base_url: str) -> str:
    try:
        parts = urlsplit(base_url)
        sound = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        sound = False
    if not sound:
        raise EndpointError(f"{base_url!r} is no server address: give one like http://localhost:8000/v1")
    if parts.username or parts.password or parts.query:
        # The address is printed and stored with the run.
        raise EndpointError(f"--base-url must hold no password or query: put the key into ${KEY_VARIABLE}")
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


def _read(place: Path) -> Reply | None:
    try:
        return msgspec.json.decode(place.read_bytes(), type=Reply)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        # Absent, or broken by a crash of the machine: the call is made again.
        return None


def _write(place: Path, reply: Reply) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(prefix=".", suffix=".tmp", dir=place.parent, delete=False) as file:
        file.write(msgspec.json.encode(reply))
    Path(file.name).replace(place)
