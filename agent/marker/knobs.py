"""How well the marker model plays: rates of honest imperfection, and the draws that decide by them.

A draw is a hash of the seed and of what it is about: the whole request for what happens to a reply, the question and
the picture for what is misread. No clock and no order of calls is in it, so a run that was resumed meets the same
faults as one that was not, and the same request gets the same reply.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import msgspec

from jrdb_avr.schema.errors import InputError

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
