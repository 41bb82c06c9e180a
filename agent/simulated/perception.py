"""What the model sees in a picture: the marks that the knobs let it read, and people who are not there.

Every fault is a draw about the question, the picture and the person, so a picture that is sent again is seen alike:
looking twice helps, looking longer does not. Correlated misreadings are draws about the question and the person alone.
Without knobs every mark is read as it is. A partner goes with its interaction, and a verb with its object.
"""

from __future__ import annotations

import base64
import hashlib
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

from jrdb_avr.agent.simulated.confusion import CONFUSED, affirmed, confusions, label_of, with_label
from jrdb_avr.agent.simulated.knobs import Draws, Knobs
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.markers import ALONE, HEADING_STEP, MAX_DISTANCE_DM, MAX_IDENTITY, Mark, Reading, read
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.things import OBJECTS

_CACHED: Final = 8192
_URI: Final = "data:image/jpeg;base64,"


class PictureMarks(NamedTuple):
    """The marks read in an image, with its width and height in pixels and its sha256."""

    digest: bytes
    size: tuple[int, int]
    readings: tuple[Reading, ...]


class Reader:
    """Reads marks from data URIs; caches them by hash, as every turn sends all pictures again."""

    def __init__(self) -> None:
        self._cache: OrderedDict[tuple[bytes, bool], PictureMarks] = OrderedDict()
        self._lock = threading.Lock()

    def picture(self, uri: str, *, wrap: bool) -> PictureMarks:
        """The marks in a JPEG, as a data URI; `wrap` for a whole panorama. Raises DecodeError for any other text."""
        digest = hashlib.sha256(uri.encode()).digest()
        key = (digest, wrap)
        with self._lock:
            if key in self._cache:
                self._cache.move_to_end(key)
                return self._cache[key]
        image = _image(uri)
        found = PictureMarks(digest, image.shape[1::-1], tuple(read(image, wrap=wrap)))
        with self._lock:
            self._cache[key] = found
            while len(self._cache) > _CACHED:
                self._cache.popitem(last=False)
        return found


def _image(uri: str) -> Any:
    import cv2
    import numpy as np

    try:
        data = base64.b64decode(uri.removeprefix(_URI), validate=True)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
    except (ValueError, cv2.error):
        image = None
    if image is None:
        raise DecodeError("an image of the request is no data URI of a readable JPEG")
    return image


# -- whom the model sees ----------------------------------------------------------------------------------------------

_LEAST_HEIGHT: Final = 24
"""Of the model's own pixels: about one patch of a vision encoder."""
_MISS_HEIGHT: Final = 100
"""Visible pixels of height at which the chance to miss somebody is the knob's."""
_FARTHEST: Final = 20.0
"""Largest error of a box's side, in scales."""


@dataclass(frozen=True)
class Perception:
    """How the pictures of a question are seen; `statements` are those that the prompt makes about people."""

    knobs: Knobs
    question: str
    statements: Sequence[Condition] = ()

    def readings(self, picture: PictureMarks, age: int = 0) -> tuple[Reading, ...]:
        """The people seen in a picture, from left to right; it was sent `age` turns ago."""
        seen = [
            Reading(self._mark(picture, reading.mark), self._box(picture, reading), reading.complete)
            for reading in picture.readings
            if not self._missed(picture, reading) and not self._forgotten(picture, reading, age)
        ]
        draws = self._draws(picture, "ghost")
        if draws.happens(self.knobs.ghosts, "there"):
            ghost = _ghost(picture.size, draws)
            seen.append(ghost._replace(mark=self._pleased(ghost.mark, draws)))
            seen.sort(key=lambda reading: reading.box.x)
        return tuple(seen)

    def _draws(self, picture: PictureMarks, whom: object) -> Draws:
        return Draws(self.knobs.seed, f"{self.question} {picture.digest.hex()} {whom}")

    def _missed(self, picture: PictureMarks, reading: Reading) -> bool:
        knobs = self.knobs
        if not knobs.miss and not knobs.pixels:
            return False
        width, height = picture.size
        shrink = min(1.0, (knobs.pixels / (width * height)) ** 0.5) if knobs.pixels else 1.0
        visible = reading.box.h * shrink * (1 - _covered(picture, reading.box))
        if knobs.pixels and visible < _LEAST_HEIGHT:
            return True
        chance = min(knobs.miss * _MISS_HEIGHT / max(visible, 1.0), 1.0)
        return self._draws(picture, reading.mark.identity).happens(chance, "miss")

    def _forgotten(self, picture: PictureMarks, reading: Reading, age: int) -> bool:
        rate = 1 - (1 - self.knobs.forget) ** age
        return self._draws(picture, reading.mark.identity).happens(rate, "forget")

    def _box(self, picture: PictureMarks, reading: Reading) -> Box:
        """The box with its sides moved; a whole one stays inside the picture."""
        scale, coarse, box = self.knobs.jitter, self.knobs.coarse / 1000, reading.box
        if not scale and not coarse:
            return box
        draws = self._draws(picture, reading.mark.identity)
        across, down = (scale * side + coarse * whole for side, whole in zip(box[2:], picture.size, strict=True))
        left, right = (edge + across * _heavy_tailed(draws, side) for side, edge in enumerate((box.x, box.x + box.w)))
        top, bottom = (edge + down * _heavy_tailed(draws, side) for side, edge in enumerate((box.y, box.y + box.h), 2))
        if box.x >= 0 and box.x + box.w <= picture.size[0]:
            left, right = max(left, 0.0), min(right, float(picture.size[0]))
        if right - left < 2 or bottom - top < 2:
            return box
        return Box(left, top, right - left, bottom - top)

    # -- what is read of them -----------------------------------------------------------------------------------------

    def _mark(self, picture: PictureMarks, mark: Mark) -> Mark:
        """What a mark is read as."""
        knobs = self.knobs
        if not knobs.wrong_attribute and not knobs.confuse and not knobs.please:
            return mark
        draws = self._draws(picture, mark.identity)
        seen = self._confused(mark, self._misread(mark, draws), draws)
        return self._pleased(seen, draws)

    def _slip(self, rate: float, draws: Draws, mark: Mark, *what: object) -> Draws | None:
        """The draws about a misreading, the person's or the picture's; None where there is none.

        `correlated` is the share of the misreadings that are the person's, and the rate of both together is `rate`.
        """
        lasting = rate * self.knobs.correlated
        person = Draws(self.knobs.seed, f"{self.question} person {mark.identity}")
        if person.happens(lasting, *what):
            return person
        return draws if draws.happens((rate - lasting) / (1 - lasting) if lasting else rate, *what) else None

    def _misread(self, mark: Mark, draws: Draws) -> Mark:
        wrong = {
            name: _another(name, mark, slip)
            for name in _FIELDS
            if getattr(mark, name) is not None
            and (slip := self._slip(self.knobs.wrong_attribute, draws, mark, name)) is not None
        }
        return replace(mark, **wrong)

    def _confused(self, true: Mark, mark: Mark, draws: Draws) -> Mark:
        """The mark with the labels that are still right taken for others."""
        if not self.knobs.confuse:
            return mark
        for name in CONFUSED:
            label = label_of(true, name)
            if label is None or label != label_of(mark, name):
                continue
            row = confusions(self.knobs.confuse, name, label)
            total = sum(row.values())
            slip = self._slip(total, draws, true, "confuse", name)
            if slip is not None:
                mark = with_label(mark, name, _weighted(row, total * slip.share("confused as", name)))
        return mark

    def _pleased(self, mark: Mark, draws: Draws) -> Mark:
        for number, statement in enumerate(self.statements):
            if draws.happens(self.knobs.please, "please", number):
                mark = affirmed(mark, statement)
        return mark


_FIELDS: Final = ("gender", "age", "pose", "actions", "group", "distance_dm", "heading_deg", "interaction", "object")

_TURNS: Final = tuple(range(45, 360, 45))
_NEARER_OR_FARTHER: Final = (0.5, 0.7, 1.5, 2.0)

_OPTIONS: Final[Mapping[str, Sequence[Any]]] = {
    "gender": GENDERS,
    "age": AGES,
    "pose": POSES,
    "actions": OTHER_ACTIONS,
    "group": range(ALONE, 13),
    "interaction": INTERACTIONS,
    "object": OBJECTS,
}


def _another(name: str, mark: Mark, draws: Draws) -> Any:
    """Another value of a field that has one."""
    value = getattr(mark, name)
    match name:
        case "distance_dm":
            far = min(round(value * draws.pick(_NEARER_OR_FARTHER, "as", name)), MAX_DISTANCE_DM)
            return far if far != value else value + 1
        case "heading_deg":
            return (value + draws.pick(_TURNS, "as", name)) // HEADING_STEP * HEADING_STEP % 360
    known = value if name == "actions" else (value,)
    other = draws.pick([option for option in _OPTIONS[name] if option not in known], "as", name)
    # One action is taken for another; where there is none, one is seen that is not there.
    return (other, *value[1:]) if name == "actions" else other


def _weighted(row: Mapping[str, float], place: float) -> str:
    """The label at a place of the row's shares laid end to end."""
    for label, share in row.items():
        if place < share:
            return label
        place -= share
    return [*row][-1]


def _covered(picture: PictureMarks, box: Box) -> float:
    """The largest share of a box that one person in front of it covers; the lower end of a box is the nearer one."""
    shares = (
        max(min(box.x + box.w, other.x + other.w) - max(box.x, other.x), 0.0)
        * max(min(box.y + box.h, other.y + other.h) - max(box.y, other.y), 0.0)
        / (box.w * box.h)
        for _, other, _ in picture.readings
        if other.y + other.h > box.y + box.h
    )
    return max(shares, default=0.0)


def _heavy_tailed(draws: Draws, side: int) -> float:
    """A draw of Student's t distribution with two degrees of freedom, cut off far out."""
    share = min(max(draws.share("side", side), 1e-9), 1 - 1e-9)
    return min(max((2 * share - 1) / math.sqrt(2 * share * (1 - share)), -_FARTHEST), _FARTHEST)


def _ghost(size: tuple[int, int], draws: Draws) -> Reading:
    """Somebody who is not there: anywhere in the picture, and of any looks."""
    width, height = size
    tall = height * (0.2 + 0.4 * draws.share("height"))
    box = Box((width - tall / 3) * draws.share("x"), (height - tall) * draws.share("y"), tall / 3, tall)
    mark = Mark(
        MAX_IDENTITY + 1 + int(draws.share("identity") * 10**6),
        gender=draws.pick(GENDERS, "gender"),
        age=draws.pick(AGES, "age"),
        pose=draws.pick(POSES, "pose"),
        group=ALONE,
        distance_dm=int(20 + draws.share("distance") * 100),
        heading_deg=draws.pick(range(0, 360, HEADING_STEP), "heading"),
    )
    return Reading(mark, box, True)


See = Callable[[str, Sequence[Condition]], Perception]
"""How the pictures of a question are seen, whose prompt makes these statements."""
