"""What a request says: the question, the legal frames, and the marks in its pictures."""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

import msgspec

from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.marks import Mark, Reading, read
from jrdb_avr.schema.panorama import CROP, Box, angle_of_column
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.wording import parse

from ..prompt import read_frame_ranges

_PICTURE: Final = re.compile(r"Picture \d+(?:, the newest)?: (\{.*\})")
_LOOKS_LEFT: Final = re.compile(r"^Looks made: \d+, left: (\d+)$", re.MULTILINE)
_CHOICE: Final = re.compile(r"^\d+\. (.+)$", re.MULTILINE)
_URI: Final = "data:image/jpeg;base64,"


@dataclass(frozen=True)
class Sighting:
    """A mark read in a picture: whose, where in the crop (pixels), and the panorama angle of the box's centre."""

    frame: int
    mark: Mark
    box: Box
    complete: bool
    angle: float

    @property
    def whole(self) -> bool:
        """Whether the crop shows the box from side to side."""
        return self.box.x >= 0 and self.box.x + self.box.w <= CROP


@dataclass(frozen=True)
class Look:
    """A picture that was sent, and what was read in it."""

    frame: int
    angle: float
    sightings: tuple[Sighting, ...]

    def of(self, identity: int) -> Sighting | None:
        return next((s for s in self.sightings if s.mark.identity == identity), None)


@dataclass(frozen=True)
class Task:
    """A ReAct turn as the marker understands it."""

    question: str
    template: str
    plan: Plan
    choices: tuple[str, ...]
    frames: tuple[int, ...]
    looks: tuple[Look, ...]
    looks_left: int


class _Metadata(msgspec.Struct):
    frame_id: Annotated[str, msgspec.Meta(pattern="^[0-9]{6}$")]
    angle_deg: float
    left: int


class Reader:
    """Reads marks from data URIs; remembers by hash what it has read, as every turn sends all pictures again."""

    def __init__(self, remembered: int = 8192) -> None:
        self._seen: OrderedDict[bytes, tuple[Reading, ...]] = OrderedDict()
        self._remembered = remembered
        self._lock = threading.Lock()

    def readings(self, uri: str) -> tuple[Reading, ...]:
        """The marks in a JPEG given as a data URI. Raises DecodeError for anything else."""
        key = hashlib.sha256(uri.encode()).digest()
        with self._lock:
            if key in self._seen:
                self._seen.move_to_end(key)
                return self._seen[key]
        found = tuple(read(_image(uri)))
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
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB) if data else None
    if image is None:
        raise DecodeError("an image of the request is no readable JPEG")
    return image


def read_task(messages: Sequence[dict[str, Any]], reader: Reader) -> Task | None:
    """The task of a ReAct turn; None for a conversation about something else.

    Raises DecodeError for a question or a picture that cannot be read.
    """
    content = messages[-1].get("content") if messages else None
    parts = [{"type": "text", "text": content}] if isinstance(content, str) else content
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
        return None
    texts = [part["text"] for part in parts if isinstance(part.get("text"), str)]
    text = "\n".join(texts)
    question, frames = _line(text, "Question: "), _line(text, "Legal frames: ")
    left = _LOOKS_LEFT.search(text)
    if question is None or frames is None or left is None:
        return None
    try:
        template, plan = parse(question)
    except PlanError as error:
        raise DecodeError(f"the marker model does not know this question: {error}") from None
    choices = text.partition("\nChoices:\n")[2].partition("\nLegal frames: ")[0]
    legal = tuple(read_frame_ranges(frames))
    if not legal:
        raise DecodeError("the prompt names no legal frame")
    return Task(
        question,
        template,
        plan,
        tuple(_CHOICE.findall(choices)),
        legal,
        tuple(_looks(parts, reader)),
        int(left[1]),
    )


def _line(text: str, start: str) -> str | None:
    return next((line.removeprefix(start) for line in text.split("\n") if line.startswith(start)), None)


def _looks(parts: Sequence[dict[str, Any]], reader: Reader) -> list[Look]:
    looks = []
    place: _Metadata | None = None
    for part in parts:
        named = _PICTURE.fullmatch(str(part.get("text", "")))
        if named:
            try:
                place = msgspec.json.decode(named[1], type=_Metadata)
            except msgspec.DecodeError as error:
                raise DecodeError(f"a picture's line cannot be read: {error}") from None
        elif part.get("type") == "image_url" and place is not None:
            image = part.get("image_url")
            readings = reader.readings(str(image.get("url") if isinstance(image, dict) else image))
            looks.append(_look(place, readings))
            place = None
    return looks


def _look(place: _Metadata, readings: Sequence[Reading]) -> Look:
    frame = int(place.frame_id)
    sightings = [
        Sighting(frame, r.mark, r.box, r.complete, angle_of_column(place.left + r.box.x + r.box.w / 2))
        for r in readings
    ]
    return Look(frame, place.angle_deg, tuple(sightings))
