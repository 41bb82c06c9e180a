"""Three-valued facts, the outcome of a plan, and helpers for frames and tables."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import pyarrow as pa

from jrdb_avr.schema.labels import ALSO
from jrdb_avr.schema.questions import NeededBox
from jrdb_avr.schema.rules import KEYFRAME_STEP

OutcomeKind = Literal["defined", "ambiguous", "empty", "unknown"]

FALSE, TRUE, UNKNOWN = 0, 1, 2
"""Values of a fact."""

SLACK: Final = 1e-9
"""Tolerance of comparisons with bounds, because decimals such as 0.55 have no exact float."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of the second program for a plan.

    Attributes:
        outcome: Kind of the outcome.
        answer: An action or a fixed answer for a question with choices, else the stored JSON. None if not defined.
        target: Track of the target.
        people: Names of the plan's nodes with their tracks.
        times: Names of the plan's times with their frames. The frame of an event is its frame in answers.
        needed: Boxes that must be seen.
        faults: Rules that the question breaks.
    """

    outcome: OutcomeKind
    answer: str | None = None
    target: int | None = None
    people: tuple[tuple[str, int], ...] = ()
    times: tuple[tuple[str, int], ...] = ()
    needed: tuple[NeededBox, ...] = ()
    faults: tuple[str, ...] = ()


class Undefined(Exception):  # noqa: N818 - not an error: the plan's answer has one of these outcomes
    """Signal that a plan has no answer."""

    def __init__(self, outcome: OutcomeKind, reason: str) -> None:
        super().__init__(reason)
        self.outcome: OutcomeKind = outcome


@functools.cache
def also_said(label: str) -> tuple[str, ...]:
    """Return the labels that may also be true of a person with `label`. They are unknown, not false."""
    return tuple(wider for narrow, wider in ALSO if narrow == label)


def rows(table: pa.Table, *names: str) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a table as tuples of the named columns."""
    return zip(*(_values(table[name]) for name in names), strict=True)


def _values(column: pa.ChunkedArray) -> list[Any]:
    """Return the values of a column. Equal texts or integers share one object, because few of them are distinct."""
    if column.null_count:
        return column.to_pylist()  # type: ignore[no-any-return]
    if pa.types.is_string(column.type) or pa.types.is_integer(column.type):
        coded = column.combine_chunks().dictionary_encode()
        return [*map(coded.dictionary.to_pylist().__getitem__, coded.indices.to_numpy().tolist())]
    # Because NumPy's conversion is much faster than that of Arrow's scalars.
    return column.to_numpy().tolist()  # type: ignore[no-any-return]


def distinct_rows(table: pa.Table, *names: str) -> Iterator[tuple[Any, ...]]:
    """Yield the distinct rows of the named columns, in any order."""
    return rows(table.group_by(list(names)).aggregate([]), *names)


def step_of(numbers: list[int]) -> int:
    """Return the number of frames between annotated frames: 15 if all are whole seconds apart, else 1."""
    apart = math.gcd(*(b - a for a, b in itertools.pairwise(numbers)))
    return KEYFRAME_STEP if apart % KEYFRAME_STEP == 0 else 1


def in_closed_gap(has_label: Callable[[int], bool], frame: int, longest: int) -> bool:
    """Return whether a frame is in a gap of at most `longest` frames between two frames with a label."""
    before = next((back for back in range(1, longest + 1) if has_label(frame - back)), None)
    return before is not None and any(has_label(frame + on) for on in range(1, longest + 2 - before))


def among(value: object, possible: Sequence[object]) -> int:
    """Return whether a value is the true value, if only the values in `possible` may be true."""
    if value not in possible:
        return FALSE
    return TRUE if len(possible) == 1 else UNKNOWN
