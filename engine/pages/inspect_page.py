"""Questions as a page on which a person accepts or rejects them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.answers import readable, unit_of
from jrdb_avr.engine.pages.inspect_data import Inspected
from jrdb_avr.engine.pages.page import jpeg_bytes, jpeg_uri, render
from jrdb_avr.engine.pages.svg import plan_graph, proof_rows, timeline
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, to_crop

STRIP_WIDTH: Final = 1880
"""Pixels of a panorama in the page: half size, so that twenty questions stay a file that can be sent."""

NEAR: Final = 220
"""Pixels of a close-up's side."""

_NEAR_LEAST: Final = 110.0
"""Panorama pixels of a close-up's side at least: some room round a small person."""


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
    near: tuple[View, ...] = ()
    """Close-ups of its people."""


def inspect_page(
    questions: Sequence[Inspected], observer: Observer, questions_sha256: str, advance: Callable[[int], None]
) -> str:
    """The page's HTML; `advance` is told of each question done."""
    shown = []
    for number, one in enumerate(questions, 1):
        shown.append(_question(one, number, observer))
        advance(1)
    return render("inspect.html", questions=shown, count=len(shown), sha256=questions_sha256)


def _question(one: Inspected, number: int, observer: Observer) -> dict[str, Any]:
    question, stored = one.question, one.answer["answer"]
    right = msgspec.json.decode(stored, type=dict[str, Any]).get("choice")
    choices = [
        {"text": text, "right": place == right, "from": _wrong(one, place)}
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
        "answer": "" if choices else readable(question["answer_mode"], stored, (), one.fps, unit_of(one.plan)),
        "graph": plan_graph(one.plan),
        "timeline": timeline(one.lines, one.moments, one.frame_count, one.fps),
        "roles": {role: place for place, role in enumerate(one.people)} | dict.fromkeys(one.counted, len(one.people)),
        "people": one.people,
        "counted": one.counted,
        "views": [_strip(one, frame, observer) for frame in one.frames],
        "crop": _crop(one, observer),
        "proofs": proof_rows([{**proof, "answer": _then(one, proof["answer"])} for proof in one.proofs]),
    }


def _then(one: Inspected, answer: str) -> str:
    """The answer that a proof came to, in words; a choice stands there as its text."""
    mode = one.question["answer_mode"]
    return answer if one.question["choices"] else readable(mode, answer, (), one.fps, unit_of(one.plan))


def _wrong(one: Inspected, place: int) -> str:
    """What a wrong choice is true of: the perturbation by its name, and where it stops at somebody, who that is."""
    name = one.distractors[place - 1] if one.distractors else None
    stop = re.fullmatch(r"hop\.stop\((\d)\)", name or "")
    roles = list(one.people)
    if stop is not None and int(stop[1]) < len(roles):
        return f"{roles[int(stop[1])].upper()} ({name})"
    return name or ""


def _strip(one: Inspected, frame: int, observer: Observer) -> View:
    title = f"frame {frame}, {frame / one.fps:.1f} s"
    if names := [_moment(one, name) for name, at in one.shown.items() if at == frame]:
        title = f"{', '.join(names)}: {title}"
    if absent := one.people.keys() - {row["role"] for row in one.boxes[frame]}:
        title += f"; no box of {', '.join(sorted(absent)).upper()}"
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
    uri = jpeg_uri(jpeg_bytes(image, (STRIP_WIDTH, height)))
    near = tuple(close_up(row, image, frame) for row in one.boxes[frame] if row["role"] in one.people)
    return View(title, uri, STRIP_WIDTH, height, tuple(boxes), near=near)


def _moment(one: Inspected, name: str) -> str:
    """A named time; where it lies between annotated frames, which it is."""
    frame = one.moments[name]
    return name if frame == one.shown[name] else f"{name} (frame {frame}, between two annotated)"


def close_up(row: Mapping[str, Any], image: Image, frame: int) -> View:
    """A person with some room round, square; over the seam where it lies there."""
    side = int(min(max(1.5 * max(row["w"], row["h"]), _NEAR_LEAST), HEIGHT))
    left = int(row["x"] + row["w"] / 2 - side / 2)
    top = int(min(max(row["y"] + row["h"] / 2 - side / 2, 0), HEIGHT - side))
    cut = np.take(image, np.arange(left, left + side), axis=1, mode="wrap")[top : top + side]
    scale = NEAR / side
    box = Framed(row["role"], (row["x"] - left) * scale, (row["y"] - top) * scale, row["w"] * scale, row["h"] * scale)
    title = f"{row['role'].upper()} in frame {frame}"
    return View(title, jpeg_uri(jpeg_bytes(cut, (NEAR, NEAR))), NEAR, NEAR, (box,), plate=24.0)


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
