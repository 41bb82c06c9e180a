"""Find out how a model writes boxes, and how its errors repeat.

The model gets pictures of red rectangles with known boxes. The prompts request boxes in the same words as the
prompts of a run. A reading is an order and a scale of the four numbers of a box. For each JSON key under which the
model writes boxes, the boxes that result from every reading are compared with the known boxes. A reading is chosen only
if it explains the replies well, and no other reading explains the replies nearly as well.

The model also gets crops of labelled people, each person three times. The errors in two readings of one label give the
weights of repeated readings (`schema.repeats`). No question of a store is used.
"""

from __future__ import annotations

import functools
import hashlib
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final, NamedTuple, get_args

import msgspec

from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT_KEY, Convention, Order, Reading, Scale
from jrdb_avr.agent.model.decode import closed_object, finite, place_box, read_each, reply_object
from jrdb_avr.agent.model.labelled_people import PERSON_SCHEMA, LabelledPerson, find_errors, request_labels
from jrdb_avr.agent.model.messages import Message, fingerprint
from jrdb_avr.agent.model.probes import BOX_LINE, DrawnPicture, drawn_rectangles
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.model.schemas import evidence_schema
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box, iou
from jrdb_avr.schema.repeats import USUAL_REPEATS as _USUAL
from jrdb_avr.schema.repeats import ErrorCorrelation, Repeats, correlate_errors

PICTURES: Final = 50
SEED: Final = 0
FRAME_ID: Final = "000150"
KEYS: Final = (CONTRACT_KEY, "bbox_2d", "box_2d", "box")
BOX_REPLY_SCHEMA: Final = closed_object({"evidence_bboxes": evidence_schema()})

LEAST_REPLIES: Final = 10
"""Minimum number of replies that write their box under a key. With fewer replies, no reading of the key is chosen."""
LEAST_READABLE: Final = 0.5
"""Minimum share of replies that hold a box, among all replies."""
CLEAR: Final = 0.4
"""Minimum share of a key's replies that, under the chosen reading, have an IoU of at least 0.5 with the known box."""
LEAD: Final = 0.2
"""Minimum lead of the chosen reading's share (as in `CLEAR`) over the share of any reading that gives other boxes."""
_SAME: Final = 0.9
_IN_FLIGHT: Final = 8

# The simplest reading comes first, because the first of several readings that give the same boxes is chosen.
_READINGS: Final = tuple(Reading(order, scale) for scale in get_args(Scale) for order in get_args(Order))


class Score(msgspec.Struct, frozen=True):
    """Measure of how well a reading explains the replies that write their box under one JSON key.

    key: the JSON key. order, scale: the reading. n: the number of replies with this key. median_iou: the median IoU
    of the boxes in these replies with the known boxes. share: the share of these replies with an IoU of at least 0.5.
    chosen: whether the reading is chosen for the key.
    """

    key: str
    order: Order
    scale: Scale
    n: int
    median_iou: float
    share: float
    chosen: bool = False


class Calibration(msgspec.Struct, frozen=True):
    """The result of a calibration, which is stored as `STORE/conventions/<model>.json`.

    model: the model id that the requests named. served_model: the model id that the first reply named. response_format,
    thinking: the request settings for which the readings hold. asked: the number of requests. asked_sha256: the hash of
    the requests. readable: the number of replies with a box. scores: one score for each reading of each JSON key that
    the replies use. boxes: the order of the numbers, for each JSON key with a chosen reading. scales: the scale of the
    numbers, for each JSON key with a chosen reading. `boxes` and `scales` are empty if no reading was chosen. reason:
    why no reading was chosen, or "". frame_errors, person_errors: the correlation of the errors in two crops of one
    frame, and in two frames a second apart.
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
    frame_errors: ErrorCorrelation = ErrorCorrelation()
    person_errors: ErrorCorrelation = ErrorCorrelation()

    @property
    def repeats(self) -> Repeats:
        """The weights of repeated readings. A weight that could not be measured is the usual one."""
        return Repeats(self.frame_errors.weight(_USUAL.frame), self.person_errors.weight(_USUAL.person))

    def convention(self, declared: Convention) -> Convention:
        """Return a convention with the calibrated readings.

        Args:
            declared: The convention of the model's family.

        Returns:
            The declared convention with the readings of this calibration instead of the declared readings.
        """
        return replace(
            declared, boxes={**declared.boxes, **self.boxes}, scales={**declared.scales, **self.scales}, calibrated=True
        )


class _Written(NamedTuple):
    """The box of one reply: its JSON key, its four numbers, and the drawn rectangle that the request showed."""

    key: str
    numbers: list[float]
    drawn: DrawnPicture


def calibrate(
    client: Client,
    n: int = PICTURES,
    advance: Callable[[int], None] = lambda steps: None,
    people: Sequence[LabelledPerson] = (),
) -> Calibration:
    """Request boxes of drawn rectangles and labels of people, and find for each JSON key the reading of boxes.

    Args:
        client: The client of the model's server.
        n: The number of pictures of rectangles.
        people: The labelled people. Each one needs three requests.
        advance: Called with 1 after each reply.

    Returns:
        The calibration. If no reading was chosen, the calibration states the reason.

    Raises:
        EndpointError: If the server refuses a request, or if all retries fail.
    """
    pictures = drawn_rectangles(n, SEED)
    views = [view for person in people for view in person]
    requests = [(request(drawn), BOX_REPLY_SCHEMA) for drawn in pictures]
    requests += [(request_labels(view), PERSON_SCHEMA) for view in views]
    replies = []
    with ThreadPoolExecutor(_IN_FLIGHT) as pool:
        for reply in pool.map(lambda request: client.complete(*request), requests):
            replies.append(reply)
            advance(1)
    labels = [find_errors(reply, view, client.convention) for reply, view in zip(replies[n:], views, strict=True)]
    boxes = [_written(reply, drawn, client.convention) for reply, drawn in zip(replies[:n], pictures, strict=True)]
    written = [box for box in boxes if box is not None]
    scores, reason = _judge(written, n, client.convention)
    served = list(dict.fromkeys(reply.model for reply in replies))
    if len(served) > 1:
        reason = f"several models replied: {', '.join(map(ascii, served[:3]))}"
    if reason:
        scores = [msgspec.structs.replace(score, chosen=False) for score in scores]
    chosen = [score for score in scores if score.chosen]
    options = client.options
    whole = [[options.response_format, options.thinking], [(fingerprint(sent), schema) for sent, schema in requests]]
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
        frame_errors=correlate_errors(labels[0::3], labels[1::3]),
        person_errors=correlate_errors(labels[0::3], labels[2::3]),
    )


def request(drawn: DrawnPicture) -> list[Message]:
    """Return the messages that request the box of a rectangle.

    Args:
        drawn: The picture.

    Returns:
        One user message.
    """
    return [Message("user", (render("calibrate", frame_id=FRAME_ID), drawn.picture, BOX_LINE))]


def _written(reply: Reply, drawn: DrawnPicture, convention: Convention) -> _Written | None:
    """Return the box of a reply. Return None if the reply does not have exactly one box of four finite numbers."""
    try:
        boxes = reply_object(reply, convention).get("evidence_bboxes")
    except DecodeError:
        return None
    entry: Any = boxes[0] if isinstance(boxes, list) and len(boxes) == 1 else None
    boxed = [(key, entry[key]) for key in KEYS if isinstance(entry, dict) and key in entry]
    key, numbers = boxed[0] if len(boxed) == 1 else ("", None)
    if isinstance(numbers, list) and len(numbers) == 4 and None not in map(finite, numbers):
        return _Written(key, numbers, drawn)
    return None


class _Tried(NamedTuple):
    """The result of applying one reading to the replies that write their box under one JSON key.

    boxes: one box per reply, None if the box is invalid under this reading. score: the score of the reading.
    """

    boxes: tuple[Box | None, ...]
    score: Score

    def is_same(self, tried: _Tried) -> bool:
        """Return whether this reading and another reading give nearly the same boxes."""
        overlaps = [iou(a, b) if a and b else float(a is b) for a, b in zip(self.boxes, tried.boxes, strict=True)]
        return statistics.median(overlaps) >= _SAME


def _judge(written: Sequence[_Written], n: int, convention: Convention) -> tuple[list[Score], str]:
    """Return the scores, and the reason why no reading may be chosen, or "".

    There is one score for each reading of each JSON key that the replies use.
    """
    scores: list[Score] = []
    reasons = []
    for key in KEYS:
        if boxes := [box for box in written if box.key == key]:
            readings = [_try(boxes, reading, convention) for reading in _READINGS]
            # A key with few replies keeps its declared reading.
            best, reason = _best(readings) if len(boxes) >= LEAST_REPLIES else (None, "")
            scores += [msgspec.structs.replace(tried.score, chosen=tried is best) for tried in readings]
            reasons += [f"{key}: {reason}"] if reason else []
    if len(written) < LEAST_READABLE * n:
        reasons = [f"only {len(written)} of {n} replies hold a box: run preflight, and look at the model's replies"]
    elif not reasons and not any(score.chosen for score in scores):
        reasons = [f"no key was written {LEAST_REPLIES} times"]
    scores.sort(key=lambda score: (-score.n, score.key, -score.share, -score.median_iou))
    return scores, "; ".join(reasons)


def _best(readings: Sequence[_Tried]) -> tuple[_Tried | None, str]:
    best = max(readings, key=lambda tried: (tried.score.share, tried.score.median_iou))
    # Readings that give the same boxes do not compete. The first of them, which is the simplest, is chosen.
    best = next(tried for tried in readings if tried.is_same(best))
    if best.score.share < CLEAR:
        return None, "no reading explains the boxes: the declared convention stays"
    if any(tried.score.share > best.score.share - LEAD for tried in readings if not tried.is_same(best)):
        return None, "no reading is clearly the best: the declared convention stays"
    return best, ""


def _try(written: Sequence[_Written], reading: Reading, convention: Convention) -> _Tried:
    convert = functools.partial(place_box, reading=reading, convention=convention)
    boxes, _ = read_each(*(functools.partial(convert, box.numbers, box.drawn.size) for box in written))
    overlaps = [iou(box, numbers.drawn.box) if box else 0.0 for box, numbers in zip(boxes, written, strict=True)]
    share, median = sum(overlap >= 0.5 for overlap in overlaps) / len(overlaps), round(statistics.median(overlaps), 4)
    return _Tried(boxes, Score(written[0].key, reading.order, reading.scale, len(written), median, share))
