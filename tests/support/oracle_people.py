"""Who can be told from whom, and who stands how to whom, at one keyframe: by brute force from the raw JSON.

Plain Python over the facts of `oracle_facts.Oracle`: conditions of people, the descriptions that single them out, and
relations between people, each true, false or unknown. Vocabularies are written out again.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from functools import cache, cached_property

from oracle_facts import LABELED, Oracle, distance_words, off_axis
from oracle_reading import read_root
from oracle_words import AGES, OTHERS, POSES, TOGETHER, VERBS

GENDERS = ("male", "female")
GROUP = "in the same group as"
FIRST = ("first to the left of (robot view)", "first to the right of (robot view)")
PLACES = tuple(
    f"{sector}, {word}"
    for sector in ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
    for word in ("very close", "close", "moderate")
)
WINDOWS = {
    f"within {degrees} degrees to the {side} of (robot view)": (degrees, side)
    for degrees in (30, 45, 60, 90)
    for side in ("left", "right")
}
RELATIONS = (*TOGETHER, GROUP, *FIRST, *PLACES)
KINDS = ("gender", "age", "pose", "action", "object", "interaction", "group_size", "sector", "distance")
YES, NO, MAYBE = "true", "false", "unknown"
EMPTY, SEVERAL = "empty", "several"


def text(value):
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def poses_in(words):
    """The poses that somebody who reads these words of a relation or of handling a thing takes for granted."""
    if words in FIRST or words in PLACES or words in WINDOWS or words == GROUP:
        return set()
    first = words.split()[0]
    named = {"walking", "standing", "sitting", "bending", "cycling", "running"} & {first}
    named |= {"cycling", "skating", "scootering"} if first == "riding" else set()
    up, down = ("going upstairs", "going up", "climbing"), ("going downstairs", "going down")
    named |= {"going upstairs"} if any(words in (w, f"{w} together") for w in up) else set()
    return named | ({"going downstairs"} if any(words in (w, f"{w} together") for w in down) else set())


def condition_poses(condition):
    """The poses that a condition's words name."""
    kind, value = condition
    if kind == "pose":
        return {value}
    return poses_in(value if kind == "interaction" else value[1]) if kind in ("interaction", "object") else set()


class People(Oracle):
    def __init__(self, root, sequence):
        super().__init__(read_root(root, sequence), sequence)
        self.state = cache(self.state)
        self.clear = cache(self.clear)
        self.rows = self.tables()
        for name in LABELED:
            self.rows[name] += self.rows[f"possible_{name}"]
        self.layers = set(self.rows["sequence"][0]["layers"])
        self.sights = {(row["frame"], row["track"]): row for row in self.rows["sightings"]}
        self.told = {row["track"]: row for row in self.rows["persons"]}
        self.things = {(row["object"], row["category_id"]): row["category"] for row in self.rows["objects"]}
        self.pictures = set(self.found.frames.get("images", ()))
        self.value = cache(self._value)
        self.related = cache(self._related)
        self.step = cache(self._step)
        self.fits = cache(self._fits)
        self.description = cache(self._description)

    # -- conditions --

    def _value(self, condition, frame, track):
        """Whether a condition, (kind, value), is true, false or unknown of a person with a box."""
        kind, wanted = condition
        sight = self.sights[frame, track]
        if kind in ("pose", "action"):
            return self.state(frame, track, wanted)
        if kind == "object":
            return self._handles_thing(frame, track, *wanted)
        if kind == "interaction":
            found = {self.related(frame, track, wanted, other) for other in self.in_frame(frame) if other != track}
            return YES if YES in found else MAYBE if MAYBE in found else NO
        if kind in ("gender", "age"):
            could = {self.told[track][kind]} & {*GENDERS, *AGES}
            # Nobody sees where an age ends: to its neighbours it is unknown.
            if kind == "age" and could and abs(AGES.index(wanted) - AGES.index(min(could))) == 1:
                return MAYBE
        elif kind == "group_size":
            could = {sight["group_size"]}
        elif kind == "sector":
            off = off_axis(self.angle(frame, track), wanted)
            return YES if off <= 40 + 1e-9 else MAYBE if off <= 90 + 1e-9 else NO
        else:
            could = set() if sight["distance"] is None else set(distance_words(sight["distance"]))
        could -= {None}
        if not could:
            return MAYBE
        return NO if wanted not in could else YES if could == {wanted} else MAYBE

    def _handles_thing(self, frame, track, category, verb):
        possible = False
        for row in self.handled.get(track, ()):
            what = self.things[row["object"], row["category_id"]]
            if row["verb"] == verb and row["first"] <= frame <= row["last"] and what in (category, None):
                if row["certain"] and what == category:
                    return YES
                possible = True
        return NO if self.sights[frame, track]["handles_listed"] and not possible else MAYBE

    @cached_property
    def handled(self):
        by_track = {}
        for row in self.rows["handles"]:
            by_track.setdefault(row["track"], []).append(row)
        return by_track

    @cached_property
    def pairs(self):
        """Everything done with a thing, as (category, verb), by verbs of the label list that are no poses."""
        every = {(self.things[row["object"], row["category_id"]], row["verb"]) for row in self.rows["handles"]}
        return {(category, verb) for category, verb in every if category is not None and verb in VERBS}

    def conditions(self, frame, track):
        """Everything that is certainly true of a person and may be said of it, as (kind, value)."""
        size = self.sights[frame, track]["group_size"]
        every = [("pose", pose) for pose in POSES] + [("action", action) for action in OTHERS]
        if "pose" not in self.layers or self.sights[frame, track]["face_visible"]:
            every += [("gender", word) for word in GENDERS] + [("age", word) for word in AGES]
        every += [("object", pair) for pair in self.pairs]
        every += [("interaction", label) for label in TOGETHER]
        every += [("group_size", size)] if size is not None else []
        every += [("sector", word) for word in ("ahead", "right", "behind", "left")]
        every += [("distance", word) for word in ("very close", "close", "moderate", "far", "very far")]
        return [condition for condition in every if self.value(condition, frame, track) == YES]

    # -- descriptions --

    def could_match(self, conditions, frame):
        return [
            track
            for track in self.in_frame(frame)
            if all(self.value(condition, frame, track) != NO for condition in conditions)
        ]

    def _fits(self, conditions, frame):
        """The one person who certainly matches while nobody else could, or EMPTY, SEVERAL or MAYBE."""
        return self.only({t: [self.value(c, frame, t) for c in conditions] for t in self.in_frame(frame)})

    @staticmethod
    def only(values):
        """{track: values that must all hold} -> who it is."""
        could = [track for track, all_of in values.items() if NO not in all_of]
        sure = [track for track in could if set(values[track]) <= {YES}]
        if len(could) == 1 and sure:
            return could[0]
        return SEVERAL if len(sure) > 1 else MAYBE if could else EMPTY

    def _description(self, frame, track, poseless=False):
        """The one description of a person, or None."""
        true = [c for c in self.conditions(frame, track) if not (poseless and condition_poses(c))]
        for size in (1, 2, 3):
            fits = []
            for conditions in itertools.combinations(true, size):
                if all(kind in ("sector", "distance") for kind, _ in conditions):
                    continue
                if self.could_match(conditions, frame) == [track]:
                    said = text(self.plain(conditions))[1:-1]
                    digest = hashlib.sha256(f"{self.sequence}\n{track}\n{frame}\n{said}".encode()).hexdigest()
                    fits.append((sorted(KINDS.index(kind) for kind, _ in conditions), digest, conditions))
            if fits:
                return min(fits)[2]
        return None

    @staticmethod
    def plain(conditions, at="t0"):
        """Conditions as a plan holds them: by kind, then by their text."""
        rows = []
        for kind, value in conditions:
            if kind in ("pose", "action"):
                row = {"action": value}
            elif kind == "object":
                row = {"object": value[0], "verb": value[1]}
            elif kind == "interaction":
                row = {"interaction": value}
            else:
                row = {"attribute": kind, "value": value}
            rows.append((KINDS.index(kind), row if kind in ("gender", "age") else row | {"at": at}))
        return [row for _, row in sorted(rows, key=lambda ranked: (ranked[0], json.dumps(ranked[1])))]

    def anchored(self, track, frame, poseless=False):
        """The description, if each of its conditions is needed and the person is seen; else None."""
        conditions = self.description(frame, track, poseless)
        if conditions is None or not self.clear(frame, track) or not self.shown(frame):
            return None
        for dropped in conditions:
            rest = [condition for condition in conditions if condition != dropped]
            if len(self.could_match(rest, frame)) < 2:
                return None
        return conditions

    # -- relations --

    @cached_property
    def spans(self):
        """{(source, label, target): [(first, last, certain)]}; of members of groups {(track, cluster): ...}."""
        found = {}
        for table in ("interactions", "beside", "memberships"):
            for row in self.rows[table]:
                key = (
                    (row["track"], row["cluster"]) if "cluster" in row else (row["source"], row["label"], row["target"])
                )
                found.setdefault(key, []).append((row["first"], row["last"], row["certain"]))
        return found

    def _stands(self, frame, key):
        """True, unknown, or None where nothing says so."""
        certain = [sure for first, last, sure in self.spans.get(key, ()) if first <= frame <= last]
        return None if not certain else YES if any(certain) else MAYBE

    def groups_of(self, frame, track):
        clusters = [key[1] for key in self.spans if len(key) == 2 and key[0] == track]
        stands = {cluster: self._stands(frame, (track, cluster)) for cluster in clusters}
        return {cluster: state for cluster, state in stands.items() if state is not None}

    def tells(self, frame, track, label):
        """Whether all of a person's relations of this kind are known."""
        if label == GROUP:
            return bool(self.groups_of(frame, track))
        column = "interactions_listed" if label in TOGETHER else "located" if label in PLACES else None
        return column is None or self.sights[frame, track][column]

    def _related(self, frame, source, label, target):
        """Whether a relation between two different people with a box in the frame holds."""
        if label in WINDOWS:
            return self._in_window(frame, source, label, target)
        if label == GROUP:
            mine, theirs = self.groups_of(frame, source), self.groups_of(frame, target)
            found = [{mine[cluster], theirs[cluster]} for cluster in set(mine) & set(theirs)]
            stands = None if not found else YES if {YES} in found else MAYBE
        else:
            stands = self._stands(frame, (source, label, target))
        if stands is not None:
            return stands
        return NO if self.tells(frame, source, label) and self.tells(frame, target, label) else MAYBE

    def _in_window(self, frame, source, label, target):
        degrees, side = WINDOWS[label]
        here, there = self.angle(frame, source), self.angle(frame, target)
        turn = (here - there if side == "left" else there - here) % 360
        if min(turn, 360 - turn) <= 1 or abs(turn - degrees) <= 1:
            return MAYBE
        return YES if turn < degrees else NO

    def _step(self, frame, source, label):
        """The one person to whom a relation leads, or EMPTY, SEVERAL or MAYBE."""
        others = [track for track in self.in_frame(frame) if track != source]
        return self.only({other: [self.related(frame, source, label, other)] for other in others})

    # -- what is seen --

    def shown(self, frame):
        return not self.pictures or frame in self.pictures

    def ahead(self, frame, track):
        """At least half of the box lies within the 480 columns round the middle of the panorama."""
        return self._in_crop(1640, frame, track)

    def _in_crop(self, left, frame, track):
        x, w = self.people[frame, track]["x"], self.people[frame, track]["w"]
        turns = (turn * 3760 for turn in range(-3, 4))
        return any(min(x + turn + w, left + 480) - max(x + turn, left) >= w / 2 for turn in turns)

    def one_view(self, boxes):
        """Whether a crop, which begins at a whole column, shows half of each of these (frame, track).

        Then the last such crop shows no more than half of one of them, so it begins next to its middle.
        """
        middles = [round(self.angle(*box) / 360 * 3760) for box in boxes]
        lefts = [middle + by for middle in middles for by in range(-3, 4)]
        return any(all(self._in_crop(left % 3760, *box) for box in boxes) for left in lefts)

    def seen(self, frame, track):
        """True present, False absent, None unknown."""
        if self.clear(frame, track):
            return True
        around = (frame - 15, frame, frame + 15)
        gone = all(f in self.known_2d and (f, track) not in self.people for f in around)
        return False if gone else None
