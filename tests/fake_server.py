"""A chat-completions server for tests that behaves, and misbehaves, as it is told.

`FakeServer(script)` calls `script(request, n)` for the n-th request (from 0) and sends what it returns: a text (a clean
reply), a dict (a whole reply body), or one of the faults below. Every request body is kept in `requests`.
"""

import json
import threading
import time
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Status:
    """An HTTP error."""

    code: int
    message: str = "an error"
    headers: tuple = ()


@dataclass
class Slow:
    """A reply after some seconds."""

    seconds: float
    text: str


@dataclass
class CutOff:
    """A reply whose connection ends in the middle of the body."""

    text: str


@dataclass
class Body:
    """Any bytes with status 200."""

    data: bytes


def completion(text, finish_reason="stop", model="fake-1", **message):
    return {
        "id": "x",
        "object": "chat.completion",
        "created": 0,
        "model": model,
        "choices": [
            {"index": 0, "finish_reason": finish_reason, "message": {"role": "assistant", "content": text, **message}}
        ],
        "usage": {"prompt_tokens": 10, "completion_tokens": 5, "total_tokens": 15},
    }


class FakeServer:
    def __init__(self, script):
        self.script = script
        self.requests = []
        self.headers = []
        self._lock = threading.Lock()
        fake = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            wbufsize = -1
            disable_nagle_algorithm = True

            def do_POST(self):
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                with fake._lock:
                    number = len(fake.requests)
                    fake.requests.append(body)
                    fake.headers.append({name.lower(): value for name, value in self.headers.items()})
                self.answer(fake.script(body, number))

            def answer(self, what):
                if isinstance(what, Slow):
                    time.sleep(what.seconds)
                    what = what.text
                if isinstance(what, Status):
                    data = json.dumps({"error": {"message": what.message}}).encode()
                    self.send(what.code, data, what.headers)
                elif isinstance(what, CutOff):
                    data = json.dumps(completion(what.text)).encode()
                    self.send_response(200)
                    self.send_header("Content-Length", str(len(data)))
                    self.end_headers()
                    self.wfile.write(data[: len(data) // 2])
                    self.close_connection = True
                elif isinstance(what, Body):
                    self.send(200, what.data)
                else:
                    self.send(200, json.dumps(completion(what) if isinstance(what, str) else what).encode())

            def send(self, status, data, headers=()):
                self.send_response(status)
                for name, value in headers:
                    self.send_header(name, value)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, *args):
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            request_queue_size = 128

            def handle_error(self, request, client_address):
                pass

        self._server = Server(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}/v1"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._server.shutdown()
        self._server.server_close()


def texts(request):
    """All text of a request's messages."""
    out = []
    for message in request["messages"]:
        content = message["content"]
        if isinstance(content, str):
            out.append(content)
        else:
            out += [part["text"] for part in content if part["type"] == "text"]
    return "\n".join(out)


def images(request):
    """All image URLs of a request's messages."""
    return [
        part["image_url"]["url"]
        for message in request["messages"]
        if not isinstance(message["content"], str)
        for part in message["content"]
        if part["type"] == "image_url"
    ]
