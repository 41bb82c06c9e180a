"""Knobs of the simulated model: one table of names, defaults and meanings, which parsing, help and docs read.

A profile is a named setting of the knobs: `simulated:noisy` is a model id. Draws are hashes of the seed and of their
subject. They depend on no clock and no order of calls: a resumed run meets the same faults as one that was not
interrupted, whatever the number of workers, and the same request gets the same reply.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, TypeVar

import msgspec
from msgspec import Meta

from jrdb_avr.agent.simulated.confusion import Matrix, Share, check_matrix
from jrdb_avr.schema.errors import InputError

_T = TypeVar("_T")

_HASHED: Final = 2.0**64


class Knobs(msgspec.Struct, frozen=True, forbid_unknown_fields=True, repr_omit_defaults=True):
    """Imperfections of the simulated model; with the defaults it reads every mark, and no draw changes a byte.

    Each field's description says what it does: `knob_table` lists them.
    """

    wrong_attribute: Annotated[
        Share, Meta(description="share of a mark's fields that are read as any other value, for each picture anew")
    ] = 0.0
    confuse: Annotated[
        Share | Matrix,
        Meta(
            description="share of labels that are taken for one that looks alike; or a matrix for each attribute, as "
            'JSON: {"pose": {"standing": {"walking": 0.2}}}'
        ),
    ] = 0.0
    correlated: Annotated[
        Share, Meta(description="share of the misreadings that are the person's, alike in all pictures of a question")
    ] = 0.0
    ids: Annotated[
        bool, Meta(description="whether a person has the same identity in all pictures; else place and looks decide")
    ] = True
    miss: Annotated[
        Share,
        Meta(
            description="chance to miss a person of 100 visible pixels of height; it grows as fewer are visible, by "
            "distance or by people in front"
        ),
    ] = 0.0
    pixels: Annotated[
        int,
        Meta(
            ge=0,
            le=2**40,
            description="pixels to which the model shrinks a larger picture, as a panorama, before it looks for "
            "people; 0: none. Below 24 of these pixels of height nobody is seen",
        ),
    ] = 0
    ghosts: Annotated[Share, Meta(description="share of pictures in which somebody is seen who is not there")] = 0.0
    please: Annotated[
        Share, Meta(description="share of the prompt's statements about a person that are affirmed of anybody")
    ] = 0.0
    jitter: Annotated[
        Share,
        Meta(description="scale of the errors of a box's sides, in its width and height; the errors have a heavy tail"),
    ] = 0.0
    coarse: Annotated[
        float,
        Meta(
            ge=0,
            le=1000,
            description="scale of further such errors in thousandths of the picture's width and height, in which boxes "
            "are written: people of a panorama are boxed less exactly than those of a crop",
        ),
    ] = 0.0
    forget: Annotated[
        Share, Meta(description="share of the people in a chat's picture who are forgotten with each later turn")
    ] = 0.0
    policy: Annotated[
        Share, Meta(description="share of requested looks that go elsewhere, and of a plan's relations that are wrong")
    ] = 0.0
    wrong_box: Annotated[Share, Meta(description="share of written boxes that are shifted or another person's")] = 0.0
    malformed: Annotated[Share, Meta(description="share of replies that are no JSON object")] = 0.0
    malformed_per_kb: Annotated[
        Share, Meta(description="the same for each thousand characters of the reply, beside `malformed`")
    ] = 0.0
    refusal: Annotated[Share, Meta(description="share of replies that are refused")] = 0.0
    truncated: Annotated[Share, Meta(description="share of replies that are cut off at the token limit")] = 0.0
    thinking: Annotated[Share, Meta(description="share of replies with thinking before them")] = 0.0
    latency: Annotated[float, Meta(ge=0, le=600, description="seconds that each reply waits")] = 0.0
    seed: Annotated[int, Meta(ge=0, le=2**53, description="seed of all draws")] = 0

    def __post_init__(self) -> None:
        if not isinstance(self.confuse, float | int):
            check_matrix(self.confuse)


PERFECT: Final = Knobs()

PROFILES: Final = {
    "perfect": PERFECT,
    "noisy": Knobs(wrong_attribute=0.1, wrong_box=0.1, malformed=0.02),
    # Fitted to published rows of methods that are no agent, without running any agent, and frozen:
    # `python tests/benchmarks/fit_small_vlm.py` prints the fit.
    "small-vlm": Knobs(
        wrong_attribute=0.06,
        confuse=0.48,
        correlated=0.6,
        ids=False,
        miss=0.41,
        pixels=1_003_520,
        ghosts=0.1,
        please=0.2,
        jitter=0.06,
        coarse=7.5,
        forget=0.03,
        wrong_box=0.18,
        malformed=0.01,
        malformed_per_kb=0.01,
    ),
}
"""Profiles by name."""

SIMULATED: Final = "simulated"
_ALIASES: Final = {"marker": "perfect", SIMULATED: "perfect"}


def profile_of(model: str) -> Knobs | None:
    """The knobs of a model id: "marker", "simulated" or "simulated:PROFILE"; None for any other model.

    Raises InputError for a profile that there is not.
    """
    family, colon, name = model.partition(":")
    if family != SIMULATED or not colon:
        return PROFILES[_ALIASES[model]] if model in _ALIASES else None
    if name not in PROFILES:
        raise InputError(f"{model[:60]!r}: the simulated model's profiles are {', '.join(PROFILES)}", field="model")
    return PROFILES[name]


# -- settings as texts ------------------------------------------------------------------------------------------------

_FORMS: Final[Mapping[str, Any]] = msgspec.json.schema(Knobs)["$defs"]["Knobs"]["properties"]
_RANGES: Final = {
    "ids": "on or off",
    "confuse": "a number from 0 to 1, or a JSON object of shares by attribute, label and label",
    **{
        name: f"a {'whole ' if form['type'] == 'integer' else ''}number from {form['minimum']} to {form['maximum']}"
        for name, form in _FORMS.items()
        if "minimum" in form
    },
}


def knob_table() -> list[tuple[str, str, str]]:
    """Name, default and meaning of every knob."""
    return [(name, _text(getattr(PERFECT, name)), form["description"]) for name, form in _FORMS.items()]


def parse(settings: Iterable[str], base: Knobs = PERFECT) -> Knobs:
    """The knobs of texts such as "wrong_box=0.1", "ids=off" or "seed=3", on top of those of a profile.

    Raises InputError in one line for any other text.
    """
    values: dict[str, Any] = {}
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        if name not in _FORMS or not equals:
            raise InputError(f"{setting[:60]!r} is no knob: give NAME=VALUE with a name of {', '.join(_FORMS)}")
        if name in values:
            raise InputError(f"the knob {name} is set twice")
        try:
            values[name] = getattr(msgspec.convert({name: _value(name, text)}, Knobs), name)
        except (ValueError, KeyError, msgspec.MsgspecError) as error:
            why = f": {error}" if text.startswith("{") else ""
            raise InputError(f"{name}={text[:40]} must be {_RANGES[name]}{why}") from None
    return msgspec.structs.replace(base, **values)


def _value(name: str, text: str) -> Any:
    if name == "ids":
        return {"on": True, "off": False}[text]
    if name == "confuse" and text.startswith("{"):
        return msgspec.json.decode(text)
    if _FORMS[name].get("type") != "integer":
        return float(text)
    if not re.fullmatch("[0-9]{1,16}", text):
        raise ValueError
    return int(text)


def turned(knobs: Knobs) -> dict[str, Any]:
    """The knobs that differ from their defaults, for a run's manifest."""
    return {name: value for name, value in msgspec.structs.asdict(knobs).items() if value != getattr(PERFECT, name)}


def settings(knobs: Knobs) -> list[str]:
    """The texts that `parse` reads the knobs from."""
    return [f"{name}={_text(value)}" for name, value in turned(knobs).items()]


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return msgspec.json.encode(value).decode() if isinstance(value, Mapping) else repr(value)


# -- draws ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Draws:
    """Named draws about one subject, such as a request by its hash: equal names give equal draws."""

    seed: int
    about: str

    def share(self, *what: object) -> float:
        """A number of [0, 1), drawn by seed and names: the same ones give the same number."""
        text = msgspec.json.encode([self.seed, self.about, *map(str, what)])
        return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") / _HASHED

    def happens(self, rate: float, *what: object) -> bool:
        """True for this share of the names."""
        return rate > 0 and self.share(*what) < rate

    def pick(self, options: Sequence[_T], *what: object) -> _T:
        """One of the options, which must not be empty."""
        return options[min(int(self.share(*what) * len(options)), len(options) - 1)]
