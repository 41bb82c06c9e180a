"""Things and what people do with them: categories of the panoptic layer and verbs of the reasoning layer.

Positions in these tuples are codes of the marks in sample pictures: append only.
"""

from __future__ import annotations

from typing import Final

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

STUFF: Final = frozenset({*OBJECTS[: OBJECTS.index("crutch")], "glass"})
"""Categories without tracks: what surrounds people and things."""

CATEGORY_PREFIXES: Final = ("t_", "m_")
"""Stand before names in some files, and say nothing of the thing."""


def normal_category(name: str) -> str:
    """The usual spelling of a category's name: without case and prefix, whatever separates its words.

    A name outside `OBJECTS` comes back in lower case, with underscores for blanks and dashes.
    """
    plain = name.strip().lower().translate(_SEPARATORS)
    for prefix in CATEGORY_PREFIXES:
        plain = plain.removeprefix(prefix)
    return _SPELLED.get(plain.replace("_", ""), plain)


_SEPARATORS: Final = str.maketrans("- ", "__")
_SPELLED: Final = {name.replace("_", ""): name for name in OBJECTS}
