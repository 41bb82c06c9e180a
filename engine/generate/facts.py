"""Three-valued facts of one sequence at its keyframes, as sets of people.

The statements in `queries/search` return how each person is seen at each keyframe, and with which labels. `Facts`
keeps their rows and answers two questions: which people fit a condition (`match`), and which people are the targets of
a relation (`follow`). Each answer has two sets: the people who may fit, and the people who certainly fit.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from itertools import chain, permutations, product
from typing import Any, Final, NamedTuple, cast

from jrdb_avr.queries.compiler.reads import Seen
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.choice_labels import ListedActions, list_actions
from jrdb_avr.schema.labels import (
    ACTIONS,
    AGES,
    FLICKERING,
    GENDERS,
    INTERACTIONS,
    OTHER_ACTIONS,
    POSES,
    ROBOT_SECTORS,
    may_be_called,
)
from jrdb_avr.schema.panorama import angle_error, clockwise
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import QUESTION_RELATIONS, RELATIONS, SAME_GROUP, Relation
from jrdb_avr.schema.rules import KEYFRAME_STEP, SLACK, LoadRules
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES, VERBS

Sighting = Mapping[str, Any]
"""Row of the statement `seen`: one person at one keyframe."""


class Fit(NamedTuple):
    """Tracks of the people who may fit a fact, and of those who certainly fit it."""

    could: Set[int]
    certain: Set[int]


Key = tuple[Any, ...]
"""Kind of a fact, sequence, and what the fact is about."""

WORDS: Final = {"gender": frozenset(GENDERS), "age": frozenset(AGES), "pose": frozenset(POSES)}
"""Values of columns of sightings that generation knows. Any other value counts as unknown."""

_COLUMNS: Final = {"distance": ("distance_word", "distance_other")}
"""Columns of sightings that have other names than the kind of condition."""

_LISTS: Final = {"social": "interactions_listed", "first": "robot_view_listed", "person": "person_view_listed"}
"""Columns of sightings that are true if the relations of a kind were read for the person."""

_THINGS: Final = {
    (verb, value): number
    for number, (verb, value) in enumerate(product(VERBS, OBJECTS))
    if verb not in POSES and value not in PERSON_CATEGORIES
}
"""Order of the things that may describe a person, by verb and category."""

_Marks = dict[int, bool]
"""People with a label by track, each with whether the label is certain."""


class Facts:
    """The facts of one sequence at its keyframes.

    Attributes:
        keyframes: Frames at which facts are known, in order.
        people: Sightings by keyframe and track.
        lists: Written actions by track and keyframe, of each person with a box.
        counts: Number of people in clear view who certainly do each action, by keyframe.
        uncovered: People with a box who are not covered, by keyframe. Only these people count.
        judges_views: Whether the rules judge who is in clear view.
    """

    def __init__(self, graph: Graph, sequence: str, rules: LoadRules, *, with_faces: bool) -> None:
        """Read all facts of a sequence.

        Args:
            graph: Graph with the scene of the sequence.
            sequence: Name of the sequence.
            rules: Thresholds of sectors and of directions between people.
            with_faces: Whether gender and age may describe only people with a visible face.
        """
        self._rules, self._with_faces = rules, with_faces
        self.judges_views = rules.visibility == "clear"
        self.people: dict[int, dict[int, Sighting]] = defaultdict(dict)
        self.lists: dict[int, dict[int, ListedActions]] = defaultdict(dict)
        self.counts: dict[int, Counter[str]] = defaultdict(Counter)
        self._labels: dict[int, dict[tuple[str, Any], _Marks]] = defaultdict(lambda: defaultdict(dict))
        self._met: dict[int, list[Mapping[str, Any]]] = defaultdict(list)
        self._pairs: dict[int, dict[int, dict[str, _Marks]]] = {}
        self._groups: dict[int, dict[Any, _Marks]] = defaultdict(lambda: defaultdict(dict))
        self._matches: dict[tuple[Condition, int], Fit] = {}
        self._follows: dict[tuple[str, int, int], Fit] = {}
        self._turns: dict[tuple[int, int], list[tuple[int, float]]] = {}

        def rows(name: str) -> list[dict[str, Any]]:
            table = graph.query(read_statement(f"search/{name}.cypher"), {"sequence": sequence})
            return cast(list[dict[str, Any]], table.to_pylist())

        frames = rows("frames")
        self.keyframes = [row["frame"] for row in frames if row["keyframe"]]
        self._annotated = {row["frame"] for row in frames if row["annotated"]}
        seen = rows("seen")
        self._boxes = {(row["who"], row["frame"]) for row in seen}
        for row in seen:
            row |= {name: row[name] if row[name] in words else None for name, words in WORDS.items()}
            self.people[row["frame"]][row["who"]] = row
        for frame in self.people.keys() - set(self.keyframes):
            del self.people[frame]
        self.uncovered: dict[int, frozenset[int]] = defaultdict(frozenset)
        for frame, people in self.people.items():
            self.uncovered[frame] = frozenset(track for track, row in people.items() if not row["covered"])
        # A label of a person without a box counts for nothing.
        labels = {
            name: [row for row in rows(name) if row["who"] in self.people[row["frame"]]]
            for name in ("performs", "handles", "pairs", "member")
        }
        self._read_actions(labels["performs"])
        for row in labels["handles"]:
            if row["verb"] in VERBS:
                category = row["value"] if row["value"] in OBJECTS else None
                _mark(self._labels[row["frame"]][row["verb"], category], row["who"], row["certain"])
        for row in labels["pairs"]:
            if row["value"] in QUESTION_RELATIONS:
                self._met[row["frame"]].append(row)
        for row in labels["member"]:
            _mark(self._groups[row["frame"]][row["value"]], row["who"], row["certain"])

    def _read_actions(self, rows: Iterable[Mapping[str, Any]]) -> None:
        written: dict[tuple[int, int], dict[str, bool]] = defaultdict(dict)
        for row in rows:
            flickers = self.judges_views and row["value"] in FLICKERING
            if row["value"] in ACTIONS and (row["now"] or flickers):
                _mark(self._labels[row["frame"]]["action", row["value"]], row["who"], row["certain"])
            if row["value"] in ACTIONS and row["written"]:
                written[row["who"], row["frame"]][row["value"]] = row["easy"]
        for frame, people in self.people.items():
            for track, row in people.items():
                self.lists[track][frame] = list_actions(written[track, frame], row["listed"])
                if row["clear"]:
                    self.counts[frame].update(self.lists[track][frame].certain)

    def _pairs_at(self, frame: int) -> dict[int, dict[str, _Marks]]:
        """Return the others in each relation by a label with each person, made at the first use of the keyframe."""
        if frame not in self._pairs:
            pairs: dict[int, dict[str, _Marks]] = defaultdict(lambda: defaultdict(dict))
            for row in self._met.pop(frame, ()):
                for other in self.people[frame].keys() & row["others"]:
                    _mark(pairs[row["who"]][row["value"]], other, row["certain"])
            for marks in self._groups[frame].values():
                for (track, certain), (other, also) in permutations(marks.items(), 2):
                    _mark(pairs[track][SAME_GROUP], other, certain and also)
            self._pairs[frame] = pairs
        return self._pairs[frame]

    # -- conditions ---------------------------------------------------------------------------------------------------

    def match(self, condition: Condition, frame: int) -> Fit:
        """Find the people who fit a condition.

        Args:
            condition: Condition of one person.
            frame: Keyframe.

        Returns:
            The people who may fit, and those who certainly fit. Covered people are left out.
        """
        if (key := (condition, frame)) not in self._matches:
            self._matches[key] = self._without_covered(self._match(condition, frame), frame)
        return self._matches[key]

    def _match(self, condition: Condition, frame: int) -> Fit:
        labels = self._labels[frame]
        match condition.kind:
            case "action":
                return _fit(labels.get(("action", condition.action), {}), self._without(frame, "listed"))
            case "object":
                unknown = labels.get((condition.verb or "", None), {}).keys()
                marks = labels.get((condition.verb or "", condition.object), {})
                return _fit(marks, self._without(frame, "handles_listed") | unknown)
            case "interaction":
                return self._match_interaction(condition.interaction or "", frame)
            case "sector":
                return self._match_sector(str(condition.value), frame)
        return self._match_value(condition, frame)

    def _match_interaction(self, label: str, frame: int) -> Fit:
        people, marks = self.people[frame], {}
        for track, met in (
            (track, labels[label]) for track, labels in self._pairs_at(frame).items() if label in labels
        ):
            # A partner who is not in clear view may be out of sight.
            marks[track] = any(met[other] and (people[other]["clear"] or not self.judges_views) for other in met)
        # A person without a list may interact with each other person.
        anybody = len(people) > 1 and self._without(frame, "interactions_listed")
        return _fit(marks, people.keys() if anybody else ())

    def _match_sector(self, sector: str, frame: int) -> Fit:
        off = {track: angle_error(row["angle"], ROBOT_SECTORS[sector]) for track, row in self.people[frame].items()}
        could, certain = (
            {track for track, degrees in off.items() if degrees <= limit + SLACK}
            for limit in (self._rules.sector_false_deg, self._rules.sector_true_deg)
        )
        return Fit(could, certain)

    def _match_value(self, condition: Condition, frame: int) -> Fit:
        kind, wanted = condition.kind, condition.value if condition.action is None else condition.action
        values = {track: _possible_values(kind, row) for track, row in self.people[frame].items()}
        fitting = {wanted} if kind == "pose" else {wanted, *may_be_called(str(wanted))}
        could = {track for track, possible in values.items() if not possible or possible & fitting}
        if kind == "pose":
            # A closed gap of a pose leaves the pose possible beside the pose that is listed.
            could |= self._labels[frame].get(("action", wanted), {}).keys()
        return Fit(could, {track for track, possible in values.items() if possible == {wanted}})

    def _without_covered(self, fit: Fit, frame: int) -> Fit:
        people = self.uncovered[frame]
        return Fit(fit.could & people, fit.certain & people)

    def _without(self, frame: int, column: str) -> set[int]:
        """Return the people without a list of labels."""
        return {track for track, row in self.people[frame].items() if not row[column]}

    # -- relations ----------------------------------------------------------------------------------------------------

    def follow(self, relation: str, track: int, frame: int) -> Fit:
        """Find the people at the end of a relation.

        Args:
            relation: Label of the relation.
            track: Track of the person at the beginning of the relation.
            frame: Keyframe at which the person has a box.

        Returns:
            The other people to whom the relation may lead (`could`), and those to whom it certainly leads
            (`certain`). Covered people are left out.
        """
        if (key := (relation, track, frame)) not in self._follows:
            self._follows[key] = self._without_covered(self._follow(RELATIONS[relation], track, frame), frame)
        return self._follows[key]

    def _follow(self, relation: Relation, track: int, frame: int) -> Fit:
        if relation.kind == "window":
            return self._look_aside(relation, track, frame)
        marks = self._pairs_at(frame)[track].get(relation.label, {})
        others = self.people[frame].keys() - {track}
        if relation.kind == "group":
            members = (marks.items() for marks in self._groups[frame].values())
            unread = self.people[frame].keys() - {who for who, certain in chain.from_iterable(members) if certain}
        else:
            unread = self._without(frame, _LISTS[relation.kind])
        return _fit(marks, others if track in unread else unread & others)

    def _look_aside(self, window: Relation, track: int, frame: int) -> Fit:
        """Find the people within some degrees at one side. Near the edges of the window it is unknown."""
        margin, could, certain = self._rules.neighbor_margin_deg, set[int](), set[int]()
        if (key := (track, frame)) not in self._turns:
            people = self.people[frame]
            turns = [(other, clockwise(people[track]["angle"], row["angle"])) for other, row in people.items()]
            self._turns[key] = [(other, right) for other, right in turns if other != track]
        for other, right in self._turns[key]:
            left = -right % 360.0
            turn = left if window.side == "left" else right
            unknown = min(left, right) <= margin or abs(turn - window.degrees) <= margin
            if unknown or turn < window.degrees:
                (could if unknown else certain).add(other)
        return Fit(could | certain, certain)

    # -- reads --------------------------------------------------------------------------------------------------------

    def pose(self, track: int, frame: int) -> str | None:
        """Return the posture of a person at a keyframe, or None if it is unknown or the person has no box."""
        row = self.people.get(frame, {}).get(track)
        return None if row is None else row["pose"]

    def labels(self, track: int, frame: int) -> ListedActions | None:
        """Return the written actions of a person at a keyframe, or None if the person has no box or is covered."""
        return self.lists[track].get(frame) if track in self.uncovered[frame] else None

    def seen(self, track: int, frame: int) -> Seen:
        """Return whether a person is in clear view at a keyframe, and the distance from the robot.

        Args:
            track: Track of the person.
            frame: Keyframe.

        Returns:
            Presence is False if the frame, and the frames one second before and after, are annotated and have no box of
            the person. Presence is None if it is unknown. The distance is None unless the 3D box has lidar points.
        """
        row = self.people.get(frame, {}).get(track)
        present = True if row is not None and row["clear"] else False if self.is_absent(track, frame) else None
        return Seen(present, row["distance"] if row is not None and row["located"] else None)

    def is_absent(self, track: int, frame: int) -> bool:
        """Return whether a person is certainly absent at a keyframe."""
        near = (frame - KEYFRAME_STEP, frame, frame + KEYFRAME_STEP)
        return self._annotated.issuperset(near) and not any((track, other) in self._boxes for other in near)

    def ask(self, keys: Sequence[Key]) -> list[Any]:
        """Return the facts for keys such as `("match", sequence, condition, frame)`, as `perturb` asks for them."""
        return [getattr(self, kind)(*arguments) for kind, _, *arguments in keys]

    def people_at(self, frame: int) -> Fit:
        """Return all people at a keyframe who have a box and are not covered."""
        return Fit(self.uncovered[frame], self.uncovered[frame])

    # -- one person ---------------------------------------------------------------------------------------------------

    def relations_of(self, track: int, frame: int) -> tuple[str, ...]:
        """Return the relations that a person may have with some other person because of a label.

        Args:
            track: Track of the person.
            frame: Keyframe.

        Returns:
            Labels of relations that a question may name, in the order of `QUESTION_RELATIONS`.
        """
        held = self._pairs_at(frame)[track]
        return tuple(label for label in QUESTION_RELATIONS if label in held)

    def conditions_of(self, track: int, frame: int) -> list[Condition]:
        """Return the conditions that certainly hold of a person and may describe the person.

        Args:
            track: Track of the person.
            frame: Keyframe at which the person has a box.

        Returns:
            The conditions in a fixed order. Those that hold at a time hold at "t0".
        """
        row, labels = self.people[frame][track], self._labels[frame]
        conditions = [Condition(attribute="sector", value=sector, at="t0") for sector in ROBOT_SECTORS]
        if row["group_size"] is not None:
            conditions.append(Condition(attribute="group_size", value=int(row["group_size"]), at="t0"))
        if row["distance_word"]:
            conditions.append(Condition(attribute="distance", value=row["distance_word"], at="t0"))
        if row["face"] or not self._with_faces:
            conditions += [Condition(attribute=name, value=row[name]) for name in ("gender", "age") if row[name]]
        if row["pose"]:
            conditions.append(Condition(action=row["pose"], at="t0"))
        held = {topic for topic, marks in labels.items() if track in marks}
        conditions += [Condition(action=name, at="t0") for name in OTHER_ACTIONS if ("action", name) in held]
        things = sorted(held & _THINGS.keys(), key=_THINGS.__getitem__)
        conditions += [Condition(object=value, verb=verb, at="t0") for verb, value in things]
        met = self.relations_of(track, frame)
        conditions += [Condition(interaction=label, at="t0") for label in met if label in INTERACTIONS]
        return [condition for condition in conditions if track in self.match(condition, frame).certain]


def _mark(marks: _Marks, track: int, certain: bool) -> None:
    """Mark that a person has a label. A label is certain if one of its rows is."""
    marks[track] = marks.get(track, False) or certain


def _fit(marks: _Marks, possible: Iterable[int]) -> Fit:
    return Fit(marks.keys() | set(possible), {track for track, certain in marks.items() if certain})


def _possible_values(kind: str, row: Sighting) -> set[Any]:
    """Return the possible values of a condition of this kind for a person, or none if nothing is known."""
    if kind == "group_size" and row["size_min"] is not None:
        return {*range(row["size_min"], row["size_max"] + 1)}
    return {row[column] for column in _COLUMNS.get(kind, (kind,))} - {None}
