"""What a request says: its stage, the question, the legal frames, and the marks in its pictures.

A request is told apart by the last line of its newest user message. What the stages have in common is read here; a
stage reads lines of its own from `Request.lines`.

What a play hands back.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

import msgspec

from jrdb_avr.agent.model.prompts import read_frame_ranges
from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.markers import Mark, Reading, read
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, angle_of_column
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.wording import parse

_ANNOUNCED: Final = re.compile(
    r"(?:Picture|Panorama|Crop)(?: \d+)?(?:, observation (\w{1,32}))?(?:, the newest)?: (\{.*\})"
)
_CHOICE: Final = re.compile(r"\d+\. (.+)")
_URI: Final = "data:image/jpeg;base64,"
_AHEAD: Final = 180.0
"""Panorama angle of a whole panorama's middle column."""


@dataclass(frozen=True)
class Sighting:
    """A mark read in a picture: whose, where in the picture (pixels), and the panorama angle of the box's centre.

    `width` is the picture's, in pixels.
    """

    frame: int
    mark: Mark
    box: Box
    complete: bool
    angle: float
    width: int = CROP

    @property
    def whole(self) -> bool:
        """Whether the picture shows the box from side to side."""
        return self.box.x >= 0 and self.box.x + self.box.w <= self.width


@dataclass(frozen=True)
class Look:
    """A picture that was sent, and what was read in it: a crop, or a whole panorama.

    `left` is the panorama column of its left edge, `name` the observation's where the request gives one.
    """

    frame: int
    angle: float
    sightings: tuple[Sighting, ...]
    panorama: bool = False
    name: str = ""
    left: int = 0
    width: int = CROP
    height: int = HEIGHT

    def of(self, identity: int) -> Sighting | None:
        return next((s for s in self.sightings if s.mark.identity == identity), None)


@dataclass(frozen=True)
class Request:
    """A request as the marker understands it.

    `stage` is the last line of the newest user message and `lines` are all of them; `frames` are the legal ones (none
    where the method does not choose); `looks` are the pictures of all user messages, in order; `messages` are raw.
    """

    stage: str
    lines: tuple[str, ...]
    question: str
    template: str
    plan: Plan
    choices: tuple[str, ...]
    frames: tuple[int, ...]
    looks: tuple[Look, ...]
    messages: Sequence[Mapping[str, Any]] = field(repr=False, default=())

    def line(self, start: str) -> str | None:
        """The rest of the first line that begins so, in the newest user message."""
        return _line(self.lines, start)

    def legal(self) -> tuple[int, ...]:
        """The legal frames. Raises DecodeError where the prompt names none."""
        if not self.frames:
            raise DecodeError("the prompt names no legal frame")
        return self.frames

    def number(self, start: str, pattern: str = r"(\d{1,9})") -> int:
        """A count in such a line. Raises DecodeError where it is not there."""
        found = re.match(pattern, self.line(start) or "")
        if not found:
            raise DecodeError(f"the prompt lacks a line {start!r} with a count")
        return int(found[1])


@dataclass(frozen=True)
class Picture:
    """What was read in an image: its size in pixels, its sha256, and the marks."""

    digest: bytes
    width: int
    height: int
    readings: tuple[Reading, ...]


Misread = Callable[[bytes, Mark], Mark]
"""What is taken for a mark in the picture of a sha256."""


class Reader:
    """Reads marks from data URIs; remembers by hash what it has read, as every turn sends all pictures again."""

    def __init__(self, remembered: int = 8192) -> None:
        self._seen: OrderedDict[tuple[bytes, bool], Picture] = OrderedDict()
        self._remembered = remembered
        self._lock = threading.Lock()

    def picture(self, uri: str, *, wrap: bool) -> Picture:
        """The marks in a JPEG given as a data URI; `wrap` for a whole panorama. Raises DecodeError for else."""
        digest = hashlib.sha256(uri.encode()).digest()
        key = (digest, wrap)
        with self._lock:
            if key in self._seen:
                self._seen.move_to_end(key)
                return self._seen[key]
        image = _image(uri)
        found = Picture(digest, image.shape[1], image.shape[0], tuple(read(image, wrap=wrap)))
        with self._lock:
            self._seen[key] = found
            while len(self._seen) > self._remembered:
                self._seen.popitem(last=False)
        return found


def _image(uri: str) -> Any:
    import cv2
    import numpy as np

    try:
        data = base64.b64decode(uri.removeprefix(_URI), validate=True)
    except (binascii.Error, ValueError):
        raise DecodeError("an image must be a data URI of a JPEG") from None
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB) if data else None
    except cv2.error:
        image = None
    if image is None:
        raise DecodeError("an image of the request is no readable JPEG")
    return image


# -- the request ------------------------------------------------------------------------------------------------------


def read_request(
    messages: Sequence[Mapping[str, Any]],
    reader: Reader,
    stages: Collection[str],
    misread: Callable[[str], Misread | None] = lambda _: None,
) -> Request | None:
    """The request; None for a conversation whose last line is none of the stages'.

    The question and its choices may stand in an earlier user message, as in a chat. `misread` says how the marks of a
    question are misread. Raises DecodeError for a question or a picture that cannot be read.
    """
    said = [parts for message in messages if (parts := user_parts(message)) is not None]
    if not said:
        return None
    lines = lines_of(said[-1])
    stage = lines[-1] if lines else ""
    if stage not in stages:
        return None
    told = next((found for parts in (said[-1], *said) if _line(found := lines_of(parts), "Question: ") is not None), ())
    question = _line(told, "Question: ")
    if question is None:
        raise DecodeError("the prompt has no line 'Question: ...'")
    try:
        template, plan = parse(question)
    except PlanError as error:
        raise DecodeError(f"the marker model does not know this question: {error}") from None
    legal = _line(told, "Legal frames: ")
    frames = () if legal is None else tuple(read_frame_ranges(legal))
    misread_mark = misread(question)
    looks = tuple(look for parts in said for look in _looks(parts, reader, misread_mark))
    return Request(stage, lines, question, template, plan, _choices(told), frames, looks, messages)


def user_parts(message: object) -> list[dict[str, Any]] | None:
    """The parts of a user message's content; None for other messages and other content."""
    if not isinstance(message, dict) or message.get("role") in ("system", "assistant"):
        return None
    content = message.get("content")
    parts = [{"type": "text", "text": content}] if isinstance(content, str) else content
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
        return None
    return parts


def lines_of(parts: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """The lines of a message's text that are not blank."""
    texts = [part["text"] for part in parts if isinstance(part.get("text"), str)]
    return tuple(line for line in "\n".join(texts).split("\n") if line.strip())


def _line(lines: Sequence[str], start: str) -> str | None:
    return next((line.removeprefix(start) for line in lines if line.startswith(start)), None)


def _choices(lines: Sequence[str]) -> tuple[str, ...]:
    """The numbered lines that follow the line `Choices:`."""
    choices: list[str] = []
    for line in lines[lines.index("Choices:") + 1 :] if "Choices:" in lines else ():
        numbered = _CHOICE.fullmatch(line)
        if not numbered:
            break
        choices.append(numbered[1])
    return tuple(choices)


# -- its pictures -----------------------------------------------------------------------------------------------------


class _Metadata(msgspec.Struct):
    """What stands before a picture; without an angle it is a whole panorama."""

    frame_id: Annotated[str, msgspec.Meta(pattern="^[0-9]{6}$")]
    angle_deg: float | None = None
    left: int = 0


# Made at import: threads that meet a type first at the same time crash the decoder.
_METADATA: Final = msgspec.json.Decoder(_Metadata)


def _looks(parts: Sequence[dict[str, Any]], reader: Reader, misread: Misread | None) -> list[Look]:
    looks = []
    place: _Metadata | None = None
    name = ""
    for part in parts:
        last = str(part.get("text", "")).rpartition("\n")[2]
        announced = _ANNOUNCED.fullmatch(last)
        if announced:
            try:
                place = _METADATA.decode(announced[2])
            except msgspec.DecodeError as error:
                raise DecodeError(f"a picture's line cannot be read: {error}") from None
            name = announced[1] or ""
        elif part.get("type") == "image_url" and place is not None:
            picture = reader.picture(uri_of(part), wrap=place.angle_deg is None)
            looks.append(_look(place, name, picture, misread))
            place = None
    return looks


def uri_of(part: Mapping[str, Any]) -> str:
    """The address of a part that is an image."""
    image = part.get("image_url")
    return str(image.get("url") if isinstance(image, dict) else image)


def _look(place: _Metadata, name: str, picture: Picture, misread: Misread | None) -> Look:
    frame, panorama = int(place.frame_id), place.angle_deg is None
    # A panorama may be sent smaller than it is, a crop is as large as it was cut.
    scale = WIDTH / picture.width if panorama else 1.0
    sightings = [
        Sighting(
            frame,
            reading.mark if misread is None else misread(picture.digest, reading.mark),
            reading.box,
            reading.complete,
            angle_of_column(place.left + (reading.box.x + reading.box.w / 2) * scale),
            picture.width,
        )
        for reading in picture.readings
    ]
    angle = _AHEAD if place.angle_deg is None else place.angle_deg
    return Look(frame, angle, tuple(sightings), panorama, name, place.left, picture.width, picture.height)


@dataclass(frozen=True)
class Turn:
    """The reply's object; `missing` says what was missing where it ends the question, and is None where it does not."""

    reply: Mapping[str, Any]
    missing: list[str] | None = None


Play = Callable[[Request], Turn]
"""Plays one stage: a pure function of the request. Raises DecodeError for a request that lacks a line."""
