"""What is asked of the marker model before a run: some object of a form, and where in a drawn picture the mark is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.schema.errors import DecodeError

from ..boxes import write_box
from ..calibrate import BOX_LINE
from ..preflight import CORNER_LINE
from .reading import Picture, Reader, lines_of, user_parts

_FRAME_ID: Final = re.compile(r'Picture 1: \{"frame_id": "(\d{6})"\}')


def check_reply(messages: Sequence[Mapping[str, Any]], response_format: object, reader: Reader) -> Mapping[str, Any]:
    """The reply to a request that is of no stage of a method. Raises DecodeError for a picture without one mark."""
    said = [parts for message in messages if (parts := user_parts(message)) is not None]
    lines = lines_of(said[-1]) if said else ()
    if lines[-1:] == (CORNER_LINE,):
        picture = _picture(said[-1], reader)
        box = picture.readings[0].box
        down = "lower" if box.y + box.h / 2 > picture.height / 2 else "upper"
        across = "right" if box.x + box.w / 2 > picture.width / 2 else "left"
        return {"corner": f"{down} {across}"}
    if lines[-1:] == (BOX_LINE,):
        picture = _picture(said[-1], reader)
        named = next((found[1] for line in lines if (found := _FRAME_ID.fullmatch(line))), "")
        written = write_box(picture.readings[0].box, picture.width, picture.height)
        return {"evidence_bboxes": [{"frame_id": named, "bbox": written}]}
    return _of_form(response_format)


def _picture(parts: Sequence[Mapping[str, Any]], reader: Reader) -> Picture:
    """The picture of a message, which shows one mark. Raises DecodeError."""
    for part in parts:
        image = part.get("image_url")
        if isinstance(image, dict) and isinstance(image.get("url"), str):
            picture = reader.picture(image["url"], wrap=False)
            if len(picture.readings) == 1:
                return picture
    raise DecodeError("the request lacks a picture with one mark")


def _of_form(response_format: object) -> Mapping[str, Any]:
    """An object that keeps to the request's JSON Schema, as far as its properties list what they may be."""
    match response_format:
        case {"json_schema": {"schema": {"properties": {**properties}}}}:
            return {str(name): _first(form) for name, form in properties.items()}
    return {"ok": True}


def _first(form: object) -> Any:
    match form:
        case {"enum": [first, *_]}:
            return first
    return True
