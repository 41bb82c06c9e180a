"""How a model writes boxes, found by asking: which reading explains its boxes of drawn rectangles?

The model is shown pictures of which it is known where the marked rectangle is, and asked for the box in the contract's
own words. Each reading (order of the numbers, scale) of each key that it writes is held against the known boxes. One is
chosen only if it explains the replies and no other does nearly as well. No question, and no true box of one, is
involved.
"""

from __future__ import annotations

import hashlib
import math
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import msgspec

from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box, iou

from .boxes import place_box
from .client import Client
from .conventions import CONTRACT_KEY, Convention, Order, Reading, Scale
from .decode import EVIDENCE_SCHEMA, closed_object, reply_object
from .drawn import Drawn, drawn_rectangles
from .messages import Message, fingerprint
from .prompt import render
from .replies import Reply

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
    boxes = [_place(one, reading, convention) for one in written]
    overlaps = [iou(box, one.drawn.box) if box else 0.0 for box, one in zip(boxes, written, strict=True)]
    share = sum(overlap >= 0.5 for overlap in overlaps) / len(overlaps)
    score = Score(
        written[0].key, reading.order, reading.scale, len(written), round(statistics.median(overlaps), 4), share
    )
    return _Tried(boxes, score)


def _place(one: _Written, reading: Reading, convention: Convention) -> Box | None:
    try:
        return place_box(one.numbers, one.drawn.width, one.drawn.height, reading, convention)
    except DecodeError:
        return None
