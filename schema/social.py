"""Vocabularies of the social and reasoning layers, and the explicit tables that normalise their spellings.

Values keep the spelling of the annotation format, so that "food-truck", "food truck" and "food_truck" are one value.
A label that no table knows comes back in plain spelling (lower case, blanks for `_` and `-`) and is reported by the
loader. None stands for "cannot be told", which is not a value.
"""

from __future__ import annotations

import functools
from typing import Final

from jrdb_avr.schema.labels import AGES, GENDERS, IMPOSSIBLE, INTERACTIONS, VERBS, plain

ETHNICITIES: Final = ("caucasian/white", "negroid/black", "mongoloid/asian", "others")
"""The annotators' guesses, in the annotation's own terms."""

PLACES: Final = (
    "cafeteria/dining_hall/food_court",
    "open_area/campus",
    "open_space/corridor",
    "room/class",
    "study_space",
    "street",
)
VENUES: Final = tuple(f"{side}_{place}" for side in ("indoor", "outdoor") for place in PLACES)
"""Where a group is."""

AIMS: Final = (
    "wandering",
    "discussing_an_object/matter",
    "studying/writing/reading/working",
    "waiting_for_someone/something",
    "socializing",
    "excursion",
    "attending_class/lecture/seminar",
    "eating/ordering_food",
    "commuting",
    "navigating",
)
"""What a group is up to."""

BODY_PLACES: Final = (
    "floor",
    "chair",
    "stairs",
    "ground",
    "platform",
    "grass",
    "bike",
    "scooter",
    "balcony",
    "sofa",
    "skateboard",
    "sidewalk",
    "pathway",
    "desk",
    "street",
    "crosswalk",
    "bench",
    "road",
)
"""What the bodies of a group are on (`BPC` in the files)."""

SURROUNDINGS: Final = (
    "counter",
    "pillar",
    "bin",
    "gate",
    "table",
    "wall",
    "stairs",
    "fence",
    "door",
    "trolley",
    "coffee_machine",
    "shelves",
    "cafeteria",
    "balcony",
    "desk",
    "room",
    "elevator",
    "sofa",
    "bike",
    "board",
    "stroller",
    "scooter",
    "statue",
    "platform",
    "standboard",
    "poster",
    "show_case",
    "window",
    "floor",
    "crutches",
    "chair",
    "tree",
    "pole",
    "bench",
    "building",
    "food_truck",
    "bus",
    "robot",
    "baggage",
    "stand_pillar",
    "screen",
    "forecourt",
    "shop",
    "cabinet",
    "light_street",
    "car",
    "copy_machine",
    "drink_fountain",
    "class",
)
"""What stands out round a group (`SSC` in the files)."""

LOCATIONS: Final = ("at",)
"""How a group stands to its surroundings (`location_pre`). No complete list is published."""

DEMOGRAPHICS: Final = {"gender": "gender", "age": "age", "race": "ethnicity"}
"""Attributes of a person: key in the files -> name here."""

GROUP_INFO: Final = {
    "venue": "venue",
    "aim": "aim",
    "BPC": "bpc",
    "SSC": "ssc",
    "location_pre": "location",
    "inter": "inter",
}
"""Attributes of a group: key in the files -> name here."""

VALUES: Final[dict[str, tuple[str, ...]]] = {
    "gender": GENDERS,
    "age": AGES,
    "ethnicity": ETHNICITIES,
    "venue": VENUES,
    "aim": AIMS,
    "bpc": BODY_PLACES,
    "ssc": SURROUNDINGS,
    "location": LOCATIONS,
    "inter": INTERACTIONS,
}
"""The vocabulary of every attribute."""

NOT_TOLD: Final = frozenset({IMPOSSIBLE, "unknown"})
"""Annotators' words for "cannot be told"."""

_INTERACTION_SPELLINGS: Final = {"standing together together": "standing together"}
"""In plain spelling, after "something" has become "sth"."""

_VERB_SPELLINGS: Final = {
    "finding sth": "finding_something",
    "putting sth": "putting_something",
}

_VALUE_SPELLINGS: Final[dict[str, dict[str, str]]] = {
    # The words of the reasoning files.
    "age": {
        "child": "childhood",
        "adolescent": "adolescence",
        "young": "young adulthood",
        "middle aged": "middle adulthood",
        "elderly": "late adulthood",
    },
    "aim": {"waiting for someone/sth": "waiting_for_someone/something"},
    "ssc": {"garbage bin": "bin"},
}


def _spellings(vocabulary: tuple[str, ...], others: dict[str, str]) -> dict[str, str]:
    """Plain spelling -> the vocabulary's."""
    return {plain(word): word for word in vocabulary} | others


_INTERACTION: Final = _spellings(INTERACTIONS, _INTERACTION_SPELLINGS)
_VERB: Final = _spellings(VERBS, _VERB_SPELLINGS)
_PLACE: Final = _spellings(PLACES, {})
_VALUE: Final = {name: _spellings(words, _VALUE_SPELLINGS.get(name, {})) for name, words in VALUES.items()}


@functools.lru_cache(maxsize=10_000)
def normal_interaction(raw: str) -> str:
    """The vocabulary's spelling of a label between two people.

    >>> normal_interaction("standing_together together")
    'standing together'
    """
    word = plain(raw).replace(" something", " sth")
    return _INTERACTION.get(word, word)


@functools.lru_cache(maxsize=10_000)
def normal_verb(raw: str) -> str:
    """The vocabulary's spelling of what a person does with a thing.

    >>> normal_verb("looking_at"), normal_verb("finding something")
    ('looking at', 'finding_something')
    """
    word = plain(raw)
    return _VERB.get(word, word)


@functools.lru_cache(maxsize=10_000)
def normal_values(attribute: str, raw: str) -> tuple[str | None, ...]:
    """Values that a label of an attribute (a key of `VALUES`) stands for, each once; None where it cannot be told.

    An aim may be several, joined with `&`; a venue may be written with a colon after indoor or outdoor.

    >>> normal_values("age", "Young_Adulthood"), normal_values("aim", "socializing&commuting")
    (('young adulthood',), ('socializing', 'commuting'))
    """
    words = raw.split("&") if attribute == "aim" else [raw.replace(":", " ") if attribute == "venue" else raw]
    values: dict[str | None, None] = {}
    for word in map(plain, words):
        if word:
            values[None if word in NOT_TOLD else _value(attribute, word)] = None
    return tuple(values)


def _value(attribute: str, word: str) -> str:
    """The vocabulary's spelling of a plain word."""
    if attribute == "inter":
        return normal_interaction(word)
    if attribute == "venue" and word.startswith(("indoor ", "outdoor ")):
        # Even of an unknown place the label says whether it is indoors.
        side, place = word.split(" ", 1)
        return f"{side}_{_PLACE.get(place, place)}"
    return _VALUE[attribute].get(word, word)
