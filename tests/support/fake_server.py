"""Servers that a test scripts or records, hosts of a model's tools, and the models with declared conventions."""

import base64
import contextlib
import functools
import json
import re
import socket
import threading
import time
import urllib.request
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from jrdb_avr.agent.simulated.profiles import PERFECT
from jrdb_avr.agent.simulated.server import Server


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
class Drip:
    """A reply that comes byte by byte, with a pause before each."""

    pause: float
    text: str


@dataclass
class Body:
    """Any bytes."""

    data: bytes
    content_type: str = "application/json"
    code: int = 200
    headers: tuple = ()


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
    def __init__(self, script, version=None):
        self.script = script
        self.version = version
        self.requests = []
        self.headers = []
        self.paths = []
        self._lock = threading.Lock()
        self._idle, self._connections = threading.Condition(), 0
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
                    fake.paths.append(self.path)
                    fake.headers.append({name.lower(): value for name, value in self.headers.items()})
                self.answer(fake.script(body, number))

            def do_GET(self):
                if self.path == "/version" and fake.version is not None:
                    self.send(200, fake.version)
                else:
                    self.send(404, b'{"detail": "Not Found"}')

            def answer(self, what):
                if isinstance(what, Slow):
                    time.sleep(what.seconds)
                    what = what.text
                if isinstance(what, Status):
                    data = json.dumps({"error": {"message": what.message}}).encode()
                    self.send(what.code, data, what.headers)
                elif isinstance(what, CutOff | Drip):
                    self.trickle(what)
                elif isinstance(what, Body):
                    self.send(what.code, what.data, what.headers, what.content_type)
                else:
                    self.send(200, json.dumps(completion(what) if isinstance(what, str) else what).encode())

            def trickle(self, what):
                data = json.dumps(completion(what.text)).encode()
                self.send_response(200)
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                if isinstance(what, CutOff):
                    self.wfile.write(data[: len(data) // 2])
                    self.close_connection = True
                    return
                for byte in data:
                    time.sleep(what.pause)
                    self.wfile.write(bytes([byte]))
                    self.wfile.flush()

            def send(self, status, data, headers=(), content_type="application/json"):
                self.send_response(status)
                for name, value in headers:
                    self.send_header(name, value)
                self.send_header("Content-Type", content_type)
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

            def process_request(self, request, client_address):
                with fake._idle:
                    fake._connections += 1
                super().process_request(request, client_address)

            def process_request_thread(self, request, client_address):
                try:
                    super().process_request_thread(request, client_address)
                finally:
                    with fake._idle:
                        fake._connections -= 1
                        fake._idle.notify_all()

        self._server = Server(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}/v1"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def hear_out(self):
        """Wait until all that clients said, who have ended, is heard."""
        # Connections are taken in turn: when this one is, all that were made before it are.
        with socket.create_connection(self._server.server_address) as last:
            last.sendall(b"GET / HTTP/1.0\r\n\r\n")
            assert last.recv(1)
        with self._idle:
            assert self._idle.wait_for(lambda: not self._connections, timeout=60)

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


# -- a server that passes every check ---------------------------------------------------------------------------------


def schema_of(request):
    """The JSON Schema that the reply must keep to; None where none was sent."""
    format_ = request.get("response_format", {})
    return format_["json_schema"]["schema"] if format_.get("type") == "json_schema" else None


def marked(request):
    """Width, height and the one marked rectangle (x, y, w, h) of a request's picture."""
    (url,) = images(request)
    return _marked(url)


def _marked(url):
    width, height, (box,) = _seen(url)
    return width, height, box


@functools.cache
def _seen(url):
    """Width, height, and the box of the red rectangle in a list, which is empty without one."""
    import cv2
    import numpy as np

    data = np.frombuffer(base64.b64decode(url.partition(",")[2]), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB).astype(int)
    down, across = np.nonzero(image[:, :, 0] - image[:, :, 2] > 70)
    box = (int(across.min()), int(down.min()), int(np.ptp(across)) + 1, int(np.ptp(down)) + 1) if len(down) else None
    return image.shape[1], image.shape[0], [] if box is None else [box]


def showing(request):
    """The number, from 1, of the first picture that shows a marked rectangle; 1 where none does, as a guess."""
    return next((number for number, url in enumerate(images(request), 1) if _seen(url)[2]), 1)


def corner_seen(request):
    """The corner that the marked rectangle is in, as the reply to a picture check."""
    width, height, (x, y, w, h) = marked(request)
    down, across = ("upper", "lower")[y + h / 2 > height / 2], ("left", "right")[x + w / 2 > width / 2]
    return json.dumps({"corner": f"{down} {across}"})


def seeing(request, n=0, model="fake"):
    """What a good server replies to a preflight request; None to any other."""
    text = texts({"messages": [message for message in request["messages"] if message["role"] != "system"]})
    if text.endswith("one word: ready"):
        return completion("ready", model=model)
    if text.startswith("Say in one sentence"):
        shape = schema_of(request)
        (key,) = shape["required"] if shape else ("",)
        return completion(json.dumps({key: shape["properties"][key]["enum"][0]}) if shape else "Grey.", model=model)
    if text.startswith("Reply with the JSON object "):
        return completion(
            text.removeprefix("Reply with the JSON object ").removesuffix(" and nothing else."), model=model
        )
    if text.endswith("The panorama's number, as one JSON object:"):
        final = {"tool": "final_answer", "answer": showing(request), "entity": "p1"}
        return completion(json.dumps({"calls": [final]}), model=model)
    if text.endswith("The picture's frame, as one JSON object:"):
        frames = re.findall(r'^Picture \d+: {"frame_id": "(\d{6})"}$', text, re.MULTILINE)
        frame = frames[showing(request) - 1]
        return completion(json.dumps({"action": "observe", "frame_id": frame, "angle_deg": 180}), model=model)
    if text.startswith("Question: Which "):
        return completion("{}", model=model)
    if text.endswith("The corner, as one JSON object:"):
        return completion(corner_seen(request), model=model)
    return None


def sound(script, model="fake"):
    """The script of a server that passes every check, and is asked for everything else as `script` says.

    `script` counts only the requests that reach it.
    """
    lock, reached = threading.Lock(), []

    def answer(request, n):
        reply = seeing(request, n, model)
        if reply is not None:
            return reply
        with lock:
            reached.append(request)
            number = len(reached) - 1
        reply = script(request, number)
        return completion(reply, model=model) if isinstance(reply, str) else reply

    return answer


@contextlib.contextmanager
def recorded_server(sight=None, errors=PERFECT):
    """Yield the address of a simulated model and the list of bodies, which grows. `sight`: whom it sees."""
    server, sent = Server(sight, errors), []
    reply = server.reply
    server.reply = lambda body: (sent.append(body), reply(body))[1]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.url, sent
    server.shutdown()
    server.server_close()


OBSERVE = {"frame_id": {"type": "string"}, "angle_deg": {"type": "number"}}
SUBMIT = {"answer": {}, "evidence_bboxes": {"type": "array"}}
TOOLS = [
    {"type": "function", "function": {"name": name, "parameters": {"type": "object", "properties": properties}}}
    for name, properties in (("observe", OBSERVE), ("submit_answer", SUBMIT))
]


def complete(url, messages):
    body = json.dumps({"model": "simulated", "messages": messages, "tools": TOOLS}).encode()
    request = urllib.request.Request(f"{url}/chat/completions", body, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as reply:
        return json.load(reply)["choices"][0]["message"]


async def play(url, prompt, call, most=60):
    """Let the model play a question: `await call(name, arguments)` gives a result's text and picture, JPEG or None.

    Ends with the answer, and returns how many calls were made.
    """
    messages = [{"role": "user", "content": prompt}]
    for made in range(1, most):
        message = complete(url, messages)
        messages.append(message)
        (wanted,) = message["tool_calls"]
        name = wanted["function"]["name"]
        text, jpeg = await call(name, json.loads(wanted["function"]["arguments"]))
        if name == "submit_answer":
            return made
        content = [{"type": "text", "text": text}]
        if jpeg is not None:
            uri = "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()
            content.append({"type": "image_url", "image_url": {"url": uri}})
        messages.append({"role": "tool", "tool_call_id": wanted["id"], "content": content})
    raise AssertionError("no answer")


BACKBONES = (
    "google/gemma-4-E2B-it",
    "google/gemma-4-E4B-it",
    "Qwen/Qwen3-VL-4B-Instruct",
    "Qwen/Qwen3-VL-8B-Instruct",
    "Qwen/Qwen3.5-4B",
    "Qwen/Qwen3.5-9B",
)
