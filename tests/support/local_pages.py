"""A local server in the tests' own process, and requests to it as a browser or somebody else would send them."""

import contextlib
import http.client
import threading
from urllib.parse import urlsplit

from jrdb_avr.engine.local_server import LocalServer


@contextlib.contextmanager
def serving(respond):
    with LocalServer(respond) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def fetch(server, path="", *, method="GET", body=None, target=None, headers=()):
    """(status, text) of a request for a path behind the token, or for a whole target; headers replace the usual."""
    url = urlsplit(server.url)
    connection = http.client.HTTPConnection(url.hostname, url.port, timeout=30)
    try:
        connection.putrequest(method, target or url.path + path, skip_host=True)
        named = dict(headers)
        for name, value in ({"Host": url.netloc} | named).items():
            for own in value if isinstance(value, list) else [value]:
                connection.putheader(name, own)
        if body is not None and "Content-Length" not in named:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        response = connection.getresponse()
        return response.status, response.read().decode("utf-8", "replace")
    finally:
        connection.close()
