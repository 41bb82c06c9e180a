"""Errors of perception: what the simulated model reads of the people in one picture.

An error has one of three levels. It stays with a person in all pictures, with a person at a frame, or it belongs to one
picture. Every draw is a hash of the seed and its subject. So the same picture is always read alike, in any order.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import msgspec

from jrdb_avr.agent.simulated.people import Person
from jrdb_avr.agent.simulated.profiles import Errors
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES, may_be_called
from jrdb_avr.schema.panorama import FOCAL_ROWS, HEIGHT, HORIZON_ROW, WIDTH, Box
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.things import OBJECTS

_T = TypeVar("_T")

_HASHED: Final = 2.0**64

CONFUSED: Final = {
    "walking": ("standing", 0.4),
    "sitting": ("standing", 0.2),
    "standing": ("walking", 0.08),
    "bending": ("standing", 0.3),
}
"""Measured confusions: the posture that is read in place of a posture, and the rate."""

LEAST_HEIGHT: Final = 24.0
"""Minimum visible height, in pixels, of people who are read."""
_THINNEST: Final = 500.0
"""Minimum width of people who are read, as a part of the picture's width."""
_MISS_HEIGHT: Final = 100.0
_MISS_POWER: Final = 1.5
_MOST_MISSED: Final = 0.98
_MISS_LEVELS: Final = (0.75, 0.17)
"""Shares of misses that stay with the person, and with the person at the frame."""

_GHOST_SLOTS: Final = 9
_GHOST_STAYS: Final = 0.75
_GHOST_SHOWN: Final = 0.67
_GHOST_HEIGHTS: Final = (23.0, 80.0)
_GHOST_POSES: Final = ("standing", "sitting", "walking")
_METRES_TALL: Final = 1.7
_ABOVE_GROUND: Final = 1.2

_BOX_FRAME: Final = 0.8
"""Share of a box's errors that belongs to the frame. The rest belongs to the picture."""
_FARTHEST: Final = 20.0
"""Maximum error of a box's edge, in scales."""

_OPTIONS: Final = {"gender": GENDERS, "age": AGES, "pose": POSES}
_VALUES: Final = {"action": len(OTHER_ACTIONS), "interaction": len(INTERACTIONS), "object": len(OBJECTS)}
_FACTORS: Final = (0.5, 0.7, 1.5, 2.0)
"""Factors of distances that are read wrongly."""


@dataclass(frozen=True)
class Draws:
    """Draws about one subject. Equal names give equal draws."""

    seed: int
    about: str

    def share(self, *names: object) -> float:
        """Return a number in [0, 1) that depends only on seed, subject and names."""
        text = msgspec.json.encode([self.seed, self.about, *map(str, names)])
        return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") / _HASHED

    def happens(self, rate: float, *names: object) -> bool:
        """Return whether the draw is below `rate`."""
        return rate > 0 and self.share(*names) < rate

    def pick(self, options: Sequence[_T], *names: object) -> _T:
        """Return one of the options. `options` is not empty."""
        return options[min(int(self.share(*names) * len(options)), len(options) - 1)]


@dataclass(frozen=True)
class PictureView:
    """A picture: the sequence, the frame, and the columns [left, left + width) that it shows, in stitched pixels."""

    sequence: str
    frame: int
    left: float
    width: float

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return int(self.width), HEIGHT

    def place(self, box: Box) -> Box | None:
        """Return a box in pixels of the picture, or None if the picture does not show its centre column."""
        x = (box.x + box.w / 2 - self.left) % WIDTH
        return None if x >= self.width else box._replace(x=x - box.w / 2)


@dataclass(frozen=True, eq=False)
class ReadPerson:
    """A person as the model reads the person in one picture.

    Attributes:
        identity: Number by which the model knows the person.
        person: The person as annotated, or a false person.
        box: Box as it was read, in pixels of the picture.
        reader: The reader of the picture.
    """

    identity: int
    person: Person
    box: Box
    reader: Reader

    def label(self, name: str) -> str | None:
        """Return the gender, the age or the pose as it was read, or None if the model says nothing."""
        values, errors = self.person.labels.get(name, frozenset()), self.reader.errors
        if len(values) != 1 or self.person.track < 0:
            return next(iter(values)) if len(values) == 1 else None
        (value,) = values
        confused, rate = CONFUSED.get(value, ("", 0.0))
        if name == "pose" and self._slip(rate * errors.pose, "confused") is not None:
            return confused
        if name != "pose" and self._slip(errors.dropped, "dropped", name) is not None:
            return None
        rate = errors.wrong + (0.0 if name == "pose" else errors.added)
        slip = self._slip(rate, "wrong", name)
        return (
            value if slip is None else slip.pick([option for option in _OPTIONS[name] if option != value], "as", name)
        )

    def holds(self, name: str, value: str) -> bool | None:
        """Return whether an action, interaction or object was read, or None if the model says nothing."""
        values, errors = self.person.labels.get(name), self.reader.errors
        if values is None:
            return None
        if value in values:
            return self._slip(errors.dropped + errors.wrong, "dropped", name, value) is None
        # The verb of an object, as in "holding: bag", may be called by another verb.
        if {label.partition(": ")[0] for label in values} & may_be_called(value.partition(": ")[0]):
            return None
        return self._slip(errors.added + errors.wrong / _VALUES[name], "added", name, value) is not None

    def partners(self, relation: str, people: Sequence[ReadPerson]) -> list[int] | None:
        """Return the positions, from 1, of the people in a relation to the person. None if the model says nothing."""
        tied, errors = self.person.ties.get(relation), self.reader.errors
        if tied is None:
            return None
        others = {partner.person.track: number for number, partner in enumerate(people, 1) if partner is not self}
        positions = set()
        for track in tied & others.keys():
            first, last = sorted((self.person.track, track))
            if self.reader.slip(first, errors.dropped + errors.wrong, "dropped", relation, first, last) is None:
                positions.add(others[track])
        if others and (slip := self._slip(errors.added + errors.wrong, "added", relation)) is not None:
            positions.add(others[slip.pick(sorted(others), "with", relation)])
        return sorted(positions)

    @property
    def metres(self) -> float | None:
        """Distance from the robot as it was read, in metres. Its error is the error of the box's height."""
        metres = self.person.metres
        if metres is None:
            return None
        if (slip := self._slip(self.reader.errors.wrong, "wrong", "metres")) is not None:
            metres *= slip.pick(_FACTORS, "metres")
        return round(metres * self.person.box.h / max(self.box.h, 1.0), 2)

    def _slip(self, rate: float, *names: str) -> Draws | None:
        return self.reader.slip(self.person.track, rate, *names)


@dataclass(frozen=True)
class Reader:
    """Reads the people of one picture, with errors."""

    errors: Errors
    view: PictureView

    def people(self, everyone: Sequence[Person]) -> tuple[ReadPerson, ...]:
        """Return the people who are read in the picture, from left to right.

        Args:
            everyone: All people with a box at the frame.

        Returns:
            The people, false ones included.
        """
        identities = self._identities([person.track for person in everyone])
        # A reply writes boxes in thousandths of the picture.
        wide = [person for person in everyone if person.box.w * _THINNEST >= self.view.width]
        shown = [(person, box) for person in wide if (box := self.view.place(person.box)) is not None]
        boxes = [box for _, box in shown]
        read = [
            ReadPerson(identities[person.track], person, self._box(person, box), self)
            for person, box in shown
            if not self._missed(person, box, boxes)
        ]
        for ghost in self._ghosts():
            box = self.view.place(ghost.box)
            if box is not None and self._picture(ghost.track).happens(_GHOST_SHOWN, "shown"):
                read.append(ReadPerson(ghost.track, ghost, box, self))
        return tuple(sorted(read, key=lambda person: (person.box.x, person.identity)))

    # -- levels of errors ---------------------------------------------------------------------------------------------

    def _person(self, track: int) -> Draws:
        return Draws(self.errors.seed, f"{self.view.sequence} {track}")

    def _frame(self, track: int) -> Draws:
        return Draws(self.errors.seed, f"{self.view.sequence} {track} frame {self.view.frame}")

    def _picture(self, track: int) -> Draws:
        view = self.view
        return Draws(self.errors.seed, f"{view.sequence} {track} frame {view.frame} {view.left:g} {view.width:g}")

    def slip(self, track: int, rate: float, *names: object, levels: tuple[float, float] | None = None) -> Draws | None:
        """Return the draws of an error that happens at a rate, or None if it does not happen."""
        if rate <= 0:
            return None
        person, frame = levels or (self.errors.person, self.errors.frame)
        lasting = rate * person
        at_frame = rate * frame / (1 - lasting) if lasting < 1 else 0.0
        left = (1 - lasting) * (1 - at_frame)
        rest = max(0.0, 1 - (1 - rate) / left) if left > 0 else 0.0
        for draws, share in ((self._person, lasting), (self._frame, at_frame), (self._picture, rest)):
            if draws(track).happens(share, *names):
                return draws(track)
        return None

    # -- who is read --------------------------------------------------------------------------------------------------

    def _missed(self, person: Person, box: Box, boxes: Sequence[Box]) -> bool:
        if not self.errors.miss:
            return False
        visible = box.h * (1 - _covered_share(box, boxes))
        if visible < LEAST_HEIGHT:
            return True
        rate = min(self.errors.miss * (_MISS_HEIGHT / visible) ** _MISS_POWER, _MOST_MISSED)
        return self.slip(person.track, rate, "miss", levels=_MISS_LEVELS) is not None

    def _identities(self, tracks: Sequence[int]) -> dict[int, int]:
        """Return the identity under which the model knows each person of the frame. No two have the same identity."""
        identities = {track: track for track in tracks}
        rate, order = self.errors.identity / 2, sorted(tracks)
        for track in order:
            # A person is confused at both ends of a pair of frames, and a swap confuses two people.
            if self._frame(track).happens(rate / 2, "swapped") and len(order) > 1:
                partner = self._frame(track).pick([each for each in order if each != track], "with")
                identities[track], identities[partner] = identities[partner], identities[track]
        for track in order:
            if self._frame(track).happens(rate, "new"):
                identities[track] = (self.view.frame + 1) * 1_000_000 + track
        return identities

    def _ghosts(self) -> list[Person]:
        """Return the false people of the frame. Each stays at its place for some seconds."""
        second = self.view.frame // round(FPS)
        ghosts = []
        for slot in range(_GHOST_SLOTS if self.errors.ghosts else 0):
            draws = Draws(self.errors.seed, f"{self.view.sequence} ghost {slot}")
            born = next((s for s in range(second, 0, -1) if not draws.happens(_GHOST_STAYS, "stays", s)), 0)
            if draws.happens(self.errors.ghosts / _GHOST_SLOTS, "present", born):
                ghosts.append(_ghost(Draws(self.errors.seed, f"{draws.about} from {born}"), -1 - slot - 16 * born))
        return ghosts

    def _box(self, person: Person, box: Box) -> Box:
        """Return a box with errors, so that a reply can write the part that the picture shows."""
        if self._picture(person.track).happens(self.errors.wrong_box, "wrong box"):
            return box._replace(x=min(box.x + box.w / 2, self.view.width * (1 - 1 / _THINNEST)))
        scale = self.errors.box
        if not scale:
            return box
        at_frame, picture = self._frame(person.track), self._picture(person.track)
        sides = [_BOX_FRAME * _draw_t(at_frame, side) + (1 - _BOX_FRAME) * _draw_t(picture, side) for side in range(4)]
        left, right = box.x + scale * box.w * sides[0], box.x + box.w * (1 + scale * sides[1])
        top, bottom = box.y + scale * box.h * sides[2], box.y + box.h * (1 + scale * sides[3])
        left, right = max(left, 0.0), min(right, self.view.width)
        top, bottom = max(top, 0.0), min(bottom, float(HEIGHT))
        thin = right - left < max(self.view.width / _THINNEST, 2.0) or bottom - top < 2
        return box if thin else Box(left, top, right - left, bottom - top)


def _covered_share(box: Box, boxes: Sequence[Box]) -> float:
    """Return the largest share of a box that one nearer person covers. The box with the lower end is nearer."""
    shares = (
        max(min(box.x + box.w, cover.x + cover.w) - max(box.x, cover.x), 0.0)
        * max(min(box.y + box.h, cover.y + cover.h) - max(box.y, cover.y), 0.0)
        / (box.w * box.h)
        for cover in boxes
        if cover.y + cover.h > box.y + box.h
    )
    return min(max(shares, default=0.0), 1.0)


def _draw_t(draws: Draws, side: int) -> float:
    """Return a draw of Student's t distribution with two degrees of freedom, limited to `_FARTHEST`."""
    share = min(max(draws.share("side", side), 1e-9), 1 - 1e-9)
    return min(max((2 * share - 1) / math.sqrt(2 * share * (1 - share)), -_FARTHEST), _FARTHEST)


def _ghost(draws: Draws, track: int) -> Person:
    """Return a false person at a place on the ground."""
    low, high = _GHOST_HEIGHTS
    tall = low + (high - low) * draws.share("height")
    bottom = HORIZON_ROW + tall * _ABOVE_GROUND / _METRES_TALL
    labels: Mapping[str, frozenset[str]] = {
        "gender": frozenset((draws.pick(GENDERS, "gender"),)),
        "age": frozenset((draws.pick(AGES, "age"),)),
        "pose": frozenset((draws.pick(_GHOST_POSES, "pose"),)),
        "action": frozenset(),
        "interaction": frozenset(),
        "object": frozenset(),
    }
    box = Box(draws.share("x") * WIDTH, bottom - tall, tall / 2.8, tall)
    ties = {relation: frozenset[int]() for relation in (SAME_GROUP, *INTERACTIONS)}
    return Person(track, box, labels, ties, FOCAL_ROWS * _METRES_TALL / tall)
