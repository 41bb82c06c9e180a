"""Questions as a page on which a person accepts or rejects them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.engine.inspection import Inspected
from jrdb_avr.engine.observe import Observer
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, to_crop

from .answers import readable
from .diagrams import plan_graph, proof_rows, timeline
from .page import jpeg_bytes, jpeg_uri, render

STRIP_WIDTH: Final = 1880
"""Pixels of a panorama in the page: half size, so that twenty questions stay a file that can be sent."""


@dataclass(frozen=True)
class Framed:
    """A box in the picture's own pixels, with its person's role."""

    role: str
    x: float
    y: float
    w: float
    h: float


@dataclass(frozen=True)
class View:
    """A picture with boxes; `missing` says why there is none."""

    title: str
    uri: str
    width: int
    height: int
    boxes: tuple[Framed, ...]
    missing: str = ""
    plate: float = 28.0


def inspect_page(
    questions: Sequence[Inspected], observer: Observer, questions_sha256: str, advance: Callable[[int], None]
) -> str:
    """The page's HTML; `advance` is told of each question done."""
    shown = []
    for number, one in enumerate(questions, 1):
        shown.append(_question(one, number, observer))
        advance(1)
    return render("inspect", questions=shown, count=len(shown), sha256=questions_sha256)


def _question(one: Inspected, number: int, observer: Observer) -> dict[str, Any]:
    question, stored = one.question, one.answer["answer"]
    right = msgspec.json.decode(stored, type=dict[str, Any]).get("choice")
    choices = [
        {"text": text, "right": place == right, "from": one.distractors[place - 1] if one.distractors else None}
        for place, text in enumerate(question["choices"], 1)
    ]
    return {
        "number": number,
        "id": question["question_id"],
        "sequence": question["sequence"],
        "template": question["template"],
        "family": question["family"],
        "text": question["question"],
        "choices": choices,
        "answer": "" if choices else readable(question["answer_mode"], stored, (), one.fps),
        "graph": plan_graph(one.plan),
        "timeline": timeline(one.lines, one.moments, one.frame_count, one.fps),
        "roles": {role: place for place, role in enumerate(one.people)},
        "people": one.people,
        "views": [_strip(one, frame, observer) for frame in one.frames],
        "crop": _crop(one, observer),
        "proofs": proof_rows(one.proofs),
    }


def _strip(one: Inspected, frame: int, observer: Observer) -> View:
    names = [name for name, at in one.moments.items() if at == frame]
    title = f"{', '.join(names) or 'decisive'}: frame {frame}, {frame / one.fps:.1f} s"
    try:
        image = observer.panorama(one.question["sequence"], frame)
    except ObserveError as error:
        return View(title, "", 0, 0, (), str(error))
    scale = STRIP_WIDTH / WIDTH
    boxes = [
        Framed(row["role"], (row["x"] + shift) * scale, row["y"] * scale, row["w"] * scale, row["h"] * scale)
        for row in one.boxes[frame]
        for shift in (-WIDTH, 0, WIDTH)
        if row["x"] + shift < WIDTH and row["x"] + shift + row["w"] > 0
    ]
    height = round(HEIGHT * scale)
    return View(title, jpeg_uri(jpeg_bytes(image, (STRIP_WIDTH, height))), STRIP_WIDTH, height, tuple(boxes))


def _crop(one: Inspected, observer: Observer) -> View:
    frame, row = one.decisive
    angle = float(center_angle(row["x"], row["w"]))
    title = f"what answers it: {row['node'].upper()} in frame {frame}, angle {angle:.1f}\N{DEGREE SIGN}"
    try:
        seen = observer(one.question["sequence"], frame, angle)
    except ObserveError as error:
        return View(title, "", 0, 0, (), str(error))
    box = to_crop(Box(row["x"], row["y"], row["w"], row["h"]), seen.left)
    return View(title, jpeg_uri(jpeg_bytes(seen.image, (CROP, CROP))), CROP, CROP, (Framed(row["node"], *box),))
