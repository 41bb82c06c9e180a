"""The local server: who is let in, and that nothing else of this machine can be reached through it."""

from urllib.parse import urlsplit

import pytest
from browser import fetch, serving

from jrdb_avr.engine.local_server import PLAIN, LocalServer, Response
from jrdb_avr.schema.errors import InputError


@pytest.fixture(scope="module")
def server():
    def respond(request):
        if request.path == "bad":
            raise InputError("two\nlines \x1b[31m", field="x")
        return Response(repr((request.method, request.path, dict(request.query), request.body)).encode(), PLAIN)

    with serving(respond) as own:
        yield own


def test_a_page_of_its_own_is_served(server):
    port = urlsplit(server.url).port
    for host in (f"127.0.0.1:{port}", f"localhost:{port}"):
        for more in ({}, {"Origin": f"http://{host}"}):
            assert fetch(server, "a?b=1&b=2", headers={"Host": host, **more}) == (
                200,
                "('GET', 'a', {'b': ['1', '2']}, b'')",
            )
    assert fetch(server, "move", method="POST", body=b"{}") == (200, "('POST', 'move', {}, b'{}')")
    assert server.server_address[0] == "127.0.0.1", "nobody else in the network reaches it"


def test_others_are_refused(server):
    url = urlsplit(server.url)
    for method in ("GET", "POST"):

        def status(method=method, **named):
            return fetch(server, "a", method=method, body=b"" if method == "POST" else None, **named)[0]

        assert status() == 200
        # A name that its owner has pointed at this machine; and none, or two.
        for host in ("evil.example", f"evil.example:{url.port}", "127.0.0.1", "127.0.0.1:1", [], [url.netloc] * 2):
            assert status(headers={"Host": host}) == 403, host
        for origin in ("http://evil.example", "null", f"https://{url.netloc}", "http://127.0.0.1:1", ""):
            assert status(headers={"Origin": origin}) == 403, origin
        token = url.path.strip("/")
        for target in (
            "/",
            "/a",
            f"/{token[:-1]}/a",
            f"/{token}x/a",
            f"/a?token={token}",
            "/%00/a",
            "*",
        ):
            assert status(target=target) == 403, target
    other = LocalServer(lambda request: Response(b""))
    other.server_close()
    assert other.url.split("/")[3] != url.path.split("/")[1], "each has a token of its own"


def test_what_is_no_request_is_refused(server):
    for length in ("", "x", "-1", "99999999", str(1 << 17)):
        assert fetch(server, "a", method="POST", headers={"Content-Length": length})[0] == 413
    assert fetch(server, "a?" + "&".join("x=1" for _ in range(600)))[0] == 400
    assert fetch(server, target="http://[/")[0] == 400
    assert fetch(server, "bad") == (404, "two lines \x1b[31m\n")
    for method in ("PUT", "DELETE", "OPTIONS"):
        assert fetch(server, "a", method=method)[0] == 501


def test_a_port_that_is_taken_is_an_error_of_one_line(server):
    with pytest.raises(InputError, match="give another"):
        LocalServer(lambda request: Response(b""), urlsplit(server.url).port)
