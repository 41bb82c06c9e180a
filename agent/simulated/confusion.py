"""Confusion matrices: the labels that a label is taken for, by attribute, and what a mark says then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Final

from msgspec import Meta

from jrdb_avr.agent.policy.finding import distance_word
from jrdb_avr.schema.labels import AGES, ALSO, DISTANCE_WORDS, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.things import OBJECTS

Share = Annotated[float, Meta(ge=0, le=1)]
Matrix = dict[str, dict[str, dict[str, Share]]]
"""By attribute and true label: the shares of the other labels that are read in its place."""

_LABELS: Final[Mapping[str, tuple[str, ...]]] = {
    "gender": GENDERS,
    "age": AGES,
    "pose": POSES,
    "actions": OTHER_ACTIONS,
    "distance": DISTANCE_WORDS,
    "interaction": INTERACTIONS,
    "object": OBJECTS,
}
"""The labels of each attribute that can be confused. Of two actions beside the pose the first one is."""

CONFUSED: Final = tuple(_LABELS)

_METRES: Final = dict(zip(DISTANCE_WORDS, (0.3, 1.0, 3.0, 7.5, 15.0), strict=True))
"""A distance that each word stands for."""

_POSES_ALIKE: Final = (
    *(("walking", "standing"), ("walking", "running"), ("walking", "going upstairs"), ("walking", "going downstairs")),
    *(("standing", "sitting"), ("standing", "bending"), ("sitting", "bending"), ("sitting", "lying")),
    *(("cycling", "scootering"), ("skating", "scootering"), ("skating", "walking"), ("scootering", "standing")),
)


def _alike() -> dict[tuple[str, str], tuple[str, ...]]:
    """By attribute and label, the labels that look alike: neighbours on a scale, and pairs of similar acts."""
    pairs = {*ALSO, *_POSES_ALIKE}
    found = {}
    for name, labels in _LABELS.items():
        for place, label in enumerate(labels):
            if name in ("gender", "age", "distance"):
                others = [*labels[max(place - 1, 0) : place], *labels[place + 1 : place + 2]]
            else:
                others = [other for other in labels if (label, other) in pairs or (other, label) in pairs]
            found[name, label] = tuple(others)
    return found


_ALIKE: Final = _alike()


def check_matrix(matrix: Matrix) -> None:
    """Raises ValueError for an attribute or label that there is not, and for a row of shares beyond 1."""
    for name, rows in matrix.items():
        if name not in _LABELS:
            raise ValueError(f"no attribute {name[:40]!r}; there are {', '.join(_LABELS)}")
        for label, row in rows.items():
            if unknown := {label, *row} - {*_LABELS[name]}:
                raise ValueError(f"no {name} is called {min(unknown)[:40]!r}")
            if sum(row.values()) > 1 or label in row:
                raise ValueError(f"the row of {label!r} must hold other labels, with shares of at most 1 in all")


def confusions(confuse: float | Matrix, name: str, label: str) -> Mapping[str, float]:
    """The shares of the labels that a label is taken for. A number is spread evenly over those that look alike."""
    if not isinstance(confuse, float | int):
        return confuse.get(name, {}).get(label, {})
    others = _ALIKE.get((name, label), ())
    return {other: confuse / len(others) for other in others}


def label_of(mark: Mark, name: str) -> str | None:
    """What a mark says of an attribute, as a label; None where it says nothing."""
    if name == "distance":
        return None if mark.distance_dm is None else distance_word(mark.distance_dm / 10)
    value: Any = getattr(mark, name)
    return next(iter(value), None) if name == "actions" else value


def with_label(mark: Mark, name: str, label: str) -> Mark:
    """The mark with another label; of its actions beside the pose the first is replaced."""
    match name:
        case "distance":
            return replace(mark, distance_dm=round(_METRES[label] * 10))
        case "actions":
            return replace(mark, actions=(label, *(other for other in mark.actions[1:] if other != label)))
    changed: dict[str, Any] = {name: label}
    return replace(mark, **changed)


def affirmed(mark: Mark, statement: Condition) -> Mark:
    """The mark of a person of whom a statement is held to be true; sides and sizes of groups stay what they are."""
    if statement.action is not None:
        if statement.action in POSES:
            return replace(mark, pose=statement.action)
        others = (action for action in mark.actions if action != statement.action)
        return replace(mark, actions=(statement.action, *others)[:2])
    if statement.interaction is not None:
        return replace(mark, interaction=statement.interaction)
    if statement.object is not None:
        return replace(mark, object=statement.object, verb=statement.verb)
    if statement.attribute in ("gender", "age", "distance"):
        return with_label(mark, statement.attribute, str(statement.value))
    return mark
