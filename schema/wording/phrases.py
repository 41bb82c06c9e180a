"""What people do, in words: actions, labelled interactions, and the verbs of things handled.

Every phrase is an -ing phrase: it fits after "is" and after "starts". No two phrases of these tables are alike, and
none holds " and " or a comma, at which lists of them are split.

Things in plain English, for descriptions of who handles what.
"""

from __future__ import annotations

from functools import cache
from typing import Final

from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M

THINGS: Final[dict[str, str]] = {
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
"""Category -> noun phrase, no two alike."""


ACTION_PHRASES: Final[dict[str, str]] = {
    "walking": "walking",
    "standing": "standing",
    "sitting": "sitting",
    "cycling": "cycling",
    "going upstairs": "going upstairs",
    "going downstairs": "going downstairs",
    "bending": "bending down",
    "skating": "skating",
    "scootering": "riding a scooter",
    "running": "running",
    "lying": "lying down",
    "holding sth": "holding something",
    "listening to someone": "listening to someone",
    "talking to someone": "talking to someone",
    "looking at robot": "looking at the robot",
    "looking into sth": "looking into something",
    "looking at sth": "looking at something",
    "typing": "typing",
    "interaction with door": "using a door",
    "eating sth": "eating something",
    "talking on the phone": "talking on the phone",
    "pointing at sth": "pointing at something",
    "reading": "reading",
    "pushing": "pushing something",
    "greeting gestures": "making a greeting gesture",
    "writing": "writing",
    "pulling": "pulling something",
}
"""Each action as an -ing phrase: fits after "is" and after "starts"."""

TOGETHER: Final[dict[str, str]] = {
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
"""Each interaction, with a place for the other person."""

INTERACTION_PHRASES: Final = {label: phrase.format(someone="someone") for label, phrase in TOGETHER.items()}
"""Each interaction, when the other person is anybody."""

VERB_PHRASES: Final[dict[str, str]] = {
    "working": "working at",
    "opening": "opening",
    "closing": "closing",
    "entering": "entering",
    "exiting": "leaving",
    "touching": "touching",
    "cleaning": "cleaning",
    "watering": "watering",
    "pruning": "pruning",
    "planting": "planting",
    "sitting": "sitting on",
    "pushing": "pushing",
    "pulling": "pulling",
    "carrying": "carrying",
    "holding": "holding",
    "looking at": "looking at",
    "looking into": "looking into",
    "looking out": "looking out of",
    "presenting": "presenting",
    "organizing": "organizing",
    "leaning": "leaning on",
    "painting": "painting",
    "installing": "installing",
    "removing": "removing",
    "walking": "walking on",
    "standing": "standing on",
    "running": "running on",
    "repairing": "repairing",
    "riding": "riding",
    "parking": "parking",
    "mounting": "mounting",
    "depositing": "depositing something in",
    "placing": "placing",
    "warning": "warning of",
    "blocking": "blocking",
    "adjusting": "adjusting",
    "constructing": "constructing",
    "maintaining": "maintaining",
    "handling/manipulating": "handling",
    "accessing": "getting access to",
    "inspecting": "inspecting",
    "storing": "storing",
    "pressing": "pressing",
    "switching": "switching",
    "drinking": "drinking from",
    "refilling": "refilling",
    "moving": "moving",
    "operating": "operating",
    "displaying": "displaying",
    "arranging": "arranging",
    "talking on": "talking on",
    "browsing/engaging": "browsing",
    "loading": "loading",
    "unloading": "unloading",
    "transporting": "transporting",
    "connecting": "connecting",
    "using": "using",
    "configuring": "setting up",
    "disconnecting": "disconnecting",
    "printing/copying": "printing or copying",
    "identifying": "identifying",
    "locating": "locating",
    "promoting": "promoting",
    "advertising": "advertising",
    "finding_something": "finding something in",
    "putting_something": "putting something into",
    "directing": "directing",
    "attracting": "attracting attention with",
    "investigating": "investigating",
    "exploring": "exploring",
    "utilizing": "utilizing",
    "understanding": "trying to understand",
    "observing": "observing",
    "turning": "turning",
    "wearing": "wearing",
    "adorning": "adorning",
    "replacing": "replacing",
    "matching": "matching",
    "collecting": "collecting",
    "folding": "folding",
    "servicing": "servicing",
    "feeding": "feeding",
    "climbing": "climbing",
    "going down": "going down",
    "going up": "going up",
}
"""Each verb as it stands before a thing."""

_PAIR_PHRASES: Final[dict[tuple[str, str], str]] = {
    ("sitting", "table"): "sitting at a table",
    ("standing", "table"): "standing at a table",
    # "using a door" is the action "interaction with door"; this is a verb and a thing.
    ("using", "door"): "making use of a door",
}
"""(verb, category) -> phrase, where verb and thing put together would not do."""

POSES_OF_INTERACTIONS: Final[dict[str, str]] = {
    "walking together": "walking",
    "standing together": "standing",
    "sitting together": "sitting",
    "going upstairs together": "going upstairs",
    "walking toward each other": "walking",
    "going downstairs together": "going downstairs",
    "bending together": "bending",
    "cycling together": "cycling",
}
"""The pose that an interaction gives away."""

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
"""The poses that handling a thing gives away; riding may be any of three."""


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
    words = phrase_of(VERB_PHRASES, verb, "verb"), phrase_of(THINGS, category, "object")
    return _PAIR_PHRASES.get((verb, category), " ".join(words))


@cache
def handled() -> dict[str, tuple[str, str]]:
    """The phrase of every pair of a verb and a thing -> (verb, category)."""
    return {handling(verb, category): (verb, category) for verb in VERB_PHRASES for category in THINGS}
