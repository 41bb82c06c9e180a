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
"""Phrases of pairs (verb, category), if the phrases of the verb and the category do not fit together."""

_BOUNDS: Final = tuple(f"{bound:g}" for bound in DISTANCE_BOUNDS_M)

FAR_AWAY: Final[dict[str, str]] = {
    "very close": f"very close to {{x}} (under {_BOUNDS[0]} m)",
    "close": f"close to {{x}} ({_BOUNDS[0]} to {_BOUNDS[1]} m)",
    "moderate": f"at a moderate distance from {{x}} ({_BOUNDS[1]} to {_BOUNDS[2]} m)",
    "far": f"far from {{x}} ({_BOUNDS[2]} to {_BOUNDS[3]} m)",
    "very far": f"very far from {{x}} (over {_BOUNDS[3]} m)",
}
"""Phrase for each distance word, seen from `{x}`.

The phrase states the metres, because readers disagree about the meaning of "close".
"""


def phrase_of(table: dict[str, str], name: str, kind: str) -> str:
    """Return a phrase from a table.

    Args:
        table: Phrases by name.
        name: Name of an action, interaction, verb or object.
        kind: Kind of the name, for the error message.

    Raises:
        PlanError: If the table lacks the name.
    """
    if name not in table:
        raise PlanError("conditions", f"there are no words for the {kind} {name!r}")
    return table[name]


def handling(verb: str, category: str) -> str:
    """Return the phrase for a handled thing, such as "carrying a bag".

    Args:
        verb: Verb.
        category: Category of the thing.

    Raises:
        PlanError: If the verb or the category is unknown.
    """
    phrases = phrase_of(VERB_PHRASES, verb, "verb"), phrase_of(OBJECT_PHRASES, category, "object")
    return _PAIR_PHRASES.get((verb, category), " ".join(phrases))


@cache
def handled() -> dict[str, tuple[str, str]]:
    """Return the pair (verb, category) by its phrase, for all pairs."""
    return {handling(verb, category): (verb, category) for verb in VERB_PHRASES for category in OBJECT_PHRASES}
