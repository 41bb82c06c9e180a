"""Reads of found people: one statement per kind of fact, each for many people at once.

The statements lie in `queries/reads/<namespace>/*.cypher`; only counts are compiled here, from an edge's clauses.
Results are by the number of the question; unknown ones are left out. The solver queries a `Reader`: `SceneReader` reads
the annotations, `beliefs.BeliefReader` the beliefs of an agent.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal, Protocol

from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.compiler.find import Agreed, Find, compile_find, outcome_of_people
from jrdb_avr.queries.compiler.mapping import PersonId, SchemaMapping, edge_kind, edge_values
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.choice_labels import CALLED, ListedActions, list_actions
from jrdb_avr.schema.labels import ACTIONS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import KEYFRAME_STEP, SLACK, LoadRules, frames

_TIMEOUT_S: Final = 60.0
"""For each statement."""


Queryable = Graph | WorldGraph
"""A graph that answers statements."""


@dataclass(frozen=True)
class Person:
    """A found person: the number of the question, the sequence or episode, and the person's identity there."""

    id: int
    scope: str
    who: PersonId

    def row(self, **more: Any) -> dict[str, Any]:
        return {"id": self.id, "scope": self.scope, "who": self.who, **more}


@dataclass(frozen=True)
class Segment:
    """A stretch of an action: the frames with it, its start and end as answers have them, whether it is known to end
    there, and the panorama angle at the first frame."""

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


Rows = Sequence[Mapping[str, Any]]
"""Rows of a statement, or of its parameter `$plans`."""

Looks = Sequence[tuple[Person, int]]
"""People, each with a frame."""

Offers = Sequence[tuple[Person, int, str, Sequence[str]]]
"""People, each with a frame, the name of an attribute, or "action", and the actions that are offered."""


class Reader(Protocol):
    """Facts of people in a graph.

    timeout_s: of each statement; values: of the statements' parameters beside `$plans`, by name.
    """

    graph: Queryable
    timeout_s: float
    values: Mapping[str, Any]

    def find(self, plan: Plan) -> Find:
        """The statement that finds a plan's people. Raises PlanError for a plan that cannot be compiled."""

    def agreed(self, plan: Plan, find: Find, rows: Rows) -> Agreed:
        """The outcome of that statement's rows."""

    def run(self, cypher: str, rows: Rows) -> list[dict[str, Any]]:
        """The rows of a compiled statement for the rows of `$plans`. Raises QueryError, as after the timeout."""
        return self.query(cypher, {"plans": list(rows)}) if rows else []

    def query(self, cypher: str, params: Mapping[str, Any], *, ordered: bool = True) -> list[dict[str, Any]]:
        """The rows of a statement under these parameters and the reader's own. Raises QueryError likewise."""
        own = {name: self.values[name] for name in parameters(cypher) if name not in params}
        found = self.graph.query(cypher, {**params, **own}, ordered=ordered, timeout_s=self.timeout_s)
        rows: list[dict[str, Any]] = found.to_pylist()
        return rows

    def values_at(self, queries: Offers) -> dict[int, str]:
        """The value of an attribute, or the one of the offered actions that people do if they do none of the others."""

    def seen(self, queries: Looks) -> dict[tuple[int, int], Seen]:
        """Presence and distance, by question and frame."""

    def starts(self, queries: Sequence[tuple[Person, str, int]]) -> dict[int, Segment]:
        """The first start of an action after a frame."""

    def absences(self, queries: Looks) -> dict[int, tuple[int | None, int | None]]:
        """The last frame before, and the first one after, the first absence after a frame."""

    def next_poses(self, queries: Looks) -> dict[int, tuple[str, int]]:
        """The posture that follows the one at a frame, and the last frame with the one before."""

    def counts(self, queries: Sequence[tuple[Person, str, int, int]]) -> dict[int, int]:
        """The number of different people in a relation with a person at any frame of a stretch."""


class SceneReader(Reader):
    """Reads the annotations, under the rules of their load."""

    def __init__(
        self, graph: Queryable, mapping: SchemaMapping, rules: LoadRules, timeout_s: float = _TIMEOUT_S
    ) -> None:
        self.graph, self.mapping, self.timeout_s = graph, mapping, timeout_s
        self.values = {
            "margin": rules.neighbor_margin_deg,
            "sector_true": rules.sector_true_deg + SLACK,
            "sector_false": rules.sector_false_deg + SLACK,
            "least": frames(rules.segment_min_s),
            "edge": frames(rules.segment_edge_s),
            "quiet": frames(rules.segment_quiet_s),
            "in_view": rules.visibility == "clear",
        }

    def find(self, plan: Plan) -> Find:
        return compile_find(plan, self.mapping)

    def agreed(self, plan: Plan, find: Find, rows: Rows) -> Agreed:
        return outcome_of_people(find, rows)

    def values_at(self, queries: Offers) -> dict[int, str]:
        names = {person.id: name for person, _, name, _ in queries if name != "action"}
        found = self._actions_at([one for one in queries if one[2] == "action"])
        for row in self._read("value", [one.row(t=frame) for one, frame, *_ in queries if one.id in names]):
            off = {word: angle_error(row["angle"], axis) for word, axis in ROBOT_SECTORS.items()}
            sector = next((word for word in off if off[word] <= self.values["sector_true"]), None)
            value = (row | {"sector": sector})[names[row["id"]]]
            found |= {} if value is None else {row["id"]: str(value)}
        return found

    def _actions_at(self, queries: Offers) -> dict[int, str]:
        rows = [one.row(at=f"{one.scope}/{t:06d}", t=t, person=f"{one.scope}/{one.who}") for one, t, *_ in queries]
        listed, found = self.listed_actions(rows), {}
        for person, _, _, offered in queries:
            outcomes = [outcome_of_action(listed.get(person.id), label) for label in offered]
            if sorted(outcomes) == ["different"] * (len(offered) - 1) + ["same"]:
                found[person.id] = offered[outcomes.index("same")]
        return found

    def listed_actions(self, rows: Rows) -> dict[int, ListedActions]:
        """The action labels of people, by the number of the row in `$asked`; without people who are covered."""
        labels: dict[int, dict[str, bool]] = defaultdict(dict)
        complete: dict[int, bool] = {}
        for row in self.query(read_statement("necessity/labels.cypher"), {"asked": list(rows)}) if rows else ():
            complete[row["id"]] = row["listed"]
            labels[row["id"]] |= {row["label"]: row["easy"]} if row["label"] in ACTIONS else {}
        return {number: list_actions(labels[number], complete[number]) for number in complete}

    def seen(self, queries: Looks) -> dict[tuple[int, int], Seen]:
        found = {}
        for row in self._read("seen", [person.row(t=frame) for person, frame in queries]):
            absent = row["annotated"] == len(_NEIGHBOURS) and not row["boxes"]
            present = True if row["clear"] else False if absent else None
            found[row["id"], row["t"]] = Seen(present, row["distance"])
        return found

    def starts(self, queries: Sequence[tuple[Person, str, int]]) -> dict[int, Segment]:
        rows = [person.row(action=action, posture=action in POSES, after=after) for person, action, after in queries]
        return {row.pop("id"): Segment(**row) for row in self._read("start", self.rows_on_grid(rows))}

    def absences(self, queries: Looks) -> dict[int, tuple[int | None, int | None]]:
        rows = self.rows_on_grid(person.row(after=after) for person, after in queries)
        return {row["id"]: (row["leaves"], row["returns"]) for row in self._read("absence", rows)}

    def next_poses(self, queries: Looks) -> dict[int, tuple[str, int]]:
        """The posture that follows by a clear start, and the last keyframe with the one before."""
        people = {person.id: person for person, _ in queries}
        found = self._read("next_action", [person.row(after=after) for person, after in queries])
        follows = {row["id"]: (row["pose"], row["until"] - KEYFRAME_STEP) for row in found if row["pose"] is not None}
        started = self.starts([(people[i], pose, last) for i, (pose, last) in follows.items()])
        return {
            i: (pose, last)
            for i, (pose, last) in follows.items()
            if i in started and started[i].first <= last + KEYFRAME_STEP
        }

    def counts(self, queries: Sequence[tuple[Person, str, int, int]]) -> dict[int, int]:
        rows = self.rows_on_grid(person.row(t1=first, t2=last) for person, _, first, last in queries)
        known = {row["id"] for row in self._read("company", rows)}
        by_text: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for person, relation, first, last in queries:
            if person.id in known:
                row = person.row(t1=first, t2=last, **edge_values(relation))
                by_text[compile_count(relation, self.mapping)].append(row)
        could: dict[int, set[int]] = {i: set() for i in known}
        does: dict[int, set[int]] = {i: set() for i in known}
        for text, members in by_text.items():
            for row in self.run(text, members):
                # Whether somebody counts is unknown unless both people are in clear view.
                sure = row["sure"] and (row["clear"] or not self.values["in_view"])
                (does if sure else could)[row["id"]].add(row["other"])
        return {i: len(does[i]) for i in known if could[i] <= does[i]}

    def _read(self, name: str, rows: Rows) -> list[dict[str, Any]]:
        return self.run(read_statement(f"reads/scene/{name}.cypher"), rows)

    def rows_on_grid(self, rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
        """The rows, each with the frames of its sequence that have action labels; without sequences that have none."""
        return [row | self._grids[row["scope"]] for row in rows if row["scope"] in self._grids]

    @cached_property
    def _grids(self) -> dict[str, dict[str, int]]:
        return {row.pop("scope"): row for row in self.query(read_statement("reads/scene/grid.cypher"), {})}


def outcome_of_action(labels: ListedActions | None, label: str) -> Literal["same", "different", "unknown"]:
    """Compare an action with the labels of a person who has a box and is not covered.

    Args:
        labels: The labels at a keyframe, or None if no list exists.
        label: The action.

    Returns:
        "same" if the action is certain. "different" if it is certainly false: the list is complete, and neither the
        action nor one that may be called so is in it. A pose is certainly false only beside exactly one certain pose.
    """
    if labels is None:
        return "unknown"
    if label in labels.certain:
        return "same"
    listed = labels.certain | labels.hard
    called = label in listed or any(label in CALLED.get(other, ()) for other in listed)
    poses = listed.intersection(POSES)
    unsure = label in POSES and (len(poses) != 1 or poses & labels.hard)
    return "unknown" if called or unsure or not labels.complete else "different"


_NEIGHBOURS: Final = (-KEYFRAME_STEP, 0, KEYFRAME_STEP)


def compile_count(relation: str, mapping: SchemaMapping) -> str:
    """The statement for everybody who is, or could be, in a relation with a person at any frame from t1 to t2."""
    values = edge_values(relation)
    clause = mapping.edges[edge_kind(relation)]
    carried = ", ".join(["id", "scope", *values])
    at = {"n": "n", "s": "s", "m": "m", "z": "z", "t": "t", "scope": "scope"} | {name: name for name in values}
    other = at | {"n": "m", "s": "z"}
    return "\n".join(
        [
            "UNWIND $plans AS q",
            f"WITH {', '.join(f'q.{name} AS {name}' for name in ('id', 'scope', 'who', 't1', 't2', *values))}",
            "UNWIND range(t1, t2) AS t",
            f"MATCH {mapping.pattern.format(**at)}",
            f"WHERE {mapping.boxed.format(**at)} AND {mapping.who.format(**at)} = who",
            f"WITH {carried}, t, n, s",
            f"MATCH {mapping.pattern.format(**other)}",
            f"WHERE {mapping.there.format(**other)} AND m.id <> n.id AND {clause.could.format(**at)}",
            f"WITH {carried}, t, n, s, m, z",
            f"WITH id, m, s.clear AND z.clear AS clear, {clause.sure.format(**at)} AS sure",
            f"RETURN DISTINCT id, {mapping.who.format(n='m')} AS other, clear, sure",
            "ORDER BY id, other, clear, sure",
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
