"""Serve the simulated model: chat completions over HTTP on the loopback interface.

The server plays the stages of a question from the annotations of a store. It also passes the checks of a server: it
repeats a word or an object, follows a JSON Schema of labels, and finds the marked rectangle of a drawn picture.
"""

from __future__ import annotations

import functools
import hashlib
import re
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.conventions import SCALE
from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.model.labelled_people import PERSON_LINE
from jrdb_avr.agent.model.probes import BOX_LINE, CORNER_LINE, CROP_LINE, PANORAMA_LINE
from jrdb_avr.agent.simulated.brain import STAGES
from jrdb_avr.agent.simulated.noise import Draws, PictureView, Reader, ReadPerson
from jrdb_avr.agent.simulated.profiles import PROFILES, SIMULATED, USUAL_PROFILE, Errors
from jrdb_avr.agent.simulated.recorded import RecordedReader, load_readings
from jrdb_avr.agent.simulated.requests import MessagePart, See, UserMessage, lines_of, picture_view, read_request
from jrdb_avr.agent.simulated.sight import Sight
from jrdb_avr.agent.simulated.tools import ChatMessage, Tool, tool_calls, user_turns, with_stage
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import CROP, Box, iou

_IMAGE_TOKENS: Final = 256
_PICTURES: Final = 4096
"""Maximum number of pictures in memory, as they were read."""


class _Request(msgspec.Struct):
    messages: list[ChatMessage]
    model: str = SIMULATED
    response_format: Any = None
    tools: list[Tool] = []
    stream: bool | None = None
    simulated: bool = False


# Made at import, because threads that meet a type first at the same time crash the decoder.
_REQUEST: Final = msgspec.json.Decoder(_Request)


class Server(ThreadingHTTPServer):
    """Server of the simulated model. It serves until `shutdown`."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, sight: Sight | None, errors: Errors | None = None, port: int = 0) -> None:
        """Open the port.

        Args:
            sight: Annotated people of a store. Without it, the model passes only the checks of a server.
            errors: Errors of the model. None takes the profile that a request's model names, or else the usual one.
            port: Port on 127.0.0.1. 0 takes a free one.

        Raises:
            InputError: If the errors name a file of readings that cannot be read.
        """
        load_readings(errors.readings if errors else "")
        super().__init__(("127.0.0.1", port), _Handler)
        self._sight = sight
        self._errors = errors
        # Every turn sends all pictures again.
        self._see = functools.lru_cache(_PICTURES)(self._read)

    def _read(self, errors: Errors, view: PictureView) -> tuple[ReadPerson, ...]:
        """Return the people who are read in a picture."""
        if self._sight is None:
            raise DecodeError("the simulated model has no store to read annotations from")
        reader = (RecordedReader if errors.readings else Reader)(errors, view)
        return reader.people(self._sight.people(view.sequence, view.frame))

    @property
    def url(self) -> str:
        """Base URL for a client."""
        return f"http://127.0.0.1:{self.server_port}/v1"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a client that goes away, as when a run is killed. Report any other error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def reply(self, body: bytes) -> dict[str, Any]:
        """Return the completion for a request.

        Args:
            body: Body of the request.

        Returns:
            The completion. Equal requests get equal completions.

        Raises:
            DecodeError: If the request cannot be understood.
        """
        try:
            message = _REQUEST.decode(body)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise DecodeError(f"not a chat-completions request: {error}") from None
        if message.stream:
            raise DecodeError("the simulated model does not stream: leave out stream, or set it to false")
        turns = with_stage(user_turns(message.messages), message.tools)
        profile = PROFILES.get(message.model.removeprefix(f"{SIMULATED}:"), PROFILES[USUAL_PROFILE])
        errors = self._errors or profile
        see = functools.partial(self._see, errors)
        # Only programs that declare tools, or the run simulated, may send pictures without references.
        by_text = message.tools or message.simulated
        sequences = self._sight.sequences if self._sight is not None and by_text else {}
        request = read_request(turns, STAGES, see, sequences)
        calls: list[dict[str, Any]] = []
        if request is None:
            content = _probe_reply(turns[-1] if turns else [], message.response_format, see)
        else:
            reply = STAGES[request.stage](request)
            content = msgspec.json.encode(reply).decode()
            draws = Draws(errors.seed, hashlib.sha256(body).hexdigest() if errors.malformed else "")
            if draws.happens(errors.malformed, "malformed"):
                # The object lacks its end, or has prose around it.
                content = draws.pick((content[:-1], f"Here is my reply: {content} I hope that this helps."), "how")
            elif message.tools:
                calls = tool_calls(reply, message.tools, len(message.messages))
        time.sleep(errors.latency)
        return _completion(message, content, calls)


def _completion(request: _Request, content: str, calls: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    parts = [part for message in request.messages for part in message.parts]
    prompt = sum(_IMAGE_TOKENS if part.image_url else len(part.text) // 4 for part in parts)
    tokens = {"prompt_tokens": prompt, "completion_tokens": len(content) // 4}
    finish, called = ("tool_calls", {"content": None, "tool_calls": calls}) if calls else ("stop", {"content": content})
    choice = {"index": 0, "finish_reason": finish, "message": {"role": "assistant", **called}}
    about = {"id": SIMULATED, "object": "chat.completion", "created": 0, "model": request.model}
    return {**about, "choices": [choice], "usage": {**tokens, "total_tokens": sum(tokens.values())}}


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    # One packet per reply, because headers and body apart would wait for each other's acknowledgement.
    wbufsize = -1
    disable_nagle_algorithm = True

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        body = self.rfile.read(int(length)) if re.fullmatch("[0-9]{1,9}", length) else b""
        try:
            if not self.path.endswith("/chat/completions"):
                raise DecodeError(f"there is no {self.path}; use /v1/chat/completions")
            self._send(200, self.server.reply(body))
        except (DecodeError, KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
            self._send(400, {"error": {"message": str(error)}})

    def _send(self, status: int, value: Mapping[str, Any]) -> None:
        data = msgspec.json.encode(value)
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing, because a line per request on stderr would break the progress bar of a run."""


@contextmanager
def simulated_server(sight: Sight | None, errors: Errors | None) -> Iterator[str]:
    """Serve from a thread of this process while a `with` block lasts.

    Args:
        sight: As in `Server`.
        errors: As in `Server`.

    Yields:
        The base URL.
    """
    with Server(sight, errors) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.url
        finally:
            server.shutdown()


# -- probes -----------------------------------------------------------------------------------------------------------

_WORD: Final = re.compile(r"Reply with the one word: (\w{1,40})")
_OBJECT: Final = re.compile(r"Reply with the JSON object (\{.*\}) and nothing else\.")
_BOX: Final = re.compile(r"inside the box (\[[0-9, ]+\]):")
_FRAME: Final = re.compile(r'Picture \d+: \{"frame_id": ?"(\d{6})"\}')


def _probe_reply(parts: UserMessage, form: Any, see: See) -> str:
    """Return the reply to a request that is not a stage of a question. Raise DecodeError if its picture is missing."""
    lines = lines_of(parts)
    text, last = "\n".join(lines), lines[-1] if lines else ""
    if last in (CORNER_LINE, BOX_LINE, PANORAMA_LINE, CROP_LINE):
        return msgspec.json.encode(_picture_reply(last, parts)).decode()
    if last == PERSON_LINE:
        return msgspec.json.encode(_person_reply(text, parts, see)).decode()
    if match := _OBJECT.search(text):
        return match[1]
    if form is not None and form["type"] == "json_schema":
        properties = form["json_schema"]["schema"].get("properties", {})
        return msgspec.json.encode({name: value.get("enum", [None])[0] for name, value in properties.items()}).decode()
    match = _WORD.search(text)
    return match[1] if match else '{"ok":true}'


def _person_reply(text: str, parts: UserMessage, see: See) -> dict[str, Any]:
    """Return the labels of the person with the box that overlaps most with the box in a probe's text."""
    reference, box = next((part.jrdb_avr for part in parts if part.jrdb_avr is not None), None), _BOX.search(text)
    if reference is None or box is None:
        raise DecodeError("the request names no box, or its picture has no reference")
    left, top, right, bottom = (side * CROP / SCALE for side in msgspec.json.decode(box[1], type=list[int]))
    asked = Box(left, top, right - left, bottom - top)
    people = [person for person in see(picture_view(reference)) if iou(person.box, asked) > 0]
    best = max(people, key=lambda person: iou(person.box, asked), default=None)
    return {name: (best and best.label(name)) or "cannot tell" for name in ("gender", "age", "pose")}


def _picture_reply(last: str, parts: UserMessage) -> dict[str, Any]:
    """Return the reply to a probe with drawn pictures, of which one shows a marked rectangle."""
    pictures = [(part.jrdb_avr, before.text) for before, part in pairwise([MessagePart(), *parts]) if part.image_url]
    marked = [(n, one, before) for n, (one, before) in enumerate(pictures, 1) if one is not None and one.rectangle]
    if not marked:
        raise DecodeError("no picture of the request refers to a rectangle: declare the run simulated (--simulated)")
    number, reference, before = marked[0]
    size, box = reference.size, Box(*(reference.rectangle or (0, 0, 0, 0)))
    if last == CORNER_LINE:
        down = "upper" if box.y + box.h / 2 < size[1] / 2 else "lower"
        across = "left" if box.x + box.w / 2 < size[0] / 2 else "right"
        return {"corner": f"{down} {across}"}
    if last == PANORAMA_LINE:
        return {"calls": [{"tool": "final_answer", "answer": number, "entity": "p1"}]}
    frame = _FRAME.search(before)
    if frame is None:
        raise DecodeError("the request does not name its picture's frame")
    if last == CROP_LINE:
        return {"action": "observe", "frame_id": frame[1], "angle_deg": 180}
    return {"evidence_bboxes": [{"frame_id": frame[1], "bbox": write_box(box, size)}]}
