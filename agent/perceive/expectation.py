"""The expected angle and height of a person at another frame.

Between two sightings a person is expected on a straight line, in angle and in the logarithm of the height. Beyond the
last sighting, a person is expected to move on and to slow down. The uncertainty grows with the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.readings import PersonReading

_EXACT_DEG: Final = 1.5
_DRIFT: Final = 0.7
"""Growth of the uncertainty of a person's angle, in degrees per frame, if the speed is unknown."""

_TURNING: Final = 0.25
"""Growth of the uncertainty of a person's angle, in degrees per frame, if two sightings give the speed."""

_WIDEST_DEG: Final = 120.0
"""Maximum uncertainty of an angle in degrees."""

_LONGEST: Final = 60
"""Maximum number of frames for which a person is expected to move on."""

_SLOWED: Final = 25
"""Number of frames after which half of the way at the last speed is expected, because some people stop or turn."""


class ExpectedPlace(NamedTuple):
    """Panorama angle in degrees at which a person is expected at a frame, and its standard deviation."""

    angle: float
    angle_spread: float


def expected_place(readings: Sequence[PersonReading], frame: int) -> ExpectedPlace:
    """Return where a person is expected at a frame.

    Args:
        readings: Readings of the person, at least one.
        frame: The frame.

    Returns:
        The angle with its uncertainty.
    """
    # If a frame has several readings, the last reading that shows the person whole counts.
    by_frame = {reading.frame: reading for reading in sorted(readings, key=lambda item: (item.frame, item.whole))}
    near = sorted(by_frame, key=lambda at: (abs(at - frame), at))
    first = near[0]
    gap = abs(first - frame)
    second = next((at for at in near[1:] if (at - frame) * (first - frame) <= 0), near[1] if len(near) > 1 else None)
    angle, drift = by_frame[first].angle, _DRIFT
    if second is not None and abs(second - first) <= 2 * _LONGEST:
        passed = (frame - first) / (second - first)
        if passed < 0:
            longest = min(gap, _LONGEST)
            passed = -(0.5 ** (longest / _SLOWED)) * longest / abs(second - first)
        angle += passed * ((by_frame[second].angle - angle + 180.0) % 360.0 - 180.0)
        drift = min(_DRIFT, _TURNING + _EXACT_DEG / abs(second - first))
    # The second modulo catches a tiny negative angle, because its first modulo rounds to 360.
    return ExpectedPlace(angle % 360.0 % 360.0, min(_EXACT_DEG + drift * gap, _WIDEST_DEG))
