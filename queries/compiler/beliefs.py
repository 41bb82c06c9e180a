"""Plans over an agent's beliefs: the statement that finds the people, and what the plan reads of them.

The statement compares texts, one per belief: the other person of a relation, the belief with its frame, and the person
("/action=sitting@15/p1", "p2/conversation=@15/p1"; a sighting is "/=@15/p1"). Each condition and edge of a plan becomes
such a text, so a plan is all parameters, and the statement depends on its `Shape` alone. The engine needs several times
as long for the first use of a statement, and while no two questions of an agent have one plan, most have one of a few
shapes. What is not believed is no match.

An agent looks at a person only now and then. Without a belief that a seen person acts, the person does not: a model
cannot write a negation. A person is absent from a frame if the whole panorama of it was observed and the person was not
seen; at any other frame the presence is unknown. A moment lies between two looks, and is known where these are at most
`RESOLVED_FRAMES` apart; it is the middle of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from jrdb_avr.queries.compiler.find import (
    Agreed,
    Edges,
    Find,
    conditions_of,
    joined,
    outcome_of_target,
    people_of,
    search_order,
    stated_frame,
    times_of,
)
from jrdb_avr.queries.compiler.mapping import PersonId, read_text
from jrdb_avr.queries.compiler.reads import Looks, Person, Queryable, Reader, Rows, Seen, Segment
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.schema.beliefs import TIMELESS, episode_hash
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.plan import Edge, Plan, validate
from jrdb_avr.schema.relations import SYMMETRIC

READS: Final = "world"
"""The folder of the world namespace's statements."""

_TEXTS: Final = 4
"""A statement asks for so many texts of each person, or for the next multiple of it."""

_SMALL: Final = 5
"""People up to whom all orders of a plan are tried."""

_ENDS: Final = ("who", "whom")

_NOTHING: Final = ""
"""What no belief says."""


@dataclass(frozen=True)
class Shape:
    """What the statement of a plan depends on.

    people: how many nodes there are, called by their places in the search; edges: the places that each joins, the
    earlier first; texts: how many are asked for of each person; anybody: whether one says of a person only that it is
    in a relation, whoever the other one is.
    """

    people: int
    edges: tuple[tuple[int, int], ...]
    texts: int = _TEXTS
    anybody: bool = False


def find_believed(plan: Plan) -> Find:
    """Compile a plan's conditions and edges, to a statement whose parameters are the values of `Find.row` and the
    episode's `hash`. It gives columns who0, who1, ..., every binding once, in any order.

    Raises PlanError where the plan is invalid or not of stated times.
    """
    validate(plan)
    places = {node: place for place, (node, _) in enumerate(believed_order(plan))}
    people = [_asked_of(plan, node) for node in places]
    edges = sorted(_asked_between(plan, edge, places) for edge in plan.edges)
    conditions = [one for node in plan.nodes for one in node.conditions if one.interaction is not None]
    ties = {_said(one.wanted[1], "", stated_frame(plan, one.at or "")) for one in conditions}
    shape = Shape(
        people=len(people),
        edges=tuple(pair for pair, _, _ in edges),
        texts=filled(max(map(len, people))),
        anybody=bool(ties),
    )
    row: dict[str, Any] = {}
    for place, texts in enumerate(people):
        # What is asked for once more changes nothing.
        asked = texts + texts[:1] * (shape.texts - len(texts))
        row |= {f"c{place}_{i}": f"/{text}/" for i, text in enumerate(asked)}
    for i, (_, there, back) in enumerate(edges):
        row |= {f"e{i}": f"/{there}/", f"b{i}": f"/{back}/"}
    row["wanted"] = sorted(({text[1:-1] for text in row.values()} | ties) - {_NOTHING})
    return Find(statement(shape), tuple(places), row)


def filled(texts: int) -> int:
    """How many texts of each person a statement asks for where there are so many."""
    return -(-texts // _TEXTS) * _TEXTS


def believed_order(plan: Plan) -> list[tuple[str, Edges]]:
    """Nodes in the order in which they are looked for, as `search_order`. Of the orders of a small plan it is the one
    with the smallest places in its shape: how the plan lists its edges does not matter then.
    """
    if len(plan.nodes) > _SMALL:
        return search_order(plan)

    def pairs(order: Sequence[str]) -> list[list[int]]:
        return sorted(sorted((order.index(edge.source), order.index(edge.target))) for edge in plan.edges)

    return joined(plan, min(_orders(plan, [plan.root]), key=pairs))


def _orders(plan: Plan, known: Sequence[str]) -> Iterator[Sequence[str]]:
    """All orders in which edges lead from the known nodes to the others."""
    if len(known) == len(plan.nodes):
        yield known
    for node in sorted({e.target for e in plan.edges if e.source in known} - {*known}):
        yield from _orders(plan, [*known, node])


@lru_cache(256)
def statement(shape: Shape) -> str:
    """The statement of a shape. Names in it are the compiler's own."""
    lines = read_text(READS, "beliefs").rstrip().splitlines()
    told = "concat(r.whom, '/', said, '/', r.who)"
    if shape.anybody:
        # A relation says of both ends what an attribute would.
        ends = [f"concat('/interaction=', r.name, '@', CAST(r.first AS STRING), '/', r.{end})" for end in _ENDS]
        lines.append(f"UNWIND CASE WHEN r.whom IS NULL THEN [{told}] ELSE [{', '.join([told, *ends])}] END AS one")
        told = "one"
    lines.append(f"WITH collect({told}) AS told, collect(DISTINCT r.who) AS people")
    bound = ["told", "people"]
    for place in range(shape.people):
        bound.append(f"n{place}")
        tests = " AND ".join(_tests(shape, place))
        lines += [f"UNWIND people AS n{place}", f"WITH {', '.join(bound)}", f"WHERE {tests}"]
    lines.append(f"RETURN {', '.join(f'n{place} AS who{place}' for place in range(shape.people))}")
    return "\n".join(lines)


def _tests(shape: Shape, place: int) -> Iterator[str]:
    """What must hold of the person at a place, alone and with those before."""
    own = f"n{place}"
    for other in range(place):
        yield f"{own} <> n{other}"
    for i in range(shape.texts):
        yield f"concat($c{place}_{i}, {own}) IN told"
    for i, (first, second) in enumerate(shape.edges):
        if second == place:
            yield f"(concat({own}, $e{i}, n{first}) IN told OR concat(n{first}, $b{i}, {own}) IN told)"


# -- what a plan asks for ---------------------------------------------------------------------------------------------


def _said(name: str, value: str, frame: int) -> str:
    """What is said at a frame, as the statement puts it: of a relation, which has no value, its name."""
    return f"{name}={value}@{frame}"


def _asked_of(plan: Plan, node: str) -> list[str]:
    """What is asked of one person; first that it is seen."""
    times = times_of(plan, node)
    texts = [_said("", "", stated_frame(plan, time)) for time in times]
    for condition in conditions_of(plan, node):
        name, value = condition.wanted
        texts.append(_said(name, value, 0 if name in TIMELESS else stated_frame(plan, condition.at or times[0])))
    return list(dict.fromkeys(texts))


def _asked_between(plan: Plan, edge: Edge, places: Mapping[str, int]) -> tuple[tuple[int, int], str, str]:
    """The places that an edge joins, the earlier first, and what is asked of them in this order, and the other way
    round.
    """
    said = _said(edge.relation, "", stated_frame(plan, edge.at))
    source, target = places[edge.source], places[edge.target]
    back = said if edge.relation in SYMMETRIC else _NOTHING
    return ((source, target), said, back) if source < target else ((target, source), back, said)


RESOLVED_FRAMES: Final = 30
"""Looks farther apart leave a moment unresolved (design, section 6: reference agent)."""

DISTANCE_CUT_M: Final = 1.0
"""Closer or farther from this change of distance on, about the same below it (design, section 6: reference agent)."""


BeliefRows = Mapping[str, Rows]
"""What is believed in an episode: by the name of a statement of `queries/reads/world`, the rows that it gives."""


@dataclass(frozen=True)
class Sighting:
    """Somebody at a frame: actions and distance in metres, as far as they were written down."""

    frame: int
    actions: tuple[str, ...]
    distance: float | None

    @property
    def pose(self) -> str | None:
        """The posture, None where it was not written down, or two were."""
        poses = {action for action in self.actions if action in POSES}
        return poses.pop() if len(poses) == 1 else None


@dataclass(frozen=True)
class Moment:
    """A sighting: its frame, its box in stitched pixels, the angle of its centre, and the number of its write."""

    frame: int
    box: Box
    angle: float
    written: int


class BeliefReader(Reader):
    """Reads what is believed in one episode. Why something is unknown is kept in `notes`, where the answer can be seen
    in `shown`, the best last: both by the number of the question. One reader serves one solving.

    rows: what is currently believed, where that is known already; the graph is then asked for nothing that is read.
    """

    def __init__(self, graph: Queryable, episode: str, timeout_s: float, rows: BeliefRows | None = None) -> None:
        self.graph, self.timeout_s = graph, timeout_s
        self.values = {"scope": episode, "hash": episode_hash(episode)}
        self.notes: dict[int, list[tuple[str, str]]] = {}
        self.shown: dict[int, list[int]] = {}
        self._rows: dict[str, Rows] = dict(rows or {})
        self._sightings: dict[PersonId, list[Sighting]] = {}

    def find(self, plan: Plan) -> Find:
        return find_believed(plan)

    def agreed(self, plan: Plan, find: Find, rows: Rows) -> Agreed:
        return outcome_of_target(plan, [people_of(find, row) for row in rows])

    def run(self, cypher: str, rows: Rows) -> list[dict[str, Any]]:
        """The rows of a compiled statement, run for one plan after the other, in any order. Raises QueryError."""
        own = [name for name in parameters(cypher) if name not in self.values]
        return [
            {"id": row["id"], **found}
            for row in rows
            for found in self.query(cypher, {name: row[name] for name in own}, ordered=False)
        ]

    # -- what is there --------------------------------------------------------------------------------------------

    def all(self, name: str) -> Rows:
        """Rows of a statement that asks for something of the whole episode, of what was not replaced."""
        if name not in self._rows:
            rows = self.query(read_text(READS, name), {})
            self._rows[name] = [row for row in rows if row.get("current", True)]
        return self._rows[name]

    def sightings(self, who: PersonId) -> list[Sighting]:
        """Sightings of somebody, by frame."""
        if who not in self._sightings:
            frames = {moment.frame for moment in self.moments(who)}
            told = [row for row in self.all("attributes") if row["who"] == who]
            self._sightings[who] = [_sighting(told, frame) for frame in sorted(frames)]
        return self._sightings[who]

    def moments(self, who: PersonId) -> list[Moment]:
        """Boxes of somebody, by frame, then the newest last."""
        return [
            Moment(row["frame"], Box(*(row["box"][key] for key in "xywh")), row["angle"], row["written"])
            for row in self.all("sighted")
            if row["who"] == who
        ]

    def covered(self) -> list[int]:
        """Frames of which the whole panorama was observed, ascending."""
        looks: dict[int, list[tuple[int, int]]] = {}
        for row in self.all("looks"):
            looks.setdefault(row["frame"], []).append((row["edge"], row["width"]))
        return sorted(frame for frame, crops in looks.items() if goes_round(crops))

    def nodes(self) -> dict[str, str]:
        """Names of everybody, with the node that each is said to be, "" for none."""
        return {row["who"]: row["node"] for row in self.all("entities")}

    # -- reads ----------------------------------------------------------------------------------------------------

    def poses(self, queries: Looks) -> dict[int, str]:
        found = {}
        for person, frame in queries:
            self._show(person, [frame])
            seen = self._at(person, frame)
            if seen is None:
                self._note(person, "action", f"{person.who} is not seen at {_at(frame)}")
            elif (pose := seen.pose) is None:
                self._note(person, "action", f"the posture of {person.who} at {_at(frame)} is not known")
            else:
                found[person.id] = pose
        return found

    def seen(self, queries: Looks) -> dict[tuple[int, int], Seen]:
        found = {}
        for person, frame in queries:
            self._show(person, [frame])
            seen = self._at(person, frame)
            present = True if seen is not None else False if frame in self.covered() else None
            if present is None:
                how = "not seen, nor is the whole panorama observed"
                self._note(person, "presence", f"{person.who} is {how}, at {_at(frame)}")
            elif seen is not None and seen.distance is None:
                self._note(person, "distance", f"distance_m of {person.who} at {_at(frame)} is not known")
            found[person.id, frame] = Seen(present, seen.distance if seen is not None else None)
        return found

    def starts(self, queries: Sequence[tuple[Person, str, int]]) -> dict[int, Segment]:
        return {
            person.id: segment
            for person, action, after in queries
            if (segment := self._start(person, action, after)) is not None
        }

    def _start(self, person: Person, action: str, after: int) -> Segment | None:
        seen = [one for one in self.sightings(person.who) if one.frame >= after]
        does = [one.frame for one in seen if action in one.actions]
        without = [one.frame for one in seen if action not in one.actions]
        if not does:
            self._note(person, "start", f"{person.who} is not seen {action} from {_at(after)} on")
            return None
        first = does[0]
        if not without or without[0] > first:
            self._note(person, "start", f"{person.who} is not seen before it is {action}, from {_at(after)} on")
            return None
        begin = self._between(person, "start", f"the start of {action}", max(f for f in without if f < first), first)
        ended = next((frame for frame in without if frame > first), None)
        last = max(frame for frame in does if ended is None or frame < ended)
        if ended is None:
            self._note(person, "end", f"{person.who} is not seen to have ended {action} after {_at(last)}")
        end = None if ended is None else self._between(person, "end", f"the end of {action}", last, ended)
        self._show(person, [first])
        if begin is None:
            return None
        angle = next(one.angle for one in reversed(self.moments(person.who)) if one.frame == first)
        return Segment(first, last, begin, last if end is None else end, end is not None, angle)

    def absences(self, queries: Looks) -> dict[int, tuple[int | None, int | None]]:
        return {person.id: self._absence(person, after) for person, after in queries}

    def _absence(self, person: Person, after: int) -> tuple[int | None, int | None]:
        seen = [one.frame for one in self.sightings(person.who) if one.frame >= after]
        gone = [frame for frame in self.covered() if frame > after and frame not in seen]
        if not gone or not seen or seen[0] > gone[0]:
            how = "is at no frame known to be absent (the whole panorama observed, and not seen in it)"
            self._note(person, "leaves", f"{person.who} {how} after {_at(after)}")
            return None, None
        before = max(frame for frame in seen if frame < gone[0])
        leaves = self._between(person, "leaves", f"when {person.who} leaves", before, gone[0])
        back = next((frame for frame in seen if frame > gone[0]), None)
        self._show(person, [before] if back is None else [before, back])
        if back is None:
            self._note(person, "returns", f"{person.who} is not seen to be back after {_at(gone[0])}")
            return leaves, None
        last = max(frame for frame in gone if frame < back)
        return leaves, self._between(person, "returns", f"when {person.who} is back", last, back)

    def next_poses(self, queries: Looks) -> dict[int, tuple[str, int]]:
        found = {}
        for person, after in queries:
            held = self._at(person, after)
            if held is None or held.pose is None:
                self._note(person, "next_action", f"the posture of {person.who} at {_at(after)} is not known")
                continue
            later = [one for one in self.sightings(person.who) if one.frame > after and one.pose is not None]
            follows = next((one for one in later if one.pose != held.pose), None)
            if follows is None or follows.pose is None:
                self._note(person, "next_action", f"no other posture of {person.who} is known after {_at(after)}")
                continue
            self._show(person, [follows.frame])
            held_last = max([after, *(one.frame for one in later if one.frame < follows.frame)])
            found[person.id] = (follows.pose, held_last)
        return found

    def counts(self, queries: Sequence[tuple[Person, str, int, int]]) -> dict[int, int]:
        found = {}
        for person, relation, first, last in queries:
            self._show(person, [one.frame for one in self.sightings(person.who) if first <= one.frame <= last][::-1])
            ties = [
                (row["source"], row["target"])
                for row in self.all("relations")
                if row["name"] == relation and row["first"] <= last and row["last"] >= first
            ]
            met = {target for source, target in ties if source == person.who}
            if relation in SYMMETRIC:
                met |= {source for source, target in ties if target == person.who}
            if met:
                found[person.id] = len(met)
            else:
                # A missing fact is unknown, and nobody is missing until somebody is met.
                when = f"from {_at(first)} to {_at(last)}"
                self._note(person, "count", f"nobody is known to be in '{relation}' with {person.who} {when}")
        return found

    def _at(self, person: Person, frame: int) -> Sighting | None:
        return next((one for one in self.sightings(person.who) if one.frame == frame), None)

    def _between(self, person: Person, kind: str, what: str, before: int, after: int) -> int | None:
        """The middle of two looks, None (and noted) where they are too far apart."""
        if after - before <= RESOLVED_FRAMES:
            return (before + after) // 2
        how = f"to {after - before} frames only, from {before:06d} to {after:06d}; {RESOLVED_FRAMES} are needed"
        self._note(person, kind, f"{what} is known {how}")
        return None

    def _note(self, person: Person, kind: str, text: str) -> None:
        self.notes.setdefault(person.id, []).append((kind, text))

    def _show(self, person: Person, frames: Sequence[int]) -> None:
        self.shown.setdefault(person.id, []).extend(frames)


def notes_of(plan: Plan, notes: Sequence[tuple[str, str]]) -> list[str]:
    """What of a reader's notes matters to a plan: how an action ends, and when somebody is back, where it asks so."""
    events = {time.event for time in plan.times.values()}
    read = plan.answer.read
    matters: Mapping[str, bool] = {
        "end": "end" in events and read != "next_action",
        "returns": "returns" in events,
        "distance": read == "distance_change",
    }
    return list(dict.fromkeys(text for kind, text in notes if matters.get(kind, True)))


def goes_round(crops: Sequence[tuple[int, int]]) -> bool:
    """Whether crops, as left columns and widths in pixels, leave out no column of the panorama.

    Where a crop ends another one must go on; where that is so of all of them, there is no last column before a gap.
    """
    return all(any((left + width - begin) % WIDTH < wide for begin, wide in crops) for left, width in crops)


def _sighting(rows: Rows, frame: int) -> Sighting:
    """What rows of beliefs say of somebody at a frame."""
    told = [row for row in rows if row["first"] <= frame <= row["last"]]
    distances = {row["number"] for row in told if row["name"] == "distance_m"}
    actions = tuple(row["value"] for row in told if row["name"] == "action")
    return Sighting(frame, actions, distances.pop() if len(distances) == 1 else None)


def _at(frame: int) -> str:
    return f"frame {frame:06d}"
