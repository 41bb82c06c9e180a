"""Phrases for distances and for people who handle things."""

from __future__ import annotations

from functools import cache
from typing import Final

from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M
from jrdb_avr.schema.things import OBJECT_PHRASES, VERB_PHRASES

_PAIR_PHRASES: Final[dict[tuple[str, str], str]] = {
    ("sitting", "table"): "sitting at a table",
    ("standing", "table"): "standing at a table",
    # "using a door" is the action "interaction with door"; this is a verb and a thing.
    ("using", "door"): "making use of a door",
}
"""(verb, category) -> phrase, where the phrases of verb and thing do not join well."""

POSES_OF_VERBS: Final[dict[str, tuple[str, ...]]] = {
    "sitting": ("sitting",),
    "walking": ("walking",),
    "standing": ("standing",),
    "running": ("running",),
    "riding": ("cycling", "skating", "scootering"),
    "climbing": ("going upstairs",),
    "going up": ("going upstairs",),
    "going down": ("going downstairs",),
}
"""The poses that handling a thing implies; riding may be any of three."""

_BOUNDS: Final = tuple(f"{bound:g}" for bound in DISTANCE_BOUNDS_M)

FAR_AWAY: Final[dict[str, str]] = {
    "very close": f"very close to {{x}} (under {_BOUNDS[0]} m)",
    "close": f"close to {{x}} ({_BOUNDS[0]} to {_BOUNDS[1]} m)",
    "moderate": f"at a moderate distance from {{x}} ({_BOUNDS[1]} to {_BOUNDS[2]} m)",
    "far": f"far from {{x}} ({_BOUNDS[2]} to {_BOUNDS[3]} m)",
    "very far": f"very far from {{x}} (over {_BOUNDS[3]} m)",
}
"""Each distance word, seen from `{x}`, with its metres: what is close to one reader is far for another."""


def phrase_of(table: dict[str, str], name: str, kind: str) -> str:
    """A table's words. Raises PlanError where it has none."""
    if name not in table:
        raise PlanError("conditions", f"there are no words for the {kind} {name!r}")
    return table[name]


def handling(verb: str, category: str) -> str:
    """A thing handled, as in "carrying a bag". Raises PlanError for an unknown verb or thing."""
    words = phrase_of(VERB_PHRASES, verb, "verb"), phrase_of(OBJECT_PHRASES, category, "object")
    return _PAIR_PHRASES.get((verb, category), " ".join(words))


@cache
def handled() -> dict[str, tuple[str, str]]:
    """The phrase of every pair of a verb and a thing -> (verb, category)."""
    return {handling(verb, category): (verb, category) for verb in VERB_PHRASES for category in OBJECT_PHRASES}
