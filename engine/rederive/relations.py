"""Attributes, groups, interactions, handled things, and positions relative to the robot and to people.

Left, of a person and in the robot's view, is counter-clockwise as seen from above. Panorama angles grow clockwise.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from typing import Final, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.rederive.actions import ActionFacts
from jrdb_avr.engine.rederive.truth import (
    FALSE,
    SLACK,
    TRUE,
    UNKNOWN,
    also_said,
    distinct_rows,
    in_closed_gap,
    rows,
    step_of,
)
from jrdb_avr.schema.labels import AGES, DISTANCE_BOUNDS_M, DISTANCE_WORDS, GENDERS, POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES

_Labels = dict[int, bool]
"""Labelled frames of a fact, and whether each label is certain."""

_VOCABULARY: Final = {"gender": GENDERS, "age": AGES}


class SocialFacts(ActionFacts):
    """Actions of one sequence with the social, group and reasoning labels."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._agreed = _agreed_values(tables["demographics"])
        self._faces = _visible_faces(tables["poses"])
        self._listed: dict[str, set[tuple[int, int]]] = {
            layer: set(rows(tables["listed"].filter(pc.field("layer") == layer), "frame", "track"))
            for layer in ("interactions", "handles")
        }
        self._clusters: dict[int, dict[int, _Labels]] = defaultdict(lambda: defaultdict(dict))
        for (frame, track), (cluster, certain) in self._groups.items():
            self._clusters[track][cluster][frame] = certain
        self._met: dict[tuple[int, int], list[tuple[str, int, int | None]]] = defaultdict(list)
        self._together: dict[tuple[int, int], dict[str, _Labels]] = {}
        columns = ("frame", "track", "partner", "label", "difficulty")
        for frame, track, partner, label, difficulty in rows(tables["interactions"], *columns):
            # A label of one person holds for both people. If a partner has no box in the frame, there is no fact.
            present = self._people.get(frame, ())
            if track in present and partner in present:
                self._met[min(track, partner), max(track, partner)].append((label, frame, difficulty))
            else:
                # Because further labels of a missing person may be missing too, the list is not complete.
                self._listed["interactions"] -= {(frame, track), (frame, partner)}
        names = dict(rows(tables["categories"], "category_id", "category"))
        self._handled: dict[tuple[int, str], dict[tuple[int, int], _Labels]] = defaultdict(lambda: defaultdict(dict))
        things = rows(tables["handles"], "frame", "track", "object", "category_id", "verb", "difficulty")
        for frame, track, thing, category, verb, difficulty in things:
            if track in self._people.get(frame, ()) and names.get(category) not in PERSON_CATEGORIES:
                _add_label(self._handled[track, verb][category, thing], frame, difficulty)
                for wider in also_said(verb):
                    _add_label(self._handled[track, wider][category, thing], frame, None)
        self._categories = {category: name for category, name in names.items() if name in OBJECTS}
        numbers = sorted(self.layers.get("2d", []))
        self._unread = self._find_unread(numbers) if numbers else frozenset()
        layers = ("groups", "interactions", "handles")
        self._steps = {layer: step_of(sorted(self.layers.get(layer, []))) for layer in layers}

    def _find_unread(self, numbers: list[int]) -> frozenset[int]:
        """Return the missing frames of the 2D layer, from a second before its first frame to a second after its last.

        Only frames between the first and the last frame with a box or a group label count.
        """
        labelled = set(self._people).union(numbers, self.layers.get("groups", ()))
        first, last = min(labelled), max(labelled)
        near = range(numbers[0] - KEYFRAME_STEP, numbers[-1] + KEYFRAME_STEP + 1, step_of(numbers))
        return frozenset(frame for frame in near if first <= frame <= last and not self.knows(frame))

    def _certainty(self, labels: _Labels, frame: int, layer: str) -> bool | None:
        """Return whether a fact is certain at a frame, or None if it has no label. A closed gap is not certain.

        If a layer has one frame per second, a fact with equal labels in two consecutive frames holds between them.
        """
        if frame in labels:
            return labels[frame]
        if self._steps[layer] == 1:
            return False if in_closed_gap(labels.__contains__, frame, self.rules.load.gap_frames) else None
        for before in range(frame - KEYFRAME_STEP + 1, frame):
            if before in labels and labels.get(before + KEYFRAME_STEP) == labels[before]:
                return labels[before]
        return None

    def is_complete(self, track: int, frame: int, layer: str) -> bool:
        """Return whether the whole list of a person was read. If it was, a fact without a label is false."""
        return (frame, track) in self._listed[layer]

    # -- attributes ---------------------------------------------------------------------------------------------

    def attribute(self, track: int, name: str, value: str) -> int:
        """Return whether a person's gender or age has a value, by all frames with certain labels."""
        agreed = self._agreed.get((track, name))
        if agreed not in _VOCABULARY[name] or value in also_said(agreed):
            return UNKNOWN
        return int(agreed == value)

    def face_visible(self, track: int, frame: int) -> bool:
        """Return whether head or eyes are visible. True if the sequence has no keypoints."""
        return not self.layers.get("pose") or self._faces.get((frame, track), False)

    # -- groups -------------------------------------------------------------------------------------------------

    def group_sizes(self, track: int, frame: int) -> range:
        """Return the possible sizes of the group of a person, the person included. Empty if nothing is known."""
        if not self.judges_views:
            size = self._size_of_all(track, frame)
            return range(0) if size is None else range(size, size + 1)
        cluster, certain = self._groups.get((frame, track), (0, False))
        if not certain or not self.knows(frame) or self.covered(track, frame):
            return range(0)
        least = most = 1
        for person in self.uncovered_people(frame):
            group, easy = self._groups.get((frame, person), (0, False))
            if person != track and (not easy or group == cluster):
                most += 1
                least += easy and self.clear(person, frame)
        return range(least, most + 1)

    def _size_of_all(self, track: int, frame: int) -> int | None:
        """Return the size of the person's group if all people count. None if an unknown membership could change it."""
        membership = self._groups.get((frame, track))
        if membership is None or not self.knows(frame):
            return None
        memberships = [self._groups.get((frame, person)) for person in self.people(frame)]
        if None in memberships:
            return None
        same = [member for member in memberships if member is not None and member[0] == membership[0]]
        certain = all(easy for _, easy in same) and not self._may_miss_member(membership[0], frame)
        return len(same) if certain else None

    def _may_miss_member(self, cluster: int, frame: int) -> bool:
        """Return whether a person without a box at the frame is, or could be, in the group within one second of it.

        A person with an unread membership or record could be in any group.
        """
        near = range(frame - KEYFRAME_STEP, frame + KEYFRAME_STEP + 1)
        if not self._unread.isdisjoint(near):
            return True
        present = set(self.people(frame))
        return any(
            self._groups.get((at, track), (cluster,))[0] == cluster
            for at in near
            for track in self.people(at)
            if track not in present
        )

    def same_group(self, track: int, partner: int, frame: int) -> int:
        """Return whether two people belong to one group."""
        first, second = self._memberships(track, frame), self._memberships(partner, frame)
        shared = first.keys() & second.keys()
        if shared:
            return TRUE if any(first[cluster] and second[cluster] for cluster in shared) else UNKNOWN
        return FALSE if any(first.values()) and any(second.values()) else UNKNOWN

    def _memberships(self, track: int, frame: int) -> dict[int, bool]:
        """Return the groups that a person is or could be in, and whether certainly."""
        memberships = {}
        for cluster, labels in self._clusters.get(track, {}).items():
            certain = self._certainty(labels, frame, "groups")
            if certain is not None:
                memberships[cluster] = certain
        return memberships

    # -- interactions and objects --------------------------------------------------------------------------------

    def together(self, track: int, partner: int, label: str, frame: int) -> int:
        """Return whether two people, both with a box at the frame, are in the interaction."""
        labels = self._labels_together(min(track, partner), max(track, partner)).get(label)
        certain = None if labels is None else self._certainty(labels, frame, "interactions")
        if certain is not None:
            return TRUE if certain else UNKNOWN
        both = all(self.is_complete(person, frame, "interactions") for person in (track, partner))
        return FALSE if both else UNKNOWN

    def _labels_together(self, track: int, partner: int) -> dict[str, _Labels]:
        """Return the interactions of two people, collected at their first use, because few pairs are used."""
        if (pair := (track, partner)) not in self._met:
            return {}
        if pair not in self._together:
            labels = self._together[pair] = defaultdict[str, _Labels](dict)
            for label, frame, difficulty in self._met[pair]:
                _add_label(labels[label], frame, difficulty)
                for wider in also_said(label):
                    _add_label(labels[wider], frame, None)
        return self._together[pair]

    def interacts(self, track: int, label: str, frame: int) -> int:
        """Return whether a person is in the interaction with any person in clear view."""
        facts = set()
        for partner in self.people(frame):
            fact = FALSE if partner == track else self.together(track, partner, label, frame)
            unseen = self.judges_views and not self.clear(partner, frame)
            facts.add(UNKNOWN if fact == TRUE and unseen else fact)
        return TRUE if TRUE in facts else UNKNOWN if UNKNOWN in facts else FALSE

    def handles(self, track: int, verb: str, category: str, frame: int) -> int:
        """Return whether a person handles a thing of a category. A thing of unknown category may be of any category.

        Unknown for verbs that are poses, and for things that are people.
        """
        if verb in POSES or category in PERSON_CATEGORIES:
            return UNKNOWN
        possible = False
        for (category_id, _), labels in self._handled.get((track, verb), {}).items():
            handled = self._categories.get(category_id)
            certain = self._certainty(labels, frame, "handles") if handled in (category, None) else None
            if certain and handled == category:
                return TRUE
            possible |= certain is not None
        return FALSE if not possible and self.is_complete(track, frame, "handles") else UNKNOWN


def _add_label(labels: _Labels, frame: int, difficulty: int | None) -> None:
    """Add one label. The easiest of several labels in one frame counts."""
    labels[frame] = labels.get(frame, False) or difficulty in (1, 2)


def _agreed_values(table: pa.Table) -> dict[tuple[int, str], str]:
    """Return (track, attribute) -> the value, if all frames with an easy or medium label agree."""
    votes: dict[tuple[int, str], set[str]] = defaultdict(set)
    for track, attribute, value, difficulty in distinct_rows(table, "track", "attribute", "value", "difficulty"):
        if value is not None and difficulty in (1, 2):
            votes[track, attribute].add(value)
    return {topic: min(values) for topic, values in votes.items() if len(values) == 1}


def _visible_faces(table: pa.Table) -> dict[tuple[int, int], bool]:
    """Return (frame, track) -> whether one of the first three keypoints (head, both eyes) is marked visible (2)."""
    points = table["keypoints"].combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(-1, 51)
    visible = (points[:, [2, 5, 8]] == 2).any(axis=1).tolist()
    return {(frame, track): face for (frame, track), face in zip(rows(table, "frame", "track"), visible, strict=True)}


AXES: Final = {"ahead": 180.0, "left": 90.0, "behind": 0.0, "right": 270.0}
"""Panorama angle of the axis of each sector of the robot, in degrees."""

_BEGINS_M: Final = dict(zip(DISTANCE_WORDS, (0.0, *DISTANCE_BOUNDS_M), strict=True))
"""Lower bound of each distance word, in metres."""

_SIDES: Final = {
    "front": (-20, 20, -90, 90),
    "front left": (32, 43, 0, 90),
    "left": (70, 110, 0, 180),
    "back left": (137, 143, 90, 180),
    "back": (160, 200, 90, 270),
    "back right": (217, 223, 180, 270),
    "right": (250, 290, 180, 360),
    "front right": (317, 328, 270, 360),
}
"""Sectors of a person, in degrees turned to the left: bounds of true, then bounds of possible directions."""


def _in_person_sector(sector: str, turn_deg: float) -> int:
    """Return whether a direction, in degrees to the left of straight ahead, is in a sector of a person."""
    low, high, least, most = _SIDES[sector]
    turns = [turn_deg % 360 + 360 * lap for lap in (-1, 0, 1)]
    if any(low - SLACK <= turn <= high + SLACK for turn in turns):
        return TRUE
    return UNKNOWN if any(least - SLACK <= turn <= most + SLACK for turn in turns) else FALSE


class _Solid(NamedTuple):
    """3D box with lidar points: centre in the robot frame (metres), heading (radians), distance (metres)."""

    x: float
    y: float
    z: float
    heading: float
    distance: float


class RelationFacts(SocialFacts):
    """Labels of one sequence with the positions of its people from 2D and 3D boxes."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._solids: dict[tuple[int, int], _Solid] = {}
        columns = ("frame", "track", "cx", "cy", "cz", "rot_z", "distance", "num_points")
        for frame, track, x, y, z, turned, metres, points in rows(tables["boxes_3d"], *columns):
            if points:
                distance = math.hypot(x, y) if metres is None else metres
                self._solids[frame, track] = _Solid(x, y, z, math.pi - turned, distance)
        self._firsts: dict[tuple[int, int, int], dict[int, int]] = {}

    # -- from the robot -----------------------------------------------------------------------------------------

    def distance(self, track: int, frame: int) -> float | None:
        """Return the metres from the robot. None if the person lacks a 2D box, or a 3D box with lidar points."""
        solid = self._solid(track, frame)
        return None if solid is None else solid.distance

    def _solid(self, track: int, frame: int) -> _Solid | None:
        return self._solids.get((frame, track)) if self.box(track, frame) is not None else None

    def in_sector(self, track: int, word: str, frame: int) -> int:
        """Return whether a person with a box at the frame is in this sector of the robot."""
        load, off = self.rules.load, abs((self.angle(track, frame) - AXES[word] + 180) % 360 - 180)
        if off <= load.sector_true_deg + SLACK:
            return TRUE
        return UNKNOWN if off <= load.sector_false_deg + SLACK else FALSE

    def distance_words(self, track: int, frame: int) -> list[str]:
        """Return the distance words that may be true: two words near a bound, all words of an unknown distance."""
        metres = self.distance(track, frame)
        return list(DISTANCE_WORDS) if metres is None else self._distance_words(metres)

    def _distance_words(self, metres: float) -> list[str]:
        margin = self.rules.load.distance_margin
        lows = (-math.inf, *(bound * (1 - margin) - SLACK for bound in DISTANCE_BOUNDS_M))
        highs = (*(bound * (1 + margin) + SLACK for bound in DISTANCE_BOUNDS_M), math.inf)
        return [word for word, low, high in zip(DISTANCE_WORDS, lows, highs, strict=True) if low <= metres <= high]

    # -- from a person, in space --------------------------------------------------------------------------------

    def seen_from(self, track: int, partner: int, sector: str, word: str, frame: int) -> int:
        """Return whether another person is in a person's sector, at the distance of a word."""
        source, target = self._solid(track, frame), self._solid(partner, frame)
        if source is None or target is None:
            return UNKNOWN
        load = self.rules.load
        ahead, left, up = target.x - source.x, target.y - source.y, target.z - source.z
        metres = math.sqrt(ahead**2 + left**2 + up**2)
        if metres > load.pair_max_m + load.pair_margin_m + SLACK:
            return FALSE
        possible = [word for word in self._distance_words(metres) if _BEGINS_M[word] < load.pair_max_m]
        towards = _in_person_sector(sector, math.degrees(math.atan2(left, ahead) - source.heading))
        if word not in possible or towards == FALSE:
            return FALSE
        level = abs(up) <= load.pair_vertical_m
        near = metres < load.pair_max_m - load.pair_margin_m - SLACK
        return TRUE if len(possible) == 1 and towards == TRUE and level and near else UNKNOWN

    # -- from a person, in the robot's view -----------------------------------------------------------------------

    def turn(self, track: int, partner: int, frame: int, left: bool) -> float:
        """Return the degrees, [0, 360), from one person to another, turning to the left or to the right."""
        apart = (self.angle(partner, frame) - self.angle(track, frame)) % 360.0 % 360.0
        return (360.0 - apart if apart > 0 else 0.0) if left else apart

    def first_beside(self, track: int, partner: int, frame: int, left: bool) -> int:
        """Return whether `partner` is the first person beside a person, at one side in the robot's view."""
        key = (track, frame, int(left))
        if key not in self._firsts:
            self._firsts[key] = self._find_first(track, frame, left)
        return self._firsts[key].get(partner, FALSE)

    def _find_first(self, track: int, frame: int, left: bool) -> dict[int, int]:
        """Return the facts of all people who may be the first person at a side. The fact is TRUE if only one may be."""
        margin, reach = self.rules.load.neighbor_margin_deg, self.rules.load.neighbor_max_deg
        people = [person for person in self.uncovered_people(frame) if person != track]
        turns = {person: self.turn(track, person, frame, left) for person in people}
        settling = [person for person, turn in turns.items() if margin <= turn <= reach and self.clear(person, frame)]
        if not settling:
            return {person: UNKNOWN for person, turn in turns.items() if turn <= reach}
        nearest = min(turns[person] for person in settling)
        met = [person for person, turn in turns.items() if turn < nearest + margin]
        return dict.fromkeys(met, TRUE if len(met) == 1 else UNKNOWN)

    def within(self, track: int, partner: int, degrees: int, frame: int, left: bool) -> int:
        """Return whether another person is at most some degrees to one side of a person."""
        margin, turn = self.rules.load.neighbor_margin_deg, self.turn(track, partner, frame, left)
        if min(turn, 360.0 - turn) <= margin or abs(turn - degrees) <= margin:
            return UNKNOWN
        return int(turn < degrees)
