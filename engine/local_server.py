"""A server for one person's browser: on the loopback address, for requests that carry its token.

    http://127.0.0.1:PORT/TOKEN/...

A page of another site could reach the port through the browser, under a name of its own or from an origin of its own:
such requests are refused, as are those of anybody who does not know the token.
"""

from __future__ import annotations

import contextlib
import hmac
import secrets
import socket
import urllib.parse
from collections.abc import Callable, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final, NamedTuple

from jrdb_avr.schema.errors import AvrError, InputError

HTML: Final = "text/html; charset=utf-8"
PLAIN: Final = "text/plain; charset=utf-8"

_LONGEST_BODY: Final = 1 << 16
_IDLE_S: Final = 60.0
"""Seconds after which a connection that sends nothing is closed."""


class Request(NamedTuple):
    """A request that was let in: `path` behind the token, the query's values by name, and a POST's body."""

    method: str
    path: str
    query: Mapping[str, Sequence[str]]
    body: bytes

    def value(self, name: str) -> str:
        """The value of a name of the query, "" without one."""
        return (self.query.get(name) or [""])[0]


class Response(NamedTuple):
    """An HTTP response. `lasting`: whether the browser may keep it."""

    body: bytes
    kind: str = HTML
    status: int = 200
    lasting: bool = False


def listen(port: int) -> socket.socket:
    """A socket that listens on 127.0.0.1; port 0 is a free one. Raises InputError where the port is taken."""
    listener = socket.socket()
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise InputError(f"port {port} cannot be used ({error.strerror}): give another", field="port") from None
    return listener


def hosts_of(listener: socket.socket) -> list[str]:
    """The values of the header `Host` under which a browser of this machine reaches a socket."""
    return [f"{name}:{listener.getsockname()[1]}" for name in ("127.0.0.1", "localhost")]


def new_token() -> str:
    """Make a random token that fits into an address."""
    return secrets.token_urlsafe(32)


def same_token(sent: bytes, token: bytes) -> bool:
    """Compare two tokens in a time that does not depend on them."""
    return hmac.compare_digest(sent, token)


class LocalServer(ThreadingHTTPServer):
    """Serves what `respond` returns, until `shutdown` or an interrupt; an AvrError becomes a response of one line.

    `url`: the address to open, with the token.
    """

    daemon_threads = True

    def __init__(self, respond: Callable[[Request], Response], port: int = 0) -> None:
        """Listen. Raises InputError where the port is taken."""
        listener = listen(port)
        super().__init__(listener.getsockname(), _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket = listener
        self.respond = respond
        self.hosts = hosts_of(listener)
        self._token = new_token()
        self.url = f"http://{self.hosts[0]}/{self._token}/"

    def answer(self, method: str, target: str, headers: Any, body: bytes) -> Response:
        """Check a request and have it answered."""
        host, origin = headers.get_all("Host", []), headers.get_all("Origin", [])
        if len(host) != 1 or host[0] not in self.hosts or any(own != f"http://{host[0]}" for own in origin):
            return _refused("this server takes requests of its own pages only")
        try:
            address = urllib.parse.urlsplit(target)
        except ValueError:
            return Response(b"no address\n", PLAIN, 400)
        sent, _, path = address.path.removeprefix("/").partition("/")
        if not same_token(sent.encode("utf-8", "replace"), self._token.encode()):
            return _refused("this address needs its token: open the one that the command printed")
        try:
            query = urllib.parse.parse_qs(address.query, errors="replace", max_num_fields=500)
        except ValueError:
            return Response(b"too many fields\n", PLAIN, 400)
        try:
            return self.respond(Request(method, urllib.parse.unquote(path), query, body))
        except AvrError as error:
            return Response(f"{' '.join(str(error).split())}\n".encode("utf-8", "replace"), PLAIN, 404)


def _refused(why: str) -> Response:
    return Response(f"{why}\n".encode(), PLAIN, 403)


class _Handler(BaseHTTPRequestHandler):
    server: LocalServer
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "jrdb-avr", ""
    timeout = _IDLE_S

    def do_GET(self) -> None:
        self._send(self.server.answer("GET", self.path, self.headers, b""))

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdecimal() and len(length) < 8 and int(length) <= _LONGEST_BODY):
            # What follows would be taken for the next request.
            self.close_connection = True
            self._send(Response(b"a body of a stated length of at most 64 KB is needed\n", PLAIN, 413))
            return
        self._send(self.server.answer("POST", self.path, self.headers, self.rfile.read(int(length))))

    def _send(self, response: Response) -> None:
        # A browser that has gone on does not wait for the rest.
        with contextlib.suppress(ConnectionError, TimeoutError):
            self.send_response(response.status)
            for name, value in {
                "Content-Type": response.kind,
                "Content-Length": str(len(response.body)),
                "Cache-Control": "private, max-age=3600" if response.lasting else "no-store",
                "Content-Security-Policy": "frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Referrer-Policy": "same-origin",
                "X-Content-Type-Options": "nosniff",
            }.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(response.body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is logged: addresses hold the token."""
