"""What plans read of an agent's beliefs about people who are found.

An agent looks at a person only now and then. Without a belief that a seen person acts, the person does not: a model
cannot write a negation. A person is absent from a frame if the whole panorama of it was observed and the person was not
seen; at any other frame the presence is unknown. A moment lies between two looks, and is known where these are at most
`RESOLVED_FRAMES` apart; it is the middle of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.queries.compiler.believed import find_believed
from jrdb_avr.queries.compiler.find import Agreed, Find, outcome_of_target, people_of
from jrdb_avr.queries.compiler.mapping import PersonId
from jrdb_avr.queries.compiler.reads import Looks, Offers, Person, Queryable, Reader, Rows, Seen, Segment
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.beliefs import episode_hash
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import SYMMETRIC

RESOLVED_FRAMES: Final = 30
"""Looks farther apart leave a moment unresolved, by the protocol of the reference agent."""

DISTANCE_CUT_M: Final = 1.0
"""Change of distance from which on it is closer or farther, by the protocol of the reference agent."""


BeliefRows = Mapping[str, Rows]
"""The beliefs of an episode: rows by the name of their statement in `queries/reads/world`."""


@dataclass(frozen=True)
class Sighting:
    """Somebody at a frame: actions and distance in metres, as far as known."""

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
    """Reads the beliefs of one episode, for one solving.

    notes: why something is unknown; evidence: frames in which the answer can be seen, the best last; both by the number
    of the question. rows: the current beliefs, where they are at hand; the reads then do not query the graph.
    anywhen: whether a moment may lie between any two looks, however far apart.
    """

    def __init__(
        self, graph: Queryable, episode: str, timeout_s: float, rows: BeliefRows | None = None, anywhen: bool = False
    ) -> None:
        self.graph, self.timeout_s, self.anywhen = graph, timeout_s, anywhen
        self.values = {"scope": episode, "hash": episode_hash(episode)}
        self.notes: dict[int, list[tuple[str, str]]] = {}
        self.evidence: dict[int, list[int]] = {}
        self._rows: dict[str, Rows] = dict(rows or {})
        self._sightings: dict[PersonId, list[Sighting]] = {}

    def find(self, plan: Plan) -> Find:
        return find_believed(plan)

    def agreed(self, plan: Plan, find: Find, rows: Rows) -> Agreed:
        return outcome_of_target(plan, [people_of(find, row) for row in rows])

    def prepare(self, find: Find) -> None:
        """Have a plan's statement checked and parsed. Raises QueryError."""
        self.graph.prepare(find.cypher, {**find.row, "hash": self.values["hash"]}, ordered=False)

    def run(self, cypher: str, rows: Rows) -> list[dict[str, Any]]:
        """The rows of a compiled statement, run for one plan after the other, in any order. Raises QueryError."""
        own = [name for name in parameters(cypher) if name not in self.values]
        return [
            {"id": row["id"], **found}
            for row in rows
            for found in self.query(cypher, {name: row[name] for name in own}, ordered=False)
        ]

    # -- beliefs of the episode -----------------------------------------------------------------------------------

    def all(self, name: str) -> Rows:
        """Rows of a statement over the whole episode, without replaced ones."""
        if name not in self._rows:
            rows = self.query(read_statement(f"reads/world/{name}.cypher"), {})
            self._rows[name] = [row for row in rows if row.get("current", True)]
        return self._rows[name]

    def sightings(self, who: PersonId) -> list[Sighting]:
        """Sightings of somebody, by frame."""
        if who not in self._sightings:
            frames = {moment.frame for moment in self.moments(who)}
            rows = [row for row in self.all("attributes") if row["who"] == who]
            self._sightings[who] = [_sighting(rows, frame) for frame in sorted(frames)]
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
        """Names of all entities, each with its node of the plan, "" for none."""
        return {row["who"]: row["node"] for row in self.all("entities")}

    # -- reads ----------------------------------------------------------------------------------------------------

    def values_at(self, queries: Offers) -> dict[int, str]:
        found = {}
        for person, frame, name, offered in queries:
            self._add_evidence(person, [frame])
            rows = [row for row in self.all("attributes") if (row["who"], row["name"]) == (person.name, name)]
            values = {row["value"] for row in rows if row["first"] <= frame <= row["last"]}
            values &= {*offered} if name == "action" else values
            if self._at(person, frame) is None:
                self._note(person, "value", f"{person.name} is not seen at {_at(frame)}")
            elif len(values) != 1:
                self._note(person, "value", f"the {name} of {person.name} at {_at(frame)} is not known")
            else:
                found[person.id] = values.pop()
        return found

    def seen(self, queries: Looks) -> dict[tuple[int, int], Seen]:
        found = {}
        for person, frame in queries:
            self._add_evidence(person, [frame])
            seen = self._at(person, frame)
            present = True if seen is not None else False if frame in self.covered() else None
            if present is None:
                how = "not seen, nor is the whole panorama observed"
                self._note(person, "presence", f"{person.name} is {how}, at {_at(frame)}")
            elif seen is not None and seen.distance is None:
                self._note(person, "distance", f"distance_m of {person.name} at {_at(frame)} is not known")
            found[person.id, frame] = Seen(present, seen.distance if seen is not None else None)
        return found

    def starts(self, queries: Sequence[tuple[Person, str, int]]) -> dict[int, Segment]:
        found = {person.id: self._start(person, action, after) for person, action, after in queries}
        return {number: segment for number, segment in found.items() if segment is not None}

    def _start(self, person: Person, action: str, after: int) -> Segment | None:
        seen = [one for one in self.sightings(person.name) if one.frame >= after]
        does = [one.frame for one in seen if action in one.actions]
        without = [one.frame for one in seen if action not in one.actions]
        if not does:
            self._note(person, "start", f"{person.name} is not seen {action} from {_at(after)} on")
            return None
        first = does[0]
        if not without or without[0] > first:
            self._note(person, "start", f"{person.name} is not seen before it is {action}, from {_at(after)} on")
            return None
        begin = self._between(person, "start", f"the start of {action}", max(f for f in without if f < first), first)
        ended = next((frame for frame in without if frame > first), None)
        last = max(frame for frame in does if ended is None or frame < ended)
        if ended is None:
            self._note(person, "end", f"{person.name} is not seen to have ended {action} after {_at(last)}")
        end = None if ended is None else self._between(person, "end", f"the end of {action}", last, ended)
        self._add_evidence(person, [first])
        if begin is None:
            return None
        angle = next(one.angle for one in reversed(self.moments(person.name)) if one.frame == first)
        return Segment(first, last, begin, last if end is None else end, end is not None, angle)

    def absences(self, queries: Looks) -> dict[int, tuple[int | None, int | None]]:
        return {person.id: self._absence(person, after) for person, after in queries}

    def _absence(self, person: Person, after: int) -> tuple[int | None, int | None]:
        seen = [one.frame for one in self.sightings(person.name) if one.frame >= after]
        gone = [frame for frame in self.covered() if frame > after and frame not in seen]
        if not gone or not seen or seen[0] > gone[0]:
            how = "is at no frame known to be absent (the whole panorama observed, and not seen in it)"
            self._note(person, "leaves", f"{person.name} {how} after {_at(after)}")
            return None, None
        before = max(frame for frame in seen if frame < gone[0])
        leaves = self._between(person, "leaves", f"when {person.name} leaves", before, gone[0])
        back = next((frame for frame in seen if frame > gone[0]), None)
        self._add_evidence(person, [before] if back is None else [before, back])
        if back is None:
            self._note(person, "returns", f"{person.name} is not seen to be back after {_at(gone[0])}")
            return leaves, None
        last = max(frame for frame in gone if frame < back)
        return leaves, self._between(person, "returns", f"when {person.name} is back", last, back)

    def next_poses(self, queries: Looks) -> dict[int, tuple[str, int]]:
        found = {}
        for person, after in queries:
            held = self._at(person, after)
            if held is None or held.pose is None:
                self._note(person, "next_action", f"the posture of {person.name} at {_at(after)} is not known")
                continue
            later = [one for one in self.sightings(person.name) if one.frame > after and one.pose is not None]
            follows = next((one for one in later if one.pose != held.pose), None)
            if follows is None or follows.pose is None:
                self._note(person, "next_action", f"no other posture of {person.name} is known after {_at(after)}")
                continue
            self._add_evidence(person, [follows.frame])
            held_last = max([after, *(one.frame for one in later if one.frame < follows.frame)])
            found[person.id] = (follows.pose, held_last)
        return found

    def counts(self, queries: Sequence[tuple[Person, str, int, int]]) -> dict[int, int]:
        found = {}
        for person, relation, first, last in queries:
            seen = [one.frame for one in self.sightings(person.name) if first <= one.frame <= last]
            self._add_evidence(person, seen[::-1])
            rows = [row for row in self.all("relations") if row["name"] == relation]
            rows = [row for row in rows if row["first"] <= last and row["last"] >= first]
            met = {row["target"] for row in rows if row["source"] == person.name}
            if relation in SYMMETRIC:
                met |= {row["source"] for row in rows if row["target"] == person.name}
            if met:
                found[person.id] = len(met)
            else:
                # A missing fact is unknown, and nobody is missing until somebody is met.
                when = f"from {_at(first)} to {_at(last)}"
                self._note(person, "count", f"nobody is known to be in '{relation}' with {person.name} {when}")
        return found

    def _at(self, person: Person, frame: int) -> Sighting | None:
        return next((one for one in self.sightings(person.name) if one.frame == frame), None)

    def _between(self, person: Person, kind: str, what: str, before: int, after: int) -> int | None:
        """The middle of two looks, None (and noted) where they are too far apart."""
        if self.anywhen or after - before <= RESOLVED_FRAMES:
            return (before + after) // 2
        how = f"to {after - before} frames only, from {before:06d} to {after:06d}; {RESOLVED_FRAMES} are needed"
        self._note(person, kind, f"{what} is known {how}")
        return None

    def _note(self, person: Person, kind: str, text: str) -> None:
        self.notes.setdefault(person.id, []).append((kind, text))

    def _add_evidence(self, person: Person, frames: Sequence[int]) -> None:
        self.evidence.setdefault(person.id, []).extend(frames)


def notes_of(plan: Plan, notes: Sequence[tuple[str, str]]) -> list[str]:
    """The notes of a reader that matter to a plan: ends of actions and returns only where it has such events."""
    events = {time.event for time in plan.times.values()}
    read = plan.answer.read
    matters: Mapping[str, bool] = {
        "end": "end" in events and read != "next_action",
        "returns": "returns" in events,
        "distance": read == "distance_change",
    }
    return list(dict.fromkeys(text for kind, text in notes if matters.get(kind, True)))


def goes_round(crops: Sequence[tuple[int, int]]) -> bool:
    """Whether crops, as left columns and widths in pixels, leave out no column of the panorama."""
    # Where each crop ends another one goes on, so that there is no last column before a gap.
    return all(any((left + width - begin) % WIDTH < wide for begin, wide in crops) for left, width in crops)


def _sighting(rows: Rows, frame: int) -> Sighting:
    """Somebody at a frame, by rows of beliefs."""
    current = [row for row in rows if row["first"] <= frame <= row["last"]]
    distances = {row["number"] for row in current if row["name"] == "distance_m"}
    actions = tuple(row["value"] for row in current if row["name"] == "action")
    return Sighting(frame, actions, distances.pop() if len(distances) == 1 else None)


def _at(frame: int) -> str:
    return f"frame {frame:06d}"
