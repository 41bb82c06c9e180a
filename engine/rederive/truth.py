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
"""Tolerance at edges, so that decimals such as 0.55 lie on the edge they name."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the second program finds.

    `answer` is a choice's text or another answer's stored JSON, None unless the outcome is "defined". `people` are the
    tracks of the plan's nodes, `times` the frames of its times (for an event the frame that a question means), `faults`
    the rules of the template that do not hold.
    """

    outcome: OutcomeKind
    answer: str | None = None
    target: int | None = None
    people: tuple[tuple[str, int], ...] = ()
    times: tuple[tuple[str, int], ...] = ()
    needed: tuple[NeededBox, ...] = ()
    faults: tuple[str, ...] = ()


class Undefined(Exception):  # noqa: N818 - not an error: the plan's answer is one of these outcomes
    """Raised where a plan has no answer."""

    def __init__(self, outcome: OutcomeKind, reason: str) -> None:
        super().__init__(reason)
        self.outcome: OutcomeKind = outcome


@functools.cache
def also_said(label: str) -> tuple[str, ...]:
    """Labels whose words may also be said of somebody with this one: unknown of that person, not false."""
    return tuple(other for own, other in ALSO if own == label)


def rows(table: pa.Table, *names: str) -> Iterator[tuple[Any, ...]]:
    """Rows of a table as tuples of the columns named."""
    return zip(*(_values(table[name]) for name in names), strict=True)


def _values(column: pa.ChunkedArray) -> list[Any]:
    """The values of a column. Equal texts are one object: there are millions of few different ones."""
    if column.null_count:
        return column.to_pylist()  # type: ignore[no-any-return]
    if pa.types.is_string(column.type):
        coded = column.combine_chunks().dictionary_encode()
        return [*map(coded.dictionary.to_pylist().__getitem__, coded.indices.to_numpy().tolist())]
    # Much faster than by way of Arrow's own scalars.
    return column.to_numpy().tolist()  # type: ignore[no-any-return]


def distinct_rows(table: pa.Table, *names: str) -> Iterator[tuple[Any, ...]]:
    """Distinct rows of the columns named, in any order."""
    return rows(table.group_by(list(names)).aggregate([]), *names)


def step_of(numbers: list[int]) -> int:
    """Frames between annotated frames: 15 where all lie whole seconds apart, else 1."""
    apart = math.gcd(*(b - a for a, b in itertools.pairwise(numbers)))
    return KEYFRAME_STEP if apart % KEYFRAME_STEP == 0 else 1


def in_closed_gap(named: Callable[[int], bool], frame: int, longest: int) -> bool:
    """Whether a frame at which a fact is not named lies between two at which it is, at most `longest` apart."""
    before = next((back for back in range(1, longest + 1) if named(frame - back)), None)
    return before is not None and any(named(frame + on) for on in range(1, longest + 2 - before))


def among(wanted: object, possible: Sequence[object]) -> int:
    """Whether the wanted word is right, where one of the possible words is."""
    if wanted not in possible:
        return FALSE
    return TRUE if len(possible) == 1 else UNKNOWN
