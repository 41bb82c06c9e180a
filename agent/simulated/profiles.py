"""Settings of the simulated model's errors: one table of names, defaults and meanings, and the named profiles.

The profile `realistic` follows measurements of a real detector and pose network on real panoramas. Rates of labels
other than postures are assumed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

from jrdb_avr.schema.errors import InputError

Share = Annotated[float, Meta(ge=0, le=1)]


class Errors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Errors of the simulated model. With the defaults, the model reads every annotation as it is.

    Attributes:
        person: Share of an error rate that stays with a person in all pictures.
        frame: Share of an error rate that stays with a person at one frame.
        wrong: Rate of attributes that are read as any other value.
        pose: Factor of the measured rates at which postures are confused.
        dropped: Rate of true labels that are not read, postures excluded.
        added: Rate of false labels that are read, postures excluded.
        miss: Rate of missed people of 100 visible pixels. Smaller people are missed more often.
        ghosts: Mean number of false people at a frame, all round.
        box: Scale of the errors of a box's edges, in its width and height.
        identity: Share of people who are taken for another person at another frame, and as many for a new one.
        wrong_box: Rate of boxes that are shifted by half of their width.
        malformed: Rate of replies that are not a JSON object.
        latency: Seconds that each reply waits.
        seed: Seed of all errors.
        readings: File with a detector's readings, for the profile `recorded`.
    """

    person: Share = 0.0
    frame: Share = 0.0
    wrong: Share = 0.0
    pose: Share = 0.0
    dropped: Share = 0.0
    added: Share = 0.0
    miss: Share = 0.0
    ghosts: Annotated[float, Meta(ge=0, le=9)] = 0.0
    box: Share = 0.0
    identity: Share = 0.0
    wrong_box: Share = 0.0
    malformed: Share = 0.0
    latency: Annotated[float, Meta(ge=0, le=600)] = 0.0
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 0
    readings: str = ""


PERFECT: Final = Errors()

PROFILES: Final = {
    "perfect": PERFECT,
    "independent": Errors(wrong=0.1, wrong_box=0.1, malformed=0.02),
    "lasting": Errors(person=0.55, frame=0.25, wrong=0.1),
    "realistic": Errors(
        person=0.55, frame=0.25, pose=1.0, dropped=0.3, added=0.05, miss=0.45, ghosts=4.5, box=0.05, identity=0.05
    ),
    "recorded": Errors(readings="detector_readings.json"),
}
"""Profiles by name. `recorded` takes boxes and postures from a file, which `readings` names."""

SIMULATED: Final = "simulated"
USUAL_PROFILE: Final = "realistic"
"""Profile of the model `simulated`."""


def profile_of(model: str) -> Errors | None:
    """Return the errors of a model id.

    Args:
        model: Id of a model. "simulated" and "simulated:PROFILE" are simulated models.

    Returns:
        The errors, or None for any other model.

    Raises:
        InputError: If there is no such profile.
    """
    family, _, name = model.partition(":")
    if family != SIMULATED:
        return None
    name = name or USUAL_PROFILE
    if name not in PROFILES:
        raise InputError(f"{model[:60]!r}: the simulated model's profiles are {', '.join(PROFILES)}", field="model")
    return PROFILES[name]


def parse_errors(settings: Iterable[str], base: Errors = PERFECT) -> Errors:
    """Change errors by texts such as "miss=0.2" or "seed=3".

    Args:
        settings: Texts of the form NAME=VALUE.
        base: Errors that the texts change.

    Returns:
        The changed errors.

    Raises:
        InputError: If a text has another form, an unknown name or a value outside its range.
    """
    texts: dict[str, str] = {}
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        if name not in Errors.__struct_fields__ or not equals:
            raise InputError(f"{setting[:60]!r}: give NAME=VALUE with a name of {', '.join(Errors.__struct_fields__)}")
        if name in texts:
            raise InputError(f"{name} is set twice")
        texts[name] = text
    try:
        changed = msgspec.convert(texts, Errors, strict=False)
    except msgspec.ValidationError as error:
        raise InputError(f"a setting of the simulated model is wrong: {error}") from None
    return msgspec.structs.replace(base, **{name: getattr(changed, name) for name in texts})


def changed_errors(errors: Errors) -> dict[str, Any]:
    """Return the settings that differ from those of the perfect profile, by name."""
    return {name: value for name, value in msgspec.structs.asdict(errors).items() if value != getattr(PERFECT, name)}
