"""HTTP exchanges with a model's server: connections, deadlines, addresses, and secrets, which are kept out of messages.

Servers are untrusted. No redirect is followed, and no compressed reply is unpacked. Replies have a maximum size, and
each exchange has a deadline.
"""

from __future__ import annotations

import functools
import os
import re
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from jrdb_avr.schema.errors import EndpointError

if TYPE_CHECKING:
    import ssl

    import httpx2

_SECRET: Final = 16
"""Minimum length of a key that is hidden in replies. Shorter keys, such as "EMPTY", may be words of a reply."""


@dataclass(frozen=True)
class Bounds:
    """Limits of one exchange.

    connect_s: the seconds to connect. probe_s: the seconds of a whole probe. reply_bytes: the bytes of a reply.
    For comparison, a reply of a few thousand tokens has some kilobytes.
    """

    connect_s: float = 20.0
    probe_s: float = 180.0
    reply_bytes: int = 1 << 20


BOUNDS: Final = Bounds()


class Connections:
    """HTTP connections of a client to one server. Many threads may share them."""

    def __init__(self, base_url: str, bounds: Bounds) -> None:
        """Prepare connections that follow no redirect.

        Args:
            base_url: The server's address. If the server is this machine, the proxies of the environment are not used.
            bounds: The maxima of each exchange.

        Raises:
            EndpointError: If the environment names a proxy that cannot be used.
        """
        import httpx2

        self._bounds = bounds
        self._exchanges = threading.local()
        """The deadline of the exchange of the calling thread, in seconds of `time.monotonic`."""
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
            raise EndpointError("no usable proxy: correct HTTP_PROXY, HTTPS_PROXY or ALL_PROXY") from None

    def exchange(self, timeout_s: float, method: str, url: str, **request: Any) -> tuple[httpx2.Response, bytes]:
        """Send a request and read the whole reply.

        Args:
            timeout_s: Maximum seconds for the whole exchange.
            method: The HTTP method.
            url: The full address.
            request: Further arguments of `httpx2.Client.stream`.

        Returns:
            The response and the bytes of its body.

        Raises:
            EndpointError: If the server redirects, or if the reply is too long or compressed. A redirect is not
                followed, so that the key is not sent elsewhere. A compressed reply could unpack to a huge size.
            httpx2.HTTPError: If the server cannot be reached, or if the reply breaks off or does not end in time.
        """
        import httpx2

        self._exchanges.end = time.monotonic() + timeout_s
        timeout = httpx2.Timeout(timeout_s, connect=min(timeout_s, self._bounds.connect_s))
        hooks = {"trace": self._bound_reads}
        with self._http.stream(method, url, timeout=timeout, extensions=hooks, **request) as response:
            if response.has_redirect_location:
                raise EndpointError(f"the server redirects (HTTP {response.status_code}): give the new --base-url")
            if response.headers.get("content-encoding", "").strip().lower() not in ("", "identity"):
                raise EndpointError("the reply is compressed against the request: switch this off at the server")
            data = bytearray()
            for chunk in response.iter_raw():
                data += chunk
                if len(data) > self._bounds.reply_bytes:
                    size = self._bounds.reply_bytes / (1 << 20)
                    raise EndpointError(f"the reply is longer than {size:.3g} MB: is this a chat server?")
            return response, bytes(data)

    def _bound_reads(self, event: str, details: Mapping[str, Any]) -> None:
        """Make each read of a new connection fail after the deadline of the exchange.

        httpx2 limits only each single wait for bytes. Without this function, a server could hold a call for ever by
        sending one byte at a time, or endless interim responses (102 Processing).
        """
        if event.endswith(("connect_tcp.complete", "start_tls.complete")):
            stream = details["return_value"]
            stream.read = functools.partial(self._read, stream.read)

    def _read(self, read: Callable[[int, float], bytes], most_bytes: int, timeout: float | None = None) -> bytes:
        import httpx2

        left = self._exchanges.end - time.monotonic()
        if left <= 0:
            raise httpx2.ReadTimeout("the exchange did not end in time")
        return read(most_bytes, left)


@functools.cache
def _certificates(environment: bool) -> ssl.SSLContext:
    """Return the trusted certificates. They are cached, because loading them takes as long as many calls."""
    import httpx2

    return httpx2.create_ssl_context(trust_env=environment)


class Credentials:
    """Headers of requests, with secrets from the environment. `hide` and `hide_in_json` remove these secrets."""

    def __init__(self, key_variable: str, header_variables: Mapping[str, str]) -> None:
        """Read the key and the headers from the environment.

        Args:
            key_variable: The environment variable that holds the server's key. It may be unset.
            header_variables: For each further header, the environment variable that holds the header's value.

        Raises:
            EndpointError: If a header variable is unset, or if a value has characters that a header cannot hold. The
                message does not contain the value.
        """
        key = _read_variable(key_variable, "[!-~]*")
        values = {name: _read_variable(variable, "[ -~]+") for name, variable in header_variables.items()}
        self.headers = {"Content-Type": "application/json"}
        if key and "authorization" not in map(str.lower, values):
            self.headers["Authorization"] = f"Bearer {key}"
        self.headers |= values
        parts = [word for value in values.values() for word in (value, *value.split()) if len(word) >= _SECRET // 2]
        # The longest secret is replaced first. If a word of a header's value were replaced first, the whole value would
        # not be found any more.
        self._secrets = sorted(filter(None, [key, *parts]), key=len, reverse=True)
        long = ["".join(map(_forms, secret)) for secret in self._secrets if len(secret) >= _SECRET]
        # The last pattern matches an escaped backslash, so that the second of its two characters is not taken for the
        # start of an escaped secret.
        self._in_json = re.compile("|".join([*long, r"(\\\\)"]).encode())

    def hide(self, text: str) -> str:
        """Return a text with "[key]" in place of each secret."""
        for secret in self._secrets:
            text = text.replace(secret, "[key]")
        return text

    def hide_in_json(self, data: bytes) -> bytes:
        """Return JSON with "[key]" in place of each long secret, even if the secret is written with JSON escapes."""
        return self._in_json.sub(lambda match: match[1] or b"[key]", data)


def _read_variable(variable: str, form: str) -> str:
    value = os.environ.get(variable, "").strip()
    if not re.fullmatch(form, value):
        raise EndpointError(f"${variable} holds no value of printable ASCII characters (a key: without spaces)")
    return value


def _forms(character: str) -> str:
    """Return a regular expression for a given character: the character itself, or its JSON escape."""
    return rf"(?:\\?{re.escape(character)}|\\u00(?i:{ord(character):02x}))"


# -- addresses --------------------------------------------------------------------------------------------------------

_SECRETIVE: Final = re.compile(
    r"(?i)#|^([^/]*//)?[^/?]*@|[?&;][^=&;]*(key|token|secret|pass|pw|sig|auth|cred|code)|[?&;][^=&;]*=[^&;]{41}"
)
"""Parts of an address that may hold a secret: the fragment, the user info, and names or long values of the query."""


def checked_url(base_url: str) -> str:
    """Check a server's address.

    Args:
        base_url: The address.

    Returns:
        The address without a slash at its end.

    Raises:
        EndpointError: If the address cannot be used, or if it may hold a secret.
    """
    import httpx2

    if _SECRETIVE.search(base_url):
        # The address must hold no secret, because it is printed and stored with the run.
        raise EndpointError(
            "--base-url must hold no password, key or fragment: name a key's variable by --api-key-env or --header"
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
        base_url: The base address. If it has a query, the query stays at the end.
        path: The path to append. It begins with a slash.

    Returns:
        The full address.
    """
    parts = urlsplit(base_url)
    return parts._replace(path=parts.path + path).geturl()


def _is_loopback(base_url: str) -> bool:
    return re.fullmatch(r"localhost|127\.[0-9.]+|::1", urlsplit(base_url).hostname or "") is not None
