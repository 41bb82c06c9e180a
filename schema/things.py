"""Categories of things, verbs for handling things, and the phrases for categories and verbs in questions.

The categories come from the panoptic layer, and the verbs from the reasoning layer. Add new entries only at the end of
`OBJECTS` and `VERBS`, because the marks in sample pictures encode a category or a verb by its position.
"""

from __future__ import annotations

import functools
from typing import Final

from jrdb_avr.schema.labels import POSES, plain

OBJECTS: Final = (
    *("road", "terrain", "sky", "vegetation", "wall", "column", "building", "stair", "ceiling", "barrier/fence"),
    *("crutch", "fire_extinguisher", "big_socket/button", "airpot", "controller", "umbrella", "animal", "monitor"),
    *("carpet", "cabinet", "jacket", "emergency_pole", "helmet", "peripheral", "curtain", "box", "document"),
    *("television", "light_pole", "board", "manhole", "phone", "ladder", "waterbottle", "picture_frames", "standee"),
    *("store_sign", "statues", "cargo", "tableware", "accessory", "other", "clock", "golfcart", "wall_panel"),
    *("decoration", "hanging_light", "window", "poster", "lift", "vent", "fountain", "door_handle"),
    *("floor/walking_path", "machines", "child", "trash_bin", "shelf", "car", "bicycle/scooter", "bag"),
    *("big_vehicle", "chair/sofa", "pedestrian", "sign", "trolley", "pole/trafficcone", "bicyclist/rider", "table"),
    *("skateboard/segway/hoverboard", "glass", "door"),
)
"""Categories of things, in the order of their standard ids in the panoptic layer."""


def _noun_phrase(category: str) -> str:
    noun = category.replace("_", " ").replace("/", " or ")
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


OBJECT_PHRASES: Final = {category: _noun_phrase(category) for category in OBJECTS} | {
    "road": "the road",
    "terrain": "the ground",
    "sky": "the sky",
    "vegetation": "some plants",
    "stair": "the stairs",
    "ceiling": "the ceiling",
    "big_socket/button": "a large socket or button",
    "airpot": "a thermos jug",
    "emergency_pole": "an emergency call pole",
    "peripheral": "a computer accessory",
    "light_pole": "a lamp post",
    "manhole": "a manhole cover",
    "waterbottle": "a water bottle",
    "picture_frames": "a picture frame",
    "standee": "a display stand",
    "store_sign": "a shop sign",
    "statues": "a statue",
    "cargo": "some cargo",
    "tableware": "some tableware",
    "other": "some other kind of object",
    "golfcart": "a golf cart",
    "hanging_light": "a hanging lamp",
    "vent": "an air vent",
    "floor/walking_path": "the floor or a path",
    "machines": "a machine",
    "big_vehicle": "a large vehicle",
    "pole/trafficcone": "a pole or traffic cone",
    "bicyclist/rider": "a cyclist or rider",
    "glass": "a pane of glass",
}
"""Noun phrase of each category in questions. No two categories have the same phrase."""

PERSON_CATEGORIES: Final = frozenset({"pedestrian", "bicyclist/rider", "child"})
"""Categories of people. They are not things, because the layers of boxes already track and count people."""

VERBS: Final = (
    *("working", "opening", "closing", "entering", "exiting", "touching", "cleaning", "watering", "pruning"),
    *("planting", "sitting", "pushing", "pulling", "carrying", "holding", "looking at", "looking into"),
    *("looking out", "presenting", "organizing", "leaning", "painting", "installing", "removing", "walking"),
    *("standing", "running", "repairing", "riding", "parking", "mounting", "depositing", "placing", "warning"),
    *("blocking", "adjusting", "constructing", "maintaining", "handling/manipulating", "accessing", "inspecting"),
    *("storing", "pressing", "switching", "drinking", "refilling", "moving", "operating", "displaying", "arranging"),
    *("talking on", "browsing/engaging", "loading", "unloading", "transporting", "connecting", "using"),
    *("configuring", "disconnecting", "printing/copying", "identifying", "locating", "promoting", "advertising"),
    *("finding_something", "putting_something", "directing", "attracting", "investigating", "exploring", "utilizing"),
    *("understanding", "observing", "turning", "wearing", "adorning", "replacing", "matching", "collecting"),
    *("folding", "servicing", "feeding", "climbing", "going down", "going up"),
)
"""Verbs of the reasoning layer."""

VERB_PHRASES: Final = {verb: verb for verb in VERBS} | {
    "working": "working at",
    "exiting": "leaving",
    "sitting": "sitting on",
    "looking out": "looking out of",
    "leaning": "leaning on",
    "walking": "walking on",
    "standing": "standing on",
    "running": "running on",
    "depositing": "depositing something in",
    "warning": "warning of",
    "handling/manipulating": "handling",
    "accessing": "getting access to",
    "drinking": "drinking from",
    "browsing/engaging": "browsing",
    "configuring": "setting up",
    "printing/copying": "printing or copying",
    "finding_something": "finding something in",
    "putting_something": "putting something into",
    "attracting": "attracting attention with",
    "understanding": "trying to understand",
}
"""Phrase of each verb in questions. The noun phrase of the thing follows the phrase of the verb."""

POSES_OF_VERBS: Final[dict[str, tuple[str, ...]]] = {verb: (verb,) for verb in VERBS if verb in POSES} | {
    "riding": ("cycling", "skating", "scootering"),
    "climbing": ("going upstairs",),
    "going up": ("going upstairs",),
    "going down": ("going downstairs",),
}
"""Poses that a verb implies, by verb. The verb "riding" may imply any of three poses."""

_VERB_OF: Final = {plain(verb): verb for verb in VERBS} | {
    "finding sth": "finding_something",
    "putting sth": "putting_something",
}


def normal_category(name: str) -> str:
    """Return a category's name in the spelling of `OBJECTS`: lower case, no prefix, underscores between words.

    In some files, names have the prefix "t_" or "m_". A name that is not in `OBJECTS` is converted in the same way.
    """
    return plain(name).replace(" ", "_").removeprefix("t_").removeprefix("m_")


@functools.lru_cache(maxsize=10_000)
def normal_verb(raw: str) -> str:
    """Return a verb in the spelling of `VERBS`.

    A verb that is not in `VERBS` is returned in lower case, with blanks in place of underscores and hyphens.

    >>> normal_verb("looking_at"), normal_verb("finding something")
    ('looking at', 'finding_something')
    """
    word = plain(raw)
    return _VERB_OF.get(word, word)
