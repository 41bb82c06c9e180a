"""Sectors and distance words with their margins: which word is meant, and which other it could be near an edge.

All margins are inclusive; a thousand-millionth of slack keeps decimals such as 0.55 on the edge they name.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from jrdb_avr.schema.arrays import Floats, Ints
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.vocabulary import DISTANCE_BOUNDS_M, PERSON_SECTORS, ROBOT_SECTORS

SLACK: Final = 1e-9

_FROM_BEHIND: Final = tuple(ROBOT_SECTORS.index(word) for word in ("behind", "left", "ahead", "right"))
"""Robot sectors by growing panorama angle, the first centred on 0."""

_PERSON_EDGES: Final = (30.0, 45.0, 135.0, 145.0)
"""Edges of the sectors front, front side, side, back side, back, in degrees off a person's heading; inclusive."""
_LEFT_ROUND: Final = tuple(PERSON_SECTORS.index(word) for word in ("front", "front left", "left", "back left", "back"))
_RIGHT_ROUND: Final = tuple(
    PERSON_SECTORS.index(word) for word in ("front", "front right", "right", "back right", "back")
)


def robot_sector(angle_deg: Floats, rules: LoadRules) -> tuple[Ints, Ints]:
    """Of panorama angles: index into ROBOT_SECTORS, and of the other possible sector near an edge (else -1)."""
    quarter = np.floor((angle_deg + 45.0) / 90.0).astype(np.int64)
    offset = angle_deg - quarter * 90.0  # degrees past the sector's centre, [-45, 45)
    near = 45.0 - np.abs(offset) <= rules.sector_margin_deg + SLACK
    neighbor = quarter + np.where(offset < 0, -1, 1)
    order = np.array(_FROM_BEHIND)
    return order[quarter % 4], np.where(near, order[neighbor % 4], -1)


def person_sector(bearing_deg: Floats, rules: LoadRules) -> tuple[Ints, Ints]:
    """Of bearings off a person's heading, [-180, 180], left positive: index into PERSON_SECTORS, the other or -1."""
    size = np.abs(bearing_deg)
    edges = np.array(_PERSON_EDGES)
    ring = np.searchsorted(edges, size, "left")
    away = np.abs(size[:, None] - edges)
    edge = away.argmin(axis=1)
    near = away.min(axis=1) <= rules.narrow_sector_margin_deg + SLACK
    # An edge has ring `edge` before it and ring `edge + 1` behind it.
    other = np.where(ring == edge, edge + 1, edge)
    names = np.where((bearing_deg >= 0)[:, None], np.array(_LEFT_ROUND), np.array(_RIGHT_ROUND))
    row = np.arange(len(size))
    return names[row, ring], np.where(near, names[row, other], -1)


def distance_word(metres: Floats, rules: LoadRules) -> tuple[Ints, Ints]:
    """Of distances: index into DISTANCE_WORDS, and of the other possible word near a bound (else -1)."""
    bounds = np.array(DISTANCE_BOUNDS_M)
    word = np.searchsorted(bounds, metres, "left")
    away = np.abs(metres[:, None] - bounds)
    near = away <= rules.distance_margin * bounds + SLACK
    bound = near.argmax(axis=1)
    other = np.where(word == bound, bound + 1, bound)
    return word, np.where(near.any(axis=1), other, -1)
