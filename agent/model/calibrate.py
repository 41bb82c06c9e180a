"""How a model writes boxes, found by asking: which reading explains its boxes of drawn rectangles?

The model is shown pictures of which it is known where the marked rectangle is, and asked for the box in the contract's
own words. Each reading (order of the numbers, scale) of each key that it writes is held against the known boxes. One is
chosen only if it explains the replies and no other does nearly as well. No question, and no true box of one, is
involved.

Drawn pictures of which it is known what they show, to learn how a model sees: no question's picture among them.

Each shows, on a plain background, one *marked* rectangle: filled with a colour that a prompt can name, and with a mark
of `schema.marks` in it, whose black and white grid a person, a model and the marker model can all tell from the plain
shapes round it. Everything follows from a seed.
"""

from __future__ import annotations

import functools
import hashlib
import math
import random
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import msgspec
import numpy as np

from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT_KEY, Convention, Order, Reading, Scale
from jrdb_avr.agent.model.decode import EVIDENCE_SCHEMA, closed_object, place_box, reply_object
from jrdb_avr.agent.model.messages import JPEG_QUALITY, Message, Picture, fingerprint
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.errors import DecodeError, ObserveError
from jrdb_avr.schema.markers import Image, Mark, draw
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, iou

CORNERS: Final = ("upper left", "upper right", "lower left", "lower right")

SHAPES: Final = ((CROP, CROP), (WIDTH, HEIGHT))
"""Width and height of the pictures that methods send: a crop, a panorama."""

_COLORS: Final = {
    "red": (185, 30, 30),
    "green": (30, 135, 45),
    "blue": (30, 70, 185),
    "yellow": (185, 165, 20),
    "purple": (125, 40, 145),
}
_GREY: Final = (105, 105, 105)
_GRAIN: Final = 8
_SIDE_PX: Final = (60, 180)
_HEIGHT_PX: Final = (90, 300)
_DISTRACTORS: Final = 5
_APART_PX: Final = 6
_TRIES: Final = 200


@dataclass(frozen=True)
class Drawn:
    """A picture of `width` x `height` pixels, and the marked rectangle's box and colour in it."""

    picture: Picture
    width: int
    height: int
    box: Box
    color: str


@functools.cache
def corner_picture(corner: str) -> Picture:
    """A crop-sized picture with a marked rectangle in one of the `CORNERS`."""
    w, h, edge = 150, 190, 15
    x = edge if corner.endswith("left") else CROP - edge - w
    y = edge if corner.startswith("upper") else CROP - edge - h
    image = _plain(CROP, CROP)
    _marked(image, Box(x, y, w, h), "red", 0)
    return _picture(f"drawn {corner}", image)


@functools.cache
def plain_crop() -> Picture:
    """A crop-sized picture that shows nothing."""
    return _picture("drawn nothing", _plain(CROP, CROP))


@functools.cache
def drawn_panorama(shows: bool) -> Picture:
    """A panorama of pixels that differ slightly, so that its file is as large as a real one's (650 kB); with a marked
    rectangle or without.
    """
    grain = np.random.default_rng(0).integers(-_GRAIN, _GRAIN + 1, (HEIGHT, WIDTH, 1), dtype=np.int8)
    image = (_plain(WIDTH, HEIGHT).astype(np.int16) + grain).astype(np.uint8)
    if shows:
        _marked(image, Box(1500, 130, 180, 240), "red", 0)
    return _picture(f"drawn panorama {shows}", image)


def drawn_rectangles(n: int, seed: int) -> list[Drawn]:
    """`n` pictures, crop- and panorama-shaped in turn, each with one marked rectangle among plain shapes."""
    rng = random.Random(seed)  # noqa: S311
    return [_drawn(rng, number, *SHAPES[number % len(SHAPES)]) for number in range(n)]


def _drawn(rng: random.Random, number: int, width: int, height: int) -> Drawn:
    image = _plain(width, height)
    color, *others = rng.sample(sorted(_COLORS), len(_COLORS))
    taken: list[Box] = [_place(rng, width, height, [])]
    for _ in range(_DISTRACTORS * (1 if width == height else 3)):
        try:
            taken.append(_place(rng, width, height, taken))
        except ObserveError:
            break
    for box in taken[1:]:
        _shape(image, box, rng.choice(others), rng.random() < 0.5)
    _marked(image, taken[0], color, rng.randrange(4096))
    return Drawn(_picture(f"drawn {number:03d} {width}x{height}", image), width, height, taken[0], color)


def _place(rng: random.Random, width: int, height: int, taken: Sequence[Box]) -> Box:
    """A free place. Raises ObserveError where none is found."""
    for _ in range(_TRIES):
        w, h = rng.randint(*_SIDE_PX), rng.randint(*_HEIGHT_PX)
        x, y = rng.randint(0, width - w), rng.randint(0, height - h)
        if all(
            x + w + _APART_PX <= b.x
            or b.x + b.w + _APART_PX <= x
            or y + h + _APART_PX <= b.y
            or b.y + b.h + _APART_PX <= y
            for b in taken
        ):
            return Box(x, y, w, h)
    raise ObserveError("there is no room for another shape")


def _plain(width: int, height: int) -> Image:
    return np.full((height, width, 3), _GREY, np.uint8)


def _shape(image: Image, box: Box, color: str, round_: bool) -> None:
    import cv2

    x, y, w, h = (int(v) for v in box)
    if round_:
        cv2.ellipse(image, (x + w // 2, y + h // 2), (w // 2, h // 2), 0, 0, 360, _COLORS[color], -1)
    else:
        cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), _COLORS[color], -1)


def _marked(image: Image, box: Box, color: str, identity: int) -> None:
    _shape(image, box, color, False)
    draw(image, box, Mark(identity))
    # The mark's frame has a colour of its own: the rectangle keeps the one that the prompt names. A plate comes no
    # nearer to the edge than two pixels.
    x, y, w, h = (int(v) for v in box)
    for thick in range(2):
        image[[y + thick, y + h - 1 - thick], x : x + w] = _COLORS[color]
        image[y : y + h, [x + thick, x + w - 1 - thick]] = _COLORS[color]


def _picture(name: str, image: Image) -> Picture:
    import cv2

    done, data = cv2.imencode(".jpg", image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise ObserveError(f"the picture {name!r} cannot be written as JPEG")
    return Picture(name, data.tobytes())


PICTURES: Final = 50
SEED: Final = 0
FRAME_ID: Final = "000150"
KEYS: Final = (CONTRACT_KEY, "bbox_2d", "box_2d", "box")
BOX_LINE: Final = "The rectangle's box, as one JSON object:"
SCHEMA: Final = closed_object({"evidence_bboxes": EVIDENCE_SCHEMA})

LEAST_REPLIES: Final = 10
"""With one key, for a reading of that key to be chosen."""
LEAST_READABLE: Final = 0.5
"""Share of all replies that hold a box at all."""
CLEAR: Final = 0.4
"""Share of a key's replies that the chosen reading brings to an overlap of one half."""
LEAD: Final = 0.2
"""By which that share exceeds that of every other reading, but for those that read the same boxes."""
_SAME: Final = 0.9
_IN_FLIGHT: Final = 8

# The plainest first: of readings that read the same boxes, the first is chosen.
_SCALES: Final[tuple[Scale, ...]] = ("thousandths", "pixels", "unit", "resized")
_ORDERS: Final[tuple[Order, ...]] = ("xyxy", "yxyx")
_READINGS: Final = tuple(Reading(order, scale) for scale in _SCALES for order in _ORDERS)


class Score(msgspec.Struct, frozen=True):
    """How well a reading explains the `n` replies under a key: their overlap (IoU) with the known boxes, its median and
    the share of 0.5 and more."""

    key: str
    order: Order
    scale: Scale
    n: int
    median_iou: float
    share: float
    chosen: bool = False


class Calibration(msgspec.Struct, frozen=True):
    """`STORE/conventions/<model>.json`: what was found of a model under one way of asking.

    `asked_sha256` covers everything that was asked; `boxes` and `scales` say how each chosen key is read, and are empty
    where no reading was clearly best: `reason` then says so.
    """

    model: str
    served_model: str
    response_format: str
    thinking: str
    asked_sha256: str
    asked: int
    readable: int
    scores: tuple[Score, ...]
    boxes: dict[str, Order]
    scales: dict[str, Scale]
    reason: str = ""

    def convention(self, declared: Convention) -> Convention:
        """The declared convention with the keys that were found read as was found."""
        return replace(
            declared, boxes={**declared.boxes, **self.boxes}, scales={**declared.scales, **self.scales}, calibrated=True
        )


class _Written(NamedTuple):
    """Four numbers that a model wrote under a key for a drawn rectangle."""

    key: str
    numbers: list[float]
    drawn: Drawn


def calibrate(
    client: Client, n: int = PICTURES, seed: int = SEED, advance: Callable[[int], None] = lambda steps: None
) -> Calibration:
    """Ask for `n` boxes and find the reading that explains them. Raises EndpointError."""
    pictures = drawn_rectangles(n, seed)
    asked = [request(drawn) for drawn in pictures]

    def ask(messages: Sequence[Message]) -> Reply:
        reply = client.complete(messages, SCHEMA)
        advance(1)
        return reply

    with ThreadPoolExecutor(_IN_FLIGHT) as pool:
        replies = list(pool.map(ask, asked))
    written = [
        found
        for reply, drawn in zip(replies, pictures, strict=True)
        if (found := _written(reply, drawn, client.convention)) is not None
    ]
    scores, reason = _judge(written, n, client.convention)
    served = list(dict.fromkeys(reply.model for reply in replies))
    if len(served) > 1:
        scores = [msgspec.structs.replace(score, chosen=False) for score in scores]
        reason = f"several models replied: {', '.join(map(ascii, served[:3]))}"
    chosen = [score for score in scores if score.chosen]
    way = [client.options.response_format, client.options.thinking]
    whole = [SCHEMA, way, [fingerprint(messages) for messages in asked]]
    return Calibration(
        model=client.model,
        served_model=served[0] if served else "",
        response_format=client.options.response_format,
        thinking=client.options.thinking,
        asked_sha256=hashlib.sha256(msgspec.json.encode(whole, order="sorted")).hexdigest(),
        asked=n,
        readable=len(written),
        scores=tuple(scores),
        boxes={score.key: score.order for score in chosen},
        scales={score.key: score.scale for score in chosen},
        reason=reason,
    )


def request(drawn: Drawn) -> list[Message]:
    """What a model is asked of a picture."""
    return [
        Message(
            "user",
            (
                render("calibrate", color=drawn.color, frame_id=FRAME_ID),
                drawn.picture,
                BOX_LINE,
            ),
        )
    ]


def _written(reply: Reply, drawn: Drawn, convention: Convention) -> _Written | None:
    """The box of a reply as it stands there; None where there is not exactly one of four finite numbers."""
    try:
        boxes = reply_object(reply, convention).get("evidence_bboxes")
    except DecodeError:
        return None
    entry = boxes[0] if isinstance(boxes, list) and len(boxes) == 1 else None
    keys = [key for key in KEYS if isinstance(entry, dict) and key in entry]
    if not isinstance(entry, dict) or len(keys) != 1:
        return None
    numbers = entry[keys[0]]
    if not isinstance(numbers, list) or len(numbers) != 4 or not all(map(_is_number, numbers)):
        return None
    return _Written(keys[0], numbers, drawn)


def _is_number(value: object) -> bool:
    return type(value) is int or (isinstance(value, float) and math.isfinite(value))


@dataclass(frozen=True)
class _Tried:
    """A reading of a key's replies: the boxes it gives (None: refused), and its score."""

    boxes: list[Box | None]
    score: Score


def _judge(written: Sequence[_Written], asked: int, convention: Convention) -> tuple[list[Score], str]:
    """Every reading's score, those chosen marked, and why none is chosen."""
    by_key = {key: [one for one in written if one.key == key] for key in KEYS}
    tried = {key: [_try(ones, reading, convention) for reading in _READINGS] for key, ones in by_key.items() if ones}
    scores, reasons = [], []
    for key, readings in tried.items():
        best, reason = _best(readings)
        if best is not None and best.score.n < LEAST_REPLIES:
            best, reason = None, ""  # Too few to say anything of; what is declared of the key stays.
        scores += [msgspec.structs.replace(one.score, chosen=one is best) for one in readings]
        if reason and readings[0].score.n >= LEAST_REPLIES:
            reasons.append(f"{key}: {reason}")
    if len(written) < LEAST_READABLE * asked:
        reasons = [f"only {len(written)} of {asked} replies hold a box: run preflight, and look at the model's replies"]
    elif not reasons and not any(score.chosen for score in scores):
        reasons = [f"no key was written {LEAST_REPLIES} times"]
    if reasons:
        scores = [msgspec.structs.replace(score, chosen=False) for score in scores]
    scores.sort(key=lambda score: (-score.n, score.key, -score.share, -score.median_iou))
    return scores, "; ".join(reasons)


def _best(readings: Sequence[_Tried]) -> tuple[_Tried | None, str]:
    best = max(readings, key=lambda one: (one.score.share, one.score.median_iou))
    # A reading that gives the same boxes, as pixels do where the model's resizing changes little, is no rival.
    best = next(one for one in readings if one is best or _same(one, best))
    told = f"{best.score.order} in {best.score.scale} explains {best.score.share:.0%} of {best.score.n}"
    if best.score.share < CLEAR:
        return None, f"no reading explains the boxes (the best, {told}): the declared convention stays"
    for rival in readings:
        if rival is not best and not _same(rival, best) and rival.score.share > best.score.share - LEAD:
            other = f"{rival.score.order} in {rival.score.scale} {rival.score.share:.0%}"
            return None, f"no reading is clearly the best ({told}, {other}): the declared convention stays"
    return best, ""


def _same(one: _Tried, other: _Tried) -> bool:
    overlaps = [iou(a, b) if a and b else float(a is b) for a, b in zip(one.boxes, other.boxes, strict=True)]
    return statistics.median(overlaps) >= _SAME


def _try(written: Sequence[_Written], reading: Reading, convention: Convention) -> _Tried:
    boxes = [_place_calibrate(one, reading, convention) for one in written]
    overlaps = [iou(box, one.drawn.box) if box else 0.0 for box, one in zip(boxes, written, strict=True)]
    share = sum(overlap >= 0.5 for overlap in overlaps) / len(overlaps)
    score = Score(
        written[0].key, reading.order, reading.scale, len(written), round(statistics.median(overlaps), 4), share
    )
    return _Tried(boxes, score)


def _place_calibrate(one: _Written, reading: Reading, convention: Convention) -> Box | None:
    try:
        return place_box(one.numbers, one.drawn.width, one.drawn.height, reading, convention)
    except DecodeError:
        return None
