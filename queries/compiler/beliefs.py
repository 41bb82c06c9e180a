"""Reads of plans over an agent's beliefs about the people that a plan finds.

An agent sees a person only in some frames. A model cannot write a negation. So a seen person without a belief in an
action does not do it. A person is absent from a frame if the whole panorama of the frame was observed and the person
was not seen. At a frame without either, the presence is unknown. The time of an event is the middle of the looks before
and after it. It is known if these two looks are at most `RESOLVED_FRAMES` apart.
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
"""Maximum frames between two looks that resolve the time of an event, by the protocol of the reference agent."""

DISTANCE_CUT_M: Final = 1.0
"""Minimum change of distance in metres for "closer" or "farther", by the protocol of the reference agent."""


BeliefRows = Mapping[str, Rows]
"""The beliefs of an episode: rows by the name of their statement in `queries/reads/world`."""


@dataclass(frozen=True)
class Sighting:
    """A person at a frame: the known actions, and the distance in metres or None."""

    frame: int
    actions: tuple[str, ...]
    distance: float | None

    @property
    def pose(self) -> str | None:
        """The pose, or None if no pose or more than one pose was written."""
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
    """Reader of the beliefs of one episode, for one solution of a plan.

    notes: reasons why values are unknown, by the number of the question. evidence: frames that show the answer, the
    best last, by the number of the question. rows: the current beliefs, or None to query the graph. anywhen: whether
    two looks resolve the time of an event at any distance.
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
        """Check and parse the statement of a plan. Raises QueryError."""
        self.graph.prepare(find.cypher, {**find.row, "hash": self.values["hash"]}, ordered=False)

    def run(self, cypher: str, rows: Rows) -> list[dict[str, Any]]:
        """Run a compiled statement for each plan, and return the rows in any order. Raises QueryError."""
        own = [name for name in parameters(cypher) if name not in self.values]
        return [
            {"id": row["id"], **found}
            for row in rows
            for found in self.query(cypher, {name: row[name] for name in own}, ordered=False)
        ]

    # -- beliefs of the episode -----------------------------------------------------------------------------------

    def all(self, name: str) -> Rows:
        """Return the rows of a statement over the whole episode, without replaced rows."""
        if name not in self._rows:
            rows = self.query(read_statement(f"reads/world/{name}.cypher"), {})
            self._rows[name] = [row for row in rows if row.get("current", True)]
        return self._rows[name]

    def sightings(self, who: PersonId) -> list[Sighting]:
        """Return the sightings of a person, ordered by frame."""
        if who not in self._sightings:
            frames = {moment.frame for moment in self.moments(who)}
            rows = [row for row in self.all("attributes") if row["who"] == who]
            self._sightings[who] = [_sighting(rows, frame) for frame in sorted(frames)]
        return self._sightings[who]

    def moments(self, who: PersonId) -> list[Moment]:
        """Return the boxes of a person, ordered by frame. In a frame the newest is last."""
        return [
            Moment(row["frame"], Box(*(row["box"][key] for key in "xywh")), row["angle"], row["written"])
            for row in self.all("sighted")
            if row["who"] == who
        ]

    def covered(self) -> list[int]:
        """Return the frames with a panorama that was observed as a whole, ascending."""
        looks: dict[int, list[tuple[int, int]]] = {}
        for row in self.all("looks"):
            looks.setdefault(row["frame"], []).append((row["edge"], row["width"]))
        return sorted(frame for frame, crops in looks.items() if goes_round(crops))

    def nodes(self) -> dict[str, str]:
        """Return the node of the plan for each entity by name, or "" if it has none."""
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
        """Return the middle of two looks. If they are too far apart, note this and return None."""
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
    """Return the notes that concern a plan. Notes of ends and returns count only if the plan has such events."""
    events = {time.event for time in plan.times.values()}
    read = plan.answer.read
    matters: Mapping[str, bool] = {
        "end": "end" in events and read != "next_action",
        "returns": "returns" in events,
        "distance": read == "distance_change",
    }
    return list(dict.fromkeys(text for kind, text in notes if matters.get(kind, True)))


def goes_round(crops: Sequence[tuple[int, int]]) -> bool:
    """Return whether crops show each column of the panorama. A crop is its left column and width in pixels."""
    # The panorama is a circle: there is no gap if another crop covers the end of each crop.
    return all(any((left + width - begin) % WIDTH < wide for begin, wide in crops) for left, width in crops)


def _sighting(rows: Rows, frame: int) -> Sighting:
    """Return the sighting of a person at a frame, from rows of beliefs."""
    current = [row for row in rows if row["first"] <= frame <= row["last"]]
    distances = {row["number"] for row in current if row["name"] == "distance_m"}
    actions = tuple(row["value"] for row in current if row["name"] == "action")
    return Sighting(frame, actions, distances.pop() if len(distances) == 1 else None)


def _at(frame: int) -> str:
    return f"frame {frame:06d}"
