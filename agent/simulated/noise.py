"""Noise of the simulated model: fields of marks misread, wrong boxes, and replies that are no answer.

A draw is a hash of the seed and of its subject: the whole request for faults of a reply, the question and the picture
for misread fields. It depends on no clock and no order of calls, so a resumed run meets the same faults as one that was
not interrupted, and the same request gets the same reply.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, TypeVar

import msgspec

from jrdb_avr.agent.model.conventions import SCALE
from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.policy.explorer import Look
from jrdb_avr.agent.simulated.requests import Misread
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.markers import ALONE, HEADING_STEP, MAX_DISTANCE_DM, Mark
from jrdb_avr.schema.things import OBJECTS

_T = TypeVar("_T")

_HASHED: Final = 2.0**64
_Share = Annotated[float, msgspec.Meta(ge=0, le=1)]


class Knobs(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Error rates of the simulated model, shares of 0 to 1; with none above 0, no byte of a reply changes.

    wrong_box: share of boxes that are shifted or another person's. wrong_attribute: share of a mark's readable fields
    that are misread, for each look anew. refusal, truncated, malformed: share of replies that are refused; of the
    others, cut off at the token limit; of the others, no JSON object. thinking: share of replies with thinking before
    them. latency: seconds that each reply waits. seed: of all draws.
    """

    wrong_box: _Share = 0.0
    wrong_attribute: _Share = 0.0
    malformed: _Share = 0.0
    refusal: _Share = 0.0
    truncated: _Share = 0.0
    thinking: _Share = 0.0
    latency: Annotated[float, msgspec.Meta(ge=0, le=600)] = 0.0
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0


PERFECT: Final = Knobs()
_RANGES: Final = {"latency": "a number from 0 to 600 seconds", "seed": f"a whole number from 0 to {2**53}"}


def parse(settings: Iterable[str]) -> Knobs:
    """The knobs of texts such as "wrong_box=0.1" or "seed=3". Raises InputError in one line for any other text."""
    names = Knobs.__struct_fields__
    values: dict[str, float] = {}
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        if name not in names or not equals:
            raise InputError(f"{setting[:60]!r} is no knob: give NAME=VALUE with a name of {', '.join(names)}")
        if name in values:
            raise InputError(f"the knob {name} is set twice")
        try:
            if name == "seed" and not re.fullmatch("[0-9]{1,16}", text):
                raise ValueError
            value = int(text) if name == "seed" else float(text)
            values[name] = getattr(msgspec.convert({name: value}, Knobs), name)
        except (ValueError, msgspec.ValidationError):
            raise InputError(f"{name}={text[:40]} must be {_RANGES.get(name, 'a number from 0 to 1')}") from None
    return msgspec.convert(values, Knobs)


def turned(knobs: Knobs) -> dict[str, float]:
    """The knobs that differ from their defaults, for a run's manifest."""
    return {name: value for name, value in msgspec.structs.asdict(knobs).items() if value != getattr(PERFECT, name)}


def settings(knobs: Knobs) -> list[str]:
    """The texts that `parse` reads the knobs from."""
    return [f"{name}={value!r}" for name, value in turned(knobs).items()]


@dataclass(frozen=True)
class Draws:
    """Named draws about one subject, such as a request by its hash: equal names give equal draws."""

    seed: int
    about: str

    def share(self, *what: object) -> float:
        """A number of [0, 1)."""
        text = msgspec.json.encode([self.seed, self.about, *map(str, what)])
        return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") / _HASHED

    def happens(self, rate: float, *what: object) -> bool:
        """True for this share of the names."""
        return rate > 0 and self.share(*what) < rate

    def pick(self, options: Sequence[_T], *what: object) -> _T:
        """One of the options, which must not be empty."""
        return options[min(int(self.share(*what) * len(options)), len(options) - 1)]


_TURNS: Final = tuple(range(45, 360, 45))
_NEARER_OR_FARTHER: Final = (0.5, 0.7, 1.5, 2.0)
_SORRY: Final = "I am sorry, but I cannot help with questions about people in pictures."


@dataclass(frozen=True)
class Wording:
    """A reply as it is sent; `refusal` stands in place of the content."""

    content: str
    finish_reason: str = "stop"
    refusal: str | None = None


# -- reading ---------------------------------------------------------------------------------------------------------


def misread(knobs: Knobs, question: str) -> Misread | None:
    """How the marks of a question are misread; None where they are not.

    A field of a person in a picture is misread alike whenever the picture is sent for this question, and independently
    of other pictures: looking twice helps, looking longer does not. Identity and place are never misread.
    """
    if not knobs.wrong_attribute:
        return None

    def misread_mark(digest: bytes, mark: Mark) -> Mark:
        draws = Draws(knobs.seed, f"{question} {digest.hex()} {mark.identity}")
        wrong = {
            name: _another(name, mark, draws)
            for name in _FIELDS
            if getattr(mark, name) is not None and draws.happens(knobs.wrong_attribute, name)
        }
        return replace(mark, **wrong)

    return misread_mark


_FIELDS: Final = ("gender", "age", "pose", "actions", "group", "distance_dm", "heading_deg", "interaction", "object")
"""A partner goes with its interaction, and a verb with its object."""


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


# -- replying ---------------------------------------------------------------------------------------------------------


def with_wrong_boxes(reply: Mapping[str, Any], looks: Sequence[Look], knobs: Knobs, draws: Draws) -> Mapping[str, Any]:
    """The reply with some of its boxes wrong."""

    def entry(number: int, place: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        look = _look_of(place, looks)
        # A person who was never found has an empty box, which stays.
        if look is None or not place.get(key) or not draws.happens(knobs.wrong_box, "box", number):
            return place
        return {**place, key: _wrong_box(place[key], look, draws, number)}

    lists = ((name, key) for name, key in (("evidence_bboxes", "bbox"), ("calls", "box")) if reply.get(name))
    return {**reply, **{name: [entry(n, place, key) for n, place in enumerate(reply[name])] for name, key in lists}}


def _look_of(place: Mapping[str, Any], looks: Sequence[Look]) -> Look | None:
    """The newest picture that a box lies in."""
    name, frame = place.get("observation"), place.get("frame_id")
    fitting = (look for look in looks if (f"{look.frame:06d}" == frame if name is None else look.name == name))
    return next(reversed([*fitting]), None)


def _wrong_box(box: list[int], look: Look, draws: Draws, number: int) -> list[int]:
    """Another person's box in the picture, or the box beside itself by more than half its width."""
    others = [write_box(seen.box, look.size) for seen in look.sightings]
    others = [other for other in others if other != box and other[0] < other[2] and other[1] < other[3]]
    if others and draws.happens(0.5, "whose", number):
        return draws.pick(others, "which", number)
    left, top, right, bottom = box
    shift = max(round((right - left) * (0.6 + 0.6 * draws.share("shift", number))), 1)
    for by in (shift, -shift) if draws.happens(0.5, "side", number) else (-shift, shift):
        if left + by >= 0 and right + by <= SCALE:
            return [left + by, top, right + by, bottom]
    # No room beside it, so it is wide: its left third, as if the rest of the person were covered.
    return [left, top, left + (right - left) // 3, bottom]


def word(content: str, knobs: Knobs, draws: Draws) -> tuple[Wording, str]:
    """The reply as it is sent, and the name of the knob that spoiled it, if any."""
    if draws.happens(knobs.refusal, "refusal"):
        return Wording("", refusal=_SORRY), "refusal"
    thought = think(knobs, draws)
    if draws.happens(knobs.truncated, "truncated"):
        end = 1 + int(draws.share("end") * (len(content) - 1))
        return Wording(thought + content[:end], "length"), "truncated"
    if draws.happens(knobs.malformed, "malformed"):
        return Wording(thought + _malformed(content, draws)), "malformed"
    return Wording(thought + content), ""


def think(knobs: Knobs, draws: Draws) -> str:
    """Thinking to stand before a reply, if any."""
    if not draws.happens(knobs.thinking, "thinking"):
        return ""
    return "<think>\nI go through the pictures one by one and compare what I read with the question.\n</think>\n"


def _malformed(content: str, draws: Draws) -> str:
    """A JSON object as models spoil it: it lacks its end, prose stands round it, or it has Python's quotes."""
    spoiled = (content[:-1], f"Here is my reply: {content} I hope that this helps.", repr(msgspec.json.decode(content)))
    return draws.pick(spoiled, "how")
