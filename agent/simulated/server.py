"""The socket of the marker model: chat completions over HTTP on the loopback interface."""

from __future__ import annotations

import functools
import hashlib
import sys
import threading
import time
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.agent.simulated.noise import PERFECT, Draws, Knobs, Wording, misread, think, with_wrong_boxes, word
from jrdb_avr.agent.simulated.play import STAGES
from jrdb_avr.agent.simulated.requests import Reader, Request, Turn, read_request
from jrdb_avr.agent.simulated.talk import talk
from jrdb_avr.schema.errors import DecodeError

MODEL: Final = "marker"
_LONGEST_REQUEST: Final = 256 * 1024 * 1024
_IMAGE_TOKENS: Final = 256


class _Request(msgspec.Struct):
    messages: list[dict[str, Any]]
    model: str = MODEL
    response_format: Any = None


# Made at import: threads that meet a type first at the same time crash the decoder.
_REQUEST: Final = msgspec.json.Decoder(_Request)


class Server(ThreadingHTTPServer):
    """Serves until `shutdown`.

    `log` receives one JSON line per question answered: what was asked, what was missing, and which knob spoiled it.
    """

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, port: int = 0, log: Path | None = None, knobs: Knobs = PERFECT) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.reader = Reader()
        self.knobs = knobs
        self._log = log
        self._lock = threading.Lock()

    @property
    def url(self) -> str:
        """The base URL that a client is given."""
        return f"http://127.0.0.1:{self.server_port}/v1"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that goes away, as when a run is killed, is no fault to tell; anything else is."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def reply(self, body: bytes) -> dict[str, Any]:
        """The completion for a request's body. Raises DecodeError for what cannot be understood."""
        try:
            request = _REQUEST.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise DecodeError(f"no chat-completions request: {error}") from None
        knobs = self.knobs
        draws = Draws(knobs.seed, "" if knobs == PERFECT else hashlib.sha256(body).hexdigest())
        asked = read_request(request.messages, self.reader, STAGES, functools.partial(misread, knobs))
        if asked is None:
            wording = Wording(think(knobs, draws) + talk(request.messages, request.response_format, self.reader))
        else:
            wording = self._play(asked, draws)
        time.sleep(knobs.latency)
        return _completion(request, wording)

    def _play(self, asked: Request, draws: Draws) -> Wording:
        turn = STAGES[asked.stage](asked)
        reply, wrong = with_wrong_boxes(turn.reply, asked.looks, self.knobs, draws)
        wording, spoiled = word(msgspec.json.encode(reply).decode(), self.knobs, draws)
        self._tell(asked, turn, [*(["wrong_box"] if wrong else ()), *([spoiled] if spoiled else ())])
        return wording

    def _tell(self, asked: Request, turn: Turn, knobs: list[str]) -> None:
        if turn.missing is None:
            return
        line = {
            "stage": asked.stage,
            "question": asked.question,
            "choices": asked.choices,
            "looks": len(asked.looks),
            "missing": turn.missing,
        }
        self._write({**line, "knobs": knobs} if knobs else line)

    def _write(self, line: Mapping[str, Any]) -> None:
        if self._log is None:
            return
        with self._lock, self._log.open("ab") as file:
            file.write(msgspec.json.encode(line) + b"\n")


def _completion(request: _Request, wording: Wording) -> dict[str, Any]:
    texts, images = _sizes(request.messages)
    prompt_tokens = texts // 4 + images * _IMAGE_TOKENS
    completion_tokens = len(wording.content or wording.refusal or "") // 4
    message: dict[str, Any] = {"role": "assistant", "content": wording.content}
    if wording.refusal is not None:
        message |= {"content": None, "refusal": wording.refusal}
    return {
        "id": "marker",
        "object": "chat.completion",
        "created": 0,
        "model": request.model,
        "choices": [{"index": 0, "finish_reason": wording.finish_reason, "message": message}],
        "usage": {
            "prompt_tokens": prompt_tokens,
            "completion_tokens": completion_tokens,
            "total_tokens": prompt_tokens + completion_tokens,
        },
    }


def _sizes(messages: list[dict[str, Any]]) -> tuple[int, int]:
    """Characters of text and number of images."""
    texts = images = 0
    for message in messages:
        content = message.get("content")
        for part in content if isinstance(content, list) else [{"text": content}]:
            if isinstance(part, dict):
                texts += len(str(part.get("text") or ""))
                images += part.get("type") == "image_url"
    return texts, images


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    # One packet per reply: headers and body apart would wait for each other's acknowledgement.
    wbufsize = -1
    disable_nagle_algorithm = True

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()) or int(length) > _LONGEST_REQUEST:
            self.close_connection = True
            self._send(413, {"error": {"message": "a request needs a Content-Length of at most 256 MB"}})
            return
        body = self.rfile.read(int(length))
        if not self.path.endswith("/chat/completions"):
            self._send(404, {"error": {"message": f"there is no {self.path}; use /v1/chat/completions"}})
            return
        try:
            self._send(200, self.server.reply(body))
        except DecodeError as error:
            self._send(400, {"error": {"message": str(error)}})

    def do_GET(self) -> None:
        if self.path.endswith("/models"):
            self._send(200, {"object": "list", "data": [{"id": MODEL, "object": "model"}]})
        else:
            self._send(404, {"error": {"message": f"there is no {self.path}; use /v1/models"}})

    def _send(self, status: int, value: Mapping[str, Any]) -> None:
        data = msgspec.json.encode(value)
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Silence: a line per request on stderr would break the progress bar of a run."""
