"""Actions as choices of questions: which may be choices, which may be called the same, and which a text implies."""

from __future__ import annotations

from typing import Final

from jrdb_avr.schema.labels import ACTIONS, ALSO, POSES_OF_INTERACTIONS

CHOICE_LABELS: Final = tuple(
    label
    for label in ACTIONS
    if label
    not in {
        *("looking at robot", "looking at sth", "pointing at sth", "interaction with door", "greeting gestures"),
        *("reading", "pulling"),
    }
)
"""Actions that may be choices. The labels of the others are too often missing or last for one second only."""

_ALSO_AS_CHOICES: Final = {
    "looking into sth": ("holding sth", "reading"),
    "talking to someone": ("listening to someone",),
    "listening to someone": ("talking to someone",),
    "typing": ("looking into sth", "holding sth", "writing"),
    "writing": ("looking into sth", "holding sth", "typing", "reading"),
    "reading": ("writing", "typing"),
    "cycling": ("scootering",),
    "scootering": ("cycling", "skating"),
    "skating": ("scootering",),
    "sitting": ("looking into sth", "typing", "reading", "writing"),
}
"""For choices and proofs only: further actions whose words fit a person with the label."""

CALLED: Final[dict[str, frozenset[str]]] = {
    label: frozenset(other for other in ACTIONS if (label, other) in ALSO or other in _ALSO_AS_CHOICES.get(label, ()))
    for label in ACTIONS
}
"""For choices and proofs: the other actions whose words fit a person with the label, too."""

_IMPLIED: Final = {
    "conversation": ("talking to someone", "listening to someone"),
    "eating together": ("eating sth",),
    "holding sth together": ("holding sth",),
    "looking into sth together": ("looking into sth",),
    **dict.fromkeys(("looking at sth together", "looking at", "observing"), ("looking at sth",)),
    "looking into": ("looking into sth",),
    "talking on": ("talking on the phone",),
    "riding": ("cycling", "skating", "scootering"),
    "climbing": ("going upstairs",),
    "going up": ("going upstairs",),
    "going down": ("going downstairs",),
    **dict.fromkeys(("holding", "carrying", "transporting", "handling/manipulating"), ("holding sth",)),
    **dict.fromkeys(("using", "utilizing", "drinking"), ("holding sth",)),
}
"""For interactions and verbs of things: the actions that their words state, if a verb is not itself the action."""


def may_be_same(label: str, other: str) -> bool:
    """Tell whether two actions may be called the same, in either direction. Then they are no choices of one question.

    >>> may_be_same("typing", "sitting"), may_be_same("walking", "standing")
    (True, False)
    """
    return label == other or other in CALLED[label] or label in CALLED[other]


def implied_actions(word: str) -> frozenset[str]:
    """Return the actions that a label in a question's text states or implies, so that none may be a choice.

    Args:
        word: Label of an action or interaction, or verb of a thing.

    Returns:
        The actions that the word states, and all actions that may be called so.

    >>> sorted(implied_actions("sitting together"))
    ['bending', 'cycling', 'sitting']
    """
    pose = POSES_OF_INTERACTIONS.get(word, word)
    stated = {pose, *_IMPLIED.get(word, ())} & CALLED.keys()
    return frozenset(stated | {label for label in ACTIONS if CALLED[label] & stated})
