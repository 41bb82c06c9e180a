"""Hints for wrong words in plans. A hint names the correct term of the plan format."""

from __future__ import annotations

import re
from typing import Final, Literal

PlanPart = Literal["attribute", "relation", "read", "event", "key"]
"""Position of a word in a plan. `key` is the key of an object. The other names are fields with the word as value."""

_ACTION: Final = '{"action": "sitting", "at": "t0"}'
_THING: Final = '{"object": "bag", "verb": "holding", "at": "t0"}'
_WITH: Final = '{"interaction": "conversation", "at": "t0"} for anybody, an edge for one person'
_BESIDE: Final = (
    '"first to the left of (robot view)", or the target\'s place seen from the source, as "left, close"; free words '
    'only to a thing, a node with "kind": "table"'
)
_ORDER: Final = 'a time {{"{word}": "t0"}} for what holds at some moment {word} t0'
_SIDE: Final = '"first to the {side} of (robot view)" or "within 30 degrees to the {side} of (robot view)"'
_SECTOR: Final = '"sector" for the side of the robot, "distance" for how far away'
FREE: Final = '{"attribute": "shirt", "value": "red", "at": "t0"} for what has no labels'

_INSTEAD: Final[dict[PlanPart, dict[str, str]]] = {
    "attribute": {
        **dict.fromkeys(("action", "activity", "doing", "movement", "pose", "posture"), _ACTION),
        **dict.fromkeys(("object", "carrying", "handling", "holding", "item", "thing"), _THING),
        **dict.fromkeys(("interaction", "company", "talking_to", "together_with", "with"), _WITH),
        **dict.fromkeys(("direction", "location", "place", "position", "side"), _SECTOR),
        **dict.fromkeys(("beside", "near", "next_to", "relation"), "an edge"),
        **dict.fromkeys(("depth", "distance_m", "metres", "range"), '"distance", a word'),
        **dict.fromkeys(("group", "group_members", "members", "people"), '"group_size", a number'),
        **dict.fromkeys(("id", "identity", "name", "track"), "what is seen of the person"),
        **dict.fromkeys(("present", "visible", "in_view"), 'the read "presence"'),
        "age_group": '"age"',
        "sex": '"gender"',
    },
    "relation": {
        **dict.fromkeys(("beside", "close to", "near", "next to"), _BESIDE),
        **{
            word.format(side): _SIDE.format(side=side)
            for side in ("left", "right")
            for word in ("{} of", "to the {} of", "on the {} of", "{}")
        },
        "behind": '"back, close", the target seen from the source',
        "in front of": '"front, close", the target seen from the source',
        **dict.fromkeys(("talking to", "talks to", "talks with", "talking with"), '"conversation"'),
        **dict.fromkeys(("group", "same group", "with", "together with"), '"in the same group as"'),
        **{word: _ORDER.format(word=word) for word in ("before", "after")},
        **dict.fromkeys(("earlier than", "precedes"), _ORDER.format(word="before")),
        **dict.fromkeys(("follows", "later than", "then"), _ORDER.format(word="after")),
        **dict.fromkeys(("is", "same as", "same person"), "one node, which is the same person at all times"),
    },
    "read": {
        **dict.fromkeys(("movement", "pose", "posture", "activity"), '"action"'),
        **dict.fromkeys(("gender", "age", "group_size", "sector", "distance", "color", "value"), '"attribute"'),
        **dict.fromkeys(("duration", "seconds"), '"seconds_between", or "span" for the frames'),
        **dict.fromkeys(("how_many", "number"), '"count"'),
        **dict.fromkeys(("angle", "direction", "viewpoint", "where"), '"start_view"'),
        **dict.fromkeys(("frame", "time", "when"), '"start"'),
        **dict.fromkeys(("exists", "visible", "yes_no"), '"presence"'),
        "end": '"span", or "next_action" for what follows',
    },
    "event": {
        **dict.fromkeys(("begin", "begins", "starts"), '"start"'),
        **dict.fromkeys(("ends", "finish", "finishes", "stop", "stops"), '"end"'),
        **dict.fromkeys(("appears", "arrives", "enters", "return"), '"returns"'),
        **dict.fromkeys(("disappears", "exits", "leave"), '"leaves"'),
        **dict.fromkeys(("join", "joins", "meets"), '"joins_group"'),
        **dict.fromkeys(("leaves the group", "parts", "separates"), '"leaves_group"'),
    },
    "key": {
        **dict.fromkeys(("color", "colour", "clothing", "hair", "name"), FREE),
        **dict.fromkeys(("gender", "age", "sector", "distance", "group_size"), '"attribute" and "value"'),
        **dict.fromkeys(("relation", "relations"), '"edges"'),
        **dict.fromkeys(("frame", "time", "when"), '"at" with the name of a time'),
        **dict.fromkeys(("category", "type"), '"kind"'),
        **dict.fromkeys(("negated", "negation", "not"), "only what is so: a plan denies nothing"),
        **dict.fromkeys(("or", "any_of", "either"), "one value: a plan has no alternatives"),
    },
}

_QUOTED: Final = re.compile(r"(unknown field|enum value) [`'](.*?)[`']")


def hint(part: PlanPart, word: str) -> str:
    """Suggest the correct term for a wrong word in a plan.

    Args:
        part: Part of the plan that has the wrong word, such as "attribute".
        word: Wrong word. Upper case counts as lower case, and underscores count as blanks.

    Returns:
        A text to append to an error message, "" if there is no hint for the word.

    >>> hint("attribute", "sex"), hint("attribute", "shirt")
    ('; use "gender"', '')
    """
    normal = " ".join(word.lower().replace("_", " ").split())
    return next((f"; use {use}" for entry, use in _INSTEAD[part].items() if entry.replace("_", " ") == normal), "")


def hint_for(field: str, message: str) -> str:
    """Suggest the correct term for the wrong word that an error message of msgspec quotes.

    Args:
        field: Path of the faulty field in the plan, such as `edges[1].source`.
        message: Error message of msgspec.

    Returns:
        A text to append to an error message, "" if the message quotes no word or there is no hint for the word.
    """
    match = _QUOTED.search(message)
    if match is None:
        return ""
    if match[1] == "unknown field":
        return hint("key", match[2])
    part = field.rpartition(".")[2]
    return hint("read", match[2]) if part == "read" else hint("event", match[2]) if part == "event" else ""
