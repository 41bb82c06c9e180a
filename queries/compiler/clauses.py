"""Clause templates: what a condition or an edge of a plan says in Cypher, filled with a namespace's names.

Facts have three values, so each clause comes twice: `sure` is true where the fact certainly holds, `could` where it is
not certainly false. Both are boolean expressions over variables that the caller has bound: `n` a person and `s` the
person's sighting at the time (`m` and `z` those of the other person of an edge), `t` the frame, `scope` the sequence
or episode, and `v`, `w` the wanted values. Values are variables, never text: nothing of a plan enters a statement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

Variables = dict[str, str]
"""Names of bound variables by the letters above."""


class Clause(Protocol):
    """A condition of a person, or an edge between two."""

    def sure(self, at: Variables) -> str: ...

    def could(self, at: Variables) -> str: ...


@dataclass(frozen=True)
class Rows:
    """Facts kept as rows over intervals of frames, inclusive; a row that is not certain says that it could be so.

    pattern: what to match; equal: columns of it with the variables they must equal; guessed: the same of columns that
    may be null, which could be anything then; span: the row's variable, with columns `first`, `last` and `certain`;
    then: a row that must lead on from this one, whose clauses hold as well. (As one pattern the two would close a
    circle, on which the engine loses rows.)
    """

    pattern: str
    equal: tuple[tuple[str, str], ...] = ()
    guessed: tuple[tuple[str, str], ...] = ()
    span: str = "r"
    first: str = "first"
    last: str = "last"
    certain: str = "certain"
    then: Rows | None = None

    def sure(self, at: Variables) -> str:
        """Whether a row says so for certain."""
        # The engine loses rows of a subquery where a column that is compared with a variable holds nulls.
        parts = [f"{column} IS NOT NULL AND {column} = {{{variable}}}" for column, variable in self.guessed]
        parts.append(f"{self.span}.{self.certain}")
        return self._exists(parts, at, [] if self.then is None else [self.then.sure(at)])

    def could(self, at: Variables) -> str:
        """Whether a row says so, or may."""
        parts = [f"({column} = {{{variable}}} OR {column} IS NULL)" for column, variable in self.guessed]
        return self._exists(parts, at, [] if self.then is None else [self.then.could(at)])

    def _exists(self, parts: list[str], at: Variables, then: list[str]) -> str:
        same = [f"{column} = {{{variable}}}" for column, variable in self.equal]
        covers = f"{self.span}.{self.first} <= {{t}} AND {self.span}.{self.last} >= {{t}}"
        holds = [part.format(**at) for part in (*same, *parts, covers)] + then
        return f"EXISTS {{ MATCH {self.pattern.format(**at)} WHERE {' AND '.join(holds)} }}"


@dataclass(frozen=True)
class Known:
    """A fact kept as one value, null where it is unknown.

    value: the column; other: one that holds a second value which it could be as well, or ""; rows: what makes another
    value possible beside it, or None.
    """

    value: str
    other: str = ""
    rows: Rows | None = None

    def sure(self, at: Variables) -> str:
        alone = f" AND {self.other} IS NULL" if self.other else ""
        return f"coalesce({self.value} = {{v}}{alone}, false)".format(**at)

    def could(self, at: Variables) -> str:
        other = f" OR {self.other} = {{v}}" if self.other else ""
        text = f"{self.value} IS NULL OR {self.value} = {{v}}{other}".format(**at)
        return f"({text} OR {self.rows.could(at)})" if self.rows is not None else f"({text})"


@dataclass(frozen=True)
class Listed:
    """A fact kept as rows: what no row tells of is false where `told` holds, else unknown."""

    rows: Rows
    told: str

    def sure(self, at: Variables) -> str:
        return self.rows.sure(at)

    def could(self, at: Variables) -> str:
        return f"({self.rows.could(at)} OR NOT {self.told.format(**at)})"


@dataclass(frozen=True)
class Tie:
    """An edge kept as rows between two people: what no row tells of is false where both tell; "" for always."""

    rows: Rows
    told: str = ""

    def sure(self, at: Variables) -> str:
        return self.rows.sure(at)

    def could(self, at: Variables) -> str:
        if not self.told:
            return self.rows.could(at)
        both = " AND ".join(self.told.format(**at | {"n": at[n], "s": at[s]}) for n, s in (("n", "s"), ("m", "z")))
        return f"({self.rows.could(at)} OR NOT ({both}))"


@dataclass(frozen=True)
class Within:
    """An edge told by the panorama angles of two people: the other one is less than `v` degrees to the left.

    turn: the two angles, from which to which one turns left. Who is within the margin of the edge, or of the person's
    own direction, could be inside.
    """

    here: str
    there: str

    def sure(self, at: Variables) -> str:
        left = self._left(at)
        inside = f"{left} > $margin AND 360.0 - {left} > $margin AND {left} < {{v}} AND {{v}} - {left} > $margin"
        return f"({inside})".format(**at)

    def could(self, at: Variables) -> str:
        left = self._left(at)
        near = f"{left} <= $margin OR 360.0 - {left} <= $margin OR {left} < {{v}} OR {left} - {{v}} <= $margin"
        return f"({near})".format(**at)

    def _left(self, at: Variables) -> str:
        """Degrees, [0, 360), by which one turns left."""
        turn = f"({self.here} - {self.there})".format(**at)
        return f"({turn} - 360.0 * floor({turn} / 360.0))"


@dataclass(frozen=True)
class Somebody:
    """A condition: an edge of this kind leads to anybody who is there."""

    edge: Clause
    there: str

    def sure(self, at: Variables) -> str:
        return self._exists(self.edge.sure(_INNER | at), at)

    def could(self, at: Variables) -> str:
        return self._exists(self.edge.could(_INNER | at), at)

    def _exists(self, holds: str, at: Variables) -> str:
        names = _INNER | at
        there = self.there.format(n=names["m"], s=names["z"], t=at["t"], scope=at["scope"])
        return f"EXISTS {{ MATCH {there} AND {names['m']}.id <> {at['n']}.id AND {holds} }}"


_INNER: Final[Variables] = {"m": "other", "z": "seen"}
