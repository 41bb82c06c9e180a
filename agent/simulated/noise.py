"""How well the marker model plays: rates of honest imperfection, and the draws that decide by them.

A draw is a hash of the seed and of what it is about: the whole request for what happens to a reply, the question and
the picture for what is misread. No clock and no order of calls is in it, so a run that was resumed meets the same
faults as one that was not, and the same request gets the same reply.

What goes wrong where a knob is turned up: a field of a mark misread, a wrong box, a reply that is no answer.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import msgspec

from jrdb_avr.agent.model.conventions import SCALE
from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.simulated.requests import Look, Misread
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.markers import ALONE, HEADING_STEP, MAX_DISTANCE_DM, Mark
from jrdb_avr.schema.things import OBJECTS

T = TypeVar("T")

_SECONDS: Final = 600.0
_MOST_SEED: Final = 2**53
_HASHED: Final = 2.0**64


class Knobs(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rates are shares of 0 to 1; at none of them above 0 nothing of a reply changes.

    wrong_box: of the boxes given, those that are shifted or another person's. wrong_attribute: of a mark's fields that
    can be read, those misread, for each look anew. refusal, truncated, malformed: of the replies, those that are
    refused; of the others those cut off at the token limit; of the others those that are no JSON object. thinking: of
    the replies, those with thinking before them. latency: seconds that each reply waits. seed: of all draws.
    """

    wrong_box: float = 0.0
    wrong_attribute: float = 0.0
    malformed: float = 0.0
    refusal: float = 0.0
    truncated: float = 0.0
    thinking: float = 0.0
    latency: float = 0.0
    seed: int = 0


PERFECT: Final = Knobs()


def parse(settings: Iterable[str]) -> Knobs:
    """The knobs of texts such as "wrong_box=0.1" or "seed=3". Raises InputError in one line for anything else."""
    names = Knobs.__struct_fields__
    given: dict[str, float] = {}
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        if name not in names or not equals:
            raise InputError(f"{setting[:60]!r} is no knob: give NAME=VALUE with a name of {', '.join(names)}")
        if name in given:
            raise InputError(f"the knob {name} is given twice")
        given[name] = _value(name, text)
    return msgspec.convert(given, Knobs, strict=False)


def _value(name: str, text: str) -> float:
    if name == "seed":
        if not (text.isascii() and text.isdigit() and len(text) <= 16 and int(text) <= _MOST_SEED):
            raise InputError(f"seed={text[:40]} must be a whole number from 0 to {_MOST_SEED}")
        return int(text)
    most, unit = (_SECONDS, " seconds") if name == "latency" else (1.0, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= most:
        raise InputError(f"{name}={text[:40]} must be a number from 0 to {most:g}{unit}")
    return value


def turned(knobs: Knobs) -> dict[str, float]:
    """The knobs that are not as they are by default, as a run's manifest holds them."""
    shown = msgspec.structs.asdict(knobs)
    return {name: value for name, value in shown.items() if value != getattr(PERFECT, name)}


def settings(knobs: Knobs) -> list[str]:
    """The texts that `parse` makes the knobs of."""
    return [f"{name}={value!r}" for name, value in turned(knobs).items()]


@dataclass(frozen=True)
class Draws:
    """Draws about one thing, such as a request by its hash: each is named, and the same whenever it is asked for."""

    seed: int
    about: str

    def share(self, *what: object) -> float:
        """A number of [0, 1)."""
        text = msgspec.json.encode([self.seed, self.about, *map(str, what)])
        return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") / _HASHED

    def happens(self, rate: float, *what: object) -> bool:
        return rate > 0 and self.share(*what) < rate

    def pick(self, options: Sequence[T], *what: object) -> T:
        """One of the options, of which there is one at least."""
        return options[min(int(self.share(*what) * len(options)), len(options) - 1)]


_GROUPS: Final = tuple(range(ALONE, 13))
_TURNS: Final = tuple(range(45, 360, 45))
_NEARER_OR_FARTHER: Final = (0.5, 0.7, 1.5, 2.0)
_SORRY: Final = "I am sorry, but I cannot help with questions about people in pictures."


@dataclass(frozen=True)
class Wording:
    """A reply as it is sent; `refusal` stands in place of the content."""

    content: str
    finish_reason: str = "stop"
    refusal: str | None = None


# -- what is read -----------------------------------------------------------------------------------------------------


def misread(knobs: Knobs, question: str) -> Misread | None:
    """How the marks of a question are misread, if at all.

    A field of somebody in a picture is misread the same whenever the picture is sent for this question, and apart from
    what any other picture shows of it: looking twice helps, looking longer does not. Who it is and where is never
    misread.
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


def _another(name: str, mark: Mark, draws: Draws) -> Any:
    """Another value of a field that has one."""
    value = getattr(mark, name)
    match name:
        case "actions":
            # One action is taken for another; where there is none, one is seen that is not there.
            seen = draws.pick([action for action in OTHER_ACTIONS if action not in value], "as", name)
            return (seen, *value[1:])
        case "distance_dm":
            far = min(round(value * draws.pick(_NEARER_OR_FARTHER, "as", name)), MAX_DISTANCE_DM)
            return far if far != value else value + 1
        case "heading_deg":
            return (value + draws.pick(_TURNS, "as", name)) // HEADING_STEP * HEADING_STEP % 360
    tables: dict[str, Sequence[Any]] = {
        "gender": GENDERS,
        "age": AGES,
        "pose": POSES,
        "group": _GROUPS,
        "interaction": INTERACTIONS,
        "object": OBJECTS,
    }
    return draws.pick([other for other in tables[name] if other != value], "as", name)


# -- what is said -----------------------------------------------------------------------------------------------------


def with_wrong_boxes(
    reply: Mapping[str, Any], looks: Sequence[Look], knobs: Knobs, draws: Draws
) -> tuple[Mapping[str, Any], int]:
    """The reply with some of its boxes wrong, and how many."""
    wrong = 0

    def entry(number: int, place: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        nonlocal wrong
        look = _look_of(place, looks)
        # Who was never found has an empty box, and there is nothing to spoil.
        if look is None or not place.get(key) or not draws.happens(knobs.wrong_box, "box", number):
            return place
        wrong += 1
        return {**place, key: _wrong_box(place[key], look, draws, number)}

    changed = dict(reply)
    for name, key in (("evidence_bboxes", "bbox"), ("calls", "box")):
        if isinstance(reply.get(name), list):
            changed[name] = [entry(number, place, key) for number, place in enumerate(reply[name])]
    return changed, wrong


def _look_of(place: Mapping[str, Any], looks: Sequence[Look]) -> Look | None:
    """The newest picture that a box lies in."""
    name, frame = place.get("observation"), place.get("frame_id")
    return next(
        (look for look in reversed(looks) if (look.name == name if name is not None else f"{look.frame:06d}" == frame)),
        None,
    )


def _wrong_box(box: list[int], look: Look, draws: Draws, number: int) -> list[int]:
    """Another person's box in the picture, or the box beside itself by more than half its width."""
    others = [write_box(seen.box, look.width, look.height) for seen in look.sightings]
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
    """The reply as it is sent, and the name of the knob that spoiled it, or ""."""
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
    spoiled = (
        content[:-1],
        f"Here is my reply: {content} I hope that this helps.",
        repr(msgspec.json.decode(content)),
    )
    return draws.pick(spoiled, "how")
