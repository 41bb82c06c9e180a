"""Parse a request: its stage, the question, the legal frames, and the marks in its pictures.

The last line of the newest user message names the stage. This module reads what all stages have in common; a stage
reads lines of its own from `Request.lines`.
"""

from __future__ import annotations

import base64
import hashlib
import itertools
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, NamedTuple

import msgspec

from jrdb_avr.agent.model.prompts import read_frame_ranges
from jrdb_avr.agent.policy.explorer import Look, Sighting
from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.markers import Mark, Reading, read
from jrdb_avr.schema.panorama import WIDTH, angle_of_column
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.wording.text import parse

_ANNOUNCED: Final = re.compile(
    r"(?:Picture|Panorama|Crop)(?: \d+)?(?:, observation (\w{1,32}))?(?:, the newest)?: (\{.*\})"
)
_CHOICE: Final = re.compile(r"\d+\. (.+)")
_CACHED: Final = 8192
_URI: Final = "data:image/jpeg;base64,"
AHEAD: Final = 180.0
"""Panorama angle of a whole panorama's middle column."""

FrameId = Annotated[str, msgspec.Meta(pattern="^[0-9]{6}$")]


@dataclass(frozen=True)
class Request:
    """A parsed request.

    `stage` is the last line of the newest user message and `lines` are all of them; `frames` are the legal ones (none
    where the method does not choose); `looks` are the pictures of all user messages, in order.
    """

    stage: str
    lines: tuple[str, ...]
    question: str
    plan: Plan
    choices: tuple[str, ...]
    frames: tuple[int, ...]
    looks: tuple[Look, ...]

    def line(self, start: str) -> str | None:
        """The rest of the first line that begins so, in the newest user message."""
        return _line(self.lines, start)

    def legal(self) -> tuple[int, ...]:
        """The legal frames. Raises DecodeError where the prompt names none."""
        if not self.frames:
            raise DecodeError("the prompt names no legal frame")
        return self.frames

    def left(self, start: str) -> int:
        """How many of a budget are left, by the line that begins so. Raises DecodeError where there is none."""
        found = re.match(r"\d+, left: (\d{1,9})$", self.line(start) or "")
        if not found:
            raise DecodeError(f"the prompt lacks a line {start!r} with a count")
        return int(found[1])


class PictureMarks(NamedTuple):
    """The marks read in an image, with its width and height in pixels and its sha256."""

    digest: bytes
    size: tuple[int, int]
    readings: tuple[Reading, ...]


Misread = Callable[[bytes, Mark], Mark]
"""Returns what a mark in the picture of a sha256 is taken for."""


class Reader:
    """Reads marks from data URIs; caches them by hash, as every turn sends all pictures again."""

    def __init__(self) -> None:
        self._cache: OrderedDict[tuple[bytes, bool], PictureMarks] = OrderedDict()
        self._lock = threading.Lock()

    def picture(self, uri: str, *, wrap: bool) -> PictureMarks:
        """The marks in a JPEG, as a data URI; `wrap` for a whole panorama. Raises DecodeError for any other text."""
        digest = hashlib.sha256(uri.encode()).digest()
        key = (digest, wrap)
        with self._lock:
            if key in self._cache:
                self._cache.move_to_end(key)
                return self._cache[key]
        image = _image(uri)
        found = PictureMarks(digest, image.shape[1::-1], tuple(read(image, wrap=wrap)))
        with self._lock:
            self._cache[key] = found
            while len(self._cache) > _CACHED:
                self._cache.popitem(last=False)
        return found


def _image(uri: str) -> Any:
    import cv2
    import numpy as np

    try:
        data = base64.b64decode(uri.removeprefix(_URI), validate=True)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
    except (ValueError, cv2.error):
        image = None
    if image is None:
        raise DecodeError("an image of the request is no data URI of a readable JPEG")
    return image


# -- the request ------------------------------------------------------------------------------------------------------


class _Url(msgspec.Struct):
    url: str


class MessagePart(msgspec.Struct):
    """A part of a message: text, or a picture."""

    text: str = ""
    image_url: _Url | None = None


UserMessage = list[MessagePart]
"""The parts of a user message."""


def read_request(
    turns: Sequence[UserMessage], reader: Reader, stages: Collection[str], misread: Callable[[str], Misread | None]
) -> Request | None:
    """Parse the user messages of a request; None where their last line names none of the stages.

    The question and its choices may stand in an earlier user message, as in a chat. `misread` returns how the marks of
    a question are misread. Raises DecodeError for a question or a picture that cannot be read.
    """
    lines = lines_of(turns[-1]) if turns else ()
    stage = lines[-1] if lines else ""
    if stage not in stages:
        return None
    texts = (lines, *map(lines_of, turns))
    heading = next((text for text in texts if _line(text, "Question: ") is not None), ())
    question = _line(heading, "Question: ")
    if question is None:
        raise DecodeError("the prompt has no line 'Question: ...'")
    try:
        _, plan = parse(question)
    except PlanError as error:
        raise DecodeError(f"the marker model does not know this question: {error}") from None
    legal = _line(heading, "Legal frames: ")
    frames = () if legal is None else tuple(read_frame_ranges(legal))
    misread_mark = misread(question)
    looks = tuple(look for parts in turns for look in _looks(parts, reader, misread_mark))
    return Request(stage, lines, question, plan, _choices(heading), frames, looks)


def lines_of(parts: UserMessage) -> tuple[str, ...]:
    """The lines of a message's text that are not blank."""
    return tuple(line for part in parts for line in part.text.split("\n") if line.strip())


def _line(lines: Sequence[str], start: str) -> str | None:
    return next((line.removeprefix(start) for line in lines if line.startswith(start)), None)


def _choices(lines: Sequence[str]) -> tuple[str, ...]:
    """The numbered lines that follow the line `Choices:`."""
    after = lines[lines.index("Choices:") + 1 :] if "Choices:" in lines else ()
    numbered = itertools.takewhile(bool, map(_CHOICE.fullmatch, after))
    return tuple(found[1] for found in numbered if found)


# -- its pictures -----------------------------------------------------------------------------------------------------


class _Metadata(msgspec.Struct):
    """The JSON object before a picture; without an angle the picture is a whole panorama."""

    frame_id: FrameId
    angle_deg: float | None = None
    left: int = 0


# Made at import: threads that meet a type first at the same time crash the decoder.
_METADATA: Final = msgspec.json.Decoder(_Metadata)


def _looks(parts: UserMessage, reader: Reader, misread: Misread | None) -> list[Look]:
    looks = []
    place: _Metadata | None = None
    name = ""
    for part in parts:
        announced = _ANNOUNCED.fullmatch(part.text.rpartition("\n")[2])
        if announced:
            try:
                place = _METADATA.decode(announced[2])
            except msgspec.DecodeError as error:
                raise DecodeError(f"a picture's line cannot be read: {error}") from None
            name = announced[1] or ""
        elif part.image_url is not None and place is not None:
            picture = reader.picture(part.image_url.url, wrap=place.angle_deg is None)
            looks.append(_look(place, name, picture, misread))
            place = None
    return looks


def _look(place: _Metadata, name: str, picture: PictureMarks, misread: Misread | None) -> Look:
    frame, panorama = int(place.frame_id), place.angle_deg is None
    # A panorama may be sent smaller than it is, a crop is as large as it was cut.
    scale = WIDTH / picture.size[0] if panorama else 1.0
    sightings = tuple(
        Sighting(
            frame,
            misread(picture.digest, mark) if misread else mark,
            box,
            complete,
            angle_of_column(place.left + (box.x + box.w / 2) * scale),
            picture.size[0],
        )
        for mark, box, complete in picture.readings
    )
    angle = AHEAD if place.angle_deg is None else place.angle_deg
    return Look(frame, angle, sightings, panorama, name, place.left, picture.size)


class StageReply(NamedTuple):
    """The reply to one stage; `missing` lists what was missing where it ends the question, else it is None."""

    reply: Mapping[str, Any]
    missing: list[str] | None = None


Play = Callable[[Request], StageReply]
"""Plays one stage: a pure function of the request. Raises DecodeError for a request that lacks a line."""
