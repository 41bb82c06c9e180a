"""Label vocabularies and the explicit tables that normalise their spellings.

Names are used, never numeric ids: projects number the last actions differently. What a table does not know is kept as
written, reported by the loader, and never used in a question.

Things and what people do with them: categories of the panoptic layer and verbs of the reasoning layer.

Positions in these tuples are codes of the marks in sample pictures: append only.
"""

from __future__ import annotations

from typing import Final

POSES: Final = (
    "walking",
    "standing",
    "sitting",
    "cycling",
    "going upstairs",
    "going downstairs",
    "bending",
    "skating",
    "scootering",
    "running",
    "lying",
)
"""Pose-type actions: a person is expected to have exactly one of them."""

OTHER_ACTIONS: Final = (
    "holding sth",
    "listening to someone",
    "talking to someone",
    "looking at robot",
    "looking into sth",
    "looking at sth",
    "typing",
    "interaction with door",
    "eating sth",
    "talking on the phone",
    "pointing at sth",
    "reading",
    "pushing",
    "greeting gestures",
    "writing",
    "pulling",
)

ACTIONS: Final = POSES + OTHER_ACTIONS

IMPOSSIBLE: Final = "impossible"
"""The annotators' word for "cannot be told", of actions and demographics; it states no fact."""

_ACTION_SPELLINGS: Final = {
    "opening the door": "interaction with door",
    "pushing the door": "interaction with door",
    "holding the door": "interaction with door",
    "holding something": "holding sth",
    "looking at something": "looking at sth",
    "looking into something": "looking into sth",
    "pointing at something": "pointing at sth",
    "eating something": "eating sth",
}

OCCLUSIONS: Final = ("Fully_visible", "Mostly_visible", "Severely_occluded", "Fully_occluded")
CLEAR_OCCLUSIONS: Final = frozenset(OCCLUSIONS[:2])

ROBOT_SECTORS: Final = ("ahead", "right", "behind", "left")
"""Sectors of a person as the robot sees it: panorama angles 180, 270, 0, 90, each +-45 degrees."""

PERSON_SECTORS: Final = (
    "front",
    "front left",
    "left",
    "back left",
    "back",
    "back right",
    "right",
    "front right",
)
"""Sectors in a person's own heading frame; left is counter-clockwise, as the person itself would say."""

DISTANCE_WORDS: Final = ("very close", "close", "moderate", "far", "very far")
DISTANCE_BOUNDS_M: Final = (0.5, 1.5, 5.0, 10.0)
"""Upper bounds, inclusive, of all distance words but the last."""

GENDERS: Final = ("male", "female")
AGES: Final = ("childhood", "adolescence", "young adulthood", "middle adulthood", "late adulthood")

INTERACTIONS: Final = (
    "walking together",
    "standing together",
    "conversation",
    "sitting together",
    "going upstairs together",
    "moving together",
    "looking at robot together",
    "looking at sth together",
    "walking toward each other",
    "eating together",
    "going downstairs together",
    "bending together",
    "holding sth together",
    "cycling together",
    "interaction with door together",
    "hugging",
    "looking into sth together",
    "shaking hand",
    "waving hand together",
    "pointing at sth together",
)
"""Labels between two people."""

PRESENCE_ANSWERS: Final = ("both times", "only at the first time", "only at the second time", "neither time")
DISTANCE_ANSWERS: Final = (
    "closer to the robot",
    "farther from the robot",
    "about the same distance",
    "not in view",
)


def plain(raw: str) -> str:
    """A label in lower case, with single blanks for `_`, `-` and any run of blanks."""
    return " ".join(raw.replace("_", " ").replace("-", " ").lower().split())


def normal_action(raw: str) -> str:
    """The vocabulary's spelling of an action label; an unknown label comes back stripped and lower-cased.

    >>> normal_action("Opening_the_door")
    'interaction with door'
    """
    word = plain(raw)
    return _ACTION_SPELLINGS.get(word, word)


OBJECTS: Final = (
    "road",
    "terrain",
    "sky",
    "vegetation",
    "wall",
    "column",
    "building",
    "stair",
    "ceiling",
    "barrier/fence",
    "crutch",
    "fire_extinguisher",
    "big_socket/button",
    "airpot",
    "controller",
    "umbrella",
    "animal",
    "monitor",
    "carpet",
    "cabinet",
    "jacket",
    "emergency_pole",
    "helmet",
    "peripheral",
    "curtain",
    "box",
    "document",
    "television",
    "light_pole",
    "board",
    "manhole",
    "phone",
    "ladder",
    "waterbottle",
    "picture_frames",
    "standee",
    "store_sign",
    "statues",
    "cargo",
    "tableware",
    "accessory",
    "other",
    "clock",
    "golfcart",
    "wall_panel",
    "decoration",
    "hanging_light",
    "window",
    "poster",
    "lift",
    "vent",
    "fountain",
    "door_handle",
    "floor/walking_path",
    "machines",
    "child",
    "trash_bin",
    "shelf",
    "car",
    "bicycle/scooter",
    "bag",
    "big_vehicle",
    "chair/sofa",
    "pedestrian",
    "sign",
    "trolley",
    "pole/trafficcone",
    "bicyclist/rider",
    "table",
    "skateboard/segway/hoverboard",
    "glass",
    "door",
)
"""Categories of things, in the standard numbering of the panoptic layer."""

PERSON_CATEGORIES: Final = frozenset({"pedestrian", "bicyclist/rider", "child"})
"""Categories that are people: they are tracked by the box layers, and counted there only."""

VERBS: Final = (
    "working",
    "opening",
    "closing",
    "entering",
    "exiting",
    "touching",
    "cleaning",
    "watering",
    "pruning",
    "planting",
    "sitting",
    "pushing",
    "pulling",
    "carrying",
    "holding",
    "looking at",
    "looking into",
    "looking out",
    "presenting",
    "organizing",
    "leaning",
    "painting",
    "installing",
    "removing",
    "walking",
    "standing",
    "running",
    "repairing",
    "riding",
    "parking",
    "mounting",
    "depositing",
    "placing",
    "warning",
    "blocking",
    "adjusting",
    "constructing",
    "maintaining",
    "handling/manipulating",
    "accessing",
    "inspecting",
    "storing",
    "pressing",
    "switching",
    "drinking",
    "refilling",
    "moving",
    "operating",
    "displaying",
    "arranging",
    "talking on",
    "browsing/engaging",
    "loading",
    "unloading",
    "transporting",
    "connecting",
    "using",
    "configuring",
    "disconnecting",
    "printing/copying",
    "identifying",
    "locating",
    "promoting",
    "advertising",
    "finding_something",
    "putting_something",
    "directing",
    "attracting",
    "investigating",
    "exploring",
    "utilizing",
    "understanding",
    "observing",
    "turning",
    "wearing",
    "adorning",
    "replacing",
    "matching",
    "collecting",
    "folding",
    "servicing",
    "feeding",
    "climbing",
    "going down",
    "going up",
)
"""What a person does with a thing."""

CATEGORY_PREFIXES: Final = ("t_", "m_")
"""Prefixes of names in some files; they say nothing about the thing."""


def normal_category(name: str) -> str:
    """The usual spelling of a category's name: without case and prefix, underscores between words.

    Names outside `OBJECTS` come back in the same spelling.
    """
    word = plain(name).replace(" ", "_")
    prefix = next((prefix for prefix in CATEGORY_PREFIXES if word.startswith(prefix)), "")
    return word.removeprefix(prefix)
