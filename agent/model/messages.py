"""Messages to a model: text and pictures, in the forms that are sent, hashed and written to a transcript."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import msgspec

from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.method import Image, Observation, Panorama

JPEG_QUALITY: Final = 95


@dataclass(frozen=True)
class Picture:
    """JPEG bytes that are sent inline; `name` stands for them wherever bytes are left out.

    uri, digest: of the bytes, made with the picture: a cached property would be made under a lock that all pictures of
    a run share.
    """

    name: str
    data: bytes
    uri: str = field(init=False, repr=False, compare=False)
    digest: str = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "uri", "data:image/jpeg;base64," + base64.b64encode(self.data).decode())
        object.__setattr__(self, "digest", "sha256:" + hashlib.sha256(self.data).hexdigest())


Part = str | Picture


@dataclass(frozen=True)
class Message:
    """One chat message."""

    role: Literal["system", "user", "assistant"]
    parts: tuple[Part, ...]

    @property
    def text(self) -> str:
        """The message as a person reads it, each picture as `[image SEQUENCE FRAME ANGLE]`."""
        return "\n".join(part if isinstance(part, str) else f"[image {part.name}]" for part in self.parts)


def picture_of(seen: Observation | Panorama) -> Picture:
    """A crop as JPEG of quality 95; a panorama as it is stored, its file's bytes not encoded anew."""
    if isinstance(seen, Panorama):
        return Picture(f"{seen.sequence} {seen.frame_id} panorama", seen.jpeg)
    return jpeg_picture(f"{seen.sequence} {seen.frame_id} {seen.angle_deg:.12g}", seen.image)


def jpeg_picture(name: str, image: Image) -> Picture:
    """An RGB image as JPEG of quality 95. Raises ObserveError where it cannot be encoded."""
    import cv2

    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise ObserveError(f"the picture {name!r} cannot be written as JPEG")
    return Picture(name, data.tobytes())


def with_last_pictures(messages: Sequence[Message], most: int | None) -> list[Message]:
    """The messages with no pictures but the last `most`, or all for None; the lines that place the others stay."""
    pictures = sum(isinstance(part, Picture) for message in messages for part in message.parts)
    left = 0 if most is None else pictures - most
    found = []
    for message in messages:
        parts: list[Part] = []
        for part in message.parts:
            if isinstance(part, Picture) and left > 0:
                left -= 1
            else:
                parts.append(part)
        found.append(Message(message.role, tuple(parts)))
    return found


def metadata_of(seen: Observation | Panorama) -> dict[str, Any]:
    """The metadata of a picture that a model gets: where and when it was taken, nothing of what it shows."""
    metadata = {"frame_id": seen.frame_id, "timestamp": round(seen.timestamp, 3)}
    if isinstance(seen, Panorama):
        return metadata
    return metadata | {"angle_deg": seen.angle_deg, "fov_deg": round(seen.fov_deg, 2), "left": seen.left}


def metadata_line(seen: Observation | Panorama) -> str:
    """`metadata_of` as JSON on one line."""
    return msgspec.json.encode(metadata_of(seen)).decode()


def wire(messages: Sequence[Message]) -> list[dict[str, Any]]:
    """Messages in the chat-completions form, pictures as data URIs."""
    return [_message(message, lambda picture: picture.uri) for message in messages]


def fingerprint(messages: Sequence[Message]) -> list[dict[str, Any]]:
    """Messages in the chat-completions form with each picture's sha256 in place of its bytes."""
    return [_message(message, lambda picture: picture.digest) for message in messages]


def transcript(messages: Sequence[Message]) -> list[dict[str, str]]:
    """Messages as a person reads them: each picture as `[image SEQUENCE FRAME ANGLE]`, from which it can be redrawn."""
    return [{"role": message.role, "content": message.text} for message in messages]


def _message(message: Message, url: Callable[[Picture], str]) -> dict[str, Any]:
    if all(isinstance(part, str) for part in message.parts):
        return {"role": message.role, "content": message.text}
    content = [
        {"type": "text", "text": part}
        if isinstance(part, str)
        else {"type": "image_url", "image_url": {"url": url(part)}}
        for part in message.parts
    ]
    return {"role": message.role, "content": content}
