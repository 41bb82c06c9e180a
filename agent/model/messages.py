"""Messages to a model, made of texts and pictures, and their forms in requests, hashes and transcripts."""

from __future__ import annotations

import base64
import hashlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import msgspec

from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.method import Image, Observation, Panorama

JPEG_QUALITY: Final = 95
REFERENCE_KEY: Final = "jrdb_avr"
"""Key of a picture's reference in the requests of a simulated run. No other request holds it."""


@dataclass(frozen=True)
class Picture:
    """A JPEG picture that is sent inside a request.

    name: the text that stands for the picture in a transcript. uri: the data URI. digest: the sha256 of the bytes.
    reference: what the picture shows. It is sent only to a simulated model, which reads annotations instead of pixels.
    """

    name: str
    data: bytes
    reference: Mapping[str, Any] = field(default_factory=dict, compare=False)
    uri: str = field(init=False, repr=False, compare=False)
    digest: str = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "uri", "data:image/jpeg;base64," + base64.b64encode(self.data).decode())
        object.__setattr__(self, "digest", "sha256:" + hashlib.sha256(self.data).hexdigest())

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, rounded up to multiples of 8. They are (0, 0) if the picture is broken."""
        import cv2
        import numpy as np

        image = cv2.imdecode(np.frombuffer(self.data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_8)
        return (0, 0) if image is None else (8 * image.shape[1], 8 * image.shape[0])


Part = str | Picture


@dataclass(frozen=True)
class Message:
    """One chat message."""

    role: Literal["system", "user", "assistant"]
    parts: tuple[Part, ...]

    @property
    def text(self) -> str:
        """The text of the message, with each picture as `[image SEQUENCE FRAME ANGLE]`."""
        return "\n".join(part if isinstance(part, str) else f"[image {part.name}]" for part in self.parts)


def picture_of(view: Observation | Panorama) -> Picture:
    """Return an observation as a picture.

    Args:
        view: A crop or a panorama. A crop is encoded as JPEG of quality 95. A panorama keeps the bytes of its file.

    Returns:
        The picture.
    """
    reference = {"sequence": view.sequence, "frame": view.frame_index, "angle": None}
    if isinstance(view, Panorama):
        return Picture(f"{view.sequence} {view.frame_index:06d} panorama", view.jpeg, reference)
    name = f"{view.sequence} {view.frame_index:06d} {view.angle_deg:.12g}"
    return jpeg_picture(name, view.image, reference | {"angle": view.angle_deg})


def jpeg_picture(name: str, image: Image, reference: Mapping[str, Any]) -> Picture:
    """Encode an image as JPEG of quality 95.

    Args:
        name: The name of the picture.
        image: The RGB pixels.
        reference: What the picture shows, as in `Picture`.

    Returns:
        The picture.

    Raises:
        ObserveError: If the image cannot be encoded.
    """
    import cv2

    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise ObserveError(f"the picture {name!r} cannot be written as JPEG")
    return Picture(name, data.tobytes(), reference)


def with_last_pictures(messages: Sequence[Message], most: int | None) -> list[Message]:
    """Return a chat without its older pictures.

    Args:
        messages: A chat.
        most: Number of newest pictures to keep. None keeps all pictures.

    Returns:
        The chat. The text before an omitted picture stays.
    """
    pictures = sum(isinstance(part, Picture) for message in messages for part in message.parts)
    left_out = 0 if most is None else pictures - most
    numbers = itertools.count()
    return [
        Message(
            message.role,
            tuple(part for part in message.parts if isinstance(part, str) or next(numbers) >= left_out),
        )
        for message in messages
    ]


def metadata_of(view: Observation | Panorama) -> dict[str, Any]:
    """Return the metadata of a picture that a model gets.

    Args:
        view: A crop or a panorama.

    Returns:
        The frame id and the time in seconds. For a crop also the angle and the width in degrees, and the left column in
            stitched pixels.
    """
    metadata = {"frame_id": f"{view.frame_index:06d}", "timestamp": round(view.timestamp, 3)}
    if isinstance(view, Panorama):
        return metadata
    return metadata | {"angle_deg": view.angle_deg, "fov_deg": round(view.fov_deg, 2), "left": view.left}


def metadata_line(view: Observation | Panorama) -> str:
    """Return the metadata of a picture as one line of JSON.

    Args:
        view: A crop or a panorama.

    Returns:
        The line.
    """
    return msgspec.json.encode(metadata_of(view)).decode()


def wire(messages: Sequence[Message], simulated: bool = False) -> list[dict[str, Any]]:
    """Return messages in the chat-completions form.

    Args:
        messages: A chat.
        simulated: Whether each picture gets its reference. Only runs that are declared simulated may set it.

    Returns:
        The messages, with pictures as data URIs.
    """
    return [_message(message, lambda picture: picture.uri, simulated) for message in messages]


def fingerprint(messages: Sequence[Message], simulated: bool = False) -> list[dict[str, Any]]:
    """Return messages in the chat-completions form, ready to be hashed.

    Args:
        messages: A chat.
        simulated: As in `wire`.

    Returns:
        The messages, with the sha256 of each picture in place of its bytes.
    """
    return [_message(message, lambda picture: picture.digest, simulated) for message in messages]


def transcript(messages: Sequence[Message]) -> list[dict[str, str]]:
    """Return messages in the form that a transcript stores.

    Args:
        messages: A chat.

    Returns:
        The role and the text of each message. The text contains the name of each picture, so that the picture can be
            made again.
    """
    return [{"role": message.role, "content": message.text} for message in messages]


def _message(message: Message, url: Callable[[Picture], str], simulated: bool) -> dict[str, Any]:
    if all(isinstance(part, str) for part in message.parts):
        return {"role": message.role, "content": message.text}

    def content(part: Part) -> dict[str, Any]:
        if isinstance(part, str):
            return {"type": "text", "text": part}
        reference = {REFERENCE_KEY: part.reference} if simulated else {}
        return {"type": "image_url", "image_url": {"url": url(part)}, **reference}

    return {"role": message.role, "content": [content(part) for part in message.parts]}
