"""Functions that render templates, and that turn pictures into data URIs and answers into words."""

from __future__ import annotations

import base64
import functools
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from jrdb_avr.engine.pages.svg import NODE_WIDTH, shortened
from jrdb_avr.engine.report.formats import cell
from jrdb_avr.engine.report.truth import read_answer
from jrdb_avr.engine.text_table import clean
from jrdb_avr.queries.files import write_bytes
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.plan import parse_plan

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

_QUALITY: Final = 70
"""WebP quality of pictures. WebP files are half as large as JPEG files of the same quality."""


def render(name: str, **values: Any) -> str:
    """Render a template of this folder. The page contains its styles and scripts.

    Args:
        name: File name of the template.
        **values: Values of the template's variables, by name.

    Returns:
        The HTML.
    """
    return environment().get_template(name).render(values)


def write_page(path: Path, html: str) -> None:
    """Write a page to a file atomically.

    Args:
        path: The file.
        html: The HTML of the page.

    Raises:
        StoreError: If the file cannot be written.
    """
    write_bytes(path, html.encode("utf-8", "replace"))


def picture_uri(image: Image, size: tuple[int, int]) -> str:
    """Encode a picture as the data URI of a WebP file.

    Args:
        image: The RGB picture (height, width, 3).
        size: Width and height of the encoded picture in pixels. The picture is scaled to this size.

    Returns:
        The data URI.
    """
    import cv2

    if (image.shape[1], image.shape[0]) != size:
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".webp", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()


def on_strip(box: Box, width: float) -> list[Box]:
    """Scale a box to a panorama of another width.

    Args:
        box: The box in stitched pixels.
        width: Width of the scaled panorama in pixels.

    Returns:
        A list with the scaled box. For a box that crosses the seam, a list of two boxes, one at each end of the
        panorama.
    """
    scale = width / WIDTH
    shifts = [shift for shift in (-WIDTH, 0, WIDTH) if box.x + shift < WIDTH and box.x + shift + box.w > 0]
    return [Box((box.x + shift) * scale, box.y * scale, box.w * scale, box.h * scale) for shift in shifts]


@functools.cache
def environment() -> Environment:
    """Return the Jinja environment of the pages. It escapes all values, and an undefined variable raises an error."""
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_text),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: value if isinstance(value, Markup) else clean(value),
    )
    environment.filters |= {"cell": functools.partial(cell, decimals=1), "json": _json, "shortened": shortened}
    environment.globals |= {"asset": lambda name: Markup(_text(name)), "node_width": NODE_WIDTH}  # noqa: S704 - own files
    return environment


def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text("utf-8")


def _json(value: object) -> Markup:
    """Return a value as JSON for a <script> element. The JSON cannot end the element or begin a comment."""
    from markupsafe import Markup

    text = clean(msgspec.json.encode(value).decode())
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return Markup(text)  # noqa: S704 - escaped above


def readable(mode: str, text: str | None, choices: Sequence[str], fps: float, unit: str = "") -> str:
    """Return a stored answer in words.

    Args:
        mode: The answer mode of the question.
        text: The answer as JSON, or None if there is no answer.
        choices: Texts of the choices, in order.
        fps: Frames per second of the sequence.
        unit: Unit of an answer that is a number (see `unit_of`).

    Returns:
        The answer in words, or an empty text if there is no answer. A text that is not a valid answer under the mode is
        returned unchanged.
    """
    if (answer := read_answer(mode, text)) is None:
        return text or ""
    write: dict[str, Callable[[Any], str]] = {
        "choice": lambda choice: f"{choice}: {choices[choice - 1] if choice <= len(choices) else 'no such choice'}",
        "frame": lambda frame: _at(frame, fps),
        "angle": lambda angle: f"{angle:.1f}\N{DEGREE SIGN}",
        "decimal": lambda value: f"{value:.2f}".removesuffix(".00") + (f" {unit}" if unit else ""),
    }
    record = MODES[mode]
    return record.phrase.format_map({name: write[kind](getattr(answer, name)) for name, kind in record.fields})


def unit_of(plan: str) -> str:
    """Return the unit of the answer to a question.

    Args:
        plan: The plan of the question as JSON. It is empty for an imported question.

    Returns:
        The unit, or an empty text if the answer has no known unit.
    """
    return {"seconds_between": "s", "count": "people"}.get(parse_plan(plan).answer.read, "") if plan else ""


def _at(frame: int, fps: float) -> str:
    return f"frame {frame} ({frame / fps:.1f} s)"
