"""Actions as choices: which actions may be choices, which overlap in meaning, and which ones a text implies."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final, NamedTuple

from jrdb_avr.schema.labels import ACTIONS, ALSO, FLICKERING, POSES, POSES_OF_INTERACTIONS
from jrdb_avr.schema.things import POSES_OF_VERBS

CHOICE_COUNT: Final = 4
"""Number of choices of a question."""

CHOICE_LABELS: Final = tuple(
    label for label in ACTIONS if label not in FLICKERING | {"greeting gestures", "reading", "pulling"}
)
"""Actions that may be choices. The labels of the excluded actions are often missing, or last only one second."""

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
"""Further actions that a reader may see in a person with the label, beside `ALSO`. Only choices and proofs use them."""

CALLED: Final[dict[str, frozenset[str]]] = {
    label: frozenset(name for name in ACTIONS if (label, name) in ALSO or name in _ALSO_AS_CHOICES.get(label, ()))
    for label in ACTIONS
}
"""All other actions that a reader may see in a person with the label. Choices and proofs use them."""

_IMPLIED: Final = {
    "conversation": ("talking to someone", "listening to someone"),
    "eating together": ("eating sth",),
    "holding sth together": ("holding sth",),
    "looking into sth together": ("looking into sth",),
    **dict.fromkeys(("looking at sth together", "looking at", "observing"), ("looking at sth",)),
    "looking into": ("looking into sth",),
    "talking on": ("talking on the phone",),
    **POSES_OF_VERBS,
    **dict.fromkeys(("holding", "carrying", "transporting", "handling/manipulating"), ("holding sth",)),
    **dict.fromkeys(("using", "utilizing", "drinking"), ("holding sth",)),
}
"""Actions that the words of an interaction or of a verb state. A verb with the name of an action states that action."""


class ListedActions(NamedTuple):
    """The action labels of a person in a frame.

    Attributes:
        certain: Actions with an easy or medium label. A pose must also be the only pose of a complete list.
        hard: All other actions with a label. They are possible.
        complete: Whether the whole list was read. If it was, an action without a label is false.
    """

    certain: frozenset[str] = frozenset()
    hard: frozenset[str] = frozenset()
    complete: bool = True


def list_actions(labels: Mapping[str, bool], complete: bool) -> ListedActions:
    """Sort the action labels of a person in a frame by certainty.

    Args:
        labels: For each labelled action, whether its label is easy or medium.
        complete: Whether the whole list was read.

    Returns:
        The labels. A pose is certain only if the list is complete and has no other pose.

    >>> list_actions({"walking": True, "standing": True, "typing": True}, True).certain
    frozenset({'typing'})
    """
    single = complete and len(labels.keys() & set(POSES)) == 1
    certain = frozenset(label for label, easy in labels.items() if easy and (single or label not in POSES))
    return ListedActions(certain, frozenset(labels) - certain, complete)


def may_be_same(label: str, second: str) -> bool:
    """Return whether the words of one action may fit a person with the other. One question never has both as choices.

    >>> may_be_same("typing", "sitting"), may_be_same("walking", "standing")
    (True, False)
    """
    return label == second or second in CALLED.get(label, ()) or label in CALLED.get(second, ())


@cache
def implied_actions(word: str) -> frozenset[str]:
    """Return the actions that a label in a question's text states or implies. None of them may be a choice.

    Args:
        word: Label of an action or interaction, or verb of a thing.

    Returns:
        The actions that the word states, and all actions with a meaning that overlaps one of them.

    >>> sorted(implied_actions("sitting together"))
    ['bending', 'cycling', 'sitting']
    """
    pose = POSES_OF_INTERACTIONS.get(word, word)
    stated = {pose, *_IMPLIED.get(word, ())} & CALLED.keys()
    return frozenset(stated | {label for label in ACTIONS if CALLED[label] & stated})
