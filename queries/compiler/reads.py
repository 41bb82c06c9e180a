"""Reads of people who are found. One statement per kind of fact reads many people together.

The statements are in `queries/reads/scene/*.cypher`. Only counts are compiled here, from the clauses of an edge.
Results are by id of the plan, and unknown results are missing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Literal

from jrdb_avr.queries.compiler.changes import first_change, read_states
from jrdb_avr.queries.compiler.find import Agreed, Find, compile_find, outcome_of_people
from jrdb_avr.queries.compiler.mapping import BOXED, PEOPLE, PersonId, edge_kind, edge_values
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.choice_labels import CALLED, ListedActions, list_actions
from jrdb_avr.schema.labels import ACTIONS, FLICKERING, POSES, ROBOT_SECTORS
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import KEYFRAME_STEP, SLACK, LoadRules, frames

_TIMEOUT_S: Final = 60.0
"""Maximum seconds of each statement."""

_STATES: Final = ("boxes", "memberships")
"""Statements that return who is in a group when."""

_COUNTED: Final = 32
"""Maximum number of counts of one statement, because the memory of the engine is bounded."""


@dataclass(frozen=True)
class Person:
    """A found person.

    Attributes:
        id: Id of the plan.
        scope: Name of the sequence, or key of the episode.
        name: Track or name of the person in the scope.
    """

    id: int
    scope: str
    name: PersonId

    def row(self, **more: Any) -> dict[str, Any]:
        """Return a row of `$plans` for the person, with further values."""
        return {"id": self.id, "scope": self.scope, "who": self.name, **more}


@dataclass(frozen=True)
class Segment:
    """A segment of an action.

    Attributes:
        first: First frame with the action.
        last: Last frame with the action.
        start: Start as in answers.
        end: End as in answers.
        closed: Whether the end is known.
        angle: Panorama angle of the person at the first frame, in degrees.
    """

    first: int
    last: int
    start: int
    end: int
    closed: bool
    angle: float


@dataclass(frozen=True)
class Seen:
    """Presence of a person at a frame.

    Attributes:
        present: Whether the person is present, or None if it is unknown.
        distance: Distance from the robot in metres, or None if it is unknown.
    """

    present: bool | None
    distance: float | None


Rows = Sequence[Mapping[str, Any]]
"""Rows of a statement, or of its parameter `$plans`."""

Looks = Sequence[tuple[Person, int]]
"""Pairs of a person and a frame."""

Offers = Sequence[tuple[Person, int, str, Sequence[str]]]
"""People, each with a frame, an attribute or "action", and the offered actions."""


class SceneReader:
    """Reader of facts about people from the annotations in a graph.

    Attributes:
        graph: Graph.
        timeout_s: Maximum seconds of each statement.
        values: Values of the parameters of statements, except `$plans`, by name.
    """

    def __init__(self, graph: Graph, rules: LoadRules, timeout_s: float = _TIMEOUT_S) -> None:
        self.graph, self.timeout_s = graph, timeout_s
        grid = read_statement("reads/scene/grid.cypher")
        self._grid = cache(lambda scope: next(iter(self.query(grid, {"scopes": [scope]})), None))
        self._states = cache(lambda scope: read_states(*(self._read_all(name, scope) for name in _STATES)))
        self.values = {
            "margin": rules.neighbor_margin_deg,
            "sector_true": rules.sector_true_deg + SLACK,
            "sector_false": rules.sector_false_deg + SLACK,
            "least": frames(rules.segment_min_s),
            "edge": frames(rules.segment_edge_s),
            "quiet": frames(rules.segment_quiet_s),
            "in_view": rules.visibility == "clear",
            "flickering": sorted(FLICKERING) if rules.visibility == "clear" else [""],
        }

    def find(self, plan: Plan) -> Find:
        """Return the statement that finds the people of a plan.

        Raises:
            PlanError: If the plan cannot be compiled.
        """
        return compile_find(plan)

    def rows(self, find: Find, plan: Plan, scope: str) -> list[dict[str, Any]]:
        """Return the rows of a plan in `$plans`: one for each combination of changes of groups at its events."""
        rows: list[tuple[dict[str, int], dict[str, Any]]] = [({}, {"scope": scope, **find.row})]
        for variable, name in find.events.items():
            time = plan.times[name]
            after, person = plan.times[time.after or ""].frame or 0, time.of or ""
            changes = {
                who: first_change(states, after, time.event == "joins_group")
                for who, states in self._states(scope).items()
            }
            rows = [
                (who | {person: track}, row | {variable: frame, f"{variable}_who": track, f"{variable}_sure": sure})
                for who, row in rows
                for track, (frames, sure) in changes.items()
                if who.get(person, track) == track
                for frame in frames
            ]
        return [row for _, row in rows]

    def _read_all(self, name: str, scope: str) -> list[dict[str, Any]]:
        return self.query(read_statement(f"reads/scene/{name}.cypher"), {"scopes": [scope]})

    def agreed(self, plan: Plan, find: Find, rows: Rows) -> Agreed:
        """Return the outcome of the rows of a statement of `find`."""
        return outcome_of_people(find, rows)

    def run(self, cypher: str, rows: Rows) -> list[dict[str, Any]]:
        """Run a compiled statement.

        Args:
            cypher: Statement.
            rows: Rows of `$plans`.

        Raises:
            QueryError: If the statement fails or takes too long.
        """
        return self.query(cypher, {"plans": list(rows)}) if rows else []

    def query(self, cypher: str, params: Mapping[str, Any], *, ordered: bool = True) -> list[dict[str, Any]]:
        """Run a statement with parameters. Parameters that are missing in `params` get the values of the reader.

        Raises:
            QueryError: If the statement fails or takes too long.
        """
        table = self.graph.query(cypher, self.with_values(cypher, params), ordered=ordered, timeout_s=self.timeout_s)
        rows: list[dict[str, Any]] = table.to_pylist()
        return rows

    def with_values(self, cypher: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters of a statement, those that are missing with the values of the reader.

        `$scopes` are the sequences of the rows. The engine reads a graph faster if they are constants.
        """
        scopes = {row.get("scope", "") for row in params.get("asked", params.get("plans", ()))}
        values = {**self.values, "scopes": sorted(scopes)}
        return {**params, **{name: values[name] for name in parameters(cypher) if name not in params}}

    def values_at(self, queries: Offers) -> dict[int, str]:
        """Return an attribute of people, or their only true action among those offered. All others must be false."""
        names = {person.id: name for person, _, name, _ in queries if name != "action"}
        values = self._actions_at([query for query in queries if query[2] == "action"])
        people = [person.row(t=t) for person, t, *_ in queries if person.id in names]
        things = [row for row in people if isinstance(row["who"], str)]
        rows = self._read("value", [row for row in people if row not in things]) + self._read("thing", things)
        for row in rows:
            off = {word: angle_error(row["angle"], axis) for word, axis in ROBOT_SECTORS.items()}
            sector = next((word for word in off if off[word] <= self.values["sector_true"]), None)
            value = (row | {"sector": sector})[names[row["id"]]]
            values |= {} if value is None else {row["id"]: str(value)}
        return values

    def _actions_at(self, queries: Offers) -> dict[int, str]:
        rows = [p.row(at=f"{p.scope}/{t:06d}", t=t, person=f"{p.scope}/{p.name}") for p, t, *_ in queries]
        listed, true = self.listed_actions(rows), {}
        for person, _, _, offered in queries:
            outcomes = [outcome_of_action(listed.get(person.id), label) for label in offered]
            if sorted(outcomes) == ["different"] * (len(offered) - 1) + ["same"]:
                true[person.id] = offered[outcomes.index("same")]
        return true

    def listed_actions(self, rows: Rows) -> dict[int, ListedActions]:
        """Return the action labels of people who are not covered, by id of the row.

        Args:
            rows: Rows of `$asked` of the statement `necessity/labels.cypher`.
        """
        labels: dict[int, dict[str, bool]] = defaultdict(dict)
        complete: dict[int, bool] = {}
        for row in self.query(read_statement("necessity/labels.cypher"), {"asked": list(rows)}) if rows else ():
            complete[row["id"]] = row["listed"]
            labels[row["id"]] |= {row["label"]: row["easy"]} if row["label"] in ACTIONS else {}
        return {row_id: list_actions(labels[row_id], complete[row_id]) for row_id in complete}

    def seen(self, queries: Looks) -> dict[tuple[int, int], Seen]:
        """Return presence and distance, by id of the plan and frame."""
        views = {}
        for row in self._read("seen", [person.row(t=frame) for person, frame in queries]):
            present = True if row["clear"] else False if row["absent"] else None
            views[row["id"], row["t"]] = Seen(present, row["distance"])
        return views

    def starts(self, queries: Sequence[tuple[Person, str, int]]) -> dict[int, Segment]:
        """Return the first start of an action after a frame."""
        rows = [person.row(action=action, posture=action in POSES, after=after) for person, action, after in queries]
        return {row.pop("id"): Segment(**row) for row in self._read("start", self.rows_on_grid(rows))}

    def absences(self, queries: Looks) -> dict[int, tuple[int | None, int | None]]:
        """Return the frames before and after the first absence after a frame."""
        rows = self.rows_on_grid(person.row(after=after) for person, after in queries)
        return {row["id"]: (row["leaves"], row["returns"]) for row in self._read("absence", rows)}

    def next_poses(self, queries: Looks) -> dict[int, tuple[str, int]]:
        """Return the posture that follows the posture at a frame, and the last frame with the first posture.

        The next posture must have a certain start.
        """
        people = {person.id: person for person, _ in queries}
        rows = self._read("next_action", [person.row(after=after) for person, after in queries])
        follows = {row["id"]: (row["pose"], row["until"] - KEYFRAME_STEP) for row in rows if row["pose"] is not None}
        started = self.starts([(people[i], pose, last) for i, (pose, last) in follows.items()])
        return {
            i: (pose, last)
            for i, (pose, last) in follows.items()
            if i in started and started[i].first <= last + KEYFRAME_STEP
        }

    def counts(self, queries: Sequence[tuple[Person, str, int, int]]) -> dict[int, int]:
        """Return the number of people in a relation with a person at any frame from the first to the last."""
        rows = self.rows_on_grid(person.row(t1=first, t2=last) for person, _, first, last in queries)
        complete = {row["id"] for row in self._read("company", rows)}
        by_text: dict[tuple[str, int], list[dict[str, Any]]] = defaultdict(list)
        for person, relation, first, last in queries:
            if person.id in complete:
                row = person.row(t1=first, t2=last, **edge_values(relation))
                by_text[compile_count(relation), person.id // _COUNTED].append(row)
        could: dict[int, set[int]] = {i: set() for i in complete}
        does: dict[int, set[int]] = {i: set() for i in complete}
        for (text, _), members in by_text.items():
            for row in self.run(text, members):
                (does if row["clear"] and row["holds"] else could)[row["id"]].add(row["other"])
        return {i: len(does[i]) for i in complete if could[i] <= does[i]}

    def _read(self, name: str, rows: Rows) -> list[dict[str, Any]]:
        return self.run(read_statement(f"reads/scene/{name}.cypher"), rows)

    def rows_on_grid(self, rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
        """Add the frames with action labels of the sequence to each row.

        Rows of sequences without such frames are left out.
        """
        return [row | grid for row in rows if (grid := self._grid(row["scope"]))]


def outcome_of_action(labels: ListedActions | None, label: str) -> Literal["same", "different", "unknown"]:
    """Compare an action with the labels of a person who has a box and is not covered.

    Args:
        labels: The labels at a keyframe, or None if no list exists.
        label: The action.

    Returns:
        "same" if the action is certain. "different" if it is certainly false: the list is complete and has no action
        that overlaps in meaning. A pose is certainly false only beside exactly one certain pose. Otherwise "unknown".
    """
    if labels is None:
        return "unknown"
    if label in labels.certain:
        return "same"
    listed = labels.certain | labels.hard
    called = label in listed or any(label in CALLED.get(name, ()) for name in listed)
    poses = listed.intersection(POSES)
    unsure = label in POSES and (len(poses) != 1 or poses & labels.hard)
    return "unknown" if called or unsure or not labels.complete else "different"


def compile_count(relation: str) -> str:
    """Compile the statement that counts the people in a relation with a person at any frame from t1 to t2.

    Args:
        relation: Relation.
    """
    values = edge_values(relation)
    clause = PEOPLE.edges[edge_kind(relation)]
    carried = ", ".join(["id", "scope", *values])
    at = {"n": "n", "s": "s", "m": "m", "z": "z", "t": "t", "scope": "scope"} | {name: name for name in values}
    partner = at | {"n": "m", "s": "z"}
    return "\n".join(
        [
            "UNWIND $plans AS q",
            f"WITH {', '.join(f'q.{name} AS {name}' for name in ('id', 'scope', 'who', 't1', 't2', *values))}",
            "UNWIND range(t1, t2) AS t",
            f"MATCH {PEOPLE.pattern.format(**at)}",
            f"WHERE n.sequence IN $scopes AND {BOXED.format(**at)} AND {PEOPLE.key.format(**at)} = who",
            f"WITH {carried}, t, n, s",
            f"MATCH {PEOPLE.pattern.format(**partner)} WHERE m.sequence IN $scopes AND m.id <> n.id",
            f"AND {PEOPLE.present.format(**partner)} AND {clause.could.format(**at)}",
            f"WITH {carried}, t, n, s, m, z, s.clear AND z.clear OR NOT $in_view AS clear",
            # The engine cannot evaluate EXISTS together with columns.
            f"WITH id, m, clear, {clause.sure.format(**at)} AS holds",
            f"RETURN DISTINCT id, {PEOPLE.key.format(n='m')} AS other, clear, holds",
            "ORDER BY id, other, clear, holds",
        ]
    )


def events_of(plan: Plan) -> list[str]:
    """Return the names of the events of a plan. An event comes later in the list than the time that it follows.

    Args:
        plan: Plan.
    """
    placed = [name for name, time in plan.times.items() if time.event is None]
    waiting = [name for name in plan.times if name not in placed]
    while waiting:
        placed += [name for name in waiting if plan.times[name].after in placed]
        waiting = [name for name in waiting if name not in placed]
    return [name for name in placed if plan.times[name].event is not None]
