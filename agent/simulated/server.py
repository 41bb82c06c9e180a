"""Serve the simulated model: chat completions over HTTP on the loopback interface.

The server plays the stages of a question, and does what the probes of a server ask for as far as marks and JSON go: it
repeats a word or an object, follows a JSON Schema of labels, and finds the rectangle with a mark in a drawn picture.
"""

from __future__ import annotations

import functools
import hashlib
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.model.probes import BOX_LINE, CORNER_LINE, CROP_LINE, PANORAMA_LINE
from jrdb_avr.agent.simulated.knobs import PERFECT, PROFILES, Draws, Knobs, settings
from jrdb_avr.agent.simulated.reply_faults import Wording, think, with_wrong_boxes, with_wrong_policy, word
from jrdb_avr.agent.simulated.perception import Perception, Reader
from jrdb_avr.agent.simulated.play import STAGES
from jrdb_avr.agent.simulated.requests import Request, UserMessage, lines_of, read_request
from jrdb_avr.agent.simulated.tools import ChatMessage, Tool, forced, tool_calls, user_turns, with_stage
from jrdb_avr.schema.errors import DecodeError, EndpointError

MODEL: Final = "marker"
_LONGEST_REQUEST: Final = 256 * 1024 * 1024
_IMAGE_TOKENS: Final = 256
READY: Final = "marker ready at "
"""Begins the line that the process prints once it takes requests; the server's address follows."""


class _Request(msgspec.Struct):
    messages: list[ChatMessage]
    model: str = MODEL
    response_format: Any = None
    tools: list[Tool] | None = None
    tool_choice: Any = None
    parallel_tool_calls: bool | None = None
    stream: bool | None = None
    n: int | None = None
    functions: Any = None

    @property
    def usable_tools(self) -> list[Tool]:
        """The tools that may be called."""
        return [] if self.tool_choice == "none" else self.tools or []

    @property
    def turns(self) -> list[UserMessage]:
        """The user messages, and the results of calls."""
        return with_stage(user_turns(self.messages), self.usable_tools, self.tool_choice, STAGES)

    def check(self) -> None:
        """Raises DecodeError for what the server cannot do."""
        if self.stream:
            raise DecodeError("the simulated model does not stream: leave out stream, or set it to false")
        if self.n not in (None, 1):
            raise DecodeError("the simulated model gives one choice: leave out n, or set it to 1")
        if self.functions is not None:
            raise DecodeError("the simulated model reads tools: declare them by tools in place of functions")
        forced(self.tool_choice)


# Made at import: threads that meet a type first at the same time crash the decoder.
_REQUEST: Final = msgspec.json.Decoder(_Request)


class Server(ThreadingHTTPServer):
    """Serves until `shutdown`.

    A request for a model that is named like a profile gets that profile, any other `knobs`.
    `log` receives one JSON line per answered question: the question, what was missing, and which knob spoiled it.
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
        """The base URL for a client."""
        return f"http://127.0.0.1:{self.server_port}/v1"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a client that goes away, as when a run is killed; report anything else."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def reply(self, body: bytes) -> dict[str, Any]:
        """The completion for a request's body. Raises DecodeError for one that cannot be understood."""
        try:
            message = _REQUEST.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise DecodeError(f"no chat-completions request: {error}") from None
        message.check()
        knobs = PROFILES.get(message.model, self.knobs)
        draws = Draws(knobs.seed, "" if knobs == PERFECT else hashlib.sha256(body).hexdigest())
        request = read_request(message.turns, self.reader, STAGES, functools.partial(Perception, knobs))
        calls: list[dict[str, Any]] = []
        if request is None:
            wording = Wording(think(knobs, draws) + _probe_reply(message, self.reader))
        else:
            wording, reply = self._play(request, knobs, draws)
            if reply is not None and message.usable_tools:
                calls = tool_calls(reply, message.usable_tools, message.tool_choice, len(message.messages))
        time.sleep(knobs.latency)
        return _completion(message, wording, calls[:1] if message.parallel_tool_calls is False else calls)

    def _play(self, request: Request, knobs: Knobs, draws: Draws) -> tuple[Wording, Mapping[str, Any] | None]:
        """The reply as it is sent, and as an object; None where it is spoiled."""
        turn = STAGES[request.stage](request)
        reply = with_wrong_boxes(turn.reply, request.looks, knobs, draws)
        boxes_wrong = reply != turn.reply
        reply = with_wrong_policy(reply, knobs, draws)
        wording, spoiled = word(msgspec.json.encode(reply).decode(), knobs, draws)
        if self._log is not None and turn.missing is not None:
            faults = [*(["wrong_box"] if boxes_wrong else ()), *([spoiled] if spoiled else ())]
            line = {
                "stage": request.stage,
                "question": request.question,
                "choices": request.choices,
                "looks": len(request.looks),
                "missing": turn.missing,
                **({"knobs": faults} if faults else {}),
            }
            with self._lock, self._log.open("ab") as file:
                file.write(msgspec.json.encode(line) + b"\n")
        return wording, None if spoiled else reply


def _completion(request: _Request, wording: Wording, calls: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    parts = [part for message in request.messages for part in message.parts]
    images = sum(part.image_url is not None for part in parts)
    prompt_tokens = sum(len(part.text) for part in parts) // 4 + images * _IMAGE_TOKENS
    completion_tokens = len(wording.content or wording.refusal or "") // 4
    answer: dict[str, Any] = {"role": "assistant", "content": wording.content}
    if wording.refusal is not None:
        answer |= {"content": None, "refusal": wording.refusal}
    if calls:
        answer |= {"content": None, "tool_calls": calls}
    return {
        "id": "marker",
        "object": "chat.completion",
        "created": 0,
        "model": request.model,
        "choices": [{"index": 0, "finish_reason": "tool_calls" if calls else wording.finish_reason, "message": answer}],
        "usage": {
            "prompt_tokens": prompt_tokens,
            "completion_tokens": completion_tokens,
            "total_tokens": prompt_tokens + completion_tokens,
        },
    }


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
            self._refuse(413, "a request needs a Content-Length of at most 256 MB")
            return
        body = self.rfile.read(int(length))
        if not self.path.endswith("/chat/completions"):
            self._refuse(404, f"there is no {self.path}; use /v1/chat/completions")
            return
        try:
            self._send(200, self.server.reply(body))
        except DecodeError as error:
            self._refuse(400, str(error))

    def _refuse(self, status: int, message: str) -> None:
        self._send(status, {"error": {"message": message}})

    def _send(self, status: int, value: Mapping[str, Any]) -> None:
        data = msgspec.json.encode(value)
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing: a line per request on stderr would break the progress bar of a run."""


@contextmanager
def marker_server(log: Path | None = None, knobs: Knobs = PERFECT) -> Iterator[str]:
    """Serve from a child process while a `with` block lasts, and yield the base URL; `log` and `knobs` as in `Server`.

    Raises EndpointError if it does not start.
    """
    command = [sys.executable, "-m", "jrdb_avr.agent.simulated"]
    if log is not None:
        command += ["--log", str(log)]
    command += [part for setting in settings(knobs) for part in ("--knob", setting)]
    # The process ends when the pipe to its standard input closes, however this process ends.
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None, "its output is a pipe"
            line = process.stdout.readline()
            if not line.startswith(READY):
                raise EndpointError(
                    "the simulated model's server did not start: run 'python -m jrdb_avr.agent.simulated'"
                )
            yield line.removeprefix(READY).strip()
        finally:
            process.kill()


# -- probes -----------------------------------------------------------------------------------------------------------

_WORD: Final = re.compile(r"Reply with the one word: (\w{1,40})")
_OBJECT: Final = re.compile(r"Reply with the JSON object (\{.*\}) and nothing else\.")
_FRAME: Final = re.compile(r'Picture \d+: \{"frame_id": ?"(\d{6})"\}')


def _probe_reply(request: _Request, reader: Reader) -> str:
    """The text of a reply to a request that is no stage of a question.

    Raises DecodeError where its picture is missing or cannot be read.
    """
    parts = request.turns[-1] if request.turns else []
    lines = lines_of(parts)
    text, last = "\n".join(lines), lines[-1] if lines else ""
    if last in (CORNER_LINE, BOX_LINE, PANORAMA_LINE, CROP_LINE):
        return msgspec.json.encode(_picture_reply(last, parts, reader)).decode()
    if found := _OBJECT.search(text):
        return found[1]
    match request.response_format:
        case {"type": "json_schema", "json_schema": {"schema": {"properties": {**properties}}}}:
            return msgspec.json.encode({str(name): _first_value(form) for name, form in properties.items()}).decode()
    found = _WORD.search(text)
    return found[1] if found else '{"ok":true}'


def _first_value(schema: object) -> Any:
    """The first value that a schema lists."""
    match schema:
        case {"enum": [value, *_]}:
            return value


def _picture_reply(last: str, parts: UserMessage, reader: Reader) -> dict[str, Any]:
    """The reply to a probe with pictures, of which one shows a mark."""
    number, before = 0, ""
    for part in parts:
        if part.image_url is None:
            before = part.text
            continue
        number += 1
        picture = reader.picture(part.image_url.url, wrap=False)
        if picture.readings:
            break
    else:
        raise DecodeError("no picture of the request shows a mark")
    mark = picture.readings[0].box
    if last == CORNER_LINE:
        width, height = picture.size
        down = "upper" if mark.y + mark.h / 2 < height / 2 else "lower"
        across = "left" if mark.x + mark.w / 2 < width / 2 else "right"
        return {"corner": f"{down} {across}"}
    if last == PANORAMA_LINE:
        return {"calls": [{"tool": "final_answer", "answer": number, "entity": "p1"}]}
    frame = _FRAME.search(before)
    if frame is None:
        raise DecodeError("the request does not name its picture's frame")
    if last == CROP_LINE:
        return {"action": "observe", "frame_id": frame[1], "angle_deg": 180}
    return {"evidence_bboxes": [{"frame_id": frame[1], "bbox": write_box(mark, picture.size)}]}
