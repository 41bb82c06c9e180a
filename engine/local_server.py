"""HTTP server on the loopback address for the browser of one person.

    http://127.0.0.1:PORT/TOKEN/...

The server refuses requests without its token. A page of another site could make the browser send requests to the port.
The header `Host` or `Origin` of such a request names the other site, so the server refuses the request.
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
"""Maximum bytes of the body of a request."""

_IDLE_S: Final = 60.0
"""Maximum seconds without data on a connection. The server then closes it."""


class Request(NamedTuple):
    """An accepted request.

    Attributes:
        method: The HTTP method.
        path: The part of the path after the token.
        query: For each name in the query, a list of its values.
        body: The body. It is empty if the method is not POST.
    """

    method: str
    path: str
    query: Mapping[str, Sequence[str]]
    body: bytes

    def value(self, name: str) -> str:
        """Return the first value of a name in the query, or "" if the name is missing."""
        return (self.query.get(name) or [""])[0]


class Response(NamedTuple):
    """An HTTP response.

    Attributes:
        body: The content.
        kind: The content type.
        status: The HTTP status code.
        lasting: Whether the browser may cache the response.
    """

    body: bytes
    kind: str = HTML
    status: int = 200
    lasting: bool = False


def listen(port: int) -> socket.socket:
    """Return a socket that listens on 127.0.0.1.

    Args:
        port: The port. 0 chooses a free port.

    Returns:
        The socket.

    Raises:
        InputError: If the port cannot be used.
    """
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
    """Return the allowed values of the header `Host` of requests to a listening socket. They are local addresses."""
    return [f"{name}:{listener.getsockname()[1]}" for name in ("127.0.0.1", "localhost")]


def new_token() -> str:
    """Return a random token of characters that are valid in an address."""
    return secrets.token_urlsafe(32)


def same_token(sent: bytes, token: bytes) -> bool:
    """Return whether two tokens are equal. The duration of the comparison does not depend on the tokens' characters."""
    return hmac.compare_digest(sent, token)


class LocalServer(ThreadingHTTPServer):
    """A server that answers requests with the responses of one function.

    If the function raises an AvrError, the response is the message of the error in one line, with status 404.

    Attributes:
        url: The address to open, with the token.
    """

    daemon_threads = True

    def __init__(self, respond: Callable[[Request], Response], port: int = 0) -> None:
        """Listen on a port. Port 0 chooses a free port. Raise InputError if the port cannot be used."""
        listener = listen(port)
        super().__init__(listener.getsockname(), _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket = listener
        self.respond = respond
        self.hosts = hosts_of(listener)
        self._token = new_token()
        self.url = f"http://{self.hosts[0]}/{self._token}/"

    def answer(self, method: str, target: str, headers: Any, body: bytes) -> Response:
        """Return the response to a request. Return a refusal if the request is not allowed."""
        host, origin = headers.get_all("Host", []), headers.get_all("Origin", [])
        if len(host) != 1 or host[0] not in self.hosts or any(page != f"http://{host[0]}" for page in origin):
            return _refused("this server accepts only requests from its own pages")
        try:
            address = urllib.parse.urlsplit(target)
        except ValueError:
            return Response(b"not an address\n", PLAIN, 400)
        sent, _, path = address.path.removeprefix("/").partition("/")
        if not same_token(sent.encode("utf-8", "replace"), self._token.encode()):
            return _refused("the token is missing: open the address that the command printed")
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
            # Close the connection, because the unread body would be taken for the next request.
            self.close_connection = True
            self._send(Response(b"the request needs a Content-Length of at most 64 KB\n", PLAIN, 413))
            return
        self._send(self.server.answer("POST", self.path, self.headers, self.rfile.read(int(length))))

    def _send(self, response: Response) -> None:
        # Sending fails if the user has left the page, because the browser then closes the connection.
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
        """Log nothing, because the addresses of requests contain the token."""
