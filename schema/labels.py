"""Vocabularies of the labels of people, with the phrases of questions and the tables for other spellings.

Labels are identified by name, never by number, because projects number the last actions differently. All spellings of
a value, such as "food-truck", "food truck" and "food_truck", become the spelling of the annotation format. The loader
reports a label that no table has, and no question uses it. None means that the annotators could not decide.

Each phrase of an action or interaction begins with a verb in -ing, so that it fits after "is" and after "starts". All
phrases differ. No phrase contains " and " or a comma, because lists of phrases are split there. The order of poses,
other actions, interactions, genders and ages gives the codes of the marks in sample pictures. Add new entries only at
the end.
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
"""Actions that are poses. A person is expected to have exactly one of them."""

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

_CHOICE_PHRASES: Final = ACTION_PHRASES | {"looking into sth": "looking into something (a screen, a phone, a book)"}
"""Phrases of actions as choices. In the text of a question, a phrase has no comma."""

INTERACTIONS: Final = (
    *("walking together", "standing together", "conversation", "sitting together", "going upstairs together"),
    *("moving together", "looking at robot together", "looking at sth together", "walking toward each other"),
    *("eating together", "going downstairs together", "bending together", "holding sth together", "cycling together"),
    *("interaction with door together", "hugging", "looking into sth together", "shaking hand"),
    *("waving hand together", "pointing at sth together"),
)
_ACTION_OF_JOINT: Final = {label: label.removesuffix(" together") for label in INTERACTIONS}
JOINT_PHRASES: Final = {
    label: f"{ACTION_PHRASES.get(action, action)} together with {{someone}}"
    for label, action in _ACTION_OF_JOINT.items()
} | {
    "conversation": "having a conversation with {someone}",
    "moving together": "moving along together with {someone}",
    "walking toward each other": "walking towards {someone} who comes the other way",
    "hugging": "hugging {someone}",
    "shaking hand": "shaking hands with {someone}",
    "waving hand together": "waving hands together with {someone}",
}
"""Phrase of each interaction between two people. `{someone}` is the other person."""

INTERACTION_PHRASES: Final = {label: phrase.format(someone="someone") for label, phrase in JOINT_PHRASES.items()}
"""Phrase of each interaction with any person."""

POSES_OF_INTERACTIONS: Final = {label: pose for label in INTERACTIONS for pose in POSES if label.startswith(pose)}
"""The pose that an interaction implies."""

GENDERS: Final = ("male", "female")
AGES: Final = ("childhood", "adolescence", "young adulthood", "middle adulthood", "late adulthood")

_NEIGHBORING_AGES: Final = [ages for pair in itertools.pairwise(AGES) for ages in (pair, pair[::-1])]

FLICKERING: Final = frozenset(("looking at robot", "looking at sth", "pointing at sth", "interaction with door"))
"""Actions with unsteady labels, which are often missing in one second between two seconds with the label.

In a description, a missing label of such an action does not make the action false if the person has the label one
keyframe earlier or later. The action is unknown instead.
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
"""Pairs (label, wider label) with the reason why the wider label may also be true of a person with the label."""


def may_be_called(label: str) -> frozenset[str]:
    """Return the labels of people who may also be called by another label.

    Args:
        label: The other label.

    >>> sorted(may_be_called("sitting"))
    ['bending', 'cycling']
    """
    return frozenset(written for written, also in ALSO if also == label)


def choice_text(answer: str) -> str:
    """Return the text of a choice with a given answer. The text of an action is its phrase.

    >>> choice_text("bending"), choice_text("neither time")
    ('bending down', 'neither time')
    """
    return _CHOICE_PHRASES.get(answer, answer)


def choice_of(answer: str, choices: Sequence[str]) -> int | None:
    """Return the position of an answer among choices, counted from 1, or None if no choice has the answer.

    Args:
        answer: Answer.
        choices: Texts of the choices, in upper or lower case.
    """
    texts = [choice.lower() for choice in choices]
    text = choice_text(answer)
    return texts.index(text) + 1 if text in texts else None


def answer_of_choice(text: str) -> str:
    """Return the answer of a choice with a given text. This is the reverse of `choice_text`."""
    return next((action for action, phrase in _CHOICE_PHRASES.items() if phrase == text), text)


IMPOSSIBLE: Final = "impossible"
"""Annotators' label for an action or attribute that they could not decide. It states no fact."""

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
"""Pairs of key points that are joined by a line.

The seventeen key points are: head, right and left eye, right shoulder, neck, left shoulder, right and left elbow,
tailbone, right wrist, right hip, left hip, left wrist, right and left knee, right and left foot.
"""

OCCLUSIONS: Final = ("Fully_visible", "Mostly_visible", "Severely_occluded", "Fully_occluded")
CLEAR_OCCLUSIONS: Final = frozenset(OCCLUSIONS[:2])
COVERED_OCCLUSIONS: Final = frozenset(OCCLUSIONS[2:])

ROBOT_SECTORS: Final = {"ahead": 180.0, "right": 270.0, "behind": 0.0, "left": 90.0}
"""Panorama angle, in degrees, of the axis of each sector that is seen from the robot."""


class PersonSector(NamedTuple):
    """Sector around a person. Angles are in degrees from the direction that the person faces, towards `side`.

    The sector is true for directions from `low` to `high`, and false for directions outside `least` to `most`. For all
    other directions it is unknown, because readers disagree about them.
    """

    side: Literal["left", "right", "either"]
    low: float
    high: float
    least: float
    most: float


# Inside `low` and `high`, the bounds 0-30-45-135-145-180 of the annotations agree with eighths of a circle.
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
"""Sectors of a person by name. Left is seen from the person."""

DISTANCE_WORDS: Final = ("very close", "close", "moderate", "far", "very far")
DISTANCE_BOUNDS_M: Final = (0.5, 1.5, 5.0, 10.0)
"""Maximum distance in metres for each distance word except the last."""

ETHNICITIES: Final = ("caucasian/white", "negroid/black", "mongoloid/asian", "others")
"""Guesses of the annotators, in the annotation's own terms."""

PLACES: Final = (
    *("cafeteria/dining_hall/food_court", "open_area/campus", "open_space/corridor", "room/class", "study_space"),
    *("street",),
)
VENUES: Final = tuple(f"{side}_{kind}" for side in ("indoor", "outdoor") for kind in PLACES)
"""Kinds of places of a group."""

AIMS: Final = (
    *("wandering", "discussing_an_object/matter", "studying/writing/reading/working", "waiting_for_someone/something"),
    *("socializing", "excursion", "attending_class/lecture/seminar", "eating/ordering_food", "commuting", "navigating"),
)
"""Purposes of a group."""

BODY_PLACES: Final = (
    *("floor", "chair", "stairs", "ground", "platform", "grass", "bike", "scooter", "balcony", "sofa", "skateboard"),
    *("sidewalk", "pathway", "desk", "street", "crosswalk", "bench", "road"),
)
"""Things that support the bodies of the people of a group, such as a floor or a chair (`BPC` in the files)."""

SURROUNDINGS: Final = (
    *("counter", "pillar", "bin", "gate", "table", "wall", "stairs", "fence", "door", "trolley", "coffee_machine"),
    *("shelves", "cafeteria", "balcony", "desk", "room", "elevator", "sofa", "bike", "board", "stroller", "scooter"),
    *("statue", "platform", "standboard", "poster", "show_case", "window", "floor", "crutches", "chair", "tree"),
    *("pole", "bench", "building", "food_truck", "bus", "robot", "baggage", "stand_pillar", "screen", "forecourt"),
    *("shop", "cabinet", "light_street", "car", "copy_machine", "drink_fountain", "class"),
)
"""Things near a group (`SSC` in the files)."""

DEMOGRAPHICS: Final = {"gender": "gender", "age": "age", "race": "ethnicity"}
"""Name of each attribute of a person by its key in the files."""

GROUP_INFO: Final = {
    "venue": "venue",
    "aim": "aim",
    "BPC": "bpc",
    "SSC": "ssc",
    "location_pre": "location",
    "inter": "inter",
}
"""Name of each attribute of a group by its key in the files."""

VALUES: Final[dict[str, tuple[str, ...]]] = {
    "gender": GENDERS,
    "age": AGES,
    "ethnicity": ETHNICITIES,
    "venue": VENUES,
    "aim": AIMS,
    "bpc": BODY_PLACES,
    "ssc": SURROUNDINGS,
    # Prepositions between a group and its surroundings (`location_pre`). No complete list is published.
    "location": ("at",),
    "inter": INTERACTIONS,
}
"""Vocabulary of each attribute."""

PRESENCE_ANSWERS: Final = ("both times", "only at the first time", "only at the second time", "neither time")
DISTANCE_ANSWERS: Final = ("closer to the robot", "farther from the robot", "about the same distance", "not in view")

UNKNOWN_WORDS: Final = frozenset({IMPOSSIBLE, "unknown"})
"""Words of annotators who could not decide."""

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
    """Return a label in lower case. Single blanks replace underscores, hyphens and runs of blanks.

    Args:
        raw: Label as written.
    """
    return " ".join(raw.replace("_", " ").replace("-", " ").lower().split())


_INTERACTION_OF: Final = {plain(label): label for label in INTERACTIONS} | {
    "standing together together": "standing together"
}
_VALUE_OF: Final = {
    name: {plain(value): value for value in values} | _VALUE_SPELLINGS.get(name, {}) for name, values in VALUES.items()
}
_PLACE_OF: Final = {plain(kind): kind for kind in PLACES}


def normal_action(raw: str) -> str:
    """Return the vocabulary's spelling of an action label.

    An unknown label is returned in lower case, without outer blanks.

    Args:
        raw: Label as written.

    >>> normal_action("Opening_the_door")
    'interaction with door'
    """
    word = plain(raw)
    return _ACTION_SPELLINGS.get(word, word)


@functools.lru_cache(maxsize=10_000)
def normal_interaction(raw: str) -> str:
    """Return the vocabulary's spelling of a label between two people.

    Args:
        raw: Label as written.

    >>> normal_interaction("standing_together together")
    'standing together'
    """
    word = plain(raw).replace(" something", " sth")
    return _INTERACTION_OF.get(word, word)


@functools.lru_cache(maxsize=10_000)
def normal_values(attribute: str, raw: str) -> tuple[str | None, ...]:
    """Return the different values of an attribute's label. A value is None if the annotators could not decide.

    Several aims may be joined with `&`. A venue may have a colon after indoor or outdoor.

    Args:
        attribute: Key of `VALUES`.
        raw: Label as written.

    >>> normal_values("age", "Young_Adulthood"), normal_values("aim", "socializing&commuting")
    (('young adulthood',), ('socializing', 'commuting'))
    """
    parts = raw.split("&") if attribute == "aim" else [raw.replace(":", " ") if attribute == "venue" else raw]
    values: dict[str | None, None] = {}
    for word in map(plain, parts):
        if word:
            values[None if word in UNKNOWN_WORDS else _value(attribute, word)] = None
    return tuple(values)


def _value(attribute: str, word: str) -> str:
    """Return the vocabulary's spelling of a plain word."""
    if attribute == "inter":
        return normal_interaction(word)
    if attribute == "venue" and word.startswith(("indoor ", "outdoor ")):
        # The label of an unknown place still says whether the place is indoors.
        side, kind = word.split(" ", 1)
        return f"{side}_{_PLACE_OF.get(kind, kind)}"
    return _VALUE_OF[attribute].get(word, word)
