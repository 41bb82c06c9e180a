"""The labels that a plan may use, in the words of a prompt, and the check that a plan uses no others."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection
from functools import cache
from typing import Final

from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import (
    ACTION_PHRASES,
    ACTIONS,
    AGES,
    DISTANCE_WORDS,
    GENDERS,
    INTERACTION_PHRASES,
    INTERACTIONS,
    OTHER_ACTIONS,
    PERSON_SECTORS,
    POSES,
    ROBOT_SECTORS,
)
from jrdb_avr.schema.plan import Condition, Plan
from jrdb_avr.schema.relations import (
    FIRST_LEFT,
    FIRST_RIGHT,
    QUESTION_RELATIONS,
    RELATIONS,
    RELATIONS_OF,
    SAME_GROUP,
    WINDOW_DEGREES,
    person_frame_label,
)
from jrdb_avr.schema.things import OBJECT_PHRASES, OBJECTS, VERB_PHRASES, VERBS
from jrdb_avr.schema.wording.phrases import FAR_AWAY

VALUES: Final[dict[str, tuple[str, ...]]] = {
    "gender": GENDERS,
    "age": AGES,
    "sector": ROBOT_SECTORS,
    "distance": DISTANCE_WORDS,
}
"""The values of the attributes that have labels."""

_AGE_WORDS: Final = {
    "childhood": "child",
    "adolescence": "teenager",
    "young adulthood": "young",
    "middle adulthood": "middle-aged",
    "late adulthood": "elderly",
}


@cache
def vocabulary() -> str:
    """Every label, a line per kind, each with the words of a question where they differ: `bending = bending down`."""
    lines = {
        "gender": _listed(GENDERS),
        "age": _listed(AGES, _AGE_WORDS.__getitem__),
        "sector": _listed(ROBOT_SECTORS),
        "distance": _listed(DISTANCE_WORDS, lambda word: FAR_AWAY[word].rpartition("(")[2].rstrip(")")),
        "action, postures and movements": _listed(POSES, ACTION_PHRASES.__getitem__),
        "action, others": _listed(OTHER_ACTIONS, ACTION_PHRASES.__getitem__),
        "interaction": _listed(
            INTERACTIONS, lambda label: INTERACTION_PHRASES[label].removesuffix(" with someone").replace(" someone", "")
        ),
        "relation": _relations(),
        "verb": _listed(VERBS, VERB_PHRASES.__getitem__),
        "object": _listed(OBJECTS, _thing),
    }
    return "\n".join(f"- {kind}: {labels}." for kind, labels in lines.items())


def _relations() -> str:
    """Relations but for the interactions, which are relations as well; those of a kind by an example."""
    rows = [RELATIONS[label] for label in QUESTION_RELATIONS]
    window = next(row.label for row in rows if row.kind == "window")
    near = dict.fromkeys(row.distance for row in rows if row.kind == "person")
    beside = person_frame_label("front left", "close")
    return (
        f"every interaction; {SAME_GROUP}; {FIRST_LEFT}; {FIRST_RIGHT}; {window}, likewise to the right of, and with "
        f"{', '.join(map(str, WINDOW_DEGREES[1:]))} for {WINDOW_DEGREES[0]}; where the target is from the source's own "
        f"point of view and how far from the source, as in {beside}: one of {', '.join(PERSON_SECTORS)}, a comma and "
        f"one of {', '.join(near)}"
    )


def _listed(labels: Collection[str], words: Callable[[str], str] = str) -> str:
    return ", ".join(label if words(label) == label else f"{label} = {words(label)}" for label in labels)


def _thing(category: str) -> str:
    """A thing's words, or the label where they say no more than it does."""
    words = OBJECT_PHRASES[category]
    for article in ("a ", "an ", "the ", "some "):
        words = words.removeprefix(article)
    return category if words == category.replace("_", " ") else words


def check_labels(plan: Plan) -> None:
    """Refuse a plan with a label that nothing is ever called. Raises PlanError naming the field."""
    for i, node in enumerate(plan.nodes):
        for j, condition in enumerate(node.conditions):
            _check_condition(f"nodes[{i}].conditions[{j}]", condition)
    for i, edge in enumerate(plan.edges):
        _check(f"edges[{i}].relation", edge.relation, QUESTION_RELATIONS)
    for name, time in plan.times.items():
        _check(f"times.{name}.action", time.action, ACTIONS)
    _check("answer.relation", plan.answer.relation, RELATIONS_OF["count"])


def _check_condition(field: str, condition: Condition) -> None:
    _check(f"{field}.action", condition.action, ACTIONS)
    _check(f"{field}.interaction", condition.interaction, INTERACTIONS)
    _check(f"{field}.object", condition.object, OBJECTS)
    _check(f"{field}.verb", condition.verb, VERBS)
    if condition.attribute == "group_size":
        if not isinstance(condition.value, int) or not 1 <= condition.value <= 1000:
            raise PlanError(f"{field}.value", "is the number of people in the group, 1 or more")
    elif condition.attribute is not None:
        _check(f"{field}.value", str(condition.value), VALUES[condition.attribute])


def _check(field: str, label: str | None, labels: Collection[str]) -> None:
    if label is not None and label not in labels:
        near = difflib.get_close_matches(label, labels, 1)
        raise PlanError(field, f"{label!r} is none of the labels" + (f"; perhaps {near[0]!r}" if near else ""))
