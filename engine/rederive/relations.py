"""Attributes, groups, interactions, handled objects, and places: sector, distance, and where others are from a person.

Left of a person, and from the robot's view, is counter-clockwise seen from above; panorama angles grow clockwise.
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
"""Frames at which a fact is labelled, and whether the label is certain."""

_WORDS: Final = {"gender": GENDERS, "age": AGES}


class SocialFacts(ActionFacts):
    """The social, group and reasoning labels of one sequence, in addition to its actions."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._chosen = _chosen(tables["demographics"])
        self._faces = _faces(tables["poses"])
        self._listed: dict[str, set[tuple[int, int]]] = {
            layer: set(rows(tables["listed"].filter(pc.field("layer") == layer), "frame", "track"))
            for layer in ("interactions", "handles")
        }
        self._clusters: dict[int, dict[int, _Labels]] = defaultdict(lambda: defaultdict(dict))
        for (frame, track), (cluster, certain) in self._groups.items():
            self._clusters[track][cluster][frame] = certain
        self._together: dict[tuple[int, int, str], _Labels] = defaultdict(dict)
        columns = ("frame", "track", "partner", "label", "difficulty")
        for frame, track, partner, label, difficulty in rows(tables["interactions"], *columns):
            # A label of one of two people holds for both; a partner without a box in the frame gives no fact.
            there = self._people.get(frame, ())
            if track in there and partner in there:
                pair = min(track, partner), max(track, partner)
                _add_label(self._together[*pair, label], frame, difficulty)
                for other in also_said(label):
                    _add_label(self._together[*pair, other], frame, None)
            else:
                # With somebody unseen, so that nothing is known of whom else it could be said.
                self._listed["interactions"] -= {(frame, track), (frame, partner)}
        names = dict(rows(tables["categories"], "category_id", "category"))
        self._handled: dict[tuple[int, str], dict[tuple[int, int], _Labels]] = defaultdict(lambda: defaultdict(dict))
        things = rows(tables["handles"], "frame", "track", "object", "category_id", "verb", "difficulty")
        for frame, track, thing, category, verb, difficulty in things:
            if track in self._people.get(frame, ()) and names.get(category) not in PERSON_CATEGORIES:
                _add_label(self._handled[track, verb][category, thing], frame, difficulty)
                for other in also_said(verb):
                    _add_label(self._handled[track, other][category, thing], frame, None)
        self._categories = {number: name for number, name in names.items() if name in OBJECTS}
        numbers = sorted(self.layers.get("2d", []))
        self._unread = self._find_unread(numbers) if numbers else frozenset()
        layers = ("groups", "interactions", "handles")
        self._steps = {layer: step_of(sorted(self.layers.get(layer, []))) for layer in layers}

    def _find_unread(self, numbers: list[int]) -> frozenset[int]:
        """Frames that the 2D layer, of these frames, should know and does not, up to a second beyond its ends.

        Beyond them it should know what lies within the frames of any box and of the layer of groups.
        """
        others = set(self._people).union(numbers, self.layers.get("groups", ()))
        first, last = min(others), max(others)
        near = range(numbers[0] - KEYFRAME_STEP, numbers[-1] + KEYFRAME_STEP + 1, step_of(numbers))
        return frozenset(one for one in near if first <= one <= last and not self.knows(one))

    def _when(self, labels: _Labels, frame: int, layer: str) -> bool | None:
        """Whether a fact is labelled with certainty at a frame; a closed gap is not certain, None means not labelled.

        Of a layer with one frame per second, a fact labelled in two consecutive frames holds between them.
        """
        if frame in labels:
            return labels[frame]
        if self._steps[layer] == 1:
            return False if in_closed_gap(labels.__contains__, frame, self.rules.load.gap_frames) else None
        for before in range(frame - KEYFRAME_STEP + 1, frame):
            if before in labels and labels.get(before + KEYFRAME_STEP) == labels[before]:
                return labels[before]
        return None

    def tells(self, track: int, frame: int, layer: str) -> bool:
        """Whether the whole list of a person could be read, so that what it lacks is false."""
        return (frame, track) in self._listed[layer]

    # -- what a person is ---------------------------------------------------------------------------------------

    def attribute(self, track: int, name: str, wanted: str) -> int:
        """Gender or age: what all frames that tell it say."""
        value = self._chosen.get((track, name))
        if value not in _WORDS[name] or wanted in also_said(value):
            return UNKNOWN
        return int(value == wanted)

    def face_visible(self, track: int, frame: int) -> bool:
        """Whether head or eyes are visible; true where the sequence has no poses."""
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
        for other in self.uncovered_people(frame):
            group, easy = self._groups.get((frame, other), (0, False))
            if other != track and (not easy or group == cluster):
                most += 1
                least += easy and self.clear(other, frame)
        return range(least, most + 1)

    def _size_of_all(self, track: int, frame: int) -> int | None:
        """People in the person's group, oneself included; None where a membership that matters is unknown."""
        own = self._groups.get((frame, track))
        if own is None or not self.knows(frame):
            return None
        members = [self._groups.get((frame, other)) for other in self.people(frame)]
        if None in members:
            return None
        same = [member for member in members if member is not None and member[0] == own[0]]
        return len(same) if all(certain for _, certain in same) and not self._somebody_away(own[0], frame) else None

    def _somebody_away(self, cluster: int, frame: int) -> bool:
        """Whether somebody without a box at the frame is in the group within a second of it, or could be.

        Whose membership or whole record could not be read there could be in any group.
        """
        near = range(frame - KEYFRAME_STEP, frame + KEYFRAME_STEP + 1)
        if not self._unread.isdisjoint(near):
            return True
        there = set(self.people(frame))
        return any(
            self._groups.get((one, track), (cluster,))[0] == cluster
            for one in near
            for track in self.people(one)
            if track not in there
        )

    def same_group(self, track: int, other: int, frame: int) -> int:
        """Whether two people belong to one group."""
        mine, theirs = self._memberships(track, frame), self._memberships(other, frame)
        shared = mine.keys() & theirs.keys()
        if shared:
            return TRUE if any(mine[cluster] and theirs[cluster] for cluster in shared) else UNKNOWN
        return FALSE if mine and theirs else UNKNOWN

    def _memberships(self, track: int, frame: int) -> dict[int, bool]:
        """Groups that a person is or could be in, and whether certainly."""
        found = {}
        for cluster, labels in self._clusters.get(track, {}).items():
            certain = self._when(labels, frame, "groups")
            if certain is not None:
                found[cluster] = certain
        return found

    # -- interactions and objects --------------------------------------------------------------------------------

    def together(self, track: int, other: int, label: str, frame: int) -> int:
        """Whether two people, both with a box at the frame, are in the interaction."""
        labels = self._together.get((min(track, other), max(track, other), label))
        certain = None if labels is None else self._when(labels, frame, "interactions")
        if certain is not None:
            return TRUE if certain else UNKNOWN
        both = self.tells(track, frame, "interactions") and self.tells(other, frame, "interactions")
        return FALSE if both else UNKNOWN

    def interacts(self, track: int, label: str, frame: int) -> int:
        """Whether a person is in the interaction with anybody."""
        facts = set()
        for other in self.people(frame):
            fact = FALSE if other == track else self.together(track, other, label, frame)
            unseen = self.judges_views and not self.clear(other, frame)
            facts.add(UNKNOWN if fact == TRUE and unseen else fact)
        return TRUE if TRUE in facts else UNKNOWN if UNKNOWN in facts else FALSE

    def handles(self, track: int, verb: str, category: str, frame: int) -> int:
        """Whether a person does this with a thing of the category; a thing of unknown category could be one.

        Verbs that are postures, and what is done with people, are unknown.
        """
        if verb in POSES or category in PERSON_CATEGORIES:
            return UNKNOWN
        possible = False
        for (number, _), labels in self._handled.get((track, verb), {}).items():
            of = self._categories.get(number)
            certain = self._when(labels, frame, "handles") if of in (category, None) else None
            if certain and of == category:
                return TRUE
            possible |= certain is not None
        return FALSE if not possible and self.tells(track, frame, "handles") else UNKNOWN


def _add_label(labels: _Labels, frame: int, difficulty: int | None) -> None:
    """Add one label; of several for one frame the easiest counts."""
    labels[frame] = labels.get(frame, False) or difficulty in (1, 2)


def _chosen(table: pa.Table) -> dict[tuple[int, str], str]:
    """(track, attribute) -> the one value of all frames where it is easy to tell."""
    votes: dict[tuple[int, str], set[str]] = defaultdict(set)
    for track, attribute, value, difficulty in distinct_rows(table, "track", "attribute", "value", "difficulty"):
        if value is not None and difficulty in (1, 2):
            votes[track, attribute].add(value)
    return {topic: min(values) for topic, values in votes.items() if len(values) == 1}


def _faces(table: pa.Table) -> dict[tuple[int, int], bool]:
    """(frame, track) -> whether head, right eye or left eye, the first three points, is marked visible (2)."""
    points = table["keypoints"].combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(-1, 51)
    seen = (points[:, [2, 5, 8]] == 2).any(axis=1).tolist()
    return {(frame, track): face for (frame, track), face in zip(rows(table, "frame", "track"), seen, strict=True)}


AXES: Final = {"ahead": 180.0, "left": 90.0, "behind": 0.0, "right": 270.0}
"""The panorama angle of the axis of each of the robot's sectors."""

_BEGINS_M: Final = dict(zip(DISTANCE_WORDS, (0.0, *DISTANCE_BOUNDS_M), strict=True))
"""Metres at which each distance word begins."""

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
"""Sectors of a person, in degrees turned to the left: where each is true from and to, and where it may be."""


def _stands(sector: str, turn_deg: float) -> int:
    """Whether somebody in this direction, degrees to the left of straight ahead, is in a sector."""
    low, high, least, most = _SIDES[sector]
    turns = [turn_deg % 360 + 360 * lap for lap in (-1, 0, 1)]
    if any(low - SLACK <= turn <= high + SLACK for turn in turns):
        return TRUE
    return UNKNOWN if any(least - SLACK <= turn <= most + SLACK for turn in turns) else FALSE


class _Solid(NamedTuple):
    """A 3D box with lidar points: its centre in the robot frame, its heading in radians, its distance in metres."""

    x: float
    y: float
    z: float
    heading: float
    distance: float


class RelationFacts(SocialFacts):
    """The places of the people of one sequence, from 2D and 3D boxes."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._solids: dict[tuple[int, int], _Solid] = {}
        columns = ("frame", "track", "cx", "cy", "cz", "rot_z", "distance", "num_points")
        for frame, track, x, y, z, turned, metres, points in rows(tables["boxes_3d"], *columns):
            if points:
                away = math.hypot(x, y) if metres is None else metres
                self._solids[frame, track] = _Solid(x, y, z, math.pi - turned, away)
        self._firsts: dict[tuple[int, int, int], dict[int, int]] = {}

    # -- from the robot -----------------------------------------------------------------------------------------

    def distance(self, track: int, frame: int) -> float | None:
        """Metres from the robot where the person has a 2D box, and a 3D box with lidar points."""
        solid = self._solid(track, frame)
        return None if solid is None else solid.distance

    def _solid(self, track: int, frame: int) -> _Solid | None:
        return self._solids.get((frame, track)) if self.box(track, frame) is not None else None

    def in_sector(self, track: int, word: str, frame: int) -> int:
        """Whether the person, who has a box at the frame, stands in this direction from the robot."""
        load, off = self.rules.load, abs((self.angle(track, frame) - AXES[word] + 180) % 360 - 180)
        if off <= load.sector_true_deg + SLACK:
            return TRUE
        return UNKNOWN if off <= load.sector_false_deg + SLACK else FALSE

    def distance_words(self, track: int, frame: int) -> list[str]:
        """The distance words that could be right of the person: two near a bound, all where nothing is known."""
        metres = self.distance(track, frame)
        return list(DISTANCE_WORDS) if metres is None else self._words(metres)

    def _words(self, metres: float) -> list[str]:
        margin = self.rules.load.distance_margin
        lows = (-math.inf, *(bound * (1 - margin) - SLACK for bound in DISTANCE_BOUNDS_M))
        highs = (*(bound * (1 + margin) + SLACK for bound in DISTANCE_BOUNDS_M), math.inf)
        return [word for word, low, high in zip(DISTANCE_WORDS, lows, highs, strict=True) if low <= metres <= high]

    # -- from a person, in space --------------------------------------------------------------------------------

    def seen_from(self, track: int, other: int, sector: str, word: str, frame: int) -> int:
        """Whether another person is in this sector of a person's, at the distance of this word."""
        here, there = self._solid(track, frame), self._solid(other, frame)
        if here is None or there is None:
            return UNKNOWN
        load = self.rules.load
        ahead, left, up = there.x - here.x, there.y - here.y, there.z - here.z
        metres = math.sqrt(ahead**2 + left**2 + up**2)
        if metres > load.pair_max_m + load.pair_margin_m + SLACK:
            return FALSE
        words = [word for word in self._words(metres) if _BEGINS_M[word] < load.pair_max_m]
        towards = _stands(sector, math.degrees(math.atan2(left, ahead) - here.heading))
        if word not in words or towards == FALSE:
            return FALSE
        level = abs(up) <= load.pair_vertical_m
        near = metres < load.pair_max_m - load.pair_margin_m - SLACK
        return TRUE if len(words) == 1 and towards == TRUE and level and near else UNKNOWN

    # -- from a person, as the robot sees it --------------------------------------------------------------------

    def turn(self, track: int, other: int, frame: int, left: bool) -> float:
        """Degrees, [0, 360), from one person to another, turning to the left or to the right."""
        apart = (self.angle(other, frame) - self.angle(track, frame)) % 360.0 % 360.0
        return (360.0 - apart if apart > 0 else 0.0) if left else apart

    def first_beside(self, track: int, other: int, frame: int, left: bool) -> int:
        """Whether another person is the first met when turning from a person to one side."""
        key = (track, frame, int(left))
        if key not in self._firsts:
            self._firsts[key] = self._meet(track, frame, left)
        return self._firsts[key].get(other, FALSE)

    def _meet(self, track: int, frame: int, left: bool) -> dict[int, int]:
        """Everybody who is or could be the first met: one person for certain, or several perhaps."""
        margin, reach = self.rules.load.neighbor_margin_deg, self.rules.load.neighbor_max_deg
        turns = {
            other: self.turn(track, other, frame, left) for other in self.uncovered_people(frame) if other != track
        }
        settling = [other for other, turn in turns.items() if margin <= turn <= reach and self.clear(other, frame)]
        if not settling:
            return {other: UNKNOWN for other, turn in turns.items() if turn <= reach}
        nearest = min(turns[other] for other in settling)
        met = [other for other, turn in turns.items() if turn < nearest + margin]
        return dict.fromkeys(met, TRUE if len(met) == 1 else UNKNOWN)

    def within(self, track: int, other: int, degrees: int, frame: int, left: bool) -> int:
        """Whether another person is at most so far to one side of a person."""
        margin, turn = self.rules.load.neighbor_margin_deg, self.turn(track, other, frame, left)
        if min(turn, 360.0 - turn) <= margin or abs(turn - degrees) <= margin:
            return UNKNOWN
        return int(turn < degrees)
