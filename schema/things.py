"""Things and what people do with them, with the words of questions.

Categories of things are those of the panoptic layer, verbs those of the reasoning layer.

The order of categories and verbs gives the codes of the marks in sample pictures: append only.
"""

from __future__ import annotations

import functools
from typing import Final

from jrdb_avr.schema.labels import plain

OBJECT_PHRASES: Final[dict[str, str]] = {
    "road": "the road",
    "terrain": "the ground",
    "sky": "the sky",
    "vegetation": "some plants",
    "wall": "a wall",
    "column": "a column",
    "building": "a building",
    "stair": "the stairs",
    "ceiling": "the ceiling",
    "barrier/fence": "a barrier or fence",
    "crutch": "a crutch",
    "fire_extinguisher": "a fire extinguisher",
    "big_socket/button": "a large socket or button",
    "airpot": "a thermos jug",
    "controller": "a controller",
    "umbrella": "an umbrella",
    "animal": "an animal",
    "monitor": "a monitor",
    "carpet": "a carpet",
    "cabinet": "a cabinet",
    "jacket": "a jacket",
    "emergency_pole": "an emergency call pole",
    "helmet": "a helmet",
    "peripheral": "a computer accessory",
    "curtain": "a curtain",
    "box": "a box",
    "document": "a document",
    "television": "a television",
    "light_pole": "a lamp post",
    "board": "a board",
    "manhole": "a manhole cover",
    "phone": "a phone",
    "ladder": "a ladder",
    "waterbottle": "a water bottle",
    "picture_frames": "a picture frame",
    "standee": "a display stand",
    "store_sign": "a shop sign",
    "statues": "a statue",
    "cargo": "some cargo",
    "tableware": "some tableware",
    "accessory": "an accessory",
    "other": "some other kind of object",
    "clock": "a clock",
    "golfcart": "a golf cart",
    "wall_panel": "a wall panel",
    "decoration": "a decoration",
    "hanging_light": "a hanging lamp",
    "window": "a window",
    "poster": "a poster",
    "lift": "a lift",
    "vent": "an air vent",
    "fountain": "a fountain",
    "door_handle": "a door handle",
    "floor/walking_path": "the floor or a path",
    "machines": "a machine",
    "child": "a child",
    "trash_bin": "a trash bin",
    "shelf": "a shelf",
    "car": "a car",
    "bicycle/scooter": "a bicycle or scooter",
    "bag": "a bag",
    "big_vehicle": "a large vehicle",
    "chair/sofa": "a chair or sofa",
    "pedestrian": "a pedestrian",
    "sign": "a sign",
    "trolley": "a trolley",
    "pole/trafficcone": "a pole or traffic cone",
    "bicyclist/rider": "a cyclist or rider",
    "table": "a table",
    "skateboard/segway/hoverboard": "a skateboard or segway or hoverboard",
    "glass": "a pane of glass",
    "door": "a door",
}
"""Each category, in the standard numbering of the panoptic layer, as a noun phrase; no two phrases are equal."""

OBJECTS: Final = tuple(OBJECT_PHRASES)

PERSON_CATEGORIES: Final = frozenset({"pedestrian", "bicyclist/rider", "child"})
"""Categories of people: the box layers track and count them."""

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
"""The verbs of the reasoning layer."""

_OTHER_PHRASES: Final = {
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
VERB_PHRASES: Final = {verb: _OTHER_PHRASES.get(verb, verb) for verb in VERBS}
"""Each verb as it stands before a thing."""

_VERB_OF: Final = {plain(verb): verb for verb in VERBS} | {
    "finding sth": "finding_something",
    "putting sth": "putting_something",
}

CATEGORY_PREFIXES: Final = ("t_", "m_")
"""Prefixes of category names in some files."""


def normal_category(name: str) -> str:
    """The vocabulary's spelling of a category's name: lower case, no prefix, underscores between words.

    Names outside `OBJECTS` come back in the same spelling.
    """
    word = plain(name).replace(" ", "_")
    prefix = next((prefix for prefix in CATEGORY_PREFIXES if word.startswith(prefix)), "")
    return word.removeprefix(prefix)


@functools.lru_cache(maxsize=10_000)
def normal_verb(raw: str) -> str:
    """The vocabulary's spelling of a verb; an unknown verb comes back in plain spelling.

    >>> normal_verb("looking_at"), normal_verb("finding something")
    ('looking at', 'finding_something')
    """
    word = plain(raw)
    return _VERB_OF.get(word, word)
