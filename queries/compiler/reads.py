"""What is read of people once they are found: one statement per kind of fact, each for many people at once.

The statements lie in `queries/reads/<namespace>/*.cypher`; only who is counted is put together here, from an edge's
clauses. Everything returned is by the number of the question; what is unknown is left out. `Reader` is what the solver
asks; `SceneReader` reads what was annotated, `beliefs.BeliefReader` what an agent wrote down.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import pyarrow as pa

from jrdb_avr.queries.compiler.find import Agreed, Find, compile_find, outcome_of_people
from jrdb_avr.queries.compiler.mapping import PersonId, SchemaMapping, edge_kind, edge_values, read_text
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import KEYFRAME_STEP, LoadRules, frames


class Queryable(Protocol):
    """A graph as far as it is read here: `Graph`, or the world model's handle."""

    def query(
        self,
        cypher: str,
        params: Mapping[str, Any] | None = None,
        *,
        ordered: bool = True,
        timeout_s: float | None = None,
    ) -> pa.Table: ...


@dataclass(frozen=True)
class Person:
    """A person found: the number of the question, the sequence or episode, and who it is there."""

    id: int
    scope: str
    who: PersonId

    def row(self, **more: Any) -> dict[str, Any]:
        return {"id": self.id, "scope": self.scope, "who": self.who, **more}


@dataclass(frozen=True)
class Segment:
    """A stretch of an action: the frames with it, start and end as asked for, whether it is known to end there, and
    the panorama angle at the first frame."""

    first: int
    last: int
    start: int
    end: int
    closed: bool
    angle: float


@dataclass(frozen=True)
class Seen:
    """Whether somebody is present, None where it is unknown; and how far away, in metres."""

    present: bool | None
    distance: float | None


class Reader(ABC):
    """Reads facts of people from a graph. `values` are those of the statements' parameters beside `$plans`, by name;
    `timeout_s` is for each statement.
    """

    def __init__(self, graph: Queryable, values: Mapping[str, Any], timeout_s: float) -> None:
        self.graph = graph
        self.timeout_s = timeout_s
        self._values = values

    @abstractmethod
    def find(self, plan: Plan) -> Find:
        """The statement that finds a plan's people. Raises PlanError for a plan that cannot be compiled."""

    @abstractmethod
    def agreed(self, plan: Plan, find: Find, rows: Sequence[Mapping[str, Any]]) -> Agreed:
        """What the rows of that statement come to."""

    def ask(self, cypher: str, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """The rows of a compiled statement for the rows of `$plans`. Raises QueryError, as after the timeout."""
        if not rows:
            return []
        return self._queried(cypher, {"plans": list(rows)})

    def _queried(self, cypher: str, given: dict[str, Any], *, ordered: bool = True) -> list[dict[str, Any]]:
        values = {name: self._values[name] for name in parameters(cypher) if name not in given}
        found = self.graph.query(cypher, given | values, ordered=ordered, timeout_s=self.timeout_s)
        rows: list[dict[str, Any]] = found.to_pylist()
        return rows

    @abstractmethod
    def poses(self, asked: Sequence[tuple[Person, int]]) -> dict[int, str]:
        """Postures at frames."""

    @abstractmethod
    def seen(self, asked: Sequence[tuple[Person, int]]) -> dict[tuple[int, int], Seen]:
        """Presence and distance, by question and frame."""

    @abstractmethod
    def starts(self, asked: Sequence[tuple[Person, str, int]]) -> dict[int, Segment]:
        """The first start of an action after a frame."""

    @abstractmethod
    def absences(self, asked: Sequence[tuple[Person, int]]) -> dict[int, tuple[int | None, int | None]]:
        """When somebody leaves for the first time after a frame, and is back."""

    @abstractmethod
    def next_poses(self, asked: Sequence[tuple[Person, int]]) -> dict[int, tuple[str, int]]:
        """The posture that follows the one held at a frame, and the last frame with the one before."""

    @abstractmethod
    def counts(self, asked: Sequence[tuple[Person, str, int, int]]) -> dict[int, int]:
        """How many different people are in a relation with somebody at any frame of a stretch."""


class SceneReader(Reader):
    """Reads what was annotated, under the rules of its load."""

    def __init__(self, graph: Queryable, names: SchemaMapping, rules: LoadRules, timeout_s: float) -> None:
        values = {
            "margin": rules.neighbor_margin_deg,
            "least": frames(rules.segment_min_s),
            "edge": frames(rules.segment_edge_s),
            "quiet": frames(rules.segment_quiet_s),
        }
        super().__init__(graph, values, timeout_s)
        self.names = names
        self._grids: dict[str, dict[str, int]] | None = None

    def find(self, plan: Plan) -> Find:
        """The statement that finds a plan's people."""
        return compile_find(plan, self.names)

    def agreed(self, plan: Plan, find: Find, rows: Sequence[Mapping[str, Any]]) -> Agreed:
        """One certain binding, while no other is possible."""
        return outcome_of_people(find, rows)

    def poses(self, asked: Sequence[tuple[Person, int]]) -> dict[int, str]:
        """Postures at frames."""
        found = self._read("action", [person.row(t=frame) for person, frame in asked])
        return {row["id"]: row["pose"] for row in found if row["pose"] is not None}

    def seen(self, asked: Sequence[tuple[Person, int]]) -> dict[tuple[int, int], Seen]:
        """Presence and distance, by question and frame."""
        found = {}
        for row in self._read("seen", [person.row(t=frame) for person, frame in asked]):
            absent = row["annotated"] == len(_NEIGHBOURS) and not row["boxes"]
            present = True if row["clear"] else False if absent else None
            found[row["id"], row["t"]] = Seen(present, row["distance"])
        return found

    def starts(self, asked: Sequence[tuple[Person, str, int]]) -> dict[int, Segment]:
        """The first start of an action after a frame."""
        rows = [
            person.row(action=action, posture=action in POSES, after=after, **grid)
            for person, action, after in asked
            if (grid := self._grid(person.scope))
        ]
        return {row.pop("id"): Segment(**row) for row in self._read("start", rows)}

    def absences(self, asked: Sequence[tuple[Person, int]]) -> dict[int, tuple[int | None, int | None]]:
        """The last frame before, and the first one after, the first absence after a frame."""
        rows = [person.row(after=after, **grid) for person, after in asked if (grid := self._grid(person.scope))]
        return {row["id"]: (row["leaves"], row["returns"]) for row in self._read("absence", rows)}

    def next_poses(self, asked: Sequence[tuple[Person, int]]) -> dict[int, tuple[str, int]]:
        """The posture that follows the one at a frame by a clear start, and the last keyframe with the one before."""
        people = {person.id: person for person, _ in asked}
        found = self._read("next_action", [person.row(after=after) for person, after in asked])
        follows = {row["id"]: (row["pose"], row["until"]) for row in found if row["pose"] is not None}
        started = self.starts([(people[i], pose, until - KEYFRAME_STEP) for i, (pose, until) in follows.items()])
        return {
            i: (pose, until - KEYFRAME_STEP)
            for i, (pose, until) in follows.items()
            if i in started and started[i].first <= until
        }

    def counts(self, asked: Sequence[tuple[Person, str, int, int]]) -> dict[int, int]:
        """How many different people are in a relation with somebody at any frame of a stretch."""
        rows = [
            person.row(t1=first, t2=last, **grid)
            for person, _, first, last in asked
            if (grid := self._grid(person.scope))
        ]
        known = {row["id"] for row in self._read("company", rows)}
        by_text: dict[str, list[dict[str, Any]]] = {}
        for person, relation, first, last in asked:
            row = person.row(t1=first, t2=last, **edge_values(relation))
            by_text.setdefault(compile_count(relation, self.names), []).append(row)
        could: dict[int, set[int]] = {i: set() for i in known}
        does: dict[int, set[int]] = {i: set() for i in known}
        for text, given in by_text.items():
            for row in self.ask(text, [row for row in given if row["id"] in known]):
                (does if row["sure"] else could)[row["id"]].add(row["other"])
        return {i: len(does[i]) for i in known if could[i] <= does[i]}

    def _read(self, name: str, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        return self.ask(read_text(self.names.reads, name), rows)

    def _grid(self, scope: str) -> dict[str, int] | None:
        """Which frames of a sequence tell of actions, None where none does."""
        if self._grids is None:
            found = self.graph.query(read_text(self.names.reads, "grid"), timeout_s=self.timeout_s).to_pylist()
            self._grids = {row.pop("scope"): row for row in found}
        return self._grids.get(scope)


_NEIGHBOURS: Final = (-KEYFRAME_STEP, 0, KEYFRAME_STEP)


def compile_count(relation: str, names: SchemaMapping) -> str:
    """The statement for everybody who is, or could be, in a relation with a person at any frame from t1 to t2."""
    values = edge_values(relation)
    clause = names.edges[edge_kind(relation)]
    carried = ", ".join(["id", "scope", *values])
    at = {"n": "n", "s": "s", "m": "m", "z": "z", "t": "t", "scope": "scope"} | {name: name for name in values}
    return "\n".join(
        [
            "UNWIND $plans AS q",
            f"WITH {', '.join(f'q.{name} AS {name}' for name in ('id', 'scope', 'who', 't1', 't2', *values))}",
            "UNWIND range(t1, t2) AS t",
            f"MATCH {names.pattern.format(**at)}",
            f"WHERE {names.there.format(**at)} AND {names.who.format(**at)} = who",
            f"WITH {carried}, t, n, s",
            f"MATCH {names.pattern.format(**at | {'n': 'm', 's': 'z'})}",
            f"WHERE {names.there.format(**at | {'n': 'm', 's': 'z'})} AND m.id <> n.id AND {clause.could.format(**at)}",
            f"WITH {carried}, t, n, s, m, z",
            f"WITH id, m, {clause.sure.format(**at)} AS sure",
            f"RETURN DISTINCT id, {names.who.format(n='m')} AS other, sure",
            "ORDER BY id, other, sure",
        ]
    )


def events_of(plan: Plan) -> list[str]:
    """Names of a plan's events, those after the times they wait for."""
    placed = [name for name, time in plan.times.items() if time.event is None]
    waiting = [name for name in plan.times if name not in placed]
    order: list[str] = []
    while waiting:
        ready = [name for name in waiting if plan.times[name].after in (*placed, *order)]
        order += ready
        waiting = [name for name in waiting if name not in ready]
    return order
