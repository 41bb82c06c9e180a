"""Candidates of a template in one scene, and which rule refuses each: all of it set-wise.

The generator query lists the candidates with what can be said of each by itself; the necessity queries read what the
perturbed programs answer, and are joined on here. The rules are tried in the order of `RULES`; a candidate is refused
by the first that fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.binding import parameters
from jrdb_avr.queries.handle import Graph
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.vocabulary import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS

from .scene import NOBODY, Ints, coded
from .templates import Template, query_text, query_values

RULES: Final = (
    "anchor",
    "evidence",
    "image",
    "view.ahead",
    "view.single",
    "stated",
    "hop.stop",
    "hop.skip",
    "time.shift",
    "time.drop",
)
"""Rules that refuse a candidate set-wise, in the order in which they are tried."""

PASSED: Final = len(RULES)

OUTCOMES: Final = ("same", "different", "ambiguous", "empty", "unknown", "outside")
SAME, DIFFERENT, AMBIGUOUS, EMPTY, UNKNOWN, OUTSIDE = range(len(OUTCOMES))

PROVING: Final = (DIFFERENT, AMBIGUOUS, EMPTY)
"""Outcomes of a perturbed program that fails to give the answer, and certainly so."""

_PROVES: Final = np.isin(np.arange(len(OUTCOMES)), PROVING)

VALUES: Final = POSES + PRESENCE_ANSWERS + DISTANCE_ANSWERS
"""Every choice answer; coded columns are indices into it, NOBODY for none."""

Codes = npt.NDArray[np.int8]


@dataclass(frozen=True)
class Perturbed:
    """What a perturbed program answers: per candidate the outcome and, where it is a choice, the answer.

    either: among the programs of a kind that are marked so, it is enough that one proves.
    """

    kind: str
    variant: str
    outcome: Codes
    answer: Codes
    either: bool = False

    def proves(self) -> Bools:
        """Where the perturbed program fails to give the answer, and certainly so."""
        return _PROVES[self.outcome]


@dataclass(frozen=True)
class Counted:
    """Whom each candidate counts.

    number: per candidate its company; company, person, met, seen: per person met, by company and person, the frames
    from which on: at all, and both in clear view.
    """

    number: Ints
    company: Ints
    person: Ints
    met: Ints
    seen: Ints

    def people(self, row: int, until: int) -> Iterator[tuple[int, int]]:
        """Everybody whom a candidate counts up to a frame: the person's number, and the frame that shows both."""
        number = int(self.number[row])
        for place in range(*np.searchsorted(self.company, [number, number + 1]).tolist()):
            if self.met[place] <= until:
                yield int(self.person[place]), int(self.seen[place])


@dataclass(frozen=True)
class Candidates:
    """All candidates of a template, one per entry of each column, in the generator's order.

    name: number of the description given; people: by node, the moment at t0; relations: `r1`, ... as indices into
    RELATIONS; frames: by name, `t0`, the stated times and of events `start`, `end`, `first`, `last`; segment: row in
    the scene's segments or NOBODY, segment2: that of the second action; answer: index into VALUES, or NOBODY for
    events; value: a number's value, else NaN; rule: index into RULES of the first that refuses, else PASSED;
    perturbed: what was found by the proofs; counted: where people are counted, whom.
    """

    template: Template
    name: Ints
    people: Mapping[str, Ints]
    relations: Mapping[str, Ints]
    segment: Ints
    segment2: Ints
    frames: Mapping[str, Ints]
    answer: Codes
    value: Floats
    rule: Codes
    perturbed: tuple[Perturbed, ...] = field(default=())
    counted: Counted | None = None

    def __len__(self) -> int:
        return len(self.name)

    def refusals(self) -> dict[str, int]:
        """Candidates refused, by rule."""
        counts = np.bincount(self.rule, minlength=PASSED + 1)
        return {rule: int(count) for rule, count in zip(RULES, counts, strict=False) if count}


def ask(graph: Graph, folder: str, name: str, rules: Rules, **more: int) -> pa.Table:
    """The result of a packaged query, with those of the rules' values that it uses."""
    text = query_text(folder, name)
    values = query_values(rules) | more
    return graph.query(text, {key: values[key] for key in parameters(text)})


def first_refusing(holds: Mapping[str, Bools], count: int) -> Codes:
    """Per candidate the first of RULES that does not hold, else PASSED; a rule that is not given holds."""
    rule = np.full(count, PASSED, dtype=np.int8)
    for number in reversed(range(len(RULES))):
        if RULES[number] in holds:
            rule[~holds[RULES[number]]] = number
    return rule


def proven_rules(perturbed: tuple[Perturbed, ...]) -> dict[str, Bools]:
    """Per rule, where its perturbed programs prove what they must: all of them, of those marked so at least one."""
    holds: dict[str, Bools] = {}
    enough: dict[str, Bools] = {}
    for proof in perturbed:
        if proof.either:
            enough[proof.kind] = enough.get(proof.kind, np.zeros(len(proof.outcome), dtype=bool)) | proof.proves()
        else:
            holds[proof.kind] = holds.get(proof.kind, np.ones(len(proof.outcome), dtype=bool)) & proof.proves()
    return holds | {kind: holds.get(kind, True) & proves for kind, proves in enough.items()}


def rows_of(read: pa.Table, keys: Mapping[str, Ints], limit: int) -> Ints:
    """For each entry of `keys`, the row of `read` with the same values in the columns they share, else NOBODY.

    All values are below `limit`, and no two rows of `read` are alike in these columns.
    """
    count = len(next(iter(keys.values())))
    given, wanted = np.zeros(len(read), dtype=np.int64), np.zeros(count, dtype=np.int64)
    for name, values in keys.items():
        if name in read.column_names:
            given = given * limit + ints(read, name)
            wanted = wanted * limit + values
    if len(read) == 0:
        return np.full(count, NOBODY)
    order = np.argsort(given, kind="stable")
    place = np.minimum(np.searchsorted(given[order], wanted), len(read) - 1)
    row = order[place]
    return np.where(given[row] == wanted, row, NOBODY)


def ints(table: pa.Table, name: str) -> Ints:
    """A column of whole numbers; null is NOBODY."""
    return np.asarray(pc.fill_null(table[name], NOBODY).to_numpy(), dtype=np.int64)


def codes(column: pa.ChunkedArray) -> Codes:
    """Choice answers as indices into VALUES."""
    return coded(column.cast(pa.string()), VALUES).astype(np.int8)
