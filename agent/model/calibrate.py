"""Find how a model writes boxes: which reading explains its boxes of drawn rectangles?

The model gets pictures in which the place of the marked rectangle is known, and writes its box in the contract's own
words. Each reading (order of the numbers, scale) of each key that it writes is compared with the known boxes. A reading
is chosen only if it explains the replies and no other does nearly as well. No question, and no true box of one, is
involved.
"""

from __future__ import annotations

import hashlib
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final, NamedTuple, get_args

import msgspec

from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT_KEY, Convention, Order, Reading, Scale
from jrdb_avr.agent.model.decode import EVIDENCE_SCHEMA, closed_object, finite, place_box, reply_object
from jrdb_avr.agent.model.messages import Message, fingerprint
from jrdb_avr.agent.model.probes import BOX_LINE, DrawnPicture, drawn_rectangles
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box, iou

PICTURES: Final = 50
SEED: Final = 0
FRAME_ID: Final = "000150"
KEYS: Final = (CONTRACT_KEY, "bbox_2d", "box_2d", "box")
BOX_REPLY_SCHEMA: Final = closed_object({"evidence_bboxes": EVIDENCE_SCHEMA})

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
_READINGS: Final = tuple(Reading(order, scale) for scale in _SCALES for order in get_args(Order))


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
    """`STORE/conventions/<model>.json`: what was found of a model under one way of requesting boxes.

    `asked_sha256` covers every request, `asked` counts them. `boxes` and `scales` say how each chosen key is read, and
    are empty where no reading was clearly best: `reason` then says so.
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
    """Four numbers that a model wrote under a key for the rectangle of a drawn picture."""

    key: str
    numbers: list[float]
    drawn: DrawnPicture


def calibrate(client: Client, n: int = PICTURES, advance: Callable[[int], None] = lambda steps: None) -> Calibration:
    """Request `n` boxes and find the reading that explains them. Raises EndpointError."""
    pictures = drawn_rectangles(n, SEED)
    requests = [request(drawn) for drawn in pictures]

    def complete(messages: Sequence[Message]) -> Reply:
        reply = client.complete(messages, BOX_REPLY_SCHEMA)
        advance(1)
        return reply

    with ThreadPoolExecutor(_IN_FLIGHT) as pool:
        replies = list(pool.map(complete, requests))
    boxes = [_written(reply, drawn, client.convention) for reply, drawn in zip(replies, pictures, strict=True)]
    written = [box for box in boxes if box is not None]
    scores, reason = _judge(written, n, client.convention)
    served = list(dict.fromkeys(reply.model for reply in replies))
    if len(served) > 1:
        reason = f"several models replied: {', '.join(map(ascii, served[:3]))}"
    if reason:
        scores = [msgspec.structs.replace(score, chosen=False) for score in scores]
    chosen = [score for score in scores if score.chosen]
    options = client.options
    sent = [fingerprint(messages) for messages in requests]
    whole = [BOX_REPLY_SCHEMA, [options.response_format, options.thinking], sent]
    return Calibration(
        model=client.model,
        served_model=served[0] if served else "",
        response_format=options.response_format,
        thinking=options.thinking,
        asked_sha256=hashlib.sha256(msgspec.json.encode(whole, order="sorted")).hexdigest(),
        asked=n,
        readable=len(written),
        scores=tuple(scores),
        boxes={score.key: score.order for score in chosen},
        scales={score.key: score.scale for score in chosen},
        reason=reason,
    )


def request(drawn: DrawnPicture) -> list[Message]:
    """The messages that request the box of a picture's rectangle."""
    return [Message("user", (render("calibrate", color=drawn.color, frame_id=FRAME_ID), drawn.picture, BOX_LINE))]


def _written(reply: Reply, drawn: DrawnPicture, convention: Convention) -> _Written | None:
    """The box of a reply as it stands there; None where there is not exactly one of four finite numbers."""
    try:
        boxes = reply_object(reply, convention).get("evidence_bboxes")
    except DecodeError:
        return None
    entry: Any = boxes[0] if isinstance(boxes, list) and len(boxes) == 1 else None
    found = [(key, entry[key]) for key in KEYS if isinstance(entry, dict) and key in entry]
    key, numbers = found[0] if len(found) == 1 else ("", None)
    if isinstance(numbers, list) and len(numbers) == 4 and all(finite(number) is not None for number in numbers):
        return _Written(key, numbers, drawn)
    return None


class _Tried(NamedTuple):
    """A reading of a key's replies: the boxes it gives (None: refused), and its score."""

    boxes: list[Box | None]
    score: Score

    def same(self, other: _Tried) -> bool:
        """Whether the other reading gives the same boxes, as pixels do where the model's resizing changes little."""
        overlaps = [iou(a, b) if a and b else float(a is b) for a, b in zip(self.boxes, other.boxes, strict=True)]
        return statistics.median(overlaps) >= _SAME


def _judge(written: Sequence[_Written], n: int, convention: Convention) -> tuple[list[Score], str]:
    """Every reading's score, the chosen ones marked, and why none is to be chosen."""
    scores: list[Score] = []
    reasons = []
    for key in KEYS:
        if boxes := [one for one in written if one.key == key]:
            readings = [_try(boxes, reading, convention) for reading in _READINGS]
            # A key with few replies keeps its declared reading.
            best, reason = _best(readings) if len(boxes) >= LEAST_REPLIES else (None, "")
            scores += [msgspec.structs.replace(one.score, chosen=one is best) for one in readings]
            reasons += [f"{key}: {reason}"] if reason else []
    if len(written) < LEAST_READABLE * n:
        reasons = [f"only {len(written)} of {n} replies hold a box: run preflight, and look at the model's replies"]
    elif not reasons and not any(score.chosen for score in scores):
        reasons = [f"no key was written {LEAST_REPLIES} times"]
    scores.sort(key=lambda score: (-score.n, score.key, -score.share, -score.median_iou))
    return scores, "; ".join(reasons)


def _best(readings: Sequence[_Tried]) -> tuple[_Tried | None, str]:
    best = max(readings, key=lambda one: (one.score.share, one.score.median_iou))
    # Of readings that give the same boxes the first, the plainest, is chosen; the others are no rivals.
    best = next(one for one in readings if one is best or one.same(best))
    name = f"{best.score.order} in {best.score.scale} explains {best.score.share:.0%} of {best.score.n}"
    if best.score.share < CLEAR:
        return None, f"no reading explains the boxes (the best, {name}): the declared convention stays"
    for rival in readings:
        if rival is not best and not rival.same(best) and rival.score.share > best.score.share - LEAD:
            other = f"{rival.score.order} in {rival.score.scale} {rival.score.share:.0%}"
            return None, f"no reading is clearly the best ({name}, {other}): the declared convention stays"
    return best, ""


def _try(written: Sequence[_Written], reading: Reading, convention: Convention) -> _Tried:
    boxes = [_box(one, reading, convention) for one in written]
    overlaps = [iou(box, one.drawn.box) if box else 0.0 for box, one in zip(boxes, written, strict=True)]
    share, median = sum(overlap >= 0.5 for overlap in overlaps) / len(overlaps), round(statistics.median(overlaps), 4)
    return _Tried(boxes, Score(written[0].key, reading.order, reading.scale, len(written), median, share))


def _box(one: _Written, reading: Reading, convention: Convention) -> Box | None:
    try:
        return place_box(one.numbers, one.drawn.size, reading, convention)
    except DecodeError:
        return None
