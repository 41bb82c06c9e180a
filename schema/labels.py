"""Vocabularies of the labels of people, with the words of questions and the tables that normalise spellings.

Labels are identified by name, never by number, as projects number the last actions differently. Values keep the
spelling of the annotation format, so that "food-truck", "food truck" and "food_truck" are one value. The loader
reports a label that no table knows; no question uses it. None stands for "the annotators could not tell", which is not
a value.

Every phrase of an action or interaction is an -ing phrase: it fits after "is" and after "starts". No two phrases are
alike, and none holds " and " or a comma, at which lists of them are split. The order of poses, other actions,
interactions, genders and ages gives the codes of the marks in sample pictures: append only.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

POSES: Final = (
    *("walking", "standing", "sitting", "cycling", "going upstairs", "going downstairs", "bending", "skating"),
    *("scootering", "running", "lying"),
)
"""Actions that are poses: a person is expected to have exactly one of them."""

OTHER_ACTIONS: Final = (
    *("holding sth", "listening to someone", "talking to someone", "looking at robot", "looking into sth"),
    *("looking at sth", "typing", "interaction with door", "eating sth", "talking on the phone", "pointing at sth"),
    *("reading", "pushing", "greeting gestures", "writing", "pulling"),
)
ACTIONS: Final = POSES + OTHER_ACTIONS

_SPELLED_OUT: Final = {label: label.replace("sth", "something") for label in ACTIONS}
ACTION_PHRASES: Final = _SPELLED_OUT | {
    "bending": "bending down",
    "scootering": "riding a scooter",
    "lying": "lying down",
    "looking at robot": "looking at the robot",
    "interaction with door": "using a door",
    "pushing": "pushing something",
    "greeting gestures": "making a greeting gesture",
    "pulling": "pulling something",
}

JOINT_PHRASES: Final[dict[str, str]] = {
    "walking together": "walking together with {someone}",
    "standing together": "standing together with {someone}",
    "conversation": "having a conversation with {someone}",
    "sitting together": "sitting together with {someone}",
    "going upstairs together": "going upstairs together with {someone}",
    "moving together": "moving along together with {someone}",
    "looking at robot together": "looking at the robot together with {someone}",
    "looking at sth together": "looking at something together with {someone}",
    "walking toward each other": "walking towards {someone} who comes the other way",
    "eating together": "eating together with {someone}",
    "going downstairs together": "going downstairs together with {someone}",
    "bending together": "bending down together with {someone}",
    "holding sth together": "holding something together with {someone}",
    "cycling together": "cycling together with {someone}",
    "interaction with door together": "using a door together with {someone}",
    "hugging": "hugging {someone}",
    "looking into sth together": "looking into something together with {someone}",
    "shaking hand": "shaking hands with {someone}",
    "waving hand together": "waving hands together with {someone}",
    "pointing at sth together": "pointing at something together with {someone}",
}
"""Each interaction between two people, with a place for the other person."""

INTERACTIONS: Final = tuple(JOINT_PHRASES)
INTERACTION_PHRASES: Final = {label: phrase.format(someone="someone") for label, phrase in JOINT_PHRASES.items()}
"""Each interaction with anybody."""

POSES_OF_INTERACTIONS: Final = {label: pose for label in INTERACTIONS for pose in POSES if label.startswith(pose)}
"""The pose that an interaction implies."""

GENDERS: Final = ("male", "female")
AGES: Final = ("childhood", "adolescence", "young adulthood", "middle adulthood", "late adulthood")

_NEIGHBORING_AGES: Final = [pair for one in itertools.pairwise(AGES) for pair in (one, one[::-1])]

FLICKERING: Final = frozenset(("looking at robot", "looking at sth", "pointing at sth", "interaction with door"))
"""Actions that labels often miss between two seconds that have them.

In a description such an action is unknown, and not false, of a person who has its label at a keyframe before or after.
"""

ALSO: Final = {
    ("going upstairs", "walking"): "people walk up stairs",
    ("going downstairs", "walking"): "people walk down stairs",
    ("running", "walking"): "there is no bound between the two",
    ("walking", "running"): "there is no bound between the two",
    ("bending", "walking"): "people bend down while they walk",
    ("bending", "standing"): "people bend down while they stand",
    ("bending", "sitting"): "people bend down while they sit",
    ("cycling", "sitting"): "people sit on a bicycle",
    ("scootering", "standing"): "people stand on a scooter",
    ("skating", "standing"): "people stand on a skateboard",
    ("looking at robot", "looking at sth"): "the robot is something",
    ("looking into sth", "looking at sth"): "one looks at what one looks into",
    ("reading", "looking at sth"): "one looks at what one reads",
    ("reading", "looking into sth"): "one looks into a book that one reads",
    ("reading", "holding sth"): "people hold what they read",
    ("eating sth", "holding sth"): "people hold what they eat",
    ("pushing", "holding sth"): "people hold what they push",
    ("pulling", "holding sth"): "people hold what they pull",
    ("interaction with door", "holding sth"): "people hold a door, or its handle",
    ("talking on the phone", "holding sth"): "people hold a telephone",
    ("talking on the phone", "talking to someone"): "somebody listens at the other end",
    ("talking on the phone", "listening to someone"): "somebody talks at the other end",
    ("pointing at sth", "looking at sth"): "people look where they point",
    ("walking together", "moving together"): "walking is moving",
    ("cycling together", "moving together"): "cycling is moving",
    ("going upstairs together", "moving together"): "people on stairs move",
    ("going downstairs together", "moving together"): "people on stairs move",
    ("going upstairs together", "walking together"): "people walk up stairs",
    ("going downstairs together", "walking together"): "people walk down stairs",
    ("looking at robot together", "looking at sth together"): "the robot is something",
    ("looking into sth together", "looking at sth together"): "one looks at what one looks into",
    ("carrying", "holding"): "people hold what they carry",
    ("holding", "carrying"): "there is no bound between the two",
    ("holding", "handling/manipulating"): "there is no bound between the two",
    ("carrying", "handling/manipulating"): "there is no bound between the two",
    ("using", "handling/manipulating"): "there is no bound between the two",
    ("handling/manipulating", "using"): "there is no bound between the two",
    ("holding", "using"): "people hold what they use",
    ("utilizing", "using"): "the two words mean the same",
    ("using", "utilizing"): "the two words mean the same",
    ("transporting", "carrying"): "people carry what they transport",
    ("observing", "looking at"): "people look at what they observe",
    ("looking at", "observing"): "there is no bound between the two",
    ("looking into", "looking at"): "one looks at what one looks into",
    **dict.fromkeys(_NEIGHBORING_AGES, "ages have no bounds that can be seen"),
}
"""(label, other): why the words of `other` may be said of somebody with the label in ordinary words."""


def may_be_called(label: str) -> frozenset[str]:
    """Labels of people of whom the words of a label may be said too: to them, the words are never certainly false.

    >>> sorted(may_be_called("sitting"))
    ['bending', 'cycling']
    """
    return frozenset(own for own, other in ALSO if other == label)


def overlapping(pose: str) -> frozenset[str]:
    """The poses that cannot be wrong choices beside this one.

    >>> sorted(overlapping("cycling"))
    ['sitting']
    """
    return may_be_called(pose) | {other for own, other in ALSO if own == pose}


def choice_text(answer: str) -> str:
    """An answer as a choice says it, in the words of questions: a pose as its phrase.

    >>> choice_text("bending"), choice_text("neither time")
    ('bending down', 'neither time')
    """
    return ACTION_PHRASES.get(answer, answer)


def choice_of(answer: str, choices: Sequence[str]) -> int | None:
    """The number, from 1, of the choice that says an answer, in whatever case; None where none does."""
    texts = [choice.lower() for choice in choices]
    text = choice_text(answer)
    return texts.index(text) + 1 if text in texts else None


def answer_of_choice(text: str) -> str:
    """The answer that a choice says: the reverse of `choice_text`."""
    return next((action for action, phrase in ACTION_PHRASES.items() if phrase == text), text)


IMPOSSIBLE: Final = "impossible"
"""The annotators' word for an action or attribute that they could not tell; it states no fact."""

_ACTION_SPELLINGS: Final = {
    "opening the door": "interaction with door",
    "pushing the door": "interaction with door",
    "holding the door": "interaction with door",
    **{phrase: label for label, phrase in _SPELLED_OUT.items()},
}

SKELETON: Final = (
    *((1, 2), (0, 4), (3, 4), (8, 10), (5, 7), (10, 13), (14, 16), (4, 5), (7, 12), (4, 8), (3, 6)),
    *((13, 15), (11, 14), (6, 9), (8, 11)),
)
"""Pairs of keypoints that a line joins. The seventeen are: head, right and left eye, right shoulder, neck,
left shoulder, right and left elbow, tailbone, right wrist, right hip, left hip, left wrist, right and left knee, right
and left foot."""

OCCLUSIONS: Final = ("Fully_visible", "Mostly_visible", "Severely_occluded", "Fully_occluded")
CLEAR_OCCLUSIONS: Final = frozenset(OCCLUSIONS[:2])
COVERED_OCCLUSIONS: Final = frozenset(OCCLUSIONS[2:])

ROBOT_SECTORS: Final = {"ahead": 180.0, "right": 270.0, "behind": 0.0, "left": 90.0}
"""Directions as the robot sees them, with the panorama angle of each one's axis."""


class PersonSector(NamedTuple):
    """A sector in a person's own heading frame, in degrees turned from straight ahead to its side, or to either.

    It is true of whoever is turned from `low` to `high`, false of whoever is not turned from `least` to `most`, and
    unknown in between, where some would say that it is true.
    """

    side: Literal["left", "right", "either"]
    low: float
    high: float
    least: float
    most: float


# The annotations draw the bounds 0-30-45-135-145-180; where a sector is true, eighths of a circle agree with them.
_FRONT, _BACK = PersonSector("either", 0, 20, 0, 90), PersonSector("either", 160, 180, 90, 180)
PERSON_SECTORS: Final = {
    "front": _FRONT,
    "front left": PersonSector("left", 32, 43, 0, 90),
    "left": PersonSector("left", 70, 110, 0, 180),
    "back left": PersonSector("left", 137, 143, 90, 180),
    "back": _BACK,
    "back right": PersonSector("right", 137, 143, 90, 180),
    "right": PersonSector("right", 70, 110, 0, 180),
    "front right": PersonSector("right", 32, 43, 0, 90),
}
"""Sectors of a person by word; left is the person's own."""

DISTANCE_WORDS: Final = ("very close", "close", "moderate", "far", "very far")
DISTANCE_BOUNDS_M: Final = (0.5, 1.5, 5.0, 10.0)
"""Upper bounds, inclusive, of all distance words but the last."""

ETHNICITIES: Final = ("caucasian/white", "negroid/black", "mongoloid/asian", "others")
"""The annotators' guesses, in the annotation's own terms."""

PLACES: Final = (
    *("cafeteria/dining_hall/food_court", "open_area/campus", "open_space/corridor", "room/class", "study_space"),
    *("street",),
)
VENUES: Final = tuple(f"{side}_{place}" for side in ("indoor", "outdoor") for place in PLACES)
"""Kinds of place of a group."""

AIMS: Final = (
    *("wandering", "discussing_an_object/matter", "studying/writing/reading/working", "waiting_for_someone/something"),
    *("socializing", "excursion", "attending_class/lecture/seminar", "eating/ordering_food", "commuting", "navigating"),
)
"""Purposes of a group."""

BODY_PLACES: Final = (
    *("floor", "chair", "stairs", "ground", "platform", "grass", "bike", "scooter", "balcony", "sofa", "skateboard"),
    *("sidewalk", "pathway", "desk", "street", "crosswalk", "bench", "road"),
)
"""What the bodies of a group are on (`BPC` in the files)."""

SURROUNDINGS: Final = (
    *("counter", "pillar", "bin", "gate", "table", "wall", "stairs", "fence", "door", "trolley", "coffee_machine"),
    *("shelves", "cafeteria", "balcony", "desk", "room", "elevator", "sofa", "bike", "board", "stroller", "scooter"),
    *("statue", "platform", "standboard", "poster", "show_case", "window", "floor", "crutches", "chair", "tree"),
    *("pole", "bench", "building", "food_truck", "bus", "robot", "baggage", "stand_pillar", "screen", "forecourt"),
    *("shop", "cabinet", "light_street", "car", "copy_machine", "drink_fountain", "class"),
)
"""What stands out around a group (`SSC` in the files)."""

LOCATIONS: Final = ("at",)
"""Prepositions between a group and its surroundings (`location_pre`). No complete list is published."""

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

PRESENCE_ANSWERS: Final = ("both times", "only at the first time", "only at the second time", "neither time")
DISTANCE_ANSWERS: Final = ("closer to the robot", "farther from the robot", "about the same distance", "not in view")

UNKNOWN_WORDS: Final = frozenset({IMPOSSIBLE, "unknown"})
"""Annotators' words for "could not tell"."""

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


def plain(raw: str) -> str:
    """A label in lower case, with single blanks for `_`, `-` and any run of blanks."""
    return " ".join(raw.replace("_", " ").replace("-", " ").lower().split())


_INTERACTION_OF: Final = {plain(label): label for label in INTERACTIONS} | {
    "standing together together": "standing together"
}
_VALUE_OF: Final = {
    name: {plain(word): word for word in words} | _VALUE_SPELLINGS.get(name, {}) for name, words in VALUES.items()
}
_PLACE_OF: Final = {plain(place): place for place in PLACES}


def normal_action(raw: str) -> str:
    """The vocabulary's spelling of an action label; an unknown label comes back stripped and lower-cased.

    >>> normal_action("Opening_the_door")
    'interaction with door'
    """
    word = plain(raw)
    return _ACTION_SPELLINGS.get(word, word)


@functools.lru_cache(maxsize=10_000)
def normal_interaction(raw: str) -> str:
    """The vocabulary's spelling of a label between two people.

    >>> normal_interaction("standing_together together")
    'standing together'
    """
    word = plain(raw).replace(" something", " sth")
    return _INTERACTION_OF.get(word, word)


@functools.lru_cache(maxsize=10_000)
def normal_values(attribute: str, raw: str) -> tuple[str | None, ...]:
    """Values of a label of an attribute (a key of `VALUES`), each once; None where the annotators could not tell.

    An aim may be several, joined with `&`; a venue may be written with a colon after indoor or outdoor.

    >>> normal_values("age", "Young_Adulthood"), normal_values("aim", "socializing&commuting")
    (('young adulthood',), ('socializing', 'commuting'))
    """
    words = raw.split("&") if attribute == "aim" else [raw.replace(":", " ") if attribute == "venue" else raw]
    values: dict[str | None, None] = {}
    for word in map(plain, words):
        if word:
            values[None if word in UNKNOWN_WORDS else _value(attribute, word)] = None
    return tuple(values)


def _value(attribute: str, word: str) -> str:
    """The vocabulary's spelling of a plain word."""
    if attribute == "inter":
        return normal_interaction(word)
    if attribute == "venue" and word.startswith(("indoor ", "outdoor ")):
        # Even of an unknown place the label says whether it is indoors.
        side, place = word.split(" ", 1)
        return f"{side}_{_PLACE_OF.get(place, place)}"
    return _VALUE_OF[attribute].get(word, word)
