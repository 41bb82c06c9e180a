"""Rendering: a template of this folder, with the style inside, as one HTML file."""

from __future__ import annotations

import base64
import functools
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from jrdb_avr.engine.console import clean
from jrdb_avr.engine.pages.svg import shortened
from jrdb_avr.engine.report.formats import cell
from jrdb_avr.queries.store import write_bytes
from jrdb_avr.schema.method import Image

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

JPEG_QUALITY: Final = 80
"""Of pictures in a page: it must stay a file that can be sent."""

_TURNING: Final = {code: f"[U+{code:04X}]" for code in (*range(0x202A, 0x202F), *range(0x2066, 0x206A))}


def render(name: str, **values: Any) -> str:
    """A template of this folder, filled in: style and scripts are inside, and nothing is fetched."""
    return _environment().get_template(name).render(values)


def write_page(path: Path, html: str) -> None:
    """Write a page, atomically. Raises StoreError where the disk refuses."""
    write_bytes(path, html.encode("utf-8", "replace"))


def jpeg_bytes(image: Image, size: tuple[int, int]) -> bytes:
    """An RGB picture as JPEG of a width and height."""
    import cv2

    if (image.shape[1], image.shape[0]) != size:
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(data.tobytes())


def jpeg_uri(data: bytes) -> str:
    """A JPEG as a data URI."""
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()


@functools.cache
def _environment() -> Environment:
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_text),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: value if isinstance(value, Markup) else _plain(value),
    )
    environment.filters |= {"cell": cell, "json": _json, "shortened": shortened}
    environment.globals["asset"] = lambda name: Markup(_text(name))  # noqa: S704 - files of this package
    return environment


def _plain(value: object) -> str:
    """A value without control characters, which would not survive as HTML and may mislead in an editor, and with the
    marks that turn the order of what follows them told by number: a reviewer must read what is stored."""
    return clean(value).translate(_TURNING)


def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text("utf-8")


def _json(value: object) -> Markup:
    """A value as JSON inside a <script>: no character in it can end the element or begin a comment."""
    from markupsafe import Markup

    text = msgspec.json.encode(value).decode()
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return Markup(text)  # noqa: S704 - escaped above
